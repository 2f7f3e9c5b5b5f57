import numpy as np
import pandas as pd
import pytest

from kilnflight.checks import (
    InputError,
    check_columns,
    check_finite,
    check_number,
    check_shape,
)


def test_missing_columns_are_named_with_the_place():
    with pytest.raises(InputError, match=r"tracks\.csv: column\(s\) y missing; it has x"):
        check_columns(pd.DataFrame({"x": [1.0]}), ["x", "y"], "tracks.csv")


def test_what_is_no_table_is_refused():
    with pytest.raises(InputError, match="list is no table"):
        check_columns([1], ["x"], "here")


def test_columns_that_are_there_pass_in_any_order():
    check_columns(pd.DataFrame({"b": [1], "a": [2]}), ["a", "b"], "here")


@pytest.mark.parametrize("shape", [(3,), (3, 2), (2, 3, 1)])
def test_a_wrong_shape_is_refused(shape):
    with pytest.raises(InputError, match=r"points: shape .*expected \(n, 3\)"):
        check_shape(np.zeros(shape), (None, 3), "points")


def test_an_empty_array_of_the_right_shape_passes():
    check_shape(np.zeros((0, 3)), (None, 3), "points")


def test_the_first_bad_value_is_named_with_its_index():
    with pytest.raises(InputError, match=r"depth: 2 value\(s\).*\(nan\) at index \(1,\)"):
        check_finite([1.0, np.nan, np.inf], "depth")


def test_finite_values_come_back_as_floats():
    assert check_finite([1, 2], "depth").dtype == np.float64


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


@pytest.mark.parametrize("values", [["1"], [1j], np.array(["2023"], "M8[D]"), [[1], [1, 2]]])
def test_texts_dates_and_complex_numbers_are_not_numbers(values):
    with pytest.raises(InputError, match=r"depth: .*not made of numbers"):
        check_finite(values, "depth")


def test_a_column_that_is_there_twice_is_refused():
    with pytest.raises(InputError, match="here: more than one column x"):
        check_columns(pd.DataFrame([[1, 2]], columns=["x", "x"]), ["x"], "here")
