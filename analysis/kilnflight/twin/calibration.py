"""The few inputs of flight and ignition that nobody published, fitted once and frozen.

Run as ``python -m kilnflight.twin.calibration`` (some minutes); it writes calibrated.json
beside this file. Only wood chips and confetti at 4.5 bar are flown, only statements about
them are read (`kilnflight.twin.statements.targets`), and no camera, detection or tracking
takes part. What comes out is effective: it makes up for what the model lacks (handfuls that
clump in the lance, hot gas around it), and is not to be read as a measured length or angle.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import asdict, dataclass, fields, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.optimize import Bounds, differential_evolution

from kilnflight import __version__
from kilnflight.project import cache
from kilnflight.twin import outcomes, statements
from kilnflight.twin.flight import Flight
from kilnflight.twin.gas import Gas

FILE = Path(__file__).with_name("calibrated.json")
PARTICLES = 300  # per cell and evaluation
SEED = 45  # of the particles (the same for all evaluations) and of the search
STEP_S = 1e-3  # twice the usual one: medians differ by less than 4 %, half the time
POPULATION, GENERATIONS = 7, 16  # of the search, population per free input


@dataclass(frozen=True)
class FreeInputs:
    """The free inputs; the defaults are those of `Flight` and `Gas`, untouched."""

    lance_length_m: float = Flight.lance_length_m
    solids_friction: float = Flight.solids_friction
    jet_persistence: float = Gas.jet_persistence
    launch_elevation_deg: float = Flight.launch_elevation_deg
    launch_spread_factor: float = Flight.launch_spread_factor
    extinction_1_s: float = Flight.extinction_1_s

    def applied(self, flight: Flight, gas: Gas) -> tuple[Flight, Gas]:
        """Return flight and gas with these inputs, all others as they were."""
        values = asdict(self)
        persistence = values.pop("jet_persistence")
        return replace(flight, **values), replace(gas, jet_persistence=persistence)


INPUTS_ONLY = FreeInputs()
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


def cells(inputs: FreeInputs, count: int = PARTICLES, seed: int = SEED) -> pd.DataFrame:
    """Return the outcomes of the two cells that the calibration may see."""
    flown = {
        (name, bar): outcomes.released(
            name, bar, inputs.applied(Flight(step_s=STEP_S), Gas()), count, seed
        )
        for name, bar in statements.CELLS
    }
    return outcomes.table(flown)


def cost(inputs: FreeInputs, said: pd.DataFrame, count: int = PARTICLES, seed: int = SEED) -> float:
    """Return the sum of squared misfits to the targets, in units of their bounds.

    Parameters
    ----------
    inputs
        To be judged.
    said
        `kilnflight.twin.statements.targets`.
    count, seed
        Particles per cell; the same seed gives the same ones for all inputs.
    """
    found = statements.answer(said, cells(inputs, count, seed))
    return float((statements.misfits(said, found) ** 2).sum())


def fit(
    function: Callable[[FreeInputs], float], seed: int = SEED, generations: int = GENERATIONS
) -> tuple[FreeInputs, int]:
    """Return the inputs of least cost within `LIMITS`, and how often cost was evaluated.

    Differential evolution with a seed, one member of it the untouched inputs.
    """

    def evaluate(point: npt.NDArray[np.float64]) -> float:
        return function(_inputs(point))

    corners = (FreeInputs(*corner) for corner in zip(*LIMITS.values(), strict=True))
    low, high = (_point(corner) for corner in corners)
    found = differential_evolution(
        evaluate,
        Bounds(low, high),
        x0=_point(INPUTS_ONLY),
        popsize=POPULATION,
        maxiter=generations,
        tol=0.0,
        polish=False,
        seed=seed,
    )
    return _inputs(found.x), int(found.nfev)


def _point(inputs: FreeInputs) -> npt.NDArray[np.float64]:
    values = asdict(inputs) | {"extinction_1_s": np.log(inputs.extinction_1_s)}
    return np.array(list(values.values()), dtype=np.float64)


def _inputs(point: npt.NDArray[np.float64]) -> FreeInputs:
    """Return a point of the search as inputs, rounded as they will be written."""
    values = [*point[:-1], np.exp(point[-1])]
    names = [field.name for field in fields(FreeInputs)]
    return FreeInputs(
        **{name: float(f"{value:.4g}") for name, value in zip(names, values, strict=True)}
    )


def target_rows(said: pd.DataFrame) -> list[dict[Hashable, object]]:
    """Return the targets as they are hashed: an open bound is None."""
    rows = said[["fraction", "pressure_bar", "outcome", "printed", "low", "high"]]
    return rows.astype(object).where(rows.notna(), None).to_dict("records")


def calibrate(generations: int = GENERATIONS) -> dict[str, object]:
    """Return the content of calibrated.json: values and where they come from."""
    said = statements.targets()
    best, evaluations = fit(lambda one: cost(one, said), SEED, generations)
    content: dict[str, object] = {
        "inputs": asdict(best),
        "cost_inputs_only": cost(INPUTS_ONLY, said),
        "cost_calibrated": cost(best, said),
        "targets": target_rows(said),
        "targets_sha256": cache.content_hash(target_rows(said)),
        "limits": LIMITS,
        "particles_per_cell": PARTICLES,
        "step_s": STEP_S,
        "seed": SEED,
        "evaluations": evaluations,
        "search": "scipy.optimize.differential_evolution",
        "version": __version__,
    }
    return content


def record(path: Path = FILE) -> dict[str, object]:
    """Return the content of a calibration file; errors as of `cache.read_calibration`."""
    return cache.read_calibration(
        path, target_rows(statements.targets()), "kilnflight.twin.calibration"
    )


@lru_cache(maxsize=8)
def calibrated(path: Path = FILE) -> FreeInputs:
    """Return the frozen inputs; see `record` for what is refused."""
    return cache.calibrated(FreeInputs, path, record(path))


def main() -> int:
    """Fit, write the file, and print what came out."""
    print(cache.write_calibration(FILE, calibrate()))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
