"""Fit the few inputs of flight and ignition that are not published.

Run as ``python -m kilnflight.experiments.twin_calibration`` (some minutes); it writes
twin/calibrated.json. Only wood chips and confetti at 4.5 bar are flown, only statements about
them are read (`kilnflight.experiments.statements.calibration_targets`), and no camera, detection or
tracking takes part. The result is effective: it makes up for what the model lacks (handfuls
that clump in the lance, hot gas around it). It is no measured length or angle.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.optimize import Bounds, differential_evolution

from kilnflight import __version__
from kilnflight.experiments import statements
from kilnflight.project import cache
from kilnflight.twin import truth
from kilnflight.twin.camera import Geometry
from kilnflight.twin.fitted import (
    FLIGHT_FILE,
    FlightInputs,
    Kiln,
    LightInputs,
    SecondInputs,
    SecondLightInputs,
)
from kilnflight.twin.flight import Flight
from kilnflight.twin.gas import Gas

PARTICLES = 300  # per campaign and evaluation
SEED = 45  # of the particles (the same for all evaluations) and of the search
STEP_S = 1e-3  # twice the usual one: medians differ by less than 4 %, half the time
Array = npt.NDArray[np.float64]
Inputs = TypeVar("Inputs", FlightInputs, LightInputs, SecondInputs, SecondLightInputs)


@dataclass(frozen=True)
class Search(Generic[Inputs]):
    """Differential evolution with a seed, of inputs that are not published.

    Parameters
    ----------
    kind
        The inputs; its defaults are those before the search.
    limits
        Lowest and highest value of each field, in the order of the fields.
    logarithmic
        Fields that are searched by their logarithm.
    digits
        Significant ones that are evaluated and written.
    seed, population, generations
        Of the search; the population is per field.
    from_defaults
        Whether one member of the first generation has the defaults.
    """

    kind: type[Inputs]
    limits: Mapping[str, tuple[float, float]]
    logarithmic: tuple[str, ...]
    digits: int
    seed: int
    population: int = 7
    generations: int = 16
    from_defaults: bool = True
    method: ClassVar[str] = "scipy.optimize.differential_evolution"

    def __call__(self, cost: Callable[[Inputs], float]) -> tuple[Inputs, int]:
        """Return the inputs of least cost, and how often cost was evaluated."""
        low, high = (self.point(corner) for corner in zip(*self.limits.values(), strict=True))

        def evaluate(point: Array) -> float:
            return cost(self.inputs(point))

        result = differential_evolution(
            evaluate,
            Bounds(low, high),
            x0=self.point(asdict(self.kind()).values()) if self.from_defaults else None,
            popsize=self.population,
            maxiter=self.generations,
            tol=0.0,
            polish=False,
            seed=self.seed,
        )
        return self.inputs(result.x), int(result.nfev)

    def content(self, cost: Callable[[Inputs], float], targets: object) -> dict[str, Any]:
        """Return what a calibration's file holds: values and where they come from."""
        best, evaluations = self(cost)
        return {
            "inputs": asdict(best),
            "cost_inputs_only": cost(self.kind()),
            "cost_calibrated": cost(best),
            "targets": targets,
            "targets_sha256": cache.content_hash(targets),
            "limits": self.limits,
            "seed": self.seed,
            "evaluations": evaluations,
            "search": self.method,
            "version": __version__,
        }

    def point(self, values: Iterable[float]) -> Array:
        """Return values of the fields as a point of the search."""
        pairs = zip(self.limits, values, strict=True)
        return np.array([np.log(v) if name in self.logarithmic else v for name, v in pairs])

    def inputs(self, point: Array) -> Inputs:
        """Return a point of the search as inputs, rounded as they will be written."""
        pairs = zip(self.limits, point, strict=True)
        values = {name: np.exp(v) if name in self.logarithmic else v for name, v in pairs}
        return self.kind(**{name: float(f"{v:.{self.digits}g}") for name, v in values.items()})


# What is conceivable, fixed before the search: slip of a lance of 1 to 8 m with the literature's
# range of solids friction, a jet from dead to ideal, aimed within 5 degrees, weak to firm flames.
LIMITS = {
    "lance_length_m": (1.0, 8.0),
    "solids_friction": (0.003, 0.01),
    "jet_persistence": (0.0, 1.0),
    "launch_elevation_deg": (-5.0, 5.0),
    "launch_spread_factor": (0.5, 3.0),
    "extinction_1_s": (100.0, 1600.0),
}
SEARCH = Search(
    FlightInputs,
    LIMITS,
    logarithmic=("extinction_1_s",),
    digits=4,
    seed=SEED,
)


def cost(
    inputs: FlightInputs, targets: pd.DataFrame, count: int = PARTICLES, seed: int = SEED
) -> float:
    """Return the `kiln_cost` of inputs, all else as in the first twin."""
    kiln = Kiln(*inputs.applied(Flight(step_s=STEP_S), Gas()), Geometry())
    return kiln_cost(kiln, targets, count, seed)


def kiln_cost(kiln: Kiln, targets: pd.DataFrame, count: int, seed: int) -> float:
    """Return the sum of squared misfits to the targets, in units of their bounds.

    Parameters
    ----------
    kiln
        What to evaluate.
    targets
        `kilnflight.experiments.statements.calibration_targets`.
    count, seed
        Particles per campaign; the same seed gives the same ones for all inputs.
    """
    flights = {key: truth.released(*key, kiln, count, seed) for key in statements.FIT_CAMPAIGNS}
    values = statements.answer(targets, statements.true_outcomes(flights))
    return float((statements.misfits(targets, values) ** 2).sum())


def target_rows(targets: pd.DataFrame) -> list[dict[Hashable, object]]:
    """Return the targets as they are hashed: an open bound is None."""
    rows = targets[["fraction", "pressure_bar", "outcome", "printed", "low", "high"]]
    return rows.astype(object).where(rows.notna(), None).to_dict("records")


def calibrate() -> dict[str, object]:
    """Return the content of calibrated.json."""
    targets = statements.calibration_targets()
    content = SEARCH.content(lambda inputs: cost(inputs, targets), target_rows(targets))
    return content | {"particles_per_cell": PARTICLES, "step_s": STEP_S}


def read_fit(path: Path = FLIGHT_FILE) -> dict[str, object]:
    """Return the calibration's content; it must have been made for today's targets.

    Raises
    ------
    InputError
        If the file is missing or damaged, or was made for other targets than published.
    """
    targets = target_rows(statements.calibration_targets())
    return cache.read_calibration(path, targets, "kilnflight.experiments.twin_calibration")


def main() -> int:
    """Fit, write the file, and print the result."""
    print(cache.write_calibration(FLIGHT_FILE, calibrate()))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
