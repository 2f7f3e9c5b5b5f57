"""Trajectories of given orders against scipy over all unknowns."""

from __future__ import annotations

import numpy as np
import pandas as pd
from measure import Row, compare
from tests.definitions import plain_regression

from kilnflight.regression import Regression

EXIT = np.array([120.0, 60.0, 6500.0])
RATE = 330.0
SCATTER = np.array([7.0, 7.0, 150.0])
TRACKS = 5
ORDERS = (2, 6)


def tracks(count: int, points: int = 60) -> list[pd.DataFrame]:
    """Return flights of one fraction, each with a t0 of its own."""
    rng = np.random.default_rng(count)
    parts = []
    for _ in range(count):
        first = int(rng.integers(100, 3000))
        since = (np.arange(points) * 60 / points + rng.uniform(5, 20)) / RATE
        speed = np.array([400.0, 900.0, -11_000.0]) * rng.uniform(0.7, 1.3, 3)
        bend = np.array([-300.0, -4900.0, 6000.0])
        places = EXIT + since[:, None] * speed + since[:, None] ** 2 * bend
        places += rng.normal(size=places.shape) * SCATTER
        parts.append(
            pd.DataFrame(places, columns=list("xyz")).assign(
                time_s=first / RATE + since
            )
        )
    return parts


def against(order: int) -> Row:
    """Return the comparison of one order along all axes, from arrays to the same
    minimum.
    """
    method = Regression(lowest=order, highest=order)
    some = [
        (track["time_s"].to_numpy(), track[list("xyz")].to_numpy())
        for track in tracks(TRACKS)
    ]
    fits = [method(*track, EXIT) for track in some]

    def plainly() -> list[float]:
        """Return the sums of squares by scipy, from a guess within the same range of
        t0.
        """
        found = []
        for (time, places), fit in zip(some, fits, strict=True):
            limits = np.array(fit.t0_range_s) - time[0]
            inner = limits + np.array([1e-9, -1e-9])
            start = np.clip(fit.t0 - time[0] + 0.01 * np.ptp(limits), *inner)
            given = (time - time[0], places, EXIT, 3 * (order,), start, limits)
            peer = plain_regression.solve(*given, tolerance=1e-8)  # scipy's own
            found.append(2 * peer.cost)
        return found

    free = len(some[0][0]) - order - 1
    ours = [free * np.square(fit.rmse_mm).sum() for fit in fits]
    np.testing.assert_allclose(ours, plainly(), rtol=1e-5)
    what = (
        f"regression of order {order}",
        "trajectories",
        TRACKS,
        "scipy over all unknowns",
    )
    return compare(what, lambda: [method(*track, EXIT) for track in some], plainly)


def rows() -> list[Row]:
    """Return every comparison."""
    return [against(order) for order in ORDERS]
