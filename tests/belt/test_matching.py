"""Which particle a track followed."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kilnflight.belt.matching import match
from kilnflight.tables import BELT_STATES


def path(particle, x, y, frames=range(5)):
    frame = np.array(frames)
    return pd.DataFrame({"frame": frame, "particle": particle, "x": x + 6.0 * frame, "y": y})


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
