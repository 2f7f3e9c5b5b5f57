"""Both readings of Table 5.17 on hand-made tracks."""

import re

import numpy as np
import pandas as pd
import pytest

from kilnflight.checks import InputError
from kilnflight.experiments import tracking, tracking_claims
from kilnflight.experiments import tracking_scores as scores
from kilnflight.experiments.tracking_scores import AFTERWARDS, ALL, FROM_LANCE, FromLance, Lance
from kilnflight.experiments.tuning import ANY_GATE, Reported
from kilnflight.project import claims

LANCE = Lance(row=500.0, col=900.0, depth_mm=6500.0)
FRACTIONS = ("wood chip", "confetti", "paper shred", "PE granule")


def path(particle, row=500.0, col=900.0, z=6500.0, frames=range(20), **more):
    """A track that leaves a place to the right and towards the camera."""
    age = np.arange(len(frames))
    table = {"frame": list(frames), "particle": particle, "row": row, "col": col + 20.0 * age}
    return pd.DataFrame({**table, "z": z - 30.0 * age, **more})


def kept(*tracks, rule=None):
    rule = rule or FromLance()
    return sorted(rule(pd.concat(tracks, ignore_index=True), LANCE)["particle"].unique())


def test_what_starts_at_the_lance_and_continues_is_kept():
    elsewhere, late = path(1, col=1300.0), path(2, frames=range(50, 64))
    in_front, no_depth = path(3, z=5000.0), path(4, z=np.nan)
    assert kept(path(0), elsewhere, late, in_front, no_depth) == [0, 4]
    assert kept(late, rule=FromLance(frames=14)) == [2]
    assert kept(elsewhere, rule=FromLance(within_px=450.0)) == [1]
    assert kept(in_front, rule=FromLance(within_mm=1600.0)) == [3]


def test_one_wrong_position_or_depth_does_not_decide():
    astray = path(0)
    astray.loc[0, ["row", "z"]] = 1400.0, 900.0
    assert kept(astray) == [0]
    astray.loc[1, "row"] = 1400.0
    assert kept(astray) == []
    assert kept(path(0).assign(z=lambda t: t["z"].where(t.index > 1))) == [0]


def test_what_arrives_at_the_lance_does_not_start_there():
    backwards = path(0).assign(frame=lambda t: t["frame"].to_numpy()[::-1])
    assert kept(backwards) == []


@pytest.mark.parametrize("frames", [[3], [3, 4], [3, 4, 6]])
def test_tracks_of_few_detections_do_not_continue(frames):
    assert kept(path(0, frames=frames)) == []
    assert kept(path(0, frames=frames), path(1)) == [1]


def test_a_track_lasts_from_its_first_to_its_last_frame():
    assert kept(path(0, frames=[3, 17])) == [0]
    assert kept(path(0, frames=[3, 16])) == []


def test_rows_in_no_track_and_empty_tables():
    assert kept(path(-1)) == []
    assert len(FromLance()(path(0)[:0], LANCE)) == 0


@pytest.mark.parametrize(
    "change", [{"within_px": 0.0}, {"within_mm": -1.0}, {"points": 0}, {"frames": 0}]
)
def test_a_rule_without_a_size_is_refused(change):
    with pytest.raises(InputError, match="FromLance"):
        FromLance(**change)


def test_a_lance_without_a_place_is_refused():
    with pytest.raises(InputError, match="lance"):
        FromLance()(path(0), Lance(np.nan, 900.0, 6500.0))
    with pytest.raises(InputError, match="Give its row"):
        scores.score_reading(FROM_LANCE, path(0), path(0), None)
    with pytest.raises(InputError, match="no reading 'some'"):
        scores.score_reading("some", path(0), path(0), LANCE)


def test_the_restriction_to_the_lance_holds_for_truth_and_tracks_in_both_stages():
    """Section 5.2.1. The third reading has "direct tracking outcomes" whole (4.2.5, 5.2.3)."""
    away = path(1, row=1200.0)
    both = pd.concat([path(0), away])

    def jsc_theta(reading, stage):
        return scores.score_reading(reading, both, both, LANCE, stage).jsc_theta

    assert jsc_theta(AFTERWARDS, "without") == 0.5  # the track from elsewhere is a false one
    assert jsc_theta(AFTERWARDS, "with") == 1.0
    assert [jsc_theta(FROM_LANCE, stage) for stage in scores.STAGES] == [1.0, 1.0]
    assert [jsc_theta(ALL, stage) for stage in scores.STAGES] == [1.0, 1.0]


def test_truth_and_tracks_are_restricted_alike():
    truth = pd.concat([path(0), path(1, col=1300.0, row=900.0)])
    tracks = pd.concat([path(5), path(6, row=200.0, col=1300.0), path(7, row=430.0)])
    every = scores.measures_of(scores.score_reading(ALL, truth, tracks, LANCE))
    here = scores.measures_of(scores.score_reading(FROM_LANCE, truth, tracks, LANCE))
    assert (every["alpha"], every["jsc_theta"]) == (0.5, 0.25)
    assert (here["alpha"], here["beta"], here["jsc_theta"]) == (1.0, 0.5, 0.5)


def test_no_track_from_the_lance_scores_nothing_and_no_truth_is_no_score():
    away = path(0, row=1200.0)
    nothing = scores.measures_of(scores.score_reading(FROM_LANCE, path(0), away, LANCE))
    assert [nothing[name] for name in scores.MEASURES] == [0.0] * 4
    assert (nothing["fn_tracks"], nothing["fp_tracks"]) == (1.0, 0.0)
    score = scores.score_reading(FROM_LANCE, away, path(0), LANCE)
    assert score is None
    row = scores.row_of(scores.scored(("a", "GNN", "with", FROM_LANCE), score, (1, 1, 1)))
    assert np.isnan([row[name] for name in scores.MEASURES]).all()
    assert np.isnan([row["alpha_low"], row["jsc_theta_high"]]).all()


def window_of(fraction, truth, detections=None):
    seen = truth.drop(columns="particle") if detections is None else detections
    frames = range(int(truth["frame"].min()), int(truth["frame"].max()) + 1)
    return tracking.Window(fraction, "made up", frames, seen, truth, Flat(), LANCE)


class Flat:
    """Frame differences: one everywhere."""

    shape = (1536, 2048)

    def __call__(self, first, last, top, left, bottom, right):
        return np.ones((bottom - top, right - left)) * (last - first + 1)


def many(count):
    """True trajectories one after the other, so that a label by time is right."""
    parts = [path(k, frames=range(30 * k, 30 * k + 20), x=0.0, y=0.0) for k in range(count)]
    return pd.concat(parts, ignore_index=True)


def right(seen):
    return seen.assign(particle=seen["frame"] // 30)


def first_half(seen):
    """Follow every other trajectory only."""
    return right(seen).assign(particle=lambda t: t["particle"].where(t["particle"] % 2 == 0, -1))


def test_the_objective_is_the_mean_of_what_is_reported():
    away = many(8).assign(row=1200.0, particle=lambda t: t["particle"] + 100)
    both = window_of("confetti", pd.concat([many(8), away], ignore_index=True))
    alone, nowhere = window_of("wood chip", many(8)), window_of("PE granule", away)

    def tracker(seen):
        return right(seen).assign(particle=lambda t: t["particle"].where(t["row"] < 1000, -1))

    assert Reported([alone, both])(tracker)["alpha"] == 1.0
    assert Reported([alone])(first_half)["alpha"] == 0.5
    assert Reported([alone, nowhere])(first_half)["alpha"] == 0.5  # no truth, no part of the mean


@pytest.fixture(scope="module")
def cells():
    windows = [window_of(name, many(12)) for name in FRACTIONS]
    trackers = {"GNN": right, "JPDA": first_half, ANY_GATE: first_half}
    readings = (ALL, FROM_LANCE, AFTERWARDS)
    found = tracking.cells(windows, tracking.follow_all(windows, trackers), readings)
    return windows, {cell.key: cell for cell in found}


def test_every_cell_has_both_readings_and_its_interval(cells):
    table = scores.tabulate(cells[1].values())
    assert len(table) == 4 * 3 * 2 * 3
    for name in scores.MEASURES:
        assert (table[f"{name}_low"] <= table[name]).all()
        assert (table[name] <= table[f"{name}_high"]).all()
    half = table[(table["tracker"] == "JPDA") & (table["postprocessing"] == "without")]
    assert (half["alpha"] == 0.5).all()
    assert half["alpha_low"].between(0.1, 0.4).all()
    beside = tracking_claims.beside_table_5_17(table)
    assert len(beside) == 64
    assert set(beside["reading"]) == {FROM_LANCE}
    assert beside["published"].between(0, 1).all()
    assert beside["all_tracks"].notna().all()


def test_a_window_with_few_trajectories_says_nothing():
    window = window_of("wood chip", many(5))
    table = scores.tabulate(tracking.cells([window], tracking.follow_all([window], {"GNN": right})))
    assert (table["alpha"] == 1).all()
    assert table[["alpha_low", "alpha_high"]].isna().all(axis=None)


def test_claims_say_fewer_than_six_and_no_infinity():
    windows = [window_of(name, many(5)) for name in FRACTIONS]
    trackers = {"GNN": right, "JPDA": first_half, ANY_GATE: first_half}
    readings = (ALL, FROM_LANCE, AFTERWARDS)
    found = tracking.cells(windows, tracking.follow_all(windows, trackers), readings)
    verdicts = tracking_claims.verdicts({cell.key: cell for cell in found})
    words = " ".join(verdict.measured + verdict.reason for verdict in verdicts)
    assert "+0.00 [fewer than six trajectories]" in words
    assert not re.search(r"\b(inf|nan)\b", words)


def test_claims_are_judged_from_the_lance_and_time_decides_nothing(cells):
    found = tracking_claims.verdicts(cells[1])
    by_claim = {verdict.id: verdict for verdict in found}
    assert sorted(by_claim) == [f"track-{k}" for k in range(1, 7)]
    assert by_claim["track-6"].verdict == claims.NOT_DECIDABLE
    assert by_claim["track-6"].because == "criterion"
    assert by_claim["track-4"].verdict == claims.NOT_REPRODUCED  # half of all are not followed
    assert by_claim["track-4"].because == "method"
    assert "from the lance; all: not reproduced" in by_claim["track-4"].reason
    assert by_claim["track-3"].verdict == claims.NOT_REPRODUCED
    # all fractions are the same but for chance, so that no rank is known
    assert by_claim["track-5"].verdict == claims.NOT_DECIDABLE


def test_what_hangs_on_the_gate_of_jpda_is_not_decidable(cells):
    """Section 5.2.3 has no number for "smaller"; with any gate JPDA is as good as GNN here."""
    free = {
        (fraction, ANY_GATE, *rest): cell
        for (fraction, tracker, *rest), cell in cells[1].items()
        if tracker == "GNN"
    }
    by_claim = {found.id: found for found in tracking_claims.verdicts(cells[1] | free)}
    assert by_claim["track-4"].verdict == claims.NOT_DECIDABLE
    assert by_claim["track-4"].because == "method"
    assert "JPDA with any gate: not decidable" in by_claim["track-4"].reason


def test_a_smoke_run_leaves_the_claims_about_four_fractions_undecided(cells):
    some = {key: cell for key, cell in cells[1].items() if key[0] != "confetti"}
    found = tracking_claims.verdicts(some)
    assert {verdict.verdict for verdict in found} == {claims.NOT_DECIDABLE}


def test_where_chance_decides_a_claim_is_open(cells):
    table = dict(cells[1])
    for name in FRACTIONS:
        gnn = table[name, "GNN", "with", FROM_LANCE]
        table[name, "JPDA", "with", FROM_LANCE] = gnn
    assert list(tracking_claims._advantage(table, FROM_LANCE).values()) == [None]
    assert set(tracking_claims._comparable(table, FROM_LANCE).values()) == {True}
