"""Pictures of flights: what is drawn where, and nothing from a network."""

import re

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest

from kilnflight.experiments import plots
from kilnflight.regression import Fit

FIT = Fit(
    (0.0, 0.0, 6500.0), 0.1, 0, (0.0, 0.1), (2, 2, 2),
    ((1.0, 0.0), (0.0, -4.9), (-9000.0, 0.0)), 0.2, 0.5, 60,
)  # fmt: skip
TRACK = pd.DataFrame(
    {"particle": 3, "frame": [60, 70], "x": 0.0, "y": 1.0, "z": [5600.0, np.nan], "gray": 900.0}
)


def test_boxes_stand_side_by_side_with_their_numbers(axes):
    groups = {
        "true": [np.array([1.0, 2, 3]), np.empty(0)],
        "measured": [np.array([2.0, np.nan])] * 2,
    }
    plots.grouped_boxes(axes, groups, ["a", "b"])
    assert [text.get_text() for text in axes.texts] == ["3", "0", "1", "1"]
    assert [text.get_text() for text in axes.get_xticklabels()] == ["a", "b"]
    names = [handle.get_label() for handle in axes.get_legend_handles_labels()[0]]
    assert names == ["true", "measured"]


def test_open_bounds_run_to_the_edge(axes):
    axes.set_ylim(0, 10)
    bounds = pd.DataFrame({"at": [1.0, 2.0], "low": [3.0, np.nan], "high": [np.nan, 4.0]})
    plots.published(axes, bounds)
    ends = [one.get_segments()[0][:, 1] for one in axes.collections]
    np.testing.assert_allclose(ends, [[2.92, 10.08], [-0.08, 4.08]])
    assert axes.get_ylim() == (0, 10)


def test_curves_start_at_the_lance_and_points_without_depth_are_left_out():
    figure = plt.figure()
    axes = figure.add_subplot(projection="3d")
    plots.curves(axes, [FIT], [TRACK])
    depth, across, _ = axes.lines[0].get_data_3d()
    assert (depth[0], across[0]) == (pytest.approx(6.5), pytest.approx(0.0))
    assert len(axes.lines[1].get_data_3d()[0]) == 1
    plt.close(figure)


def test_the_view_that_turns_needs_no_network():
    page = plots.turning({3: FIT}, TRACK, "confetti")
    assert "Plotly.newPlot" in page
    assert not re.search(r"<(script|link)[^>]+(src|href)=", page)


def test_no_trajectory_gives_an_empty_view():
    assert "Plotly.newPlot" in plots.turning({}, TRACK.head(0), "none")
