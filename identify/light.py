"""Fit the simulation's light to what the thesis prints of brightness and size.

    python -m identify.light

fits for some ten minutes, prints the inputs, and compares them with the thesis for
three seeds. What is compared stands in `kilnflight.experiments.detection.light_fit`.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import minimize

from kilnflight.experiments.detection.light_fit import (
    SEEDS,
    Prepared,
    compare,
    count,
    prepare,
    report,
)
from kilnflight.simulated.kiln.feeding import LABELLED
from kilnflight.simulated.kiln.light import Optics

FITTED = ("paper", "paper_spread", "flame", "thick_mm", "gas_mm", "flame_softness")
# The median unlit particle must not outshine the wall. Bodies are darker than paper and
# two in five, so that it is the paper below which a sixth of all paper lies.
LARGEST_UNLIT = 0.9
SIXTH = -0.967


def misfit(prepared: Prepared, optics: Optics) -> float:
    """Return the sum of squared deviations from print, in units of ``sd``."""
    unlit = optics.paper * np.exp(SIXTH * optics.paper_spread)
    if unlit > LARGEST_UNLIT or not 0.1 < optics.flame_softness < 1.0:
        return 1e6
    table = compare(count(prepared, optics))
    return float((((table["ours"] - table["printed"]) / table["sd"]) ** 2).sum())


def fit(prepared: Prepared, start: Optics, steps: int) -> tuple[Optics, float]:
    """Find the light of the least misfit by Nelder and Mead.

    Parameters
    ----------
    prepared
        From `prepare`.
    start
        Light from which the search starts; what is not in `FITTED` stays.
    steps
        Largest number of evaluations.

    Returns
    -------
    light : Optics
    misfit : float
    """
    first = np.array([getattr(start, name) for name in FITTED])

    def light(logarithms: Any) -> Optics:
        values = (first * np.exp(logarithms)).tolist()
        return replace(start, **dict(zip(FITTED, values, strict=True)))

    def cost(logarithms: Any) -> float:
        return misfit(prepared, light(logarithms))

    simplex = 0.15 * np.eye(len(FITTED) + 1, len(FITTED), -1)  # the start is first
    options: Any = {
        "maxfev": steps,
        "initial_simplex": simplex,
        "xatol": 0.01,
        "fatol": 0.5,
    }
    best = minimize(cost, simplex[0], method="Nelder-Mead", options=options)
    return light(best.x), float(best.fun)


def main() -> None:
    """Fit the light, and compare it with print on all labelled frames."""
    prepared = prepare(SEEDS)
    optics, off = fit(prepared, Optics(), steps=150)
    fitted = {name: round(getattr(optics, name), 3) for name in FITTED}
    print(f"misfit {off:.1f}: {fitted}")
    print(report(count(prepared, optics, LABELLED)).round(3).to_string())


if __name__ == "__main__":
    main()
