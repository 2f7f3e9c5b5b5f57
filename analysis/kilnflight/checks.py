"""The one place that words an error about input: what was wrong, where, what to do."""

from __future__ import annotations

from collections.abc import Sequence
from numbers import Real

import numpy as np
import numpy.typing as npt
import pandas as pd


class InputError(ValueError):
    """Input that cannot be used; the message says what, where and what to do."""


def check_columns(table: pd.DataFrame, columns: Sequence[str], where: str) -> None:
    """Raise an `InputError` unless ``table`` has all ``columns``."""
    if not isinstance(table, pd.DataFrame):
        raise InputError(f"{where}: {type(table).__name__} is no table; pass a pandas DataFrame.")
    missing = [name for name in columns if name not in table.columns]
    if missing:
        raise InputError(
            f"{where}: column(s) {', '.join(missing)} missing; it has "
            f"{', '.join(map(str, table.columns)) or 'none'}. Rename or add them."
        )


def check_shape(array: npt.NDArray[np.generic], shape: Sequence[int | None], where: str) -> None:
    """Raise an `InputError` unless ``array`` has ``shape`` (None: any length)."""
    fits = array.ndim == len(shape) and all(
        wanted is None or length == wanted
        for length, wanted in zip(array.shape, shape, strict=True)
    )
    if not fits:
        wanted = tuple("n" if length is None else length for length in shape)
        raise InputError(f"{where}: shape {array.shape}, expected {wanted}.".replace("'", ""))


def check_finite(values: npt.ArrayLike, where: str) -> npt.NDArray[np.float64]:
    """Return ``values`` as float64, or raise an `InputError` naming the first bad one."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{where}: {values!r} is not made of numbers ({error}).") from error
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        index = tuple(int(i) for i in bad[0])
        raise InputError(
            f"{where}: {len(bad)} value(s) are not finite, the first ({array[index]}) at "
            f"index {index}. Remove invalid points before the call."
        )
    return array


def check_positive(value: float, where: str) -> None:
    """Raise an `InputError` unless ``value`` is a number, finite and above zero."""
    if not (isinstance(value, Real) and np.isfinite(float(value)) and value > 0):
        raise InputError(f"{where}: must be above 0, got {value!r}.")


def check_at_least(value: float, least: float, where: str) -> None:
    """Raise an `InputError` unless ``value`` is a finite number, ``least`` or above."""
    if not (isinstance(value, Real) and np.isfinite(float(value)) and value >= least):
        raise InputError(f"{where}: must be {least} or above, got {value!r}.")


def check_count(count: float, where: str, least: int = 1) -> None:
    """Raise an `InputError` unless ``count`` is a whole number, ``least`` or above."""
    number = isinstance(count, Real) and not isinstance(count, bool | np.bool_)
    if not (number and np.isfinite(float(count)) and count == int(count) and count >= least):
        raise InputError(f"{where}: must be a whole number from {least}, got {count!r}.")
