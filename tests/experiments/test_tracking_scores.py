"""Scores of Table 5.17 on hand-made tracks."""

import numpy as np
import pandas as pd
import pytest

from kilnflight.experiments import tracking
from kilnflight.experiments import tracking_scores as scores

LANCE = scores.Lance(row=500.0, col=900.0, depth_mm=6500.0)


def path(particle, row=500.0, col=900.0, z=6500.0, frames=range(20), **more):
    """A track that leaves a place to the right and towards the camera."""
    age = np.arange(len(frames))
    table = {"frame": list(frames), "particle": particle, "row": row, "col": col + 20.0 * age}
    return pd.DataFrame({**table, "z": z - 30.0 * age, **more})


def kept(*tracks):
    found = scores.from_lance(pd.concat(tracks, ignore_index=True), LANCE)
    return sorted(found["particle"].unique())


def test_what_starts_at_the_lance_and_continues_is_kept():
    elsewhere, short = path(1, col=1300.0), path(2, frames=range(50, 64))
    in_front, no_depth = path(3, z=5000.0), path(4, z=np.nan)
    backwards = path(5).assign(frame=lambda t: t["frame"].to_numpy()[::-1])
    assert kept(path(0), elsewhere, short, in_front, no_depth, backwards) == [0, 4]
    assert kept(path(-1)) == []


def cell(truth, tracks):
    return scores.score_cell(("a", "GNN", "with"), truth, tracks, LANCE, (1, 1, 2))


def test_truth_and_tracks_are_restricted_alike():
    truth = pd.concat([path(0), path(1, col=1300.0, row=900.0)])
    tracks = pd.concat([path(5), path(6, row=200.0, col=1300.0), path(7, row=430.0)])
    found = scores.measures_of(cell(truth, tracks).score)
    assert (found["alpha"], found["beta"], found["jsc_theta"]) == (1.0, 0.5, 0.5)


class Flat:
    """Frame differences: one everywhere."""

    shape = (999, 1536, 2048)

    def __getitem__(self, box):
        return np.ones([side.stop - side.start for side in box])


def windows(count):
    """Windows in which a label by time is right."""
    parts = [path(k, frames=range(30 * k, 30 * k + 20), x=0.0, y=0.0) for k in range(count)]
    truth = pd.concat(parts, ignore_index=True)
    seen = truth.drop(columns="particle")
    names = scores.SINGULARS.values()
    return [tracking.Window(n, range(30 * count), seen, truth, Flat(), LANCE) for n in names]


def right(seen):
    return seen.assign(particle=seen["frame"] // 30)


def half(seen):
    """Follow every other trajectory only."""
    return right(seen).assign(particle=lambda t: t["particle"].where(t["particle"] % 2 == 0, -1))


@pytest.fixture(scope="module")
def cells():
    some = windows(12)
    return tracking.cells(some, tracking.follow_all(some, {"GNN": right, "JPDA": half}))


def test_every_cell_has_its_interval_and_stands_beside_the_print(cells):
    table = scores.tabulate(cells.values())
    assert len(table) == 4 * 2 * 2
    for name in scores.MEASURES:
        assert (table[f"{name}_low"] <= table[name]).all()
        assert (table[name] <= table[f"{name}_high"]).all()
    assert (table.loc[table["tracker"] == "JPDA", "alpha"] == 0.5).all()
    beside = scores.beside_published(table)
    assert len(beside) == 64
    assert beside["published"].between(0, 1).all()


def test_differences_are_paired_means_of_both_sides(cells):
    key = (scores.MEAN, "JPDA - GNN", "with")
    row = scores.difference(cells, key, "alpha, beta")
    assert row["recomputed"] == pytest.approx(-0.5)
    assert row["low"] < -0.5 < row["high"] < 0
    printed = scores.published().query("postprocessing == 'with' and measure in ['alpha', 'beta']")
    mean = printed.groupby("tracker")["published"].mean()
    assert row["published"] == pytest.approx(mean["JPDA"] - mean["GNN"])
    same = scores.difference(cells, ("confetti", scores.BOTH, "with - without"), "jsc")
    assert (same["recomputed"], same["low"], same["high"]) == (0.0, 0.0, 0.0)  # nothing to mend
    table = scores.differences(cells)
    assert table.groupby("claim").size().to_dict() == {
        "track-1": 32, "track-2": 12, "track-3": 8, "track-4": 1, "track-5": 5, "track-9": 1,
        "track-10": 1,
    }  # fmt: skip
