"""The tracking experiment and the scores of Table 5.17 on hand-made tracks."""

import numpy as np
import pandas as pd
import pytest
from identify import tracker_limits

from kilnflight import tracklets
from kilnflight.experiments.flights import textures, trackers, tracking
from kilnflight.experiments.flights import track_scores as scores
from kilnflight.tracking.tracker import track

LANCE = scores.Lance(row=500.0, col=900.0, depth_mm=6500.0)


class Flat:
    """Frame differences: one everywhere."""

    shape = (999, 1536, 2048)

    def __getitem__(self, box):
        return np.ones([side.stop - side.start for side in box])


def path(particle, row=500.0, col=900.0, z=6500.0, frames=range(20)):
    """A track that leaves a place to the right and towards the camera."""
    age = np.arange(len(frames))
    table = {
        "frame": list(frames),
        "particle": particle,
        "row": row,
        "col": col + 20.0 * age,
    }
    return pd.DataFrame({**table, "x": 0.0, "y": 0.0, "z": z - 30.0 * age})


def window_of(fraction, length, seen, truth):
    """A window whose true positions are all noted."""
    return tracking.Window(
        fraction=fraction,
        frames=range(length),
        detections=seen,
        truth=truth,
        visible=truth,
        differences=Flat(),
        lance=LANCE,
    )


def test_each_part_is_replaced_by_the_truth():
    truth = pd.concat(
        [path(k, row=row, frames=range(30)) for k, row in ((7, 400.0), (8, 600.0))]
    )
    seen = truth.drop(columns="particle")[truth["frame"] % 10 != 5].assign(points=40)
    clutter = seen.iloc[::9].assign(row=lambda t: t["row"] + 90.0)
    seen = pd.concat([seen, clutter]).sort_values("frame", ignore_index=True)
    window = window_of("confetti", 30, seen, truth)
    owner = tracking.true_particles(seen, truth)
    assert set(owner) == {-1, 7, 8}
    assert (owner == -1).sum() == 6
    linked = seen.assign(particle=owner)
    right_only = linked[owner >= 0].drop(columns="particle").reset_index(drop=True)

    def scored(detections):
        replaced = [window._replace(detections=detections)]
        found = tracking.cells(replaced, tracking.follow_all(replaced, {"GNN": track}))
        return scores.tabulate(found).set_index("postprocessing")

    assert scored(truth.drop(columns="particle")).loc[
        "without", "alpha"
    ] == pytest.approx(1.0)
    links = tracking.cells(
        [window], {("confetti", "links"): {scores.STAGES[0]: linked}}
    )
    links = scores.tabulate(links).iloc[0]
    assert links["jsc_theta"] == 1.0
    assert links["alpha"] == pytest.approx(54 / 60)
    right = scored(right_only).loc["without"]
    before, after = (scored(seen).loc[stage] for stage in scores.STAGES)
    assert right["beta"] >= before["beta"]
    assert right["fp_tracks"] == 0
    assert after["alpha"] >= before["alpha"] > 0.85
    assert after["tp_tracks"] == 2


def test_defaults_of_the_steps_are_those_of_table_5_16():
    elimination, outliers, connection, fusion = tracklets.STEPS
    assert elimination == tracklets.Elimination(duration=2, speed=1.0, regularity=0.9)
    assert (outliers.angle_deg, outliers.change) == (30.0, 18.0)
    assert (connection.gap, connection.overlap, connection.depth) == (15, 5, 1500.0)
    assert fusion.distance == 10.0
    assert tuple(vars(connection.costs).values()) == (2.0, 2.0, 0.1, 1.0, 2.0, 1e11)


def test_what_starts_at_the_lance_is_kept_and_what_continues():
    elsewhere, short = path(1, col=1300.0), path(2, frames=range(50, 64))
    in_front, no_depth = path(3, z=5000.0), path(4, z=np.nan)
    backwards = path(5).assign(frame=lambda t: t["frame"].to_numpy()[::-1])
    tracks = pd.concat(
        [path(-1), path(0), elsewhere, short, in_front, no_depth, backwards]
    )
    assert sorted(scores.from_lance(tracks, LANCE)["particle"].unique()) == [0, 2, 4]
    gap = path(6, frames=[50, 51, 64])
    assert sorted(scores.lasting(pd.concat([tracks, gap]))["particle"].unique()) == [
        0,
        1,
        3,
        4,
        5,
        6,
    ]


def test_short_true_trajectories_do_not_count_and_short_false_tracks_do():
    """Two of three true trajectories last; one false track of three frames is at the
    lance.
    """
    short, false = (
        path(2, row=600.0, frames=range(14)),
        path(3, row=640.0, frames=range(3)),
    )
    truth = pd.concat(
        [path(0), path(1, row=430.0), short, path(4, col=1300.0, row=900.0)]
    )
    tracks = pd.concat(
        [path(5), path(6, row=200.0, col=1300.0), path(7, row=430.0), false]
    )
    score = scores.score_from_lance(truth, tracks, LANCE)
    assert (score.tp_tracks, score.fn_tracks, score.fp_tracks) == (2, 0, 1)
    assert (score.alpha, score.beta, score.jsc) == (1.0, 40 / 43, 40 / 43)
    dropped = scores.score_from_lance(truth, scores.lasting(tracks), LANCE)
    assert dropped.beta == dropped.jsc_theta == 1.0
    assert scores.score_from_lance(short, tracks, LANCE) is None


def test_limits_of_tracks_are_identified_by_raw_jsc_theta(monkeypatch):
    """A window whose two flights are hidden in one frame each; print has one track per
    flight.
    """
    truth = pd.concat([path(0), path(1, row=600.0)])
    hidden = (truth["frame"] == 5) | ((truth["frame"] == 1) & (truth["particle"] == 1))
    seen = (
        truth[~hidden].drop(columns="particle").sort_values("frame", ignore_index=True)
    )
    window = window_of("confetti", 20, seen, truth)
    limits = [(0.0, 0), (0.6, 1), (0.5, 1)]
    keys = {"fraction": "confetti", "measure": "jsc_theta", "postprocessing": "without"}
    for printed, best, values in (
        (1.0, (0.5, 1), [1.0, 2 / 3, 2 / 5]),  # nothing is cut
        # only the first sighting of the second flight
        (0.6, (0.6, 1), [2 / 3, 2 / 5, 1.0]),
        (0.4, (0.0, 0), [2 / 5, 2 / 3, 1.0]),  # at each miss
    ):
        table = pd.DataFrame(
            [keys | {"tracker": t, "published": printed} for t in scores.TRACKERS]
        )
        monkeypatch.setattr(scores, "published", lambda table=table: table)
        found = tracker_limits.identify([window], limits)
        assert tuple(found.loc[0, ["visibility", "missed_frames"]]) == best
        np.testing.assert_allclose(found["confetti, GNN"], values)
        both = (found[["confetti, GNN", "confetti, JPDA"]] - printed) ** 2
        np.testing.assert_allclose(found["misfit"], both.sum(axis=1))


def test_trackers_are_as_their_table_says():
    """What decides each setting is named."""
    table = trackers.settings()
    assert set(table["decided_by"]) == {"identified", "assumption"}
    best = trackers.limits().sort_values("misfit", kind="stable").iloc[0]
    assert (
        table.loc["missed_frames", list(scores.TRACKERS)] == best["missed_frames"]
    ).all()
    tracker = trackers.chosen("GNN", missed_frames=7).keywords
    assert tracker["management"].invisible == 7
    assert tracker["gate"].distance == table.loc["gate", "GNN"]
    assert trackers.chosen("JPDA").keywords["gate"].distance < tracker["gate"].distance


def test_gaps_of_the_truth_become_straight_lines():
    truth = path(4, frames=[5, 6, 9]).drop(columns="x").assign(x=[0.0, 3.0, 0.0])
    filled = tracking.without_gaps(pd.concat([truth, path(2, frames=[7])]))
    assert filled["particle"].tolist() == [2, 4, 4, 4, 4, 4]
    assert filled["frame"].tolist() == [7, 5, 6, 7, 8, 9]
    np.testing.assert_allclose(filled["x"], [0.0, 0.0, 3.0, 2.0, 1.0, 0.0])


def test_joints_are_those_of_the_connection_in_their_order():
    """Three pieces of one flight, the last two of which overlap in two frames."""
    whole = path(0, frames=range(30))
    pieces = {7: whole[:10], 3: whole[14:22], 5: whole[20:]}
    tracks = pd.concat([each.assign(particle=k) for k, each in pieces.items()])
    tracks = tracks.reset_index(drop=True)
    connection = tracklets.Connection()
    found = textures.joints(tracks, connection, None)
    assert set(found["kind"]) == {"connection", "merging"}
    assert set(found["earlier"]) | set(found["later"]) == {3, 5, 7}
    gap = found[found["kind"] == "connection"].iloc[0]
    assert (gap["earlier"], gap["later"]) == (7, 3)
    assert (gap["start_col"], gap["end_col"]) == (900.0 + 9 * 20, 900.0 + 14 * 20)
    assert (found["first_frame"].min(), found["last_frame"].max()) == (0, 29)
    assert len(found) == 3 - connection(tracks)["particle"].max() - 1
    nothing = textures.joints(tracks.assign(particle=-1), connection, None)
    assert list(nothing) == list(found)


def right(seen):
    """Label by time, which is right in the windows of `cells`."""
    return seen.assign(particle=seen["frame"] // 30)


def half(seen):
    """Follow every other trajectory only."""
    return right(seen).assign(
        particle=lambda t: t["particle"].where(t["particle"] % 2 == 0, -1)
    )


@pytest.fixture(scope="module")
def cells():
    truth = pd.concat([path(k, frames=range(30 * k, 30 * k + 20)) for k in range(12)])
    seen = truth.drop(columns="particle").reset_index(drop=True)
    windows = [window_of(name, 360, seen, truth) for name in scores.SINGULARS.values()]
    return tracking.cells(
        windows, tracking.follow_all(windows, {"GNN": right, "JPDA": half})
    )


def test_every_cell_has_its_interval_and_stands_beside_the_print(cells):
    table = scores.tabulate(cells)
    assert len(table) == 4 * 2 * 2
    for name in scores.MEASURES:
        assert table[name].between(table[f"{name}_low"], table[f"{name}_high"]).all()
    assert (table.loc[table["tracker"] == "JPDA", "alpha"] == 0.5).all()
    beside = scores.beside_published(table)
    assert len(beside) == 64
    assert beside["published"].between(0, 1).all()


def test_differences_are_paired_means_of_both_sides(cells):
    jpda = scores.Group(list(scores.SINGULARS.values()), ["JPDA"], "with")
    gnn = jpda._replace(trackers=["GNN"])
    row = scores.difference(cells, jpda, gnn, ["alpha", "beta"])
    labels = [row[name] for name in (*scores.KEYS, "measure")]
    assert labels == ["mean of fractions", "JPDA - GNN", "with", "alpha, beta"]
    assert row["recomputed"] == pytest.approx(-0.5)
    assert row["low"] < -0.5 < row["high"] < 0
    printed = scores.published().query(
        "postprocessing == 'with' and measure in ['alpha', 'beta']"
    )
    mean = printed.groupby("tracker")["published"].mean()
    assert row["published"] == pytest.approx(mean["JPDA"] - mean["GNN"])
    after = scores.Group(["confetti"], scores.TRACKERS, "with")
    before = after._replace(stage="without")
    same = scores.difference(cells, after, before, ["jsc"])
    assert (same["tracker"], same["postprocessing"]) == ("both", "with - without")
    # nothing to mend
    assert (same["recomputed"], same["low"], same["high"]) == (0.0, 0.0, 0.0)
    assert scores.differences(cells)["claim"].nunique() == 7
