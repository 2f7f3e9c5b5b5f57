import numpy as np
import pandas as pd
import pytest

from kilnflight.checks import (
    InputError,
    check_columns,
    check_finite,
    check_number,
    check_shape,
    check_whole,
)


@pytest.mark.parametrize(
    "table",
    [pd.DataFrame({"x": [1.0]}), [1], pd.DataFrame([[1, 2, 3]], columns=["x", "y", "y"])],
    ids=["missing", "no table", "twice"],
)
def test_a_table_without_its_columns_is_refused(table):
    with pytest.raises(InputError, match=r"tracks\.csv: "):
        check_columns(table, ["y", "x"], "tracks.csv")
    check_columns(pd.DataFrame({"b": [1], "x": [2], "y": [2]}), ["y", "x"], "here")


@pytest.mark.parametrize("shape", [(3,), (3, 2), (2, 3, 1)])
def test_a_wrong_shape_is_refused(shape):
    with pytest.raises(InputError, match="points: "):
        check_shape(np.zeros(shape), (None, 3), "points")
    check_shape(np.zeros((0, 3)), (None, 3), "points")


@pytest.mark.parametrize("value", [0.0, 1.0, 1.5, -1, True, "0.5", None, np.nan, np.inf, 10**400])
def test_what_is_no_number_within_the_limits_is_refused(value):
    with pytest.raises(InputError, match="share: "):
        check_number(value, "share", above=0, below=1)


def test_limits_may_be_allowed_and_whole_numbers_asked_for():
    check_number(0.5, "share", above=0, below=1)
    check_number(1, "share", least=1, most=1)
    check_number(np.int64(2), "count", least=1, whole=True)
    check_number(2.0, "count", least=1, whole=True)
    for value in (2.5, 0, True):
        with pytest.raises(InputError, match="count: "):
            check_number(value, "count", least=1, whole=True)


@pytest.mark.parametrize(
    "values", [["1"], [1j], np.array(["2023"], "M8[D]"), [[1], [1, 2]], [True], [None, "1.0"]]
)
def test_texts_dates_and_complex_numbers_are_not_numbers(values):
    for gaps in (False, True):
        with pytest.raises(InputError, match="depth: "):
            check_finite(values, "depth", gaps=gaps)


def test_numbers_come_back_as_floats_and_gaps_as_nan():
    assert check_finite([1, 2], "depth").dtype == np.float64
    for column in (pd.Series([1, None], dtype="Int64"), pd.Series([1.0, pd.NA], dtype=object)):
        np.testing.assert_array_equal(check_finite(column, "depth", gaps=True), [1.0, np.nan])
    with pytest.raises(InputError, match="depth: "):
        check_finite([1.0, np.nan, np.inf], "depth")
    assert check_whole(pd.Series([1.0, 2.0]), "frame").tolist() == [1, 2]
    for wrong in ([1.5], [None], [2.0**60], ["1"]):
        with pytest.raises(InputError, match="frame"):
            check_whole(pd.Series(wrong), "frame")
