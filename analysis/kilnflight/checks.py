"""Checks of input, the only place that words their errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

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


def check_finite(values: npt.ArrayLike, where: str) -> npt.NDArray[np.float64]:
    """Return ``values`` as float64, or raise an `InputError`."""
    try:
        array = np.asarray(values)
        if array.dtype.kind not in "biufO":  # numpy would make numbers of dates and of texts
            raise TypeError(f"it holds {array.dtype}")
        array = array.astype(np.float64, copy=False)
    except (TypeError, ValueError) as error:
        raise InputError(f"{where}: {values!r} is not made of numbers ({error}).") from error
    finite = np.isfinite(array)
    if not finite.all():  # searched only then: it takes eight times as long
        bad = np.argwhere(~finite)
        index = tuple(bad[0].tolist())
        raise InputError(
            f"{where}: {len(bad)} value(s) are not finite, the first ({array[index]}) at "
            f"index {index}. Remove invalid points before the call."
        )
    return array


def check_whole(values: pd.Series, where: str) -> npt.NDArray[np.int64]:
    """Return a column of whole numbers as int64, also where floats hold them.

    A column without rows has no type to speak of.

    Raises
    ------
    InputError
        If the column is not made of numbers, has gaps, or holds a fraction.
    """
    if values.dtype == np.int64:
        return values.to_numpy(np.int64)
    if not len(values):
        return np.empty(0, dtype=np.int64)
    if not is_real(values) or values.isna().any():
        raise InputError(
            f"{where} holds {values.dtype}{' with gaps' if values.isna().any() else ''}, expected "
            "whole numbers without gaps. Convert it first."
        )
    numbers = check_finite(values.to_numpy(np.float64), where)
    bad = np.flatnonzero((numbers % 1 != 0) | (np.abs(numbers) > LARGEST_WHOLE))
    if len(bad):
        raise InputError(
            f"{where}: {numbers[bad[0]]} in row {values.index[bad[0]]} is no whole number."
        )
    return numbers.astype(np.int64)


def known_numbers(values: pd.Series, where: str) -> npt.NDArray[np.float64]:
    """Return a column as float64, NaN for gaps, or raise an `InputError`."""
    try:
        if len(values) and not (is_real(values) or values.dtype == object):
            raise TypeError(f"it holds {values.dtype}")
        return values.to_numpy(np.float64, na_value=np.nan)
    except (TypeError, ValueError) as error:
        raise InputError(f"{where} is not made of numbers ({error}).") from error


def is_real(values: pd.Series) -> bool:
    """Return whether a column holds real numbers and nothing else."""
    return values.dtype.kind in "iuf"


def is_number(value: object) -> bool:
    """Return whether ``value`` is one finite real number, no truth value."""
    try:
        return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:  # a whole number that no float holds
        return False


def check_number(
    value: object,
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
    fits = is_number(value) and least <= value <= most and above < value < below  # type: ignore[operator]
    if not fits or (whole and value % 1 != 0):  # type: ignore[operator]
        limits = {"at least": least, "at most": most, "above": above, "below": below}
        rules = [f"{word} {limit:g}" for word, limit in limits.items() if math.isfinite(limit)]
        rule = ", ".join(["a whole number" if whole else "a number", *rules])
        raise InputError(f"{where}: must be {rule}, got {value!r}.")


def check_new(path: Path) -> None:
    """Raise an `InputError` if the file or folder exists already."""
    if path.exists():
        raise InputError(f"{path}: exists already. Delete it or choose another target.")


def check_target(path: Path) -> None:
    """Raise an `InputError` unless the folder of a new file exists."""
    if not path.parent.is_dir():
        raise InputError(f"{path}: its folder does not exist. Make it first.")
