"""Figs 4 and 5 of the 2020 paper, from tracks."""

import matplotlib.pyplot as plt
import pandas as pd
import pytest

from kilnflight.belt import PredictionPhase
from kilnflight.belt.phase import Observed
from kilnflight.checks import InputError
from kilnflight.experiments import belt_decisions

PHASE = PredictionPhase()


def test_the_crossing_lies_between_its_neighbours_in_place_and_time():
    track = pd.DataFrame({"x": [760.0, 770.0, 780.0], "y": [9.0, 10.0, 12.0]})
    points = belt_decisions.crossing(track.assign(time_s=[0.0, 0.01, 0.02]), 775.0)
    assert points.loc["crossing"].tolist() == pytest.approx([775.0, 11.0, 15.0])
    assert points["x_mm"].tolist() == [770.0, 775.0, 780.0]
    plt.close(belt_decisions.draw_crossing(points, 775.0))
    with pytest.raises(InputError, match="both sides of 900 mm"):
        belt_decisions.crossing(track.assign(time_s=[0.0, 0.01, 0.02]), 900.0)


def observed(velocity_y):
    """150 mm at 1000 mm/s take 150 ms; the particle itself, faster at the end, takes 140 ms."""
    count = 100
    last = {"particle": range(count), "time_s": 0.0, "x": 623.0, "y": 20.0}
    last |= {"velocity_x_mm_s": 1000.0, "velocity_y_mm_s": velocity_y}
    last |= {"acceleration_x_mm_s2": 0.0, "acceleration_y_mm_s2": 0.0}
    arrival = {"particle": range(count), "time_s": 0.140, "y": 20.0 + 0.15 * velocity_y}
    arrival |= {"velocity_y_mm_s": velocity_y}
    return Observed(pd.DataFrame(last), pd.DataFrame(arrival), {})


def test_a_particle_that_drifts_over_a_border_gets_the_wrong_valve_from_straight():
    table = belt_decisions.decisions(observed(40.0), PHASE, 0)  # from 20 mm to 26 mm, past 22.5
    assert table["nozzle"].to_dict() == {"optimal": 1, "Straight": 0, "CV-CV": 1}
    late = table["opens_ms"] + belt_decisions.OPEN_MS / 2
    assert late.tolist() == pytest.approx([0.0, 0.0, 10.0])  # Straight has no time of its own
    plt.close(belt_decisions.draw_decisions(table))


def test_without_a_wrong_valve_there_is_nothing_to_draw():
    with pytest.raises(InputError, match="no particle"):
        belt_decisions.decisions(observed(1.0), PHASE, 0)
