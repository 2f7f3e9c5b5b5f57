"""Checks of columns, shapes and numbers, and the error for unusable input."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Sequence
from numbers import Real
from typing import Any

import numpy as np
import numpy.typing as npt

from kilnflight.arrays import Array, Whole

LARGEST_WHOLE = 2.0**53  # above it a float no longer holds every whole number


def printable(text: object) -> str:
    """Return a text in one line, control characters as escapes: no name commands a
    terminal.
    """
    return re.sub(
        r"[\x00-\x1f\x7f-\x9f]", lambda found: repr(found[0])[1:-1], str(text)
    )


class InputError(ValueError):
    """Unusable input; the message says what, where and what to do, in one line."""

    def __str__(self) -> str:
        return printable(super().__str__())


def check_columns(table: Any, columns: Sequence[str], where: str) -> None:
    """Raise an `InputError` unless ``table`` is a DataFrame with ``columns``, each
    once.
    """
    held = getattr(table, "columns", None)
    if not hasattr(held, "nlevels") or hasattr(held, "levels"):
        kind = type(table).__name__
        raise InputError(
            f"{where}: {kind}. Pass a DataFrame with one level of column names."
        )
    missing = [name for name in columns if name not in table.columns]
    if missing:
        has = ", ".join(map(str, table.columns)) or "none"
        raise InputError(
            f"{where}: no column {', '.join(missing)}; it has {has}. Add or rename it."
        )
    doubled = [name for name in columns if np.sum(table.columns == name) > 1]
    if doubled:
        raise InputError(
            f"{where}: several columns {', '.join(map(str, doubled))}. Keep one."
        )


def check_shape(
    array: npt.NDArray[np.generic], shape: Sequence[int | None], where: str
) -> None:
    """Raise an `InputError` unless ``array`` has ``shape`` (None: any)."""
    if array.ndim != len(shape) or any(
        expected not in (None, length)
        for length, expected in zip(array.shape, shape, strict=True)
    ):
        expected = tuple("n" if length is None else length for length in shape)
        raise InputError(
            f"{where}: shape {array.shape}, expected {expected}.".replace("'", "")
        )


def real_numbers(values: npt.ArrayLike, where: str) -> npt.NDArray[Any]:
    """Return ``values`` as integers or floats, NaN for gaps, or raise an `InputError`."""
    try:
        array = np.asarray(values)
        if array.dtype == object:  # numbers with gaps, or texts
            from pandas import isna

            cells = np.where(isna(array), np.nan, array)
            if any(
                isinstance(cell, bool) or not isinstance(cell, Real)
                for cell in cells.flat
            ):
                raise TypeError("a cell holds text, a truth value or a list")
            array = np.array(cells.tolist())
        # numpy would make numbers of dates and of texts, and forget a mask
        if array.dtype.kind not in "iuf" or np.ma.isMaskedArray(values):
            masked = (
                ", masked: fill it or leave out what is hidden"
                * np.ma.isMaskedArray(values)
            )
            raise TypeError(f"it holds {array.dtype}{masked}")
        return array
    except (TypeError, ValueError) as error:
        raise InputError(f"{where}: not made of numbers ({error}).") from error


def check_finite(
    values: Any, where: str, shape: Any = None, gaps: bool = False, most: float = 1e100
) -> Array:
    """Return ``values`` as float64, or raise an `InputError`.

    They have ``shape`` (None: any length or, alone, any shape); an empty list has it,
    too. With ``gaps`` NaN is allowed. Infinity is not, nor a size of ``most`` or more:
    squares stay finite.
    """
    array = real_numbers(values, where).astype(np.float64, order="C", copy=False)
    if shape is not None:
        array = (
            np.ones([n or 0 for n in shape])
            if array.shape == (0,) and None in shape
            else array
        )
        check_shape(array, shape, where)
    if (
        not -most < array.min(initial=0.0) <= array.max(initial=0.0) < most
    ):  # so it is fast
        finite = (np.abs(array) < most) | (np.isnan(array) & gaps)
        for index in map(tuple, np.argwhere(~finite)[:1].tolist()):
            wrong = (
                f"{np.sum(~finite)} value(s) are not finite or too large "
                f"({array[index]})"
            )
            raise InputError(
                f"{where}: {wrong}, the first at {index}. Leave out such points."
            )
    return array


def check_whole(values: Any, where: str) -> Whole:
    """Return a column of whole numbers as int64, also where floats hold them."""
    numbers = check_finite(values, where)
    wrong = (numbers % 1 != 0) | (np.abs(numbers) > LARGEST_WHOLE)
    for row in np.flatnonzero(wrong)[:1]:
        raise InputError(
            f"{where}: {numbers[row]} in row {values.index[row]} is no whole number."
        )
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
) -> Any:
    """Return ``value`` as a number of Python, or raise an `InputError`: not finite, or
    outside.

    ``least`` and ``most`` are allowed, ``above`` and ``below`` are not.
    """
    value = (
        value.item() if isinstance(value, np.generic) else value
    )  # told as 5, not np.int64(5)
    fits = (
        type(value) in (int, float) and least <= value <= most and above < value < below
    )
    if not fits or abs(value) > sys.float_info.max or (whole and value % 1 != 0):
        limits = {"at least": least, "at most": most, "above": above, "below": below}
        rules = [
            f"{word} {limit:g}"
            for word, limit in limits.items()
            if math.isfinite(limit)
        ]
        rule = ", ".join(["a whole number" if whole else "a number", *rules])
        raise InputError(f"{where}: must be {rule}, got {value!r}.")
    return int(value) if whole else value
