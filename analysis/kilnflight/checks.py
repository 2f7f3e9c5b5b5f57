"""Checks of columns, shapes, numbers and settings; the error for unusable input."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from numbers import Real
from types import NoneType, UnionType
from typing import (
    Annotated,
    Any,
    ClassVar,
    Literal,
    NamedTuple,
    dataclass_transform,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np
import numpy.typing as npt

from kilnflight.arrays import Array, Facts, Texts, Whole

LARGEST = 1e100  # squares of smaller numbers are finite
LARGEST_WHOLE = 2.0**53  # larger floats skip whole numbers


def printable(text: object) -> str:
    """Return a text in one line, control characters as escapes.

    So no name commands a terminal.
    """
    return re.sub(
        r"[\x00-\x1f\x7f-\x9f]", lambda found: repr(found[0])[1:-1], str(text)
    )


class InputError(ValueError):
    """Unusable input; the message says what, where and what to do, in one line."""

    def __str__(self) -> str:
        return printable(super().__str__())


def check_columns(table: Any, columns: Texts, where: str) -> None:
    """Raise an `InputError` unless a DataFrame has ``columns``, each once."""
    held: Any = getattr(table, "columns", None)
    if not hasattr(held, "nlevels") or hasattr(held, "levels"):
        raise InputError(
            f"{where}: {type(table).__name__}. Pass a DataFrame with one level of "
            "column names."
        )
    missing = [name for name in columns if name not in held]
    if missing:
        has = ", ".join(map(str, held)) or "none"
        raise InputError(
            f"{where}: no column {', '.join(missing)}; it has {has}. Add or rename it."
        )
    doubled = [name for name in columns if np.sum(held == name) > 1]
    if doubled:
        raise InputError(
            f"{where}: several columns {', '.join(map(str, doubled))}. Keep one."
        )


def check_shape(
    array: npt.NDArray[np.generic], shape: Sequence[int | None], where: str
) -> None:
    """Raise an `InputError` unless ``array`` has ``shape`` (None: any)."""
    fits = array.ndim == len(shape) and all(
        expected in (None, length)
        for length, expected in zip(array.shape, shape, strict=True)
    )
    if not fits:
        raise InputError(
            f"{where}: shape {array.shape}, expected "
            f"{str(tuple(shape)).replace('None', 'n')}."
        )


def real_numbers(values: npt.ArrayLike, where: str) -> npt.NDArray[Any]:
    """Return ``values`` as integers or floats, NaN for gaps."""
    try:
        array = np.asarray(values)
        if array.dtype == object:
            from pandas import isna

            cells = np.where(isna(array), np.nan, array)
            for cell in cells.flat:
                if isinstance(cell, bool) or not isinstance(cell, Real):
                    raise TypeError("a cell holds text, a truth value or a list")
            array = np.array(cells.tolist())
        # numpy would make numbers of dates and of texts, and forget a mask
        if np.ma.isMaskedArray(values):
            raise TypeError("it is masked: fill it or leave out what is hidden")
        if array.dtype.kind not in "iuf":
            raise TypeError(f"it holds {array.dtype}")
        return array
    except (TypeError, ValueError) as error:
        raise InputError(f"{where}: not made of numbers ({error}).") from error


def check_finite(
    values: Any,
    where: str,
    shape: Any = None,
    gaps: bool = False,
    most: float = LARGEST,
) -> Array:
    """Return ``values`` as float64, or raise an `InputError`.

    They have ``shape`` (None: any length or, alone, any shape); an empty list has it,
    too. With ``gaps`` NaN is allowed. Infinity is not, nor a size of ``most`` or more:
    squares stay finite.
    """
    array = real_numbers(values, where).astype(np.float64, order="C", copy=False)
    if shape is not None:
        if array.shape == (0,) and None in shape:
            array = np.ones([n or 0 for n in shape])
        check_shape(array, shape, where)
    # two passes without a copy, for the usual case
    if -most < array.min(initial=0.0) <= array.max(initial=0.0) < most:
        return array
    wrong = ~((np.abs(array) < most) | (np.isnan(array) & gaps))
    if wrong.any():
        first = tuple(np.argwhere(wrong)[0].tolist())
        raise InputError(
            f"{where}: {wrong.sum()} value(s) are not finite or too large "
            f"({array[first]}), the first at {first}. Leave out such points."
        )
    return array


def check_flags(where: str, *values: Any) -> None:
    """Raise an `InputError` unless each is True or False; numbers and words are not."""
    for value in values:
        if not isinstance(value, bool | np.bool_):
            raise InputError(f"{where}: must be True or False, got {value!r}.")


def check_whole(values: Any, where: str) -> Whole:
    """Return a column of whole numbers as int64, also where floats hold them."""
    numbers = check_finite(values, where)
    wrong = np.flatnonzero((numbers % 1 != 0) | (np.abs(numbers) > LARGEST_WHOLE))
    if len(wrong):
        row = wrong[0]
        raise InputError(
            f"{where}: {numbers[row]} in row {values.index[row]} is no whole number."
        )
    return numbers.astype(np.int64)


class Range(NamedTuple):
    """Limits of a number: those that it may be, those that it may not, and infinity."""

    least: float = -math.inf
    most: float = math.inf
    above: float = -LARGEST
    below: float = LARGEST
    infinite: bool = False  # whether it may be infinite


def check_number(value: Any, where: str, *, whole: bool = False, **limits: Any) -> Any:
    """Return ``value`` as a number of Python.

    Parameters
    ----------
    value
        Number.
    where
        Begins the message of an error.
    whole
        Whether it has to be a whole number.
    **limits
        Those of `Range`.

    Raises
    ------
    InputError
        If it is no finite number within the limits.
    """
    if isinstance(value, np.generic):  # told as 5, not np.int64(5)
        value = value.item()
    allowed = Range(**limits)
    fits = (
        type(value) in (int, float)
        and allowed.least <= value <= allowed.most
        and (allowed.above < value < allowed.below)
    )
    if allowed.infinite and type(value) is float and value == math.inf:
        return value
    if fits and not (whole and value % 1):
        return int(value) if whole else value
    rules = ["a whole number" if whole else "a number"]
    for word, limit in zip(
        ("at least", "at most", "above", "below"), allowed[:4], strict=True
    ):
        if abs(limit) < LARGEST:
            rules.append(f"{word} {limit:g}")
    raise InputError(f"{where}: must be {', '.join(rules)}, got {value!r}.")


# Kinds of the fields of settings.
Number = Annotated[float, Range()]
Positive = Annotated[float, Range(above=0)]
NotNegative = Annotated[float, Range(least=0)]
Unlimited = Annotated[float, Range(least=0, infinite=True)]
Share = Annotated[float, Range(least=0, most=1)]
Count = Annotated[int, Range(least=1, most=1e9)]
CountFrom0 = Annotated[int, Range(least=0, most=1e9)]


@dataclass_transform(frozen_default=True, field_specifiers=(field,))
class Settings:
    """Base of frozen dataclasses whose fields are checked by their kinds.

    A class becomes one by its base, with the options of `dataclass` in the brackets. An
    error names the class, or ``what`` it is.
    """

    __dataclass_fields__: ClassVar[Facts]

    def __init_subclass__(cls, **options: Any) -> None:
        dataclass(frozen=True, **options)(cls)

    def __post_init__(self, what: str = "") -> None:
        settings = type(self)
        kinds = get_type_hints(settings, include_extras=True)
        for name, value in vars(self).items():
            if value is not getattr(settings, name, settings):  # the default
                where = f"{what or settings.__name__}: {name}"
                object.__setattr__(self, name, _checked(value, kinds[name], where))


def _checked(value: Any, kind: Any, where: str) -> Any:
    """Return a value of a kind as Python's own."""
    if isinstance(value, np.generic):
        value = value.item()
    origin = get_origin(kind)
    parts = get_args(kind)
    if NoneType in parts:
        return None if value is None else _checked(value, parts[0], where)
    if origin is tuple:
        return _checked_each(value, parts, where)
    if origin is Annotated:
        limits = parts[1]._asdict()
        return check_number(value, where, whole=parts[0] is int, **limits)
    told = getattr(kind, "__name__", kind)
    if origin is Literal:
        fits = isinstance(value, str) and value in parts
        told = " or ".join(parts)
    else:
        fits = isinstance(value, parts if origin is UnionType else origin or kind)
    if not fits:
        raise InputError(f"{where}: must be {told}, got {value!r}.")
    return value


def _checked_each(values: Any, kinds: tuple[Any, ...], where: str) -> tuple[Any, ...]:
    """Return values of kinds, or of one kind where ``...`` follows it, as a tuple."""
    if isinstance(values, np.ndarray):
        values = values.tolist()
    count = len(values) if isinstance(values, list | tuple) else -1
    if kinds[-1] is Ellipsis:
        kinds = kinds[:1] * count
    if len(kinds) != count:
        raise InputError(
            f"{where}: must be {len(kinds) or 'several'} values, got {values!r}."
        )
    both = zip(values, kinds, strict=True)
    return tuple(_checked(value, kind, where) for value, kind in both)
