"""Rates of the test of grey values, traces in the optical picture: made by hand."""

import numpy as np
import pandas as pd
import pytest

from kilnflight.experiments import ignition
from kilnflight.flight import kept
from kilnflight.recording.files import open_any
from kilnflight.tables import FLIGHTS

FRAMES = np.arange(20)
FLIGHT = {"t0_s": -0.1, "first_s": 0.0, "last_s": 1.9, "end_s": 1.25, "dwell_s": 1.35}
FLIGHT |= {"ending": "landed", "start_mm": 0.0, "ignition": "none", "ignition_s": np.nan}
FLIGHT |= {"rise_gray": 0.0, "wall_mm": 700.0}


def test_a_trace_counts_up_to_the_landing_and_of_kept_flights_only():
    """The wall ignites all that land (5.1.1)."""
    rows = [FLIGHT | {"particle": k, "from_lance": True, "refused": ""} for k in range(3)]
    rows[2]["refused"] = "too fast"
    flights = pd.DataFrame(rows)[FLIGHTS.names]
    courses = {0: np.where(FRAMES < 8, 900.0, 2000.0), 1: np.where(FRAMES < 13, 900.0, 2000.0)}
    tracks = pd.concat(
        [
            pd.DataFrame({"particle": k, "frame": FRAMES, "time_s": FRAMES / 10, "gray": gray})
            for k, gray in courses.items()
        ]
    ).assign(background=1000.0)
    count = ignition.count_lit(kept(flights), tracks, pd.Series({0: False, 2: True}))
    assert (count["light_up"], count["light_at_first"], count["too_few"]) == (1, 0, 0)
    assert [count[name] for name in ("unlit", "unlit_light", "lit", "lit_light")] == [1, 1, 0, 0]
    assert (count["number"], count["estimate"]) == (2, 0.5)


def test_rates_of_hits_and_false_alarms():
    both = pd.DataFrame(
        {
            "fraction": "confetti",
            "pressure_bar": 4.5,
            "particle": range(6),
            "measurable": True,
            "track": [0, 1, 2, 3, 4, -1],
            "true_ignition_s": [0.1, 0.2, np.nan, np.nan, np.nan, 0.1],
            "measured_ignition_s": [0.13, np.nan, 0.3, np.nan, np.nan, np.nan],
        }
        | {
            f"{kind}_{name}": 1.0
            for kind in ("true", "measured")
            for name in ("dwell_s", "velocity_m_s")
        }
    )
    row = ignition.detection_rates(both, [("confetti", 4.5)]).iloc[0]
    assert (row["lit"], row["unlit"]) == (2, 3)  # of the five that were detected
    assert row["hit_percent"] == pytest.approx(50)
    assert row["false_alarm_percent"] == pytest.approx(33.33)
    assert row["time_error_median_s"] == pytest.approx(0.03)


def test_the_optical_picture_keeps_the_greatest_difference_light_or_dark():
    """A silhouette passes dark, a flame light, in whichever stretch of frames."""
    images = np.full((200, 24, 32), 1000, np.uint16)
    images[100:] = 1300  # the kiln brightens
    images[3, 5, 7] = 400  # a silhouette
    images[20, 5, 7] = 1100  # less
    images[150, 9, 9] = 5000  # a flame
    recording = open_any(images, frame_rate_hz=100.0)
    total = ignition.optical_picture(recording, range(200))
    assert (total[5, 7], total[9, 9]) == (700, 5000)
    rest = np.delete(total.ravel(), [5 * 32 + 7, 9 * 32 + 9])
    assert set(rest) == {1300}
