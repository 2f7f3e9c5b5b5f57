"""What the papers do not print of slide and friction, found with the spheres and frozen.

Run as ``python -m kilnflight.belt.friction_values`` (some minutes, needs the authors' DEM
tracks and MuJoCo); it writes friction_values.json beside this file. Only the spheres'
velocities are read: mean and standard deviation along the belt, and the median of the
absolute velocity across it. Cylinders and cuboids get the same values, so what they do is a
prediction; no deviation of any motion model takes part.

What comes out is effective. The slide stands for a feeder and a chute of unknown shape, and
the friction for whatever contact law the authors' DEM has.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.optimize import least_squares

from kilnflight import __version__, external, frozen
from kilnflight.belt.bulk import BULKS
from kilnflight.belt.dem import find_dem, read_dem
from kilnflight.belt.physics import Contacts
from kilnflight.belt.sampling import thinned
from kilnflight.belt.simulation import Sorter
from kilnflight.belt.slide import Slide
from kilnflight.belt.velocity import motion_profile, velocities
from kilnflight.checks import InputError

Array = npt.NDArray[np.float64]

FILE = Path(__file__).with_name("friction_values.json")
PLACES_MM = np.arange(425.0, 751.0, 25.0)  # along the belt, where all are seen
SCALES = {"mean_m_s": 0.01, "std_m_s": 0.01, "lateral_m_s": 0.002}  # what counts as one misfit
PARTICLES, GROUPS, SEED = 150, 2, 16  # the same particles for all evaluations
ROUNDS = 8  # of the search, each one evaluation and one more per free value
EVERY = 10  # 1000 Hz to 100 Hz, the rate of the authors' files


@dataclass(frozen=True)
class FreeValues:
    """The free values; the defaults are those of `Contacts` and `Slide`, untouched."""

    belt_friction: float = Contacts.belt_friction
    rolling_friction: float = Contacts.rolling_friction
    drop_mm: float = Slide.drop_mm
    rolling_share: float = Slide.rolling_share
    exit_deg: float = Slide.exit_deg
    speed_spread: float = Slide.speed_spread
    lateral_spread_mm_s: float = Slide.lateral_spread_mm_s

    def applied(self, sorter: Sorter) -> Sorter:
        """Return a sorter with these values, all others as they were."""
        values = asdict(self)
        touch = {name: values.pop(name) for name in ("belt_friction", "rolling_friction")}
        contacts = replace(sorter.contacts, **touch)
        return replace(sorter, contacts=contacts, slide=replace(sorter.slide, **values))


INPUTS_ONLY = FreeValues()
# What is conceivable, fixed before the search.
LIMITS = {
    "belt_friction": (0.05, 0.8),
    "rolling_friction": (0.001, 0.1),
    "drop_mm": (20.0, 300.0),
    "rolling_share": (0.0, 1.0),
    "exit_deg": (0.0, 30.0),
    "speed_spread": (0.0, 0.2),
    "lateral_spread_mm_s": (0.0, 100.0),
}


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
    found = least_squares(evaluate, start, bounds=(1.0, 2.0), diff_step=0.03, max_nfev=rounds)
    return values(found.x), int(found.nfev + len(start) * (found.njev or 0))


def _values(point: Array) -> FreeValues:
    """Return a point of the search as values, rounded as they will be written."""
    names = [field.name for field in fields(FreeValues)]
    return FreeValues(
        **{name: float(f"{value:.4g}") for name, value in zip(names, point, strict=True)}
    )


def targets() -> dict[str, object]:
    """Return what the fit is held against, as it is hashed: the file, the places, the scales."""
    spheres = external.BELT_DEM["spheres"]
    return {"sha256": spheres.sha256, "places_mm": PLACES_MM.tolist(), "scales": SCALES}


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
        "targets_sha256": frozen.digest(targets()),
        "limits": LIMITS,
        "particles": PARTICLES * GROUPS,
        "seed": SEED,
        "evaluations": evaluations,
        "search": "scipy.optimize.least_squares",
        "version": __version__,
    }


def record(path: Path = FILE) -> dict[str, Any]:
    """Return the content of the frozen file; see `kilnflight.frozen.read` for what is refused."""
    return frozen.read(path, targets(), "kilnflight.belt.friction_values")


@lru_cache(maxsize=8)
def calibrated(path: Path = FILE) -> FreeValues:
    """Return the frozen values; see `record` for what is refused."""
    return frozen.inputs(FreeValues, path, record(path))


def calibrated_sorter() -> Sorter:
    """Return the sorter with the frozen values."""
    return calibrated().applied(Sorter())


def main() -> int:
    """Fit, write the file, and print what came out."""
    content = frozen.write(FILE, calibrate())
    print(frozen.summary(content))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
