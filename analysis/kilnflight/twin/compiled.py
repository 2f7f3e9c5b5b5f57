"""What the laws of a flight share with numba, so that each stands once.

A law is written element by element and marked by ``register_jitable``: in Python it takes arrays
of many particles, in a compiled loop the numbers of one. Vectors are tuples of three components.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
from numba.extending import overload, register_jitable


def numbers(settings: Any, **more: float) -> Any:
    """Return the numbers of a dataclass, and more, as a record that compiled loops can read.

    Left out are fields without a number as their default, and those that a record array would hide
    behind a method of its own, such as ``round``.
    """
    simple = [each for each in fields(settings) if isinstance(each.default, bool | int | float)]
    simple = [each for each in simple if not hasattr(np.recarray, each.name)]
    values = {each.name: getattr(settings, each.name) for each in simple} | more
    flags = {each.name for each in simple if isinstance(each.default, bool)}
    flags |= {name for name, value in more.items() if isinstance(value, bool)}
    layout = [(name, bool if name in flags else float) for name in values]
    return np.array([tuple(values.values())], np.dtype(layout, align=True)).view(np.recarray)[0]


def either(condition: Any, first: Any, second: Any) -> Any:
    """Return the first where a condition holds, else the second: ``np.where``, also of numbers."""
    return np.where(condition, first, second)


@overload(either, strict=False)
def _either(condition: Any, first: Any, second: Any) -> Any:
    return lambda condition, first, second: first if condition else second


@register_jitable
def vector(row: Any) -> Any:
    """Return three components as a tuple."""
    return row[0], row[1], row[2]


@register_jitable
def put(row: Any, components: Any) -> None:
    """Write three components into a row."""
    row[0], row[1], row[2] = components


@register_jitable
def dot(a: Any, b: Any) -> Any:
    """Return the product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@register_jitable
def cross(a: Any, b: Any) -> Any:
    """Return the vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@register_jitable
def scaled(factor: Any, a: Any) -> Any:
    """Return a vector times a factor."""
    return factor * a[0], factor * a[1], factor * a[2]


@register_jitable
def plus(a: Any, factor: Any, b: Any) -> Any:
    """Return a vector and another times a factor."""
    return a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]


@register_jitable
def unit(a: Any) -> Any:
    """Return a vector scaled to length 1; a zero vector stays zero."""
    return scaled(1.0 / np.maximum(np.sqrt(dot(a, a)), 1e-12), a)
