"""For a given t0 the best polynomials, all orders of an axis at once (thesis, section 4.3).

A polynomial of order k through the exit point at t0 is u p(u), where u is the time after t0
and p has order k - 1. Polynomials p that are orthogonal under the weight w u^2 follow from
a recurrence of three terms (Forsythe 1957), and the fit of order k + 1 is that of order k and one
product more. The coefficients that are best for each t0 make the cost a function of t0
alone (variable projection, Golub and Pereyra 1973). With c_1 the velocity at t0, r the residuals
and d what a polynomial through 0 leaves of the constant 1,

    half the derivative of the cost by t0    c_1 sum w r
    half the second one (Gauss-Newton)       c_1^2 sum w d^2

as the derivative of the polynomial is c_1 plus something in the span of the polynomials.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from kilnflight.regression.loss import cost, weight

COST, SLOPE, CURVATURE = 0, 1, 2  # last axis of a profile
ROUNDS = 100  # of reweighting, at most
SETTLED = 1e-13  # relative change of the cost that ends the reweighting


@njit(cache=True)
def project(u: Any, place: Any, w: Any, order: int, profile: Any) -> Any:
    """Fill ``profile`` (order + 1, 3) for the orders 1 to ``order``; return residuals.

    Parameters
    ----------
    u, place, w
        (n,) time after t0, coordinate minus exit, weights.
    """
    left, rest = place.copy(), np.ones(len(u))  # what remains of the place and of 1
    now, before = np.ones(len(u)), np.zeros(len(u))
    now_0, before_0, velocity, previous = 1.0, 0.0, 0.0, 1.0
    parts = np.zeros((order, 3))
    for k in range(order):
        norm, shift, along, constant = 0.0, 0.0, 0.0, 0.0
        for i in range(len(u)):
            basis = u[i] * now[i]
            mass = w[i] * basis
            norm += mass * basis
            shift += mass * basis * u[i]
            along += mass * left[i]
            constant += mass * rest[i]
        if norm <= 0.0:  # no times left that could tell this order
            break
        shift, along, constant = shift / norm, along / norm, constant / norm
        velocity += along * now_0
        parts[k] = along * along * norm, along * constant * norm, constant * constant * norm
        profile[k + 1, SLOPE] = velocity
        back = norm / previous if k > 0 else 0.0
        for i in range(len(u)):
            left[i] -= along * u[i] * now[i]
            rest[i] -= constant * u[i] * now[i]
            now[i], before[i] = (u[i] - shift) * now[i] - back * before[i], now[i]
        now_0, before_0 = -shift * now_0 - back * before_0, now_0
        previous = norm
    _sums(left, rest, w, parts, profile)
    return left


@njit(cache=True)
def _sums(left: Any, rest: Any, w: Any, parts: Any, profile: Any) -> None:
    """Turn velocities at t0 into cost, slope and curvature, from the highest order down.

    Adding what each order takes away to what is left does not cancel, as the reverse would.
    """
    squares, balance, lack = 0.0, 0.0, 0.0
    for i in range(len(w)):
        squares += w[i] * left[i] * left[i]
        balance += w[i] * left[i]
        lack += w[i] * rest[i] * rest[i]
    for k in range(len(parts), 0, -1):
        velocity = profile[k, SLOPE]
        profile[k] = squares, velocity * balance, velocity * velocity * lack
        squares += parts[k - 1, 0]
        balance += parts[k - 1, 1]
        lack += parts[k - 1, 2]


@njit(cache=True)
def reweight(u: Any, place: Any, order: int, loss: int, profile: Any) -> Any:
    """Fill row ``order`` of ``profile`` under a robust loss; return the weights (n,)."""
    w = np.ones(len(u))
    last = np.inf
    for _ in range(ROUNDS):
        left = project(u, place, w, order, profile)
        total = 0.0
        for i in range(len(u)):
            total += cost(left[i] * left[i], loss)
        profile[order, COST] = total
        if last - total <= SETTLED * total:
            break
        last = total
        for i in range(len(u)):
            w[i] = weight(left[i] * left[i], loss)
    return w


@njit(cache=True)
def profile_at(
    time: Any, places: Any, start: float, lowest: Any, highest: Any, loss: int, out: Any
) -> None:
    """Fill ``out`` (3, orders + 1, 3) for t0 = ``start``: axis, order, and cost, slope, curvature.

    Parameters
    ----------
    time, places
        (n,) and (3, n), coordinates minus exit over their scale.
    lowest, highest
        (3,) orders wanted per axis.
    """
    u = time - start
    w = np.ones(len(u))
    for axis in range(3):
        if loss == 0:
            project(u, places[axis], w, highest[axis], out[axis])
        else:
            scratch = np.zeros((highest[axis] + 1, 3))
            for order in range(lowest[axis], highest[axis] + 1):
                reweight(u, places[axis], order, loss, scratch)
                out[axis, order] = scratch[order]
