"""The definition in plain code: scipy over all unknowns, one combination of orders at a
time.
"""

import numpy as np
from scipy.optimize import least_squares


def residuals(unknown, time, places, exit_point, orders):
    """Return measured minus Eq. 4.29 (in powers of t - t0), (3 n,); the last unknown is
    t0.
    """
    since, at, found = time - unknown[-1], 0, []
    for axis, order in enumerate(orders):
        curve = np.polyval([*unknown[at : at + order][::-1], 0.0], since)
        found.append(places[:, axis] - exit_point[axis] - curve)
        at += order
    return np.concatenate(found)


def solve(time, places, exit_point, orders, start, limits, tolerance=1e-15):
    """Return scipy's result by trust region, from t0 = ``start`` and the best motion
    for it.
    """
    motion = [
        np.linalg.lstsq((time - start)[:, None] ** np.arange(1, order + 1), moved)[0]
        for order, moved in zip(orders, (places - exit_point).T, strict=True)
    ]
    first = np.append(np.concatenate(motion), start)
    bounds = np.full((2, len(first)), [[-np.inf], [np.inf]])
    bounds[:, -1] = limits
    accuracy = dict.fromkeys(("ftol", "xtol", "gtol"), tolerance)
    return least_squares(
        residuals, first, args=(time, places, exit_point, orders), bounds=bounds,
        method="trf", x_scale="jac", max_nfev=2000, **accuracy
    )  # fmt: skip
