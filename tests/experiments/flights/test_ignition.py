"""Rates of the test of grey values, traces in the optical picture: made by hand."""

import numpy as np
import pandas as pd
import pytest

from kilnflight.experiments.flights import ignition
from kilnflight.experiments.flights.accuracy import errors
from kilnflight.ignition import Ignition
from kilnflight.publication import notebooks
from kilnflight.recording.files import open_any


def count(flights, tracks, ignites):
    """Count the flights that ignite, each tested as in notebook 54."""
    chapter = notebooks.borrow("54_ignition")
    flying = chapter.before_the_end(tracks, flights)
    outcomes = {
        particle: Ignition()(each["time_s"], each["gray"], each["background"]).outcome
        for particle, each in flying.groupby("particle")
    }
    return ignition.count_lit(flights, flying, outcomes, ignites)


def test_a_trace_counts_up_to_the_landing():
    """The wall ignites all that land (5.1.1)."""
    flights = pd.DataFrame({"particle": range(2), "end_s": 1.25})
    particle, frame = np.repeat([0, 1], 20), np.tile(np.arange(20), 2)
    gray = np.where(frame < np.where(particle == 0, 8, 13), 900.0, 2000.0)  # 8: 0.8 s
    tracks = {"particle": particle, "frame": frame, "time_s": frame / 10, "gray": gray}
    tracks = pd.DataFrame(tracks).assign(background=1000.0)
    found = count(flights, tracks, pd.Series({0: False, 2: True}))
    assert (found["light_up"], found["light_at_first"], found["too_few"]) == (1, 0, 0)
    assert (found["unlit"], found["unlit_up"]) == (1, 1)
    assert (found["lit"], found["lit_up"]) == (0, 0)
    assert (found["number"], found["estimate"]) == (2, 0.5)


def test_light_at_first_sight_is_no_ignition():
    """ "If the gray value increases abruptly" (5.3.2): it must rise.

    Flight 1 has no detection before its end: it has too few points.
    """
    frame = np.arange(30)
    steady = 2000.0 + 10 * np.sin(5 * frame)
    tracks = pd.DataFrame(
        {"particle": 0, "frame": frame, "time_s": frame / 100, "gray": steady}
    )
    flights = pd.DataFrame({"particle": [0, 1], "end_s": 1.0})
    tracks = tracks.assign(background=1000.0)
    found = count(flights, tracks, pd.Series({0: False, 1: True}))
    names = (
        "light_up",
        "light_at_first",
        "too_few",
        "unlit",
        "unlit_up",
        "unlit_light",
        "lit",
    )
    assert [found[name] for name in names] == [0, 1, 1, 1, 0, 1, 0]
    assert found["unlit_gray"] == pytest.approx(2000.0, abs=5)


def test_hits_and_false_alarms_are_counted():
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
    )
    other = [
        "true_dwell_s",
        "measured_dwell_s",
        "true_velocity_m_s",
        "measured_velocity_m_s",
    ]
    both = both.assign(**dict.fromkeys(other, 1.0))
    row = errors(both)
    assert (row["lit"], row["unlit"]) == (2, 3)  # five were detected
    assert (row["lit_detected"], row["unlit_detected"]) == (1, 1)
    assert row["ignition_s_bias"] == pytest.approx(0.03)


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
