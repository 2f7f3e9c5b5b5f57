import itertools

import numpy as np
import pandas as pd

from kilnflight.experiments import plots
from kilnflight.project import style


def test_grouped_bars_stand_side_by_side():
    table = pd.DataFrame(
        {"subset": ["V1", "V1", "V2", "V2"], "kind": ["a", "b"] * 2, "recall": [0.1, 0.2, 0.3, 0.4]}
    )
    _, ((axes,),) = style.canvas()
    plots.bars(axes, table, "subset", "kind", "recall")
    heights = [bar.get_height() for bar in axes.patches]
    assert heights == [0.1, 0.3, 0.2, 0.4]
    assert [label.get_text() for label in axes.get_xticklabels()] == ["V1", "V2"]
    left = sorted((bar.get_x(), bar.get_x() + bar.get_width()) for bar in axes.patches)
    assert all(one[1] < two[0] for one, two in itertools.pairwise(left))
    style.plt.close("all")


def test_intervals_have_a_row_per_method_the_first_on_top():
    table = pd.DataFrame(
        {"f1": [0.8, 0.6], "f1_low": [0.7, 0.5], "f1_high": [0.85, 0.65], "printed": [0.9, np.nan],
         "pixels": [0.75, 0.55]},
        index=["best", "other"],
    )  # fmt: skip
    _, ((axes,),) = style.canvas()
    plots.intervals(axes, table, "printed", "pixels")
    assert [label.get_text() for label in axes.get_yticklabels()] == ["best", "other"]
    assert axes.get_ylim()[0] > axes.get_ylim()[1]
    style.plt.close("all")


def test_without_and_with_are_joined_at_the_place_of_their_entry():
    _, ((axes,),) = style.canvas()
    table = pd.DataFrame({"who": ["b", "b", "a", "a"], "stage": ["without", "with"] * 2})
    plots.before_after(axes, table.assign(value=[1.0, 2.0, 3.0, np.nan]), "who", "stage", "value")
    without, after = axes.lines
    np.testing.assert_array_equal(without.get_xydata(), [[1, 0], [3, 1]])
    np.testing.assert_array_equal(after.get_xydata(), [[2, 0], [np.nan, 1]])
    assert [text.get_text() for text in axes.get_yticklabels()] == ["b", "a"]
