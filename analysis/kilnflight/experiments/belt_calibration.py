"""Fit the free values of the sorter by least squares to the authors' spheres.

Run as ``python -m kilnflight.experiments.belt_calibration`` (some minutes, needs the authors' DEM
tracks and MuJoCo); it writes belt/friction_values.json. Only the spheres' velocities are read:
mean and standard deviation along the belt, and the median of the absolute velocity across it. No
deviation of any motion model takes part.

The search ends after `ROUNDS` (57 evaluations), converged or not. So these values are the best of
the search, no proven optimum; other values may fit as well. Their cost is that of the 300 particles
of the fit.
"""

from __future__ import annotations

from dataclasses import asdict
from functools import partial

import joblib
import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.optimize import least_squares

from kilnflight import __version__
from kilnflight.belt.evaluation import motion_profile, step_velocities
from kilnflight.belt.machine import BULKS
from kilnflight.belt.pictures import at_rate
from kilnflight.belt.recordings import find_dem, read_dem
from kilnflight.belt.sorter import (
    FILE,
    PLACES_MM,
    SCALES,
    FittedValues,
    Sorter,
    fit_targets,
    fitted_values,
)
from kilnflight.checks import InputError
from kilnflight.project import cache

Array = npt.NDArray[np.float64]

PARTICLES, GROUPS, SEED = 150, 2, 16  # the same particles for all evaluations
ROUNDS = 8  # of the search, each one evaluation and one more per free value
HERTZ = 100.0  # the rate of the authors' files
INPUTS_ONLY = FittedValues()
# Conceivable values, fixed before the search.
LIMITS = {
    "belt_friction": (0.05, 0.8),
    "rolling_friction": (0.001, 0.1),
    "drop_mm": (20.0, 300.0),
    "rolling_share": (0.0, 1.0),
    "exit_deg": (0.0, 30.0),
    "speed_spread": (0.0, 0.2),
    "lateral_spread_mm_s": (0.0, 100.0),
}


def fitted_table() -> pd.DataFrame:
    """Return each fitted value before and after the fit, and its limits.

    Before: ``inputs_only``.
    """
    columns = {"inputs_only": asdict(INPUTS_ONLY), "fitted_to_spheres": asdict(fitted_values())}
    limits = {"low": {name: low for name, (low, _) in LIMITS.items()}}
    limits |= {"high": {name: high for name, (_, high) in LIMITS.items()}}
    return pd.DataFrame(columns | limits).rename_axis("value")


def profile(values: FittedValues) -> pd.DataFrame:
    """Return the motion profile of simulated spheres, at the authors' files' rate."""
    sorter = values.applied(Sorter())
    simulate = joblib.delayed(partial(sorter, BULKS["spheres"], PARTICLES))
    seeds = (np.random.default_rng([SEED, group]) for group in range(GROUPS))
    parts = joblib.Parallel(n_jobs=GROUPS)(simulate(seed) for seed in seeds)
    tracks = pd.concat(
        [part.assign(particle=part["particle"] + PARTICLES * k) for k, part in enumerate(parts)]
    )
    return motion_profile(step_velocities(at_rate(tracks, HERTZ)), PLACES_MM)


def profile_misfits(simulated: pd.DataFrame, published: pd.DataFrame) -> Array:
    """Return simulated minus published in units of `SCALES`, place by place.

    For each quantity.
    """
    names = list(SCALES)
    misfit = (simulated[names] - published[names]) / pd.Series(SCALES)
    if not np.isfinite(misfit.to_numpy()).all():
        raise InputError("too few particles pass each place to compare; simulate more.")
    return misfit.to_numpy().ravel(order="F")


def fit(published: pd.DataFrame, rounds: int = ROUNDS) -> tuple[FittedValues, int]:
    """Return the values of least squares within `LIMITS`, and the number of profiles.

    The number is how many profiles it took.
    Each value is scaled to run from 1 to 2 between its limits. A relative step of 3 % is then 3 to
    6 % of that range, wide enough to look past single collisions. Values are rounded as they are
    written.
    """
    low, high = (np.array(corner) for corner in zip(*LIMITS.values(), strict=True))

    def values(point: Array) -> FittedValues:
        numbers = low + (point - 1.0) * (high - low)
        return FittedValues(
            **{name: float(f"{number:.4g}") for name, number in zip(LIMITS, numbers, strict=True)}
        )

    def evaluate(point: Array) -> Array:
        return profile_misfits(profile(values(point)), published)

    start = 1.0 + (np.array(list(asdict(INPUTS_ONLY).values())) - low) / (high - low)
    start = np.clip(start, 1.02, 1.98)  # off the limits, where a search would stick
    steps = np.full(len(start), 0.03)
    best = least_squares(evaluate, start, bounds=(1.0, 2.0), diff_step=steps, max_nfev=rounds)
    return values(best.x), int(best.nfev + len(start) * (best.njev or 0))


def cost(values: FittedValues, published: pd.DataFrame) -> float:
    """Return the mean squared misfit."""
    return float(np.mean(profile_misfits(profile(values), published) ** 2))


def published_spheres() -> pd.DataFrame:
    """Return the motion profile of the authors' spheres."""
    files = find_dem()
    if "spheres" not in files:
        raise InputError("the authors' DEM tracks are not here; run make data.")
    return motion_profile(step_velocities(read_dem(files["spheres"])), PLACES_MM)


def calibrate() -> dict[str, object]:
    """Fit the values and return them with their origin, for friction_values.json."""
    published = published_spheres()
    best, evaluations = fit(published)
    return {
        "inputs": asdict(best),
        "cost_inputs_only": cost(INPUTS_ONLY, published),
        "cost_calibrated": cost(best, published),
        "targets_sha256": cache.content_hash(fit_targets()),
        "limits": LIMITS,
        "particles": PARTICLES * GROUPS,
        "seed": SEED,
        "evaluations": evaluations,
        "search": "scipy.optimize.least_squares",
        "version": __version__,
    }


def main() -> int:
    """Fit, write the file, and print the values."""
    print(cache.write_calibration(FILE, calibrate()))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
