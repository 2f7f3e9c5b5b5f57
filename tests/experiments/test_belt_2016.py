"""The evaluation of the 2016 paper on small worlds."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kilnflight.belt.camera import Area
from kilnflight.belt.evaluation import last_states, observe
from kilnflight.belt.phase import PredictionPhase
from kilnflight.belt.tracker import BeltTracker
from kilnflight.experiments import belt_2016
from kilnflight.sorter.bulk import BULKS
from kilnflight.sorter.friction import FrictionBelt
from kilnflight.sorter.rendering import Pictures
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
    row = [(particle, 0.5, 673.0, 90.0, velocity, across, 0.0, 0.0)]
    return pd.DataFrame(row, columns=BELT_LAST.names)


def arrived(time=0.6, y=92.0, particle=0):
    return pd.DataFrame([(particle, time, y, 0.0)], columns=BELT_ARRIVAL.names)


def test_a_track_is_matched_with_the_particle_beside_it():
    truth = pd.concat([path(7, 400, 90), path(8, 400, 95), path(9, 400, 91, range(3))])
    tracks = pd.concat([path(0, 400.5, 94), path(1, 400, 90.4), path(2, 400, 90, range(9))])
    pairs = belt_2016.match(tracks, truth)
    assert pairs.to_dict() == {0: 8, 1: 7}


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_matching_is_the_least_norm(seed):
    rng = np.random.default_rng(seed)
    truth = pd.concat([path(k, *rng.uniform(0, 30, 2)) for k in range(5)])
    tracks = pd.concat([path(k, *rng.uniform(0, 30, 2)) for k in range(3)])
    tracks["x"] += rng.normal(0, 2, len(tracks))
    for track, particle in belt_2016.match(tracks, truth).items():
        places = tracks.loc[tracks["particle"] == track, ["x", "y"]].to_numpy()
        norms = [
            np.linalg.norm(np.linalg.norm(particle_rows[["x", "y"]].to_numpy() - places, axis=1))
            for _, particle_rows in truth.groupby("particle")
        ]
        assert particle == int(np.argmin(norms))


def test_nothing_to_match():
    empty = BELT_STATES.empty()
    assert len(belt_2016.match(empty, path(0, 0, 0))) == 0
    assert len(belt_2016.match(path(0, 0, 0), empty)) == 0


def test_deviations_by_hand():
    table = belt_2016.deviations("Tracking", last_of(), arrived())
    np.testing.assert_allclose(table.drop(columns="approach").iloc[0], [0, 0.0, 0.0], atol=1e-9)
    late = belt_2016.deviations("Tracking", last_of(), arrived(time=0.58))
    assert late["temporal_ms"].iloc[0] == pytest.approx(20.0)  # it came earlier than predicted
    straight = belt_2016.deviations("Straight", last_of(), arrived())
    assert straight["lateral_mm"].iloc[0] == -2.0
    assert np.isnan(straight["temporal_ms"].iloc[0])


def test_a_particle_at_rest_is_not_predicted_and_no_error():
    for velocity in (0.0, -3.0):
        table = belt_2016.deviations("Tracking", last_of(velocity), arrived())
        assert table[["lateral_mm", "temporal_ms"]].isna().all(axis=None)
        straight = belt_2016.deviations("Straight", last_of(velocity), arrived())
        assert straight["lateral_mm"].iloc[0] == -2.0
    nothing = belt_2016.deviations("Tracking", BELT_LAST.empty(), BELT_ARRIVAL.empty())
    assert len(nothing) == 0


def test_a_particle_that_did_not_arrive_is_left_out():
    assert len(belt_2016.deviations("Tracking", last_of(), arrived(particle=1))) == 0


@pytest.fixture(scope="module")
def bodies():
    return SMOOTH(np.random.default_rng(5))


def test_without_noise_constant_velocity_is_exact(bodies):
    table = belt_2016.noise_free(bodies)
    assert table.groupby("approach")["particle"].nunique().to_dict() == {
        "Sim": 12, "Tracking": 12, "Straight": 12
    }  # fmt: skip
    moving = table[table["approach"] != "Straight"]
    assert (moving["lateral_mm"].abs() < 1e-2).all()
    assert (moving["temporal_ms"].abs() < 1e-2).all()
    straight = table[table["approach"] == "Straight"]
    assert straight["temporal_ms"].isna().all()
    assert straight["lateral_mm"].abs().max() > 0.3


def test_the_order_of_rows_does_not_matter(bodies):
    mixed = bodies.sample(frac=1.0, random_state=2)
    ordered, shuffled = belt_2016.noise_free(bodies), belt_2016.noise_free(mixed)
    keys = ["approach", "particle"]
    pd.testing.assert_frame_equal(
        ordered.sort_values(keys, ignore_index=True), shuffled.sort_values(keys, ignore_index=True)
    )


def test_images_give_the_same_to_a_millimetre(bodies):
    pictured = belt_2016.track_pictures(Pictures(bodies, BULKS["spheres"], 0))
    table = belt_2016.from_images(pictured, bodies)
    tracked = table[table["approach"] == "Tracking"]
    assert tracked["particle"].nunique() >= 10
    assert tracked["lateral_mm"].abs().median() < 0.5
    assert tracked["temporal_ms"].abs().median() < 1.0
    assert set(table["approach"]) == {"Tracking", "Straight"}


def test_observing_with_a_filter_keeps_what_was_measured(bodies):
    phase = PredictionPhase(688.0, 760.0)
    tracker = replace(
        belt_2016.rate_1000(),
        appearance=replace(belt_2016.rate_1000().appearance, area=Area()),
    )
    observed = observe(tracker(bodies), bodies, phase, 0.001)
    plain = phase.observe(bodies[BELT_TRACKS.names])
    np.testing.assert_allclose(
        np.sort(observed.arrival["time_s"]), np.sort(plain.arrival["time_s"]), atol=1e-6
    )
    assert observed.last["velocity_x_mm_s"].between(1100, 1300).all()


def test_an_empty_belt_gives_empty_tables():
    nothing = BELT_TRACKS.empty()
    assert len(belt_2016.noise_free(nothing)) == 0
    followed = BeltTracker()(nothing)
    assert len(last_states(followed, 0.005)) == 0
    assert len(observe(followed, nothing, belt_2016.PHASE, 0.005).last) == 0


def rolling(y, first=0):
    """Return one particle at 1000 Hz and 1200 mm/s, from a frame on."""
    frame = first + np.arange(360)
    columns = {"frame": frame, "particle": 0, "time_s": 0.001 * frame}
    return pd.DataFrame(columns | {"x": 370.0 + 1.2 * np.arange(360), "y": y})


@pytest.mark.parametrize("beside", [False, True])
def test_pictures_of_an_empty_belt_give_empty_tables(beside):
    """Nothing was ever fed, or what there is lies beyond the picture."""
    nothing = rolling(400.0) if beside else BELT_TRACKS.empty()
    pictured = belt_2016.track_pictures(Pictures(nothing, BULKS["spheres"], 0))
    assert pictured.calibration.error_mm < 0.1
    assert pictured.spots.columns.tolist() == BELT_SPOTS.names
    assert len(pictured.spots) == len(pictured.followed.states) == len(pictured.followed.ends) == 0
    table = belt_2016.from_images(pictured, nothing)
    assert table.columns.tolist() == ["approach", "particle", "lateral_mm", "temporal_ms"]
    assert len(table) == 0


def test_boxes_have_the_intervals_that_verdicts_need():
    rng = np.random.default_rng(0)
    parts = [
        pd.DataFrame({"data": data, "approach": "Tracking", "lateral_mm": rng.normal(0, size, 400)})
        for data, size in (("noise-free", 0.1), ("images", 1.0))
    ]
    table = pd.concat(parts).assign(temporal_ms=np.nan)
    boxes = belt_2016.summaries(table, ["data", "approach"], seed=1).set_index("data")
    assert boxes["quantity"].tolist() == ["lateral_mm"] * 2
    free, images = boxes.loc["noise-free"], boxes.loc["images"]
    assert free["iqr_low"] < free["iqr"] < free["iqr_high"] < images["iqr_low"]
    assert free["median_low"] < 0 < free["median_high"]
    assert images["mae_centred"] == pytest.approx(0.8, abs=0.1)  # sqrt(2 / pi)
    assert images["absolute_q95"] == pytest.approx(1.96, abs=0.2)


def test_several_recordings_have_deviations_by_material_and_data(bodies):
    pictured = belt_2016.track_all({"spheres": Pictures(bodies, BULKS["spheres"], 0)})
    every = belt_2016.all_deviations(pictured, {"spheres": bodies})
    assert every["data"].unique().tolist() == ["noise-free", "images"]
    assert every["material"].unique().tolist() == ["spheres"]
