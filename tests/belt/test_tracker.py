"""The belt's tracker: appearing and leaving, the matrix of Fig. 3, scores, and what goes wrong."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment
from scipy.stats import multivariate_normal, norm

from kilnflight.belt.camera import TRACKED
from kilnflight.belt.evaluation import last_states
from kilnflight.belt.tracker import (
    BACK,
    LEFT,
    LOST,
    RUNNING,
    SIDEWAYS,
    Appearance,
    BeltTracker,
    Likelihoods,
    pair_costs,
)
from kilnflight.checks import InputError
from kilnflight.tables import BELT_ENDS, BELT_STATES
from kilnflight.tracking.filter import ConstantAcceleration, Detected, Gate

ACCELERATED = ConstantAcceleration((750.0, 0.0), 433.0, 2000.0, 4472.0, 0.127)
TRACKERS = (BeltTracker(), BeltTracker(ACCELERATED))


def moving(x=390.0, y=90.0, along=1200.0, across=0.0, frames=80, first=0, particle=0):
    time = 0.005 * np.arange(frames)
    columns = {"frame": first + np.arange(frames), "x": x + along * time, "y": y + across * time}
    return pd.DataFrame(columns).assign(particle=particle)


def crowd(seed, count=60):
    rng = np.random.default_rng(seed)
    parts = [
        moving(388 + rng.uniform(0, 6), rng.uniform(10, 170), rng.normal(1100, 50),
               rng.normal(0, 30), 80, int(rng.integers(0, 150)), k)
        for k in range(count)
    ]  # fmt: skip
    table = pd.concat(parts, ignore_index=True)
    table[["x", "y"]] += rng.normal(0, 0.05, (len(table), 2))
    return table[table["x"] < 700].reset_index(drop=True)


def owners(table, followed):
    """Return the track of each row; -1: none."""
    states = followed.states[followed.states["row"] >= 0]
    track = np.full(len(table), -1)
    track[states["row"]] = states["particle"]
    return track


def reasons(followed):
    return followed.ends[followed.ends["valid"] == 1]["reason"].tolist()


def test_new_tracks_begin_at_the_start():
    appearance = Appearance()
    x = np.linspace(388, 688, 301)
    density = appearance.new(np.column_stack([x, np.full(301, 90.0)]))
    assert (np.diff(density) <= 0).all()
    assert density[-1] == pytest.approx(appearance.clutter_density)
    # summed over the belt: those that arrive and the clutter
    assert density.sum() * 180 == pytest.approx(1.1, abs=0.1)


def test_unobserved_is_missed_inside_and_certain_outside():
    places = np.array([[500.0, 90.0], [688.0, 90.0], [800.0, 90.0], [500.0, -50.0], [500.0, 0.0]])
    unobserved, outside = Appearance().unobserved_likelihood(places, np.tile(np.eye(2), (5, 1, 1)))
    np.testing.assert_allclose(outside, [0, 0.5, 1, 1, 0.5], atol=1e-12)
    np.testing.assert_allclose(unobserved, [0.1, 0.55, 1, 1, 0.55], atol=1e-12)


@settings(deadline=None)
@given(st.floats(300, 800), st.floats(-50, 250), st.floats(0.1, 20), st.floats(0.1, 20))
def test_outside_by_the_normal_distribution(x, y, along, across):
    residual = np.diag([along**2, across**2])[None]
    _, outside = Appearance().unobserved_likelihood(np.array([[x, y]]), residual)
    inside = np.diff(norm.cdf([388, 688], x, along)) * np.diff(norm.cdf([0, 180], y, across))
    assert outside[0] == pytest.approx(1 - inside[0], abs=1e-9)


def scene(seed, tracks, detections):
    rng = np.random.default_rng(seed)
    predicted = rng.uniform([400, 40], [440, 60], (tracks, 2))
    measured = rng.uniform([400, 40], [440, 60], (detections, 2))
    spread = rng.normal(0, 3, (tracks, 2, 2))
    residual = spread @ spread.transpose(0, 2, 1) + np.eye(2)
    return predicted, residual, measured, Gate()(predicted, residual, Detected(measured))


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 7), st.integers(0, 7))
def test_the_association_is_that_of_the_whole_matrix(seed, tracks, detections):
    rng = np.random.default_rng(seed)
    _, _, _, pairs = scene(seed, tracks, detections)
    costs = pair_costs(pairs, 0.1)
    unobserved, new = rng.uniform(1e-6, 1, tracks), 10 ** rng.uniform(-8, -2, detections)
    likelihoods = Likelihoods(costs, unobserved, new, np.zeros(tracks))
    whole = np.full((tracks + detections, detections + tracks), np.inf)  # Fig. 3 of 2016
    whole[:tracks, :detections], whole[tracks:, detections:] = costs, 0.0
    whole[tracks + np.arange(detections), np.arange(detections)] = -np.log(new)
    whole[np.arange(tracks), detections + np.arange(tracks)] = -np.log(unobserved)
    rows, columns = linear_sum_assignment(np.where(np.isinf(whole), 1e9, whole))
    column = likelihoods.detection()
    total = sum(costs[i, j] if j >= 0 else -np.log(unobserved[i]) for i, j in enumerate(column))
    total -= np.log(np.delete(new, column[column >= 0])).sum()
    assert total == pytest.approx(whole[rows, columns].sum())


def test_costs_are_minus_log_likelihoods():
    predicted, residual, measured, pairs = scene(3, 4, 5)
    costs = pair_costs(pairs, 0.1)
    for i, j in np.argwhere(np.isfinite(costs)):
        density = multivariate_normal(predicted[i], residual[i]).pdf(measured[j])
        assert costs[i, j] == pytest.approx(-np.log(0.9 * density))
    assert np.isfinite(costs).any()


@pytest.mark.parametrize("tracker", TRACKERS)
def test_one_particle_is_one_track_with_its_velocity(tracker):
    followed = tracker(moving(across=40.0), frames=80)
    BELT_STATES.check(followed.states)
    BELT_ENDS.check(followed.ends)
    assert reasons(followed) == [LEFT]
    assert reasons(tracker(moving(across=40.0))) == [RUNNING]  # who knows what comes after
    last = followed.states[followed.states["row"] >= 0].iloc[-1]
    assert last["velocity_x_mm_s"] == pytest.approx(1200, rel=1e-2)
    assert last["velocity_y_mm_s"] == pytest.approx(40, abs=2)
    assert last["x"] == pytest.approx(684.0, abs=0.01)


@pytest.mark.parametrize("tracker", TRACKERS)
@pytest.mark.parametrize("seed", range(3))
def test_a_crowd_is_followed_as_it_is(tracker, seed):
    table = crowd(seed)
    track_of_row = owners(table, tracker(table))
    inside = TRACKED.contains(table[["x", "y"]].to_numpy())
    assert (track_of_row[inside] >= 0).all()
    pairs = pd.DataFrame({"truth": table["particle"], "track": track_of_row})[
        inside
    ].drop_duplicates()
    assert len(pairs) <= 60 + 2


def test_the_order_of_rows_does_not_matter():
    table = crowd(0)
    mixed = table.sample(frac=1.0, random_state=1)
    ordered, shuffled = owners(table, BeltTracker()(table)), owners(mixed, BeltTracker()(mixed))
    np.testing.assert_array_equal(ordered[mixed.index], shuffled)


def test_a_gap_of_a_few_frames_is_bridged():
    table = moving()
    kept = table.drop(index=[20, 21, 22]).reset_index(drop=True)
    followed = BeltTracker()(kept)
    assert len(followed.ends) == 1
    missed = followed.states[followed.states["row"] < 0]
    assert set(missed["frame"]) >= {20, 21, 22}


def test_lost_frames_are_predicted_over_and_missed_ones_are_not():
    """Without its numbers a frame that was lost is one in which everything was missed."""
    taken = np.r_[:20, 28:80]
    table = moving()[lambda rows: rows["frame"].isin(taken)]
    whole, gap = BeltTracker()(moving(), 80), BeltTracker()(table, taken)
    assert len(gap.ends) == 1
    assert gap.states["frame"].tolist() == [k for k in taken if k in set(whole.states["frame"])]
    last, expected = gap.states.iloc[-1], whole.states.iloc[-1]
    names = ["x", "y", "velocity_x_mm_s", "velocity_y_mm_s"]
    np.testing.assert_allclose(last[names], expected[names], rtol=1e-4, atol=1e-3)
    assert len(BeltTracker()(table).ends) == 2
    every = BeltTracker()(moving(), range(80))
    pd.testing.assert_frame_equal(every.states, BeltTracker()(moving(), 80).states)


@pytest.mark.parametrize("frames", [[0, 2, 1], [0, 0, 1], [*range(40)], [0, 0.5, 100], ["a"]])
def test_numbers_that_are_not_those_of_the_frames_are_refused(frames):
    with pytest.raises(InputError, match="BeltTracker: frames"):
        BeltTracker()(moving(), frames)


def test_a_particle_that_vanishes_is_lost():
    goes_on = moving(particle=1, y=150.0, first=5)
    followed = BeltTracker()(pd.concat([moving(frames=20), goes_on], ignore_index=True), 90)
    assert sorted(reasons(followed)) == sorted([LOST, LEFT])


def test_dirt_seen_once_is_no_valid_track():
    speck = pd.DataFrame({"frame": [30], "x": [600.0], "y": [20.0], "particle": 9})
    followed = BeltTracker()(pd.concat([moving(), speck], ignore_index=True))
    dirt = followed.ends[followed.ends["valid"] == 0]
    assert dirt["reason"].tolist() == [LOST]


def test_a_track_that_leaves_sideways_says_so():
    side = moving(y=150.0, across=300.0, first=2)
    side = side[side["y"] < 180]
    followed = BeltTracker()(pd.concat([side, moving(y=20.0)], ignore_index=True), 90)
    assert sorted(reasons(followed)) == sorted([SIDEWAYS, LEFT])


def test_a_track_that_leaves_backwards_never_enters_the_prediction_phase():
    back = moving(x=450.0, along=-400.0, frames=31)
    followed = BeltTracker()(pd.concat([back, moving(y=20.0)], ignore_index=True), 90)
    ends = followed.ends.set_index("reason")["particle"]
    assert sorted(reasons(followed)) == sorted([BACK, LEFT])
    assert last_states(followed, 0.005)["particle"].tolist() == [ends[LEFT]]


@pytest.mark.parametrize("tracker", TRACKERS)
def test_a_particle_at_rest_stays_one_track(tracker):
    followed = tracker(moving(x=391.0, along=0.0))
    assert reasons(followed) == [RUNNING]
    assert followed.states["velocity_x_mm_s"].iloc[-1] == pytest.approx(0, abs=5)


@pytest.mark.parametrize("tracker", TRACKERS)
def test_a_ghost_is_one_track_at_rest_and_never_predicted(tracker):
    """Where a particle lay for long, in the middle of the belt; others pass beside it."""
    ghost = moving(x=550.0, y=60.0, along=0.0, frames=70, first=20, particle=1)
    table = pd.concat([moving(y=120.0), ghost, moving(y=90.0, first=15, particle=2)])
    followed = tracker(table.reset_index(drop=True), 90)
    ends = followed.ends[followed.ends["valid"] == 1].set_index("particle")["reason"]
    assert sorted(ends) == sorted([LEFT, LEFT, RUNNING])
    still = followed.states[followed.states["particle"] == ends.index[ends == RUNNING][0]]
    assert len(still[still["row"] >= 0]) == 70
    assert still["velocity_x_mm_s"].iloc[-1] == pytest.approx(0, abs=5)
    predicted = last_states(followed, 0.005)["particle"].tolist()
    assert sorted(predicted) == sorted(ends.index[ends == LEFT])


def test_two_that_touch_for_a_while_are_one_missed_track():
    """One measurement at their common place instead of two: no tracker follows both."""
    upper, lower = moving(y=90.0, across=-20.0), moving(y=86.0, across=20.0, particle=1)
    table = pd.concat([upper, lower], ignore_index=True)
    together = table["frame"].between(18, 21)
    common = table[together].groupby("frame", as_index=False)[["x", "y"]].mean().assign(particle=7)
    merged = pd.concat([table[~together], common], ignore_index=True)
    followed = BeltTracker()(merged)
    assert len(reasons(followed)) == 2
    assert LOST not in reasons(followed)


def test_scores_add_up_and_thresholds_are_those_of_the_ratio_test():
    tracker = BeltTracker()
    upper, fall = tracker.thresholds
    assert upper == pytest.approx(np.log((1 - 1e-6) / 1e-4))
    assert fall == pytest.approx(np.log((1 - 1e-4) / 1e-6))
    table, score = moving(frames=10), 0.0
    clutter = np.log(tracker.appearance.clutter_density)
    for step in tracker.steps(table):
        likelihoods = tracker.likelihoods(step.detected, step.pairs)
        if len(likelihoods.costs):
            score -= likelihoods.costs[0, 0] + clutter
        else:
            score = np.log(likelihoods.new[0]) - clutter
        assert step.tracks["score"][0] == pytest.approx(score)


def test_an_empty_belt_has_no_tracks():
    nothing = pd.DataFrame({"frame": [], "x": [], "y": []})
    followed = BeltTracker()(nothing)
    assert followed.states.columns.tolist() == BELT_STATES.names
    assert followed.ends.columns.tolist() == [*BELT_ENDS.names, "reason"]
    assert len(followed.states) == len(followed.ends) == 0
    beside = BeltTracker()(moving(y=400.0))
    assert len(beside.states) == 0


def test_what_cannot_be_tracked_is_refused():
    with pytest.raises(InputError, match="missing"):
        BeltTracker()(pd.DataFrame({"frame": [0], "x": [400.0]}))
    with pytest.raises(InputError, match="not finite"):
        BeltTracker()(pd.DataFrame({"frame": [0], "x": [np.nan], "y": [90.0]}))
    twice = pd.concat([moving(), moving()[30:31], moving(y=50.0)], ignore_index=True)
    with pytest.raises(InputError, match=r"frame 30 has two .* x 570, y 90 mm \(rows 30 and 80"):
        BeltTracker()(twice)
    assert len(BeltTracker()(twice.drop_duplicates()).ends) == 2
    far = pd.DataFrame({"frame": [0, 10**7], "x": 400.0, "y": 90.0})
    with pytest.raises(InputError, match="count the frames"):
        BeltTracker()(far)
    for wrong in ("10", 80.5, -3, True):
        for table in (moving(), moving()[:0]):
            with pytest.raises(InputError, match="frames: must be"):
                BeltTracker()(table, wrong)
    assert len(BeltTracker()(moving()[:0], 0).ends) == 0
    for wrong in ({"frame_s": 0.0}, {"false_valid": 0.0}, {"false_lost": 2.0}):
        with pytest.raises(InputError, match=f"BeltTracker: {next(iter(wrong))}"):
            BeltTracker(**wrong)
    with pytest.raises(InputError, match="Appearance: missed"):
        replace(Appearance(), missed=1.0)
