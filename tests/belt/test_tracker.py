"""The belt's tracker: appearing and leaving, the matrix of Fig. 3, scores."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal, norm
from tests.definitions.belt import whole_matrix

from kilnflight.belt.camera import TRACKED
from kilnflight.belt.phase import last_states
from kilnflight.belt.tracker import (
    BACK,
    LEFT,
    LOST,
    LOST_BY,
    RUNNING,
    SIDEWAYS,
    VALID_FROM,
    Appearance,
    BeltTracker,
    Likelihoods,
)
from kilnflight.checks import InputError
from kilnflight.tables import BELT_ENDS, BELT_STATES
from kilnflight.tracking.filter import ConstantAcceleration

ACCELERATED = ConstantAcceleration((750.0, 0.0), 433.0, 2000.0, 4472.0, 0.127)
TRACKERS = (BeltTracker(), BeltTracker(ACCELERATED))


def moving(x=390.0, y=90.0, along=1200.0, across=0.0, frames=80, first=0, particle=0):
    time = 0.005 * np.arange(frames)
    columns = {
        "frame": first + np.arange(frames),
        "x": x + along * time,
        "y": y + across * time,
    }
    return pd.DataFrame(columns).assign(particle=particle)


def crowd(seed, count=30):
    rng = np.random.default_rng(seed)
    parts = [
        moving(388 + rng.uniform(0, 6), rng.uniform(10, 170), rng.normal(1100, 50),
               rng.normal(0, 30), 80, int(rng.integers(0, 75)), k)
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
    return sorted(followed.ends[followed.ends["valid"] == 1]["reason"])


@settings(max_examples=15)
@given(st.floats(300, 800), st.floats(-50, 250), st.floats(0.1, 20), st.floats(0.1, 20))
def test_outside_by_the_normal_distribution(x, y, along, across):
    residual = np.diag([along**2, across**2])[None]
    unobserved, outside = Appearance().unobserved_likelihood(
        np.array([[x, y]]), residual
    )
    inside = np.diff(norm.cdf([388, 688], x, along)) * np.diff(
        norm.cdf([0, 180], y, across)
    )
    assert outside[0] == pytest.approx(1 - inside[0], abs=1e-9)
    assert unobserved[0] == pytest.approx(1 - 0.9 * inside[0], abs=1e-9)


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), st.integers(0, 7), st.integers(0, 7))
def test_the_association_is_that_of_the_whole_matrix(seed, tracks, detections):
    rng = np.random.default_rng(seed)
    costs = rng.uniform(-5, 30, (tracks, detections))
    costs[rng.random(costs.shape) < 0.4] = np.inf
    unobserved, new = (
        rng.uniform(1e-6, 1, tracks),
        10 ** rng.uniform(-8, -2, detections),
    )
    i, j = pairs = np.isfinite(costs).nonzero()
    taken = Likelihoods(costs[pairs], unobserved, new, np.zeros(tracks)).taken(pairs)
    total = costs[pairs][taken].sum() - np.log(np.delete(unobserved, i[taken])).sum()
    total -= np.log(np.delete(new, j[taken])).sum()
    assert total == pytest.approx(whole_matrix(costs, unobserved, new)[1])


def test_costs_are_minus_log_likelihoods_and_scores_add_up():
    assert pytest.approx(np.log((1 - 1e-6) / 1e-4)) == VALID_FROM
    assert pytest.approx(np.log((1 - 1e-4) / 1e-6)) == LOST_BY
    tracker, score = BeltTracker(), 0.0
    clutter = np.log(tracker.appearance.clutter_density)
    for step in tracker.steps(moving(frames=10)):
        likelihoods = tracker.likelihoods(step.detected, step.pairs)
        if len(likelihoods.costs):
            expected = multivariate_normal(
                step.pairs.expected[0], step.pairs.residual[0]
            )
            density = expected.pdf(step.detected.positions[0])
            assert likelihoods.costs[0] == pytest.approx(-np.log(0.9 * density))
            score -= likelihoods.costs[0] + clutter
        else:
            score = np.log(likelihoods.new[0]) - clutter
        assert step.tracks["score"][0] == pytest.approx(score)


@pytest.mark.parametrize("tracker", TRACKERS)
def test_one_particle_is_one_track_with_its_velocity(tracker):
    followed = tracker(moving(across=40.0), frames=80)
    BELT_STATES.check(followed.states)
    BELT_ENDS.check(followed.ends)
    assert reasons(followed) == [LEFT]
    assert reasons(tracker(moving(across=40.0, frames=40))) == [RUNNING]
    last = followed.states[followed.states["row"] >= 0].iloc[-1]
    assert last["velocity_x_mm_s"] == pytest.approx(1200, rel=1e-2)
    assert last["velocity_y_mm_s"] == pytest.approx(40, abs=2)
    assert last["x"] == pytest.approx(684.0, abs=0.01)


@pytest.mark.parametrize("tracker", TRACKERS)
def test_a_crowd_is_followed_as_it_is_in_any_order_of_rows(tracker):
    table = crowd(0)
    track_of_row = owners(table, tracker(table))
    inside = TRACKED.contains(table[["x", "y"]].to_numpy())
    assert (track_of_row[inside] >= 0).all()
    pairs = pd.DataFrame({"truth": table["particle"], "track": track_of_row})[inside]
    assert len(pairs.drop_duplicates()) <= 30 + 1
    mixed = table.sample(frac=1.0, random_state=1)
    np.testing.assert_array_equal(
        track_of_row[mixed.index], owners(mixed, tracker(mixed))
    )


def test_a_gap_of_a_few_frames_is_bridged_and_a_longer_one_is_not():
    kept = moving().drop(index=[20, 21, 22]).reset_index(drop=True)
    followed = BeltTracker()(kept)
    assert len(followed.ends) == 1
    missed = followed.states[followed.states["row"] < 0]
    assert set(missed["frame"]) >= {20, 21, 22}
    goes_on = moving(particle=1, y=150.0, first=5)
    followed = BeltTracker()(
        pd.concat([moving(frames=20), goes_on], ignore_index=True), 90
    )
    assert reasons(followed) == sorted([LOST, LEFT])


def test_tracks_that_leave_sideways_or_backwards_say_so_and_dirt_is_lost():
    side = moving(y=150.0, across=300.0, first=2)
    back = moving(x=450.0, along=-400.0, frames=31, y=60.0)
    speck = pd.DataFrame({"frame": [30], "x": [600.0], "y": [120.0], "particle": 9})
    parts = [side[side["y"] < 180], back, moving(y=20.0), speck]
    followed = BeltTracker()(pd.concat(parts, ignore_index=True), 90)
    assert reasons(followed) == sorted([SIDEWAYS, BACK, LEFT])
    assert followed.ends.loc[followed.ends["valid"] == 0, "reason"].tolist() == [LOST]
    ends = followed.ends.set_index("reason")["particle"]
    assert last_states(followed, 0.005)["particle"].tolist() == [ends[LEFT]]


def test_an_empty_belt_has_no_tracks():
    followed = BeltTracker()(pd.DataFrame({"frame": [], "x": [], "y": []}))
    assert followed.states.columns.tolist() == BELT_STATES.names
    assert followed.ends.columns.tolist() == [*BELT_ENDS.names, "reason"]
    assert len(followed.states) == len(followed.ends) == 0
    assert len(BeltTracker()(moving(y=400.0, frames=5)).states) == 0


@pytest.mark.parametrize("frames", [-1, 1.5, np.nan, "9", None, True])
def test_frames_are_counted_from_0(frames):
    with pytest.raises(InputError, match="frames"):
        BeltTracker()(pd.DataFrame({"frame": [0], "x": [400.0], "y": [90.0]}), frames)
