"""What a residual costs: its square, or less where it is large."""

from __future__ import annotations

from enum import IntEnum
from typing import Any

from numba import njit


class Loss(IntEnum):
    """Losses, named and defined as in `scipy.optimize.least_squares`; z is a squared residual.

    ==========  =========================================  =================================
    loss        cost                                       weight (its derivative by z)
    ==========  =========================================  =================================
    `SQUARES`   z                                          1
    `SOFT_L1`   2 (sqrt(1 + z) - 1)                        1 / sqrt(1 + z)
    `HUBER`     z up to 1, beyond 2 sqrt(z) - 1            1 up to 1, beyond 1 / sqrt(z)
    ==========  =========================================  =================================
    """

    SQUARES = 0
    SOFT_L1 = 1
    HUBER = 2


# Plain numbers: numba compiles these and takes no members of an enumeration.
_SOFT_L1, _HUBER = int(Loss.SOFT_L1), int(Loss.HUBER)


@njit(cache=True)
def cost(squared: Any, loss: int) -> float:
    """Return what a squared residual costs."""
    if loss == _SOFT_L1:
        return 2.0 * squared / ((1.0 + squared) ** 0.5 + 1.0)  # does not cancel near 0
    if loss == _HUBER and squared > 1.0:
        return 2.0 * squared**0.5 - 1.0
    return squared


@njit(cache=True)
def weight(squared: Any, loss: int) -> float:
    """Return the weight that a squared residual leaves its point, 0 to 1."""
    if loss == _SOFT_L1:
        return 1.0 / (1.0 + squared) ** 0.5
    if loss == _HUBER and squared > 1.0:
        return 1.0 / squared**0.5
    return 1.0
