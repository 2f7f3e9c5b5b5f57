"""Flights: the best step against a double loop, slices against looking everywhere."""

from __future__ import annotations

import numpy as np
from measure import Row, compare

from kilnflight.flight import space_sliced_velocity
from kilnflight.ignition import best_step
from kilnflight.regression import Fit

LENGTHS = (60, 200)  # detections of a track
LEAST = 3


def plain_step(values: np.ndarray) -> tuple[int, float]:
    """Return the best upward step as it is defined."""
    best = (-1, np.inf)
    for k in range(LEAST, len(values) - LEAST + 1):
        sides = values[:k], values[k:]
        rest = sum(np.abs(side - np.median(side)).sum() for side in sides)
        if np.median(sides[0]) < np.median(sides[1]) and rest < best[1]:
            best = (k, rest)
    return best


def everywhere(fit: Fit, samples: int = 400_001) -> list[float]:
    """Return when each metre is first reached, to a microsecond."""
    time = np.linspace(fit.t0, fit.last_s, samples)
    gone = fit.exit_point_mm[2] - fit(time)[:, 2]
    marks = 1000.0 * np.arange(1, 7)
    return [time[np.argmax(gone >= far)] for far in marks if (gone >= far).any()]


def rows() -> list[Row]:
    """Return every comparison, the results checked to be equal."""
    result = []
    for length in LENGTHS:
        values = np.random.default_rng(length).normal(1.0 * (np.arange(length) > 20), 1.0)
        split, rest = plain_step(values)
        assert best_step(values, LEAST)[0] == split
        np.testing.assert_allclose(best_step(values, LEAST)[1], rest)
        result.append(
            compare(
                ("best step of a track", "detections", length, "its definition in numpy"),
                lambda values=values: best_step(values, LEAST),
                lambda values=values: plain_step(values),
                repeats=5,
            )
        )
    z = (-9000.0, 3000.0, -2000.0, 500.0, 100.0, -50.0)
    exit_point = (0.0, 0.0, 6500.0)
    fit = Fit(exit_point, 0.0, 0, (0.0, 0.1), (2, 2, 6), ((1.0, 0.0), (1.0, 0.0), z), 0.05, 0.4, 60)
    ours = space_sliced_velocity(fit).query("reached")["end_s"]
    np.testing.assert_allclose(ours, everywhere(fit), atol=1.01e-6)
    result.append(
        compare(
            ("space-sliced velocity", "flights", 1, "looking every microsecond"),
            lambda: space_sliced_velocity(fit),
            lambda: everywhere(fit),
            repeats=5,
        )
    )
    return result
