"""The evaluation of the 2016 paper on small worlds."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kilnflight.experiments import belt_2016
from kilnflight.sorter.friction import FrictionBelt
from kilnflight.tables import BELT_ARRIVAL, BELT_LAST

# Three lanes of particles at constant velocity, so that every prediction is exact.
SMOOTH = FrictionBelt(
    particles=6,
    friction=0.0,
    rolling_friction=0.0,
    kicks_per_s=0.0,
    velocity_mm_s=1200.0,
    velocity_spread_mm_s=20.0,
    lateral_spread_mm_s=15.0,
    feed_s=0.1,
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


def test_deviations_by_hand():
    table = belt_2016.deviations("Tracking", last_of(), arrived())
    np.testing.assert_allclose(table.drop(columns="approach").iloc[0], [0, 0.0, 0.0], atol=1e-9)
    late = belt_2016.deviations("Tracking", last_of(), arrived(time=0.58))
    assert late["temporal_ms"].iloc[0] == pytest.approx(20.0)  # it came earlier than predicted
    straight = belt_2016.deviations("Straight", last_of(), arrived())
    assert straight["lateral_mm"].iloc[0] == -2.0
    assert np.isnan(straight["temporal_ms"].iloc[0])


@pytest.fixture(scope="module")
def bodies():
    return SMOOTH(np.random.default_rng(5))


def test_without_noise_constant_velocity_is_exact(bodies):
    table = belt_2016.noise_free(bodies)
    assert table.groupby("approach")["particle"].nunique().to_dict() == {
        "Sim": 6, "Tracking": 6, "Straight": 6
    }  # fmt: skip
    moving = table[table["approach"] != "Straight"]
    assert (moving["lateral_mm"].abs() < 1e-2).all()
    assert (moving["temporal_ms"].abs() < 1e-2).all()
    straight = table[table["approach"] == "Straight"]
    assert straight["temporal_ms"].isna().all()
    assert straight["lateral_mm"].abs().max() > 0.3
