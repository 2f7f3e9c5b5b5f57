"""Checks of columns, shapes and numbers, and the error for unusable input."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from kilnflight.arrays import Array, Whole

if TYPE_CHECKING:  # notebooks start faster without it
    import pandas as pd


LARGEST_WHOLE = 2.0**53  # above it a float no longer holds every whole number


class InputError(ValueError):
    """Unusable input; the message says what, where and what to do."""


def check_columns(table: pd.DataFrame, columns: Sequence[str], where: str) -> None:
    """Raise an `InputError` unless ``table`` has all ``columns``."""
    if not hasattr(table, "columns"):
        raise InputError(f"{where}: {type(table).__name__} is no table; pass a pandas DataFrame.")
    missing = [name for name in columns if name not in table.columns]
    if missing:
        raise InputError(
            f"{where}: column(s) {', '.join(missing)} missing; it has "
            f"{', '.join(map(str, table.columns)) or 'none'}. Rename or add them."
        )
    doubled = [name for name in columns if np.sum(table.columns == name) > 1]
    if doubled:
        raise InputError(
            f"{where}: more than one column {', '.join(doubled)}. Leave out or rename the others."
        )


def check_shape(array: npt.NDArray[np.generic], shape: Sequence[int | None], where: str) -> None:
    """Raise an `InputError` unless ``array`` has ``shape`` (None: any)."""
    if array.ndim != len(shape) or any(
        expected not in (None, length) for length, expected in zip(array.shape, shape, strict=True)
    ):
        expected = tuple("n" if length is None else length for length in shape)
        raise InputError(f"{where}: shape {array.shape}, expected {expected}.".replace("'", ""))


def known_numbers(values: npt.ArrayLike, where: str) -> Array:
    """Return ``values`` as float64, NaN for gaps, or raise an `InputError`."""
    try:
        array = np.asarray(values)
        if array.dtype == object:  # numbers with gaps, or texts
            from pandas import isna

            array = np.array(np.where(isna(array), np.nan, array).tolist())
        if array.dtype.kind not in "iuf":  # numpy would make numbers of dates and of texts
            raise TypeError(f"it holds {array.dtype}")
        return array.astype(np.float64, copy=False)
    except (TypeError, ValueError) as error:
        raise InputError(f"{where}: not made of numbers ({error}).") from error


def check_finite(values: npt.ArrayLike, where: str) -> Array:
    """Return ``values`` as float64, or raise an `InputError`."""
    array = known_numbers(values, where)
    finite = np.isfinite(array)
    if not finite.all():  # searched only then: it takes eight times as long
        index = tuple(np.argwhere(~finite)[0].tolist())
        raise InputError(
            f"{where}: {np.sum(~finite)} value(s) are not finite, the first ({array[index]}) at "
            f"index {index}. Remove invalid points before the call."
        )
    return array


def check_whole(values: pd.Series, where: str) -> Whole:
    """Return a column of whole numbers as int64, also where floats hold them."""
    if values.dtype == np.int64 or not len(values):  # without rows it has no type to speak of
        return values.to_numpy(np.int64)
    numbers = check_finite(values, where)
    wrong = (numbers % 1 != 0) | (np.abs(numbers) > LARGEST_WHOLE)
    if wrong.any():
        row = int(wrong.argmax())
        raise InputError(f"{where}: {numbers[row]} in row {values.index[row]} is no whole number.")
    return numbers.astype(np.int64)


def check_number(
    value: Any,
    where: str,
    *,
    least: float = -math.inf,
    most: float = math.inf,
    above: float = -math.inf,
    below: float = math.inf,
    whole: bool = False,
) -> None:
    """Raise an `InputError` unless ``value`` is a finite number within these limits.

    ``least`` and ``most`` are allowed, ``above`` and ``below`` are not.
    """
    value = value.item() if isinstance(value, np.generic) else value  # told as 5, not np.int64(5)
    real = isinstance(value, Real) and not isinstance(value, bool)
    fits = real and least <= value <= most and above < value < below
    if not fits or abs(value) > sys.float_info.max or (whole and value % 1 != 0):
        limits = {"at least": least, "at most": most, "above": above, "below": below}
        rules = [f"{word} {limit:g}" for word, limit in limits.items() if math.isfinite(limit)]
        rule = ", ".join(["a whole number" if whole else "a number", *rules])
        raise InputError(f"{where}: must be {rule}, got {value!r}.")
