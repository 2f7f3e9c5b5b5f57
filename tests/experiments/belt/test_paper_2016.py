"""The evaluation of the 2016 paper on small worlds."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kilnflight.experiments.belt import paper_2016
from kilnflight.simulated.belt.friction import FrictionBelt
from kilnflight.tables import BELT_ARRIVAL, BELT_LAST


def path(particle, x, y):
    frame = np.arange(5)
    return pd.DataFrame(
        {"frame": frame, "particle": particle, "x": x + 6.0 * frame, "y": y}
    )


@given(st.integers(0, 2**32 - 1))
def test_matching_is_the_least_norm(seed):
    rng = np.random.default_rng(seed)
    truth = pd.concat([path(k, *rng.uniform(0, 30, 2)) for k in range(5)])
    tracks = pd.concat([path(k, *rng.uniform(0, 30, 2)) for k in range(3)])
    tracks["x"] += rng.normal(0, 2, len(tracks))
    for track, particle in paper_2016.match(tracks, truth).items():
        places = tracks.loc[tracks["particle"] == track, ["x", "y"]].to_numpy()
        norms = [
            np.linalg.norm(
                np.linalg.norm(particle_rows[["x", "y"]].to_numpy() - places, axis=1)
            )
            for _, particle_rows in truth.groupby("particle")
        ]
        assert particle == int(np.argmin(norms))


def test_deviations_by_hand():
    last = [(0, 0.5, 673.0, 90.0, 1000.0, 20.0, 0.0, 0.0)]
    last = pd.DataFrame(last, columns=BELT_LAST.names)
    arrived = pd.DataFrame([(0, 0.58, 92.0, 0.0)], columns=BELT_ARRIVAL.names)
    late = paper_2016.deviations("Tracking", last, arrived, 773.0).iloc[0]
    assert late["temporal_ms"] == pytest.approx(20.0)  # it came earlier than predicted
    assert late["lateral_mm"] == pytest.approx(0.0, abs=1e-9)
    straight = paper_2016.deviations("Straight", last, arrived, 773.0).iloc[0]
    assert straight["lateral_mm"] == -2.0
    assert np.isnan(straight["temporal_ms"])


def test_without_noise_constant_velocity_is_exact():
    smooth = FrictionBelt(
        particles=6,
        friction=0.0,
        rolling_friction=0.0,
        kicks_per_s=0.0,
        lateral_spread_mm_s=15.0,
        feed_s=0.1,
        sampling_hz=1000.0,
        steps_per_sample=1,
    )
    table = paper_2016.noise_free(smooth(np.random.default_rng(5)))
    counts = table.groupby("approach")["particle"].nunique()
    assert counts.to_dict() == dict.fromkeys(("Sim", "Tracking", "Straight"), 6)
    moving = table[table["approach"] != "Straight"]
    assert (moving[["lateral_mm", "temporal_ms"]].abs() < 1e-2).all(axis=None)
    straight = table[table["approach"] == "Straight"]
    assert straight["temporal_ms"].isna().all()
    assert straight["lateral_mm"].abs().max() > 0.3
