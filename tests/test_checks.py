import numpy as np
import pandas as pd
import pytest

from kilnflight.checks import (
    InputError,
    check_at_least,
    check_columns,
    check_count,
    check_finite,
    check_positive,
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


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_what_must_be_positive_is(value):
    with pytest.raises(InputError, match="limit: must be above 0"):
        check_positive(value, "limit")


@pytest.mark.parametrize("value", ["3", None, float("nan"), -1])
def test_what_is_no_number_or_too_small_is_refused(value):
    with pytest.raises(InputError, match="limit: must be 0 or above"):
        check_at_least(value, 0, "limit")
    with pytest.raises(InputError, match="count: must be a whole number from 0"):
        check_count(value, "count", 0)
    with pytest.raises(InputError, match="limit: must be above 0"):
        check_positive(value, "limit")


def test_a_half_and_a_truth_value_are_no_counts():
    for value in (2.5, True, np.inf):
        with pytest.raises(InputError, match="whole number from 1"):
            check_count(value, "count")
    check_count(np.int64(2), "count")
    check_count(2.0, "count")


@pytest.mark.parametrize("values", [["1"], [1j], np.array(["2023"], "M8[D]"), [[1], [1, 2]]])
def test_texts_dates_and_complex_numbers_are_not_numbers(values):
    with pytest.raises(InputError, match=r"depth: .*not made of numbers"):
        check_finite(values, "depth")


def test_truth_values_are_not_numbers():
    for check in (check_positive, check_count):
        with pytest.raises(InputError, match="limit: must be"):
            check(True, "limit")


def test_a_column_that_is_there_twice_is_refused():
    with pytest.raises(InputError, match="here: more than one column x"):
        check_columns(pd.DataFrame([[1, 2]], columns=["x", "x"]), ["x"], "here")
