"""How the free values of the sorter were found: least squares on the authors' spheres.

Run as ``python -m kilnflight.belt.calibration`` (some minutes, needs the authors' DEM tracks
and MuJoCo); it writes friction_values.json beside this file. Only the spheres' velocities
are read: mean and standard deviation along the belt, and the median of the absolute velocity
across it. No deviation of any motion model takes part. The search ends after `ROUNDS`, converged
or not, and the costs are those of the particles that it ran with.
"""

from __future__ import annotations

from dataclasses import asdict, fields
from functools import partial

import joblib
import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.optimize import least_squares

from kilnflight import __version__
from kilnflight.belt.bulk import BULKS
from kilnflight.belt.dem import find_dem, read_dem
from kilnflight.belt.friction_values import (
    FILE,
    INPUTS_ONLY,
    LIMITS,
    PLACES_MM,
    SCALES,
    FreeValues,
    targets,
)
from kilnflight.belt.machine import Sorter
from kilnflight.belt.sampling import thinned
from kilnflight.belt.velocity import motion_profile, velocities
from kilnflight.checks import InputError
from kilnflight.project import cache

Array = npt.NDArray[np.float64]

PARTICLES, GROUPS, SEED = 150, 2, 16  # the same particles for all evaluations
ROUNDS = 8  # of the search, each one evaluation and one more per free value
EVERY = 10  # 1000 Hz to 100 Hz, the rate of the authors' files


def profile(values: FreeValues, material: str = "spheres") -> pd.DataFrame:
    """Return how a material moves in the simulation, at the rate of the authors' files."""
    sorter = values.applied(Sorter())
    one = joblib.delayed(partial(sorter, BULKS[material], PARTICLES))
    seeds = (np.random.default_rng([SEED, group]) for group in range(GROUPS))
    parts = joblib.Parallel(n_jobs=GROUPS)(one(seed) for seed in seeds)
    tracks = pd.concat(
        [part.assign(particle=part["particle"] + PARTICLES * k) for k, part in enumerate(parts)]
    )
    return motion_profile(velocities(thinned(tracks, EVERY)), PLACES_MM)


def misfits(found: pd.DataFrame, wanted: pd.DataFrame) -> Array:
    """Return found minus wanted in units of `SCALES`, place by place, quantity by quantity."""
    parts = [(found[name] - wanted[name]) / scale for name, scale in SCALES.items()]
    misfit = np.concatenate(parts)
    if not np.isfinite(misfit).all():
        raise InputError("too few particles pass each place to compare; simulate more.")
    return misfit


def cost(values: FreeValues, wanted: pd.DataFrame) -> float:
    """Return the mean squared misfit."""
    return float(np.mean(misfits(profile(values), wanted) ** 2))


def fit(wanted: pd.DataFrame, rounds: int = ROUNDS) -> tuple[FreeValues, int]:
    """Return the values of least squares within `LIMITS`, and how many profiles it took.

    The search runs between 1 and 2 of each value's limits: a relative step of 3 % is then 3
    to 6 % of them, wide enough to look past single collisions.
    """
    low, high = (np.array(corner) for corner in zip(*LIMITS.values(), strict=True))

    def values(point: Array) -> FreeValues:
        return _values(low + (point - 1.0) * (high - low))

    def evaluate(point: Array) -> Array:
        return misfits(profile(values(point)), wanted)

    start = 1.0 + (np.array(list(asdict(INPUTS_ONLY).values())) - low) / (high - low)
    start = np.clip(start, 1.02, 1.98)  # off the limits, where a search would stick
    steps = np.full(len(start), 0.03)
    found = least_squares(evaluate, start, bounds=(1.0, 2.0), diff_step=steps, max_nfev=rounds)
    return values(found.x), int(found.nfev + len(start) * (found.njev or 0))


def _values(point: Array) -> FreeValues:
    """Return a point of the search as values, rounded as they will be written."""
    names = [field.name for field in fields(FreeValues)]
    return FreeValues(
        **{name: float(f"{value:.4g}") for name, value in zip(names, point, strict=True)}
    )


def published(material: str) -> pd.DataFrame:
    """Return how a material moves in the authors' tracks."""
    files = find_dem()
    if material not in files:
        raise InputError("the authors' DEM tracks are not here; run make data.")
    return motion_profile(velocities(read_dem(files[material])), PLACES_MM)


def calibrate() -> dict[str, object]:
    """Return the content of friction_values.json: values and where they come from."""
    wanted = published("spheres")
    best, evaluations = fit(wanted)
    return {
        "inputs": asdict(best),
        "cost_inputs_only": cost(INPUTS_ONLY, wanted),
        "cost_calibrated": cost(best, wanted),
        "targets_sha256": cache.content_hash(targets()),
        "limits": LIMITS,
        "particles": PARTICLES * GROUPS,
        "seed": SEED,
        "evaluations": evaluations,
        "search": "scipy.optimize.least_squares",
        "version": __version__,
    }


def main() -> int:
    """Fit, write the file, and print what came out."""
    print(cache.write_calibration(FILE, calibrate()))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
