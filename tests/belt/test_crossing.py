"""Matching with the truth, predictions to the edge, and the whole evaluation on small worlds."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kilnflight.belt import predictive
from kilnflight.belt.area import Area
from kilnflight.belt.crossing import deviations, last_states, observe
from kilnflight.belt.friction import FrictionBelt
from kilnflight.belt.matching import match
from kilnflight.belt.phase import PredictionPhase
from kilnflight.belt.pictures import SHAPES, Pictures
from kilnflight.belt.sampling import thinned
from kilnflight.belt.tracker import BeltTracker, Followed
from kilnflight.checks import InputError
from kilnflight.tables import BELT_ARRIVAL, BELT_LAST, BELT_SPOTS, BELT_STATES, BELT_TRACKS

# Three lanes of particles at constant velocity, so that every prediction is exact.
SMOOTH = FrictionBelt(
    particles=12,
    friction=0.0,
    rolling_friction=0.0,
    kicks_per_s=0.0,
    velocity_mm_s=1200.0,
    velocity_spread_mm_s=20.0,
    lateral_spread_mm_s=15.0,
    feed_s=0.4,
    sampling_hz=1000.0,
    steps_per_sample=1,
)


def path(particle, x, y, frames=range(5)):
    frame = np.array(frames)
    return pd.DataFrame({"frame": frame, "particle": particle, "x": x + 6.0 * frame, "y": y})


def last_of(velocity=1000.0, across=20.0, particle=0):
    row = [(particle, 0.5, 688.0, 90.0, velocity, across, 0.0, 0.0)]
    return pd.DataFrame(row, columns=BELT_LAST.names)


def arrived(time=0.6, y=92.0, particle=0):
    return pd.DataFrame([(particle, time, y, 0.0)], columns=BELT_ARRIVAL.names)


def test_a_track_is_matched_with_the_particle_beside_it():
    truth = pd.concat([path(7, 400, 90), path(8, 400, 95), path(9, 400, 91, range(3))])
    tracks = pd.concat([path(0, 400.5, 94), path(1, 400, 90.4), path(2, 400, 90, range(9))])
    found = match(tracks, truth)
    assert found[["particle", "truth"]].to_numpy().tolist() == [[0, 8], [1, 7]]
    np.testing.assert_allclose(found["rms_mm"], [np.hypot(0.5, 1.0), 0.4])


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_matching_is_the_least_norm(seed):
    rng = np.random.default_rng(seed)
    truth = pd.concat([path(k, *rng.uniform(0, 30, 2)) for k in range(5)])
    tracks = pd.concat([path(k, *rng.uniform(0, 30, 2)) for k in range(3)])
    tracks["x"] += rng.normal(0, 2, len(tracks))
    for row in match(tracks, truth).itertuples():
        places = tracks.loc[tracks["particle"] == row.particle, ["x", "y"]].to_numpy()
        norms = [
            np.linalg.norm(np.linalg.norm(one[["x", "y"]].to_numpy() - places, axis=1))
            for _, one in truth.groupby("particle")
        ]
        assert row.truth == int(np.argmin(norms))
        assert row.rms_mm == pytest.approx(min(norms) / np.sqrt(5))


def test_nothing_to_match():
    empty = BELT_STATES.empty()
    assert len(match(empty, path(0, 0, 0))) == len(match(path(0, 0, 0), empty)) == 0


def test_deviations_by_hand():
    table = deviations(last_of(), arrived(), 788.0)
    np.testing.assert_allclose(table.iloc[0], [0, 0.0, -2.0, 0.0], atol=1e-9)
    late = deviations(last_of(), arrived(time=0.58), 788.0)  # it came earlier than predicted
    assert late["temporal_ms"].iloc[0] == pytest.approx(20.0)


def test_a_particle_at_rest_is_not_predicted_and_no_error():
    for velocity in (0.0, -3.0):
        table = deviations(last_of(velocity), arrived(), 788.0)
        assert table[["lateral_mm", "temporal_ms"]].isna().all(axis=None)
        assert table["straight_mm"].iloc[0] == -2.0
    assert len(deviations(BELT_LAST.empty(), BELT_ARRIVAL.empty(), 788.0)) == 0


def test_tables_of_different_particles_are_told():
    with pytest.raises(InputError, match="same particles"):
        deviations(last_of(), arrived(particle=1), 788.0)


def test_only_valid_tracks_that_entered_the_phase_are_predicted():
    states = pd.DataFrame([[0] * 11] * 3, columns=BELT_STATES.names)
    states["particle"] = [0, 1, 2]
    ends = pd.DataFrame({"particle": [0, 1, 2], "frame": 0, "valid": [1, 0, 1]})
    ends["reason"] = ["left at the end", "left at the end", "lost"]
    assert last_states(Followed(states, ends), 0.005)["particle"].tolist() == [0]
    with pytest.raises(InputError, match="frame_s"):
        last_states(Followed(states, ends), 0.0)


@pytest.fixture(scope="module")
def bodies():
    return SMOOTH(np.random.default_rng(5))


def test_without_noise_constant_velocity_is_exact(bodies):
    table = predictive.noise_free(bodies)
    assert table.groupby("approach")["particle"].nunique().to_dict() == {
        "Sim": 12, "Tracking": 12, "Straight": 12
    }  # fmt: skip
    moving = table[table["approach"] != "Straight"]
    assert (moving["lateral_mm"].abs() < 1e-2).all()
    assert (moving["temporal_ms"].abs() < 1e-2).all()
    straight = table[table["approach"] == "Straight"]
    assert straight["temporal_ms"].isna().all()
    assert straight["lateral_mm"].abs().max() > 0.3


def test_the_simulation_velocity_is_taken_where_there_is_one(bodies):
    wrong = bodies.assign(velocity_x_mm_s=600.0, velocity_y_mm_s=0.0)
    table = predictive.noise_free(wrong).set_index("approach")
    assert (table.loc["Sim", "temporal_ms"] > 50).all()
    assert (table.loc["Tracking", "temporal_ms"].abs() < 1e-2).all()


def test_other_rates_and_gaps_are_told(bodies):
    with pytest.raises(InputError, match="frame k must be at k ms"):
        predictive.noise_free(thinned(bodies, 10))  # 100 Hz, as the authors' public tracks
    with pytest.raises(InputError, match="frame k must be at k ms"):
        predictive.noise_free(bodies.assign(time_s=bodies["time_s"] + 1.0))
    with pytest.raises(InputError, match="particle 0 skips or repeats a frame"):
        predictive.noise_free(bodies[bodies["frame"] % 10 == 0])
    with pytest.raises(InputError, match="skips or repeats a frame"):
        predictive.noise_free(pd.concat([bodies, bodies.tail(1)], ignore_index=True))


def test_the_authors_rate_gives_the_same_without_a_tracker(bodies):
    slow = thinned(bodies[bodies["x"] < 788.0], 10)
    table = predictive.sampled(slow)
    assert table["approach"].unique().tolist() == ["Sim", "Straight"]
    moving = table[table["approach"] == "Sim"]
    assert moving["particle"].nunique() == 12
    assert (moving[["lateral_mm", "temporal_ms"]].abs() < 1e-2).all(axis=None)
    assert len(predictive.sampled(slow[:0])) == 0


def test_the_order_of_rows_does_not_matter(bodies):
    mixed = bodies.sample(frac=1.0, random_state=2)
    one, other = predictive.noise_free(bodies), predictive.noise_free(mixed)
    keys = ["approach", "particle"]
    pd.testing.assert_frame_equal(
        one.sort_values(keys, ignore_index=True), other.sort_values(keys, ignore_index=True)
    )


@pytest.mark.parametrize("installed", [True, False])
def test_an_unknown_material_is_told_with_and_without_mujoco(monkeypatch, installed):
    monkeypatch.setattr(predictive.physics, "is_installed", lambda: installed)
    with pytest.raises(InputError, match="no material 'peas'; there are spheres"):
        predictive.bodies("peas", 10, 0)
    with pytest.raises(InputError, match="count"):
        predictive.bodies("spheres", -1, 0)


def test_who_was_predicted_is_counted():
    bodies = pd.concat([path(k, 400, 90) for k in range(4)])
    table = pd.DataFrame({"approach": "Tracking", "particle": [0, 2, 2]})
    table = pd.concat([table, table.assign(approach="Straight", particle=3)])
    counts = {"fed": 4, "predicted": 2, "predicted_twice": 1, "not_predicted": 2}
    assert predictive.predicted(bodies, table) == counts
    assert set(predictive.predicted(bodies[:0], table[:0]).values()) == {0}


def test_images_give_the_same_to_a_millimetre(bodies):
    looked = predictive.look(Pictures(bodies, SHAPES["spheres"], 0), 40)
    table = predictive.from_images(looked, bodies)
    tracked = table[table["approach"] == "Tracking"]
    assert tracked["particle"].nunique() >= 10
    assert tracked["lateral_mm"].abs().median() < 0.5
    assert tracked["temporal_ms"].abs().median() < 1.0
    assert set(table["approach"]) == {"Tracking", "Straight"}


def test_observing_with_a_filter_keeps_what_was_measured(bodies):
    phase = PredictionPhase(688.0, 760.0)
    tracker = replace(
        predictive.rate_1000(),
        appearance=replace(predictive.rate_1000().appearance, area=Area()),
    )
    seen = observe(tracker(bodies), bodies, phase, 0.001)
    plain = phase.observe(bodies[BELT_TRACKS.names])
    np.testing.assert_allclose(
        np.sort(seen.arrival["time_s"]), np.sort(plain.arrival["time_s"]), atol=1e-6
    )
    assert seen.last["velocity_x_mm_s"].between(1100, 1300).all()


def test_an_empty_belt_gives_empty_tables():
    nothing = BELT_TRACKS.empty()
    assert len(predictive.noise_free(nothing)) == 0
    followed = BeltTracker()(nothing)
    assert len(last_states(followed, 0.005)) == 0
    assert len(observe(followed, nothing, predictive.PHASE, 0.005).last) == 0


def rolling(y, first=0):
    """Return one particle at 1000 Hz and 1200 mm/s, from a frame on."""
    frame = first + np.arange(360)
    columns = {"frame": frame, "particle": 0, "time_s": 0.001 * frame}
    return pd.DataFrame(columns | {"x": 370.0 + 1.2 * np.arange(360), "y": y})


@pytest.mark.parametrize("beside", [False, True])
def test_pictures_of_an_empty_belt_give_empty_tables(beside):
    """Nothing was ever fed, or what there is lies beyond the picture."""
    nothing = rolling(400.0) if beside else BELT_TRACKS.empty()
    looked = predictive.look(Pictures(nothing, SHAPES["spheres"], 0), 5)
    assert looked.calibration.error_mm < 0.1
    assert looked.spots.columns.tolist() == BELT_SPOTS.names
    assert len(looked.spots) == len(looked.followed.states) == len(looked.followed.ends) == 0
    table = predictive.from_images(looked, nothing)
    assert table.columns.tolist() == ["approach", "particle", "lateral_mm", "temporal_ms"]
    assert len(table) == 0
    assert len(predictive.with_acceleration(looked, 5).followed.states) == 0


def test_one_particle_in_many_pictures_is_enough_to_size_it():
    """None of the pictures that are looked at first shows it."""
    looked = predictive.look(Pictures(rolling(90.0, first=40), SHAPES["spheres"], 0), 2)
    assert len(looked.spots) > 20
    assert (looked.spots["touching"] == 0).all()
