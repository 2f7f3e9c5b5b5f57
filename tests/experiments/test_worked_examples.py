"""Worked examples: what the text says of its sketches is what the functions decide."""

import numpy as np
import pytest

from kilnflight.experiments import worked_examples as examples
from kilnflight.tracklets import Connection, OutlierRemoval


def test_a_detection_far_from_all_is_false_and_a_particle_without_one_is_missed():
    score, costs = examples.score_instance(45.0)
    assert costs.index[score.spurious].tolist() == ["d4"]
    assert costs.columns[score.missed].tolist() == ["p3"]
    assert score.pairs.tolist() == [[0, 0], [1, 1], [3, 2], [4, 4]]
    assert costs["p2"].idxmin() == "d1"  # which p1 needs
    assert costs.loc["d4"].isna().all()


def test_the_matrix_frames_each_pair_and_names_what_is_left(axes):
    score, costs = examples.score_instance(45.0)
    picture = examples.draw_assignment(score, costs, 45.0)
    texts = [text.get_text() for text in picture.axes[0].texts]
    assert (texts.count("FP"), texts.count("FN")) == (1, 1)
    assert texts.count("C max") == costs.isna().to_numpy().sum()


def removed(cases, column="removed"):
    table = examples.judge_outliers(cases, OutlierRemoval())
    groups = table.groupby("case", sort=False)
    return {name: (np.flatnonzero(part[column]) + 1).tolist() for name, part in groups}, table


def test_one_condition_alone_removes_nothing():
    gone, table = removed(examples.SITUATIONS)
    assert gone["situation 1: it turns"] == gone["situation 2: it speeds up"] == []
    most = table.groupby("case")[["turn_deg", "change_px_frame"]].max()
    assert most.loc["situation 1: it turns", "turn_deg"] > 30
    assert most.loc["situation 1: it turns", "change_px_frame"] < 18
    assert most.loc["situation 2: it speeds up", "turn_deg"] < 30
    assert most.loc["situation 2: it speeds up", "change_px_frame"] > 18


@pytest.mark.parametrize(("column", "gone"), [("removed", [4]), ("alone", [2, 3, 4])])
def test_in_situation_3_the_outlier_goes_alone_if_the_second_is_examined_from_the_last(
    column, gone
):
    assert removed(examples.SITUATIONS, column)[0]["situation 3: both"] == gone


def test_a_wrong_second_position_is_found_backwards_only():
    assert removed(examples.SECOND, "forwards")[0]["four positions"] == [3]
    for column in ("removed", "alone"):
        gone, _ = removed(examples.SECOND, column)
        assert gone == {"four positions": [2], "six positions": [1, 2]}


def test_each_panel_draws_the_outliers_of_its_column(axes):
    table = examples.judge_outliers(examples.SECOND, OutlierRemoval())
    by = {"one": ("four positions", "forwards"), "two": ("four positions", "removed")}
    panels = examples.draw_outliers(table, by).axes
    third, second = (axes.lines[1].get_xdata().tolist() for axes in panels[:2])
    assert (third, second) == ([24.0], [12.0])


def test_wrong_ends_are_removed():
    gone, _ = removed(examples.ENDS)
    assert gone == {"the first position": [1], "the last position": [6]}


def frames(table, name, inside=False):
    part = table[(table["tracklet"] == name) & (table["connected"] | (not inside))]
    return part["frame"].tolist()


@pytest.mark.parametrize(
    ("pair", "earlier", "later"),
    [(examples.CONNECTED, [5, 7, 8], [11, 13, 14]), (examples.MERGED, [5, 7, 9], [11, 13, 14])],
)
def test_the_connected_part_is_that_of_figure_4_10(pair, earlier, later):
    table = examples.joined_example(pair, Connection())
    assert frames(table, "Ti", inside=True) == earlier
    assert frames(table, "Tk", inside=True) == later
    assert frames(table, "Tj") == sorted({*pair[0], *pair[1]})


def test_common_frames_are_the_mean_of_both():
    table = examples.joined_example(examples.MERGED, Connection())
    rows = table.pivot(index="frame", columns="tracklet", values="row")
    common = rows.dropna()
    assert common.index.tolist() == [9, 11]
    np.testing.assert_allclose(common["Tj"], common[["Ti", "Tk"]].mean(axis=1))
    assert frames(examples.joined_example(examples.MERGED, Connection(overlap=2.0)), "Tj") == []
