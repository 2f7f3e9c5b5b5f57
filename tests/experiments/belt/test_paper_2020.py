"""The 2020 paper from tracks to differences, on small worlds."""

import numpy as np
import pandas as pd
import pytest

from kilnflight.belt.phase import Observed
from kilnflight.experiments.belt import paper_2020
from kilnflight.experiments.belt.paper_2020 import PHASE


def test_resampled_tracks_keep_a_cubic_and_every_observation():
    frame, time = np.arange(5, 25), np.arange(5, 25) / 100
    path = pd.DataFrame({"frame": frame, "particle": 7, "time_s": time})
    path = path.assign(x=900 * time + 300 * time**2 - 80 * time**3, y=20 * time)
    fast = paper_2020.resample(path, 1000.0)
    assert len(fast) == 191
    t = fast["time_s"].to_numpy()
    np.testing.assert_allclose(fast["x"], 900 * t + 300 * t**2 - 80 * t**3, atol=1e-9)
    pd.testing.assert_frame_equal(
        paper_2020.resample(fast, 100.0), path, check_dtype=False
    )


def test_the_share_beyond_the_belts_velocity_by_hand():
    last = pd.DataFrame(
        {
            "x": 688.0,
            "velocity_x_mm_s": [1400.0, 1400.0, 1510.0, 1000.0],
            "acceleration_x_mm_s2": [
                1600.0,
                1400.0,
                -9e9,
                0.0,
            ],  # 1510, 1497, now, 1000 mm/s
        }
    )
    share = paper_2020.beyond_belt({"a": Observed(last, last, {})}, PHASE)
    assert share.to_dict() == {"a": 50.0}


def test_differences_are_of_the_right_models_and_hold_beyond_chance():
    def shifted(part, phase, calibration):
        """Three models on any particles: the better one is 1 closer, the third the
        first again.
        """
        spread = np.linspace(-1.0, 1.0, np.count_nonzero(~calibration))
        yield from (("near", spread), ("far", 3.0 * spread), ("again", spread))

    orders = {
        "a": [(["near"], ["far"])],
        "b": [(["far", "near"], ["again"])],
        "c": [(["near"], ["again"])],
    }
    tracks = paper_2020.load_tracks({}, seed=1, particles=150)  # of the friction model
    observed = {name: PHASE.observe(tracks[name]) for name in ("spheres", "cuboids")}
    by_name = dict.fromkeys(observed, orders)
    pairs = paper_2020.compare_orders(observed, PHASE, shifted, by_name, "quick", 1)
    assert len(pairs) == 2 * 3 * 2
    first = pairs.iloc[:2]
    assert first["measure"].tolist() == ["MAE", "IQR"]
    assert first["excess"].tolist() == pytest.approx([1.0, 2.0], rel=0.05)
    assert (first["excess_low"] < first["excess"]).all()
    assert paper_2020.holds(pairs, "a") == [True, True]
    assert paper_2020.holds(pairs, "b") == [False, False]
    assert paper_2020.holds(pairs, "c") == [
        None,
        None,
    ]  # no difference is none beyond chance
