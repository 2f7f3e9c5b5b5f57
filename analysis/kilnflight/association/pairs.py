"""What an associator sees: tracks against detections, after the gate (thesis, section 4.1.2)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from kilnflight.checks import (
    InputError,
    check_at_least,
    check_between,
    check_count,
    check_kind,
    is_number,
)

Array = npt.NDArray[np.float64]


class Pairs(NamedTuple):
    """All pairs of n tracks and m detections of one frame."""

    distance_squared: Array
    """(n, m) squared Mahalanobis distance; inf outside the gate."""
    log_determinant: Array
    """(n,) ln |S_i|, S_i the residual covariance in px^2 (Eq. 2.50)."""
    size_difference: Array
    """(n, m) |N_d - N_p|, number of 3D points (Eq. 4.9); 0 where unknown."""
    gate_area: Array
    """(n,) V(i), area of the elliptical gate in px^2 (Eq. 4.13)."""
    gate_probability: float
    """P_G, probability that a particle's detection lies in its elliptical gate; 0: gate of 0."""
    dimensions: int = 2
    """d, of the positions; S is (d, d) and V(i) a volume where d is 3."""


def check_pairs(pairs: Pairs) -> Pairs:
    """Return the pairs as float64 arrays, or raise an `InputError` that names the bad field."""
    check_kind(pairs, Pairs, "pairs")
    distance, determinant, size, area = (
        np.asarray(field, dtype=np.float64, order="C") for field in pairs[:4]
    )
    if distance.ndim != 2:
        raise InputError(
            f"pairs: distance_squared has shape {distance.shape}, expected (tracks, detections)."
        )
    tracks = distance.shape[:1]
    for name, array, shape in (
        ("log_determinant", determinant, tracks),
        ("size_difference", size, distance.shape),
        ("gate_area", area, tracks),
    ):
        if array.shape != shape:
            raise InputError(f"pairs: {name} has shape {array.shape}, expected {shape}.")
    if not _sound(distance, determinant, size, area):  # the quick look first
        _refuse_numbers(distance, determinant, size, area)
    check_between(pairs.gate_probability, 0, 1, "pairs: gate_probability")
    check_count(pairs.dimensions, "pairs: dimensions")
    numbers = float(pairs.gate_probability), int(pairs.dimensions)
    return Pairs(distance, determinant, size, area, *numbers)


@njit(cache=True)
def _sound(distance: Any, determinant: Any, size: Any, area: Any) -> bool:
    """Return whether every number is good, the area of an empty gate included."""
    bad = False
    for i in range(len(distance)):
        bad |= not (np.isfinite(determinant[i]) and 0.0 < area[i] < np.inf)
        for j in range(distance.shape[1]):  # no early way out: entries go side by side
            bad |= (not distance[i, j] >= 0.0) | (not size[i, j] >= 0.0) | (size[i, j] == np.inf)
    return not bad


def _refuse_numbers(distance: Array, determinant: Array, size: Array, area: Array) -> None:
    """Raise an `InputError` that names the first number that is none of its kind."""
    inside = np.isfinite(distance)
    _refuse(~(distance >= 0), distance, "distance_squared", "0 or more, inf outside the gate")
    _refuse(~np.isfinite(determinant), determinant, "log_determinant", "finite")
    _refuse(~((size >= 0) & np.isfinite(size)), size, "size_difference", "finite, 0 or more")
    narrow = inside.any(axis=1) & ~((area > 0) & np.isfinite(area))
    _refuse(narrow, area, "gate_area", "finite and above 0 where the gate holds a detection")


def _refuse(bad: npt.NDArray[np.bool_], array: Array, name: str, wanted: str) -> None:
    """Raise an `InputError` that names the first bad entry, if there is one."""
    if bad.any():
        index = tuple(int(i) for i in np.argwhere(bad)[0])
        raise InputError(f"pairs: {name} at index {index} is {array[index]}, expected {wanted}.")


def check_costs(size_weight: float, nonassignment_cost: float, where: str) -> None:
    """Raise an `InputError` unless the parameters of Eq. 4.9 and C_NA can be used."""
    check_size_weight(size_weight, where)
    if not is_number(nonassignment_cost):
        raise InputError(f"{where}: nonassignment_cost is {nonassignment_cost!r}, expected finite.")


def check_size_weight(size_weight: float, where: str) -> None:
    """Raise an `InputError` unless a_0 of Eq. 4.9 is finite and not negative."""
    check_at_least(size_weight, 0, f"{where}: size_weight")


def cost(pairs: Pairs, size_weight: float) -> Array:
    """Return the cost of each pair by Eq. 4.9, thesis, (n, m); inf outside the gate.

    Notes
    -----
    Eq. 4.9 prints ln |P|; section 2.3.2, from which the term is "directly adopted", calls
    it the residual covariance S (Eq. 2.50), and S is what scales d^2. S is taken.
    """
    a_0 = size_weight
    c = pairs.distance_squared + pairs.log_determinant[:, None]
    if a_0:
        c += a_0 * pairs.size_difference
    return c


def one_hot(detection: npt.NDArray[np.intp], detections: int) -> Array:
    """Return weights (n, 1 + m) of tracks that take one detection each, or none (-1)."""
    weights = np.zeros((len(detection), 1 + detections))
    weights[np.arange(len(detection)), 1 + detection] = 1.0
    return weights
