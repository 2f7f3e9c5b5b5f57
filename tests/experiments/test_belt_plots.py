"""Box plots and lines of deviations on the belt have the panels of their tables."""

from itertools import product

import pandas as pd

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
