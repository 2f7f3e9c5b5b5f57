"""Fit the few inputs of flight and ignition that are not published.

Run as ``python -m kilnflight.experiments.twin_calibration`` (some minutes); it writes
twin/calibrated.json. Only wood chips and confetti at 4.5 bar are flown, only statements about
them are read (`kilnflight.experiments.statements.targets`), and no camera, detection or
tracking takes part. The result is effective: it makes up for what the model lacks (handfuls
that clump in the lance, hot gas around it). It is no measured length or angle.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import asdict, fields
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.optimize import Bounds, differential_evolution

from kilnflight import __version__
from kilnflight.experiments import statements
from kilnflight.project import cache
from kilnflight.twin import truth
from kilnflight.twin.fitted import FLIGHT_FILE, FlightInputs
from kilnflight.twin.flight import Flight
from kilnflight.twin.gas import Gas

PARTICLES = 300  # per campaign and evaluation
SEED = 45  # of the particles (the same for all evaluations) and of the search
STEP_S = 1e-3  # twice the usual one: medians differ by less than 4 %, half the time
POPULATION, GENERATIONS = 7, 16  # of the search, population per free input
# What is conceivable, fixed before the search: slip of a lance of 1 to 8 m with the literature's
# range of solids friction, a jet from dead to ideal, aimed within 5 degrees, weak to firm flames.
LIMITS = {
    "lance_length_m": (1.0, 8.0),
    "solids_friction": (0.003, 0.01),
    "jet_persistence": (0.0, 1.0),
    "launch_elevation_deg": (-5.0, 5.0),
    "launch_spread_factor": (0.5, 3.0),
    "extinction_1_s": (100.0, 1600.0),  # searched by its logarithm
}


def cost(
    inputs: FlightInputs, targets: pd.DataFrame, count: int = PARTICLES, seed: int = SEED
) -> float:
    """Return the sum of squared misfits to the targets, in units of their bounds.

    Parameters
    ----------
    inputs
        Inputs to evaluate.
    targets
        `kilnflight.experiments.statements.targets`.
    count, seed
        Particles per campaign; the same seed gives the same ones for all inputs.
    """
    applied = inputs.applied(Flight(step_s=STEP_S), Gas())
    flights = {cell: truth.released(*cell, applied, count, seed) for cell in statements.CELLS}
    values = statements.answer(targets, statements.true_outcomes(flights))
    return float((statements.misfits(targets, values) ** 2).sum())


def fit(
    function: Callable[[FlightInputs], float], seed: int = SEED, generations: int = GENERATIONS
) -> tuple[FlightInputs, int]:
    """Return the inputs of least cost within `LIMITS`, and how often cost was evaluated.

    Differential evolution with a seed, one member of it the assumed inputs.
    """
    low, high = (_point(FlightInputs(*corner)) for corner in zip(*LIMITS.values(), strict=True))

    def evaluate(point: npt.NDArray[np.float64]) -> float:
        return function(_inputs(point))

    result = differential_evolution(
        evaluate,
        Bounds(low, high),
        x0=_point(FlightInputs()),
        popsize=POPULATION,
        maxiter=generations,
        tol=0.0,
        polish=False,
        seed=seed,
    )
    return _inputs(result.x), int(result.nfev)


def _point(inputs: FlightInputs) -> npt.NDArray[np.float64]:
    values = asdict(inputs) | {"extinction_1_s": np.log(inputs.extinction_1_s)}
    return np.array(list(values.values()), dtype=np.float64)


def _inputs(point: npt.NDArray[np.float64]) -> FlightInputs:
    """Return a point of the search as inputs, rounded as they will be written."""
    values = [*point[:-1], np.exp(point[-1])]
    names = [field.name for field in fields(FlightInputs)]
    return FlightInputs(
        **{name: float(f"{value:.4g}") for name, value in zip(names, values, strict=True)}
    )


def target_rows(targets: pd.DataFrame) -> list[dict[Hashable, object]]:
    """Return the targets as they are hashed: an open bound is None."""
    rows = targets[["fraction", "pressure_bar", "outcome", "printed", "low", "high"]]
    return rows.astype(object).where(rows.notna(), None).to_dict("records")


def calibrate(generations: int = GENERATIONS) -> dict[str, object]:
    """Return the content of calibrated.json: values and where they come from."""
    targets = statements.targets()
    best, evaluations = fit(lambda inputs: cost(inputs, targets), SEED, generations)
    return {
        "inputs": asdict(best),
        "cost_inputs_only": cost(FlightInputs(), targets),
        "cost_calibrated": cost(best, targets),
        "targets": target_rows(targets),
        "targets_sha256": cache.content_hash(target_rows(targets)),
        "limits": LIMITS,
        "particles_per_cell": PARTICLES,
        "step_s": STEP_S,
        "seed": SEED,
        "evaluations": evaluations,
        "search": "scipy.optimize.differential_evolution",
        "version": __version__,
    }


def record(path: Path = FLIGHT_FILE) -> dict[str, object]:
    """Return the content of the calibration; it must have been made for today's targets.

    Raises
    ------
    InputError
        If the file is missing or damaged, or was made for other targets than published.
    """
    targets = target_rows(statements.targets())
    return cache.read_calibration(path, targets, "kilnflight.experiments.twin_calibration")


def main() -> int:
    """Fit, write the file, and print the result."""
    print(cache.write_calibration(FLIGHT_FILE, calibrate()))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
