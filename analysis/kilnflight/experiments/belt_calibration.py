"""Fit the free values of the sorter by least squares to the authors' spheres.

Run as ``python -m kilnflight.experiments.belt_calibration`` (a quarter of an hour on two
processes, needs the authors' DEM tracks and MuJoCo); it writes sorter/friction_values.json. Only
the spheres' velocities before the prediction phase are read: median, quartiles, 5 and 95 % along
the belt; quartiles, 5 and 95 % across it. No deviation of any motion model takes part.

Two searches from the `STARTS` end converged or at `ROUNDS`, and say so. The better one is taken.
The range of a value is where the cost rises by less than `RISE`, all others free, from the
linearised model at the best values. The true cost at both ends is kept beside it. The end of the
other search widens the range if its cost has risen by less than that, too.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, astuple, replace
from functools import partial
from typing import Any, NamedTuple

import joblib
import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.optimize import least_squares

from kilnflight import __version__
from kilnflight.belt.recordings import find_dem, read_dem
from kilnflight.checks import InputError
from kilnflight.experiments.belt_profile import motion_profile, step_velocities
from kilnflight.project import cache
from kilnflight.sorter.machine import BULKS
from kilnflight.sorter.rendering import at_rate
from kilnflight.sorter.simulation import (
    FILE,
    FIT_PLACES_MM,
    PLACES_MM,
    SCALES,
    FittedValues,
    Sorter,
    fit_targets,
    fitted_record,
    fitted_values,
)

Array = npt.NDArray[np.float64]

PARTICLES, GROUPS, SEED = 150, 2, 16  # the same particles for all evaluations
ROUNDS = 9  # of a search, each one evaluation and one more per free value
HERTZ = 100.0  # the rate of the authors' files
MEANING = "effective values of a slide and a contact law of unknown shape; see ranges"
RISE = 0.1  # of the cost within a range: with 40 misfits, 4 units squared
# For captions: a verdict on our own spheres in the phase is in-sample.
SPIN_KNOWN = (
    "In-sample (spin): the share of spin of our spheres was chosen with the motion of the authors' "
    "spheres in the prediction phase known."
)
INPUTS_ONLY = FittedValues()
# Of the first look: means, standard deviations and the whole belt with its prediction phase.
FIRST_FIT = FittedValues(0.1633, 0.04579, 78.98, 0.9103, 16.49, 0.0411, 11.36)
# Conceivable values, fixed before the search. The share of the slide's spin is not fitted: before
# the prediction phase a sphere slips, and its motion hardly shows how fast it turns.
LIMITS = {
    "belt_friction": (0.05, 0.8),
    "rolling_friction": (0.001, 0.1),
    "drop_mm": (20.0, 300.0),
    "exit_deg": (0.0, 30.0),
    "speed_spread": (0.0, 0.2),
    "lateral_spread_mm_s": (0.0, 100.0),
}
LOW, HIGH = (np.array(corner) for corner in zip(*LIMITS.values(), strict=True))
STARTS = {
    "handbooks": INPUTS_ONLY,
    "middle of the limits": FittedValues(**dict(zip(LIMITS, (LOW + HIGH) / 2.0, strict=True))),
}


class Search(NamedTuple):
    """The end of one search."""

    fitted: FittedValues
    cost: float  # mean squared misfit
    evaluations: int
    ended: str  # by which rule
    jacobian: Array  # (misfits, values) of the misfits, values from 1 to 2 between their limits


def fitted_table() -> pd.DataFrame:
    """Return each fitted value before and after the fit, its range and its limits.

    Before: ``inputs_only``. A column per start has where its search ended.
    """
    record = fitted_record()
    columns = {"inputs_only": asdict(INPUTS_ONLY), "fitted_to_spheres": asdict(fitted_values())}
    for name, pairs in (("range", record["ranges"]), ("limit", LIMITS)):
        columns |= {f"{name}_low": {key: low for key, (low, _) in pairs.items()}}
        columns |= {f"{name}_high": {key: high for key, (_, high) in pairs.items()}}
    columns |= {f"from {name}": found["inputs"] for name, found in record["searches"].items()}
    return pd.DataFrame(columns).loc[list(LIMITS)].rename_axis("value")


def profile(
    values: FittedValues, seed: int = SEED, places_mm: Array = FIT_PLACES_MM
) -> pd.DataFrame:
    """Return the motion profile of simulated spheres, at the authors' files' rate."""
    simulate = partial(values.applied(Sorter()), BULKS["spheres"], PARTICLES)
    parts = [simulate(np.random.default_rng([seed, group])) for group in range(GROUPS)]
    tracks = pd.concat(
        [part.assign(particle=part["particle"] + PARTICLES * k) for k, part in enumerate(parts)]
    )
    return motion_profile(step_velocities(at_rate(tracks, HERTZ)), places_mm)


def profile_misfits(simulated: pd.DataFrame, published: pd.DataFrame) -> Array:
    """Return simulated minus published in units of `SCALES`, place by place.

    For each quantity.
    """
    names = list(SCALES)
    misfit = (simulated[names] - published[names]) / pd.Series(SCALES)
    if not np.isfinite(misfit.to_numpy()).all():
        raise InputError("too few particles pass each place to compare; simulate more.")
    return misfit.to_numpy().ravel(order="F")


def fit(published: pd.DataFrame, start: FittedValues, rounds: int = ROUNDS) -> Search:
    """Return the values of least squares within `LIMITS`.

    Each value is scaled to run from 1 to 2 between its limits. A relative step of 3 % is then 3 to
    6 % of that range, wide enough to look past single collisions. The search has converged when a
    round lowers the cost by less than 1 %, or moves by less than a thousandth. Values are rounded
    as they are written; each evaluation is printed.
    """

    def evaluate(point: Array) -> Array:
        misfits = profile_misfits(profile(_values(point)), published)
        print(f"{np.mean(misfits**2):10.4f}", *astuple(_values(point)), flush=True)
        return misfits

    first = np.clip(_point(start), 1.02, 1.98)  # off the limits, where a search would stick
    steps = np.full(len(first), 0.03)
    options: dict[str, Any] = {"diff_step": steps, "max_nfev": rounds, "ftol": 0.01, "xtol": 0.001}
    best = least_squares(evaluate, first, bounds=(1.0, 2.0), **options)
    evaluations = int(best.nfev + len(first) * (best.njev or 0))
    mean = float(2.0 * best.cost / len(best.fun))
    return Search(_values(best.x), mean, evaluations, best.message, np.asarray(best.jac))


def _point(values: FittedValues) -> Array:
    """Return values as they run from 1 to 2 between their limits."""
    return 1.0 + (np.array([getattr(values, name) for name in LIMITS]) - LOW) / (HIGH - LOW)


def _values(point: Array) -> FittedValues:
    numbers = LOW + (np.clip(point, 1.0, 2.0) - 1.0) * (HIGH - LOW)
    rounded = {name: float(f"{n:.4g}") for name, n in zip(LIMITS, numbers, strict=True)}
    return FittedValues(**rounded)


def range_ends(search: Search, rise: float = RISE) -> dict[str, tuple[FittedValues, FittedValues]]:
    """Return the values at both ends of each value's range.

    The cost is taken as quadratic: it rises by ``rise`` at an end, with all other values as they
    then cost least. An end beyond a limit is at the limit.
    """
    spread = np.linalg.pinv(search.jacobian.T @ search.jacobian)  # covariance of unit misfits
    ways = spread * np.sqrt(rise * len(search.jacobian) / np.diag(spread))
    middle = _point(search.fitted)
    return {
        name: (_values(middle - way), _values(middle + way))
        for name, way in zip(LIMITS, ways.T, strict=True)
    }


def widened(
    ends: Mapping[str, tuple[FittedValues, FittedValues]], found: Iterable[Search]
) -> dict[str, list[float]]:
    """Return the range of each value, with the ends of all searches that cost within `RISE`."""
    found = list(found)
    least = min(search.cost for search in found)
    near = [search.fitted for search in found if search.cost <= least + RISE]
    every = {name: [getattr(v, name) for v in [*pair, *near]] for name, pair in ends.items()}
    return {name: [min(numbers), max(numbers)] for name, numbers in every.items()}


def cost(values: FittedValues, published: pd.DataFrame, seed: int = SEED) -> float:
    """Return the mean squared misfit."""
    return float(np.mean(profile_misfits(profile(values, seed), published) ** 2))


def vary_spin(shares: Iterable[float] = (0.7, 0.85, 1.0)) -> pd.DataFrame:
    """Return what the share of the slide's spin does before and in the prediction phase.

    Returns
    -------
    DataFrame
        ``rolling_share``, ``cost`` (before the phase) and ``phase_mm_s``, the mean misfit of the
        median velocity along the belt in it. The other values are the fitted ones.
    """
    published, later, rows = published_spheres(PLACES_MM), FIT_PLACES_MM[-1] < PLACES_MM, []
    for share in shares:
        simulated = profile(replace(fitted_values(), rolling_share=share), places_mm=PLACES_MM)
        misfits = profile_misfits(simulated[~later], published[~later])
        off = (simulated["median_m_s"] - published["median_m_s"])[later].mean()
        rows.append((share, float(np.mean(misfits**2)), 1000.0 * off))
    return pd.DataFrame(rows, columns=["rolling_share", "cost", "phase_mm_s"])


def published_spheres(places_mm: Array = FIT_PLACES_MM) -> pd.DataFrame:
    """Return the motion profile of the authors' spheres."""
    files = find_dem()
    if "spheres" not in files:
        raise InputError("the authors' DEM tracks are not here; run make data.")
    return motion_profile(step_velocities(read_dem(files["spheres"])), places_mm)


def calibrate() -> dict[str, object]:
    """Fit the values and return them with their origin, for friction_values.json."""
    published = published_spheres()
    run = joblib.Parallel(n_jobs=len(STARTS))
    found = dict(
        zip(
            STARTS,
            run(joblib.delayed(fit)(published, start) for start in STARTS.values()),
            strict=True,
        )
    )
    best = min(found.values(), key=lambda search: search.cost)
    ends = range_ends(best)
    searches = {
        name: {"inputs": asdict(search.fitted), **search._asdict()}
        for name, search in found.items()
    }
    for search in searches.values():
        del search["fitted"], search["jacobian"]
    return {
        "inputs": asdict(best.fitted),
        "cost_inputs_only": cost(INPUTS_ONLY, published),
        "cost_first_fit": cost(FIRST_FIT, published),
        "cost_calibrated": best.cost,
        "cost_other_particles": cost(best.fitted, published, SEED + 1),
        "targets_sha256": cache.content_hash(fit_targets()),
        "limits": LIMITS,
        "meaning": MEANING,
        "ranges": widened(ends, found.values()),
        "cost_at_linear_ends": {
            name: [cost(values, published) for values in pair] for name, pair in ends.items()
        },
        "rise": RISE,
        "searches": searches,
        "particles": PARTICLES * GROUPS,
        "seed": SEED,
        "evaluations": sum(search.evaluations for search in found.values()),
        "search": "scipy.optimize.least_squares",
        "version": __version__,
    }


def main() -> int:
    """Fit, write the file, and print the values."""
    print(cache.write_calibration(FILE, calibrate()))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
