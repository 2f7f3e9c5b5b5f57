"""Box plots and lines of deviations on the belt have the panels of their tables."""

from itertools import product

import matplotlib.pyplot as plt
import pandas as pd
import pytest

from kilnflight.belt import PredictionPhase
from kilnflight.belt.phase import Observed
from kilnflight.checks import InputError
from kilnflight.experiments import belt_plots

BOX = {"whisker_low": -2.0, "q25": -1.0, "median": 0.0, "q75": 1.0, "whisker_high": 2.0}
KEYS = ["source", "data_set", "model"]


def summaries(models):
    rows = product(("authors", "own"), ("spheres", "cuboids"), models)
    return pd.DataFrame(rows, columns=KEYS).assign(**BOX)


def test_panels_are_rows_by_columns_with_a_box_for_each_model():
    labels = {"own": "below", "authors": "above"}
    picture = belt_plots.boxes(summaries(["IV", "CV"]), tuple(KEYS), labels, 80, xlim=(-1, 3))
    panels = picture.axes
    assert [axes.get_title() for axes in panels] == ["spheres", "cuboids"] * 2
    assert [axes.get_ylabel() for axes in panels] == ["below"] * 2 + ["above"] * 2
    assert [text.get_text() for text in panels[0].get_xticklabels()] == ["IV", "CV"]
    assert panels[3].get_xlim() == (-1, 3)


def test_sources_name_their_first_panel_and_many_models_are_turned():
    picture = belt_plots.boxes_by_source(summaries("abcdef"), "ms", 40)
    assert [axes.get_ylabel() for axes in picture.axes] == ["authors\nms", "", "own\nms", ""]
    assert picture.axes[0].get_xticklabels()[0].get_rotation() == 60


def test_rates_have_a_panel_for_each_data_set_and_a_line_for_each_model():
    rows = product((100.0, 1000.0), ("spheres", "cuboids"), ("IV", "CV"))
    table = pd.DataFrame(rows, columns=["sampling_hz", "data_set", "model"]).assign(mae=1.0)
    picture = belt_plots.lines_by_rate(table, ["CV"], "mae", "ms")
    assert [axes.get_title() for axes in picture.axes] == ["spheres", "cuboids"]
    assert [len(axes.lines) for axes in picture.axes] == [1, 1]


# Figs 4 and 5 of the 2020 paper

PHASE = PredictionPhase()


def test_the_crossing_lies_between_its_neighbours_in_place_and_time():
    track = pd.DataFrame({"x": [760.0, 770.0, 780.0], "y": [9.0, 10.0, 12.0]})
    points = belt_plots.crossing(track.assign(time_s=[0.0, 0.01, 0.02]), 775.0)
    assert points.loc["crossing"].tolist() == pytest.approx([775.0, 11.0, 15.0])
    assert points["x_mm"].tolist() == [770.0, 775.0, 780.0]
    plt.close(belt_plots.draw_crossing(points, 775.0))
    with pytest.raises(InputError, match="both sides of 900 mm"):
        belt_plots.crossing(track.assign(time_s=[0.0, 0.01, 0.02]), 900.0)


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
    sets = {"spheres": observed(1.0), "cuboids": observed(40.0)}  # 20 mm to 26 mm, past 22.5
    data_set, table = belt_plots.decisions(sets, PHASE, 0)
    assert data_set == "cuboids"
    assert table["nozzle"].to_dict() == {"optimal": 1, "Straight": 0, "CV-CV": 1}
    late = table["opens_ms"] + belt_plots.OPEN_MS / 2
    assert late.tolist() == pytest.approx([0.0, 0.0, 10.0])  # Straight has no time of its own
    plt.close(belt_plots.draw_decisions(table))


def test_without_a_wrong_valve_there_is_nothing_to_draw():
    with pytest.raises(InputError, match="no particle"):
        belt_plots.decisions({"spheres": observed(1.0)}, PHASE, 0)
