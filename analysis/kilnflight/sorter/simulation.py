"""The simulated sorter (2016 and 2020 papers), and its tracks, cached on disk.

slide -> bodies on the belt, 0.2 ms at a time -> positions 1000 times a second

Six values that the papers do not print were fitted to the spheres of the authors' tracks
(`kilnflight.experiments.belt_calibration`) and frozen; a seventh, the share of spin, was chosen.
Cylinders and cuboids get the same values, so their motion is a prediction. The fitted values are
effective ones. The slide stands for a feeder and a chute of unknown shape, friction for the contact
law of the authors' DEM.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pandas as pd
from tqdm import tqdm

from kilnflight.checks import check_count
from kilnflight.project import cache, data, parallel, paths
from kilnflight.sorter.bodies import Batch, engine
from kilnflight.sorter.machine import BULKS, Bulk, Contacts, Conveyor, Slide, check_material
from kilnflight.tables import BELT_BODIES

BATCH = 500  # particles that are simulated together: about two seconds of feed
FILE = Path(__file__).with_name("friction_values.json")
PLACES_MM = np.arange(425.0, 751.0, 25.0)  # along the belt, where all are observed
# The fit reads places before the prediction phase only, so all in the phase is a prediction.
FIT_PLACES_MM = PLACES_MM[PLACES_MM <= 600.0]
# Targets of the fit: quantiles, since collisions rule the standard deviations. Units of a misfit.
SCALES = {
    "median_m_s": 0.01,
    "iqr_m_s": 0.002,
    "width_m_s": 0.01,
    "lateral_iqr_m_s": 0.002,
    "lateral_width_m_s": 0.01,
}


@dataclass(frozen=True)
class Sorter:
    """A slide, a belt, and how bodies touch each other and the belt."""

    contacts: Contacts = field(default_factory=Contacts)
    slide: Slide = field(default_factory=Slide)
    conveyor: Conveyor = field(default_factory=Conveyor)

    def __post_init__(self) -> None:
        """Refuse a time step that is too long for the contacts."""
        self.contacts.check_step(self.conveyor.step_s)

    def __call__(self, bulk: Bulk, count: int, generator: np.random.Generator) -> pd.DataFrame:
        """Simulate ``count`` particles; `kilnflight.tables.BELT_BODIES` from frame 0.

        Raises
        ------
        InputError
            If a particle does not reach the edge, or the simulation becomes unstable.
        """
        check_count(count, "Sorter: count", least=0)
        if not count:
            return BELT_BODIES.empty()
        fed = self.slide(bulk, count, self.conveyor.width_mm, generator)
        return Batch(self.conveyor, self.contacts, bulk, fed, generator.random(count)).table()


@dataclass(frozen=True)
class FittedValues:
    """The fitted values and the share of spin; defaults are those of `Contacts` and `Slide`."""

    belt_friction: float = Contacts.belt_friction
    rolling_friction: float = Contacts.rolling_friction
    drop_mm: float = Slide.drop_mm
    rolling_share: float = Slide.rolling_share
    exit_deg: float = Slide.exit_deg
    speed_spread: float = Slide.speed_spread
    lateral_spread_mm_s: float = Slide.lateral_spread_mm_s

    def applied(self, sorter: Sorter) -> Sorter:
        """Return a sorter with these values, its others unchanged."""
        values = asdict(self)
        friction = {name: values.pop(name) for name in ("belt_friction", "rolling_friction")}
        contacts = replace(sorter.contacts, **friction)
        return replace(sorter, contacts=contacts, slide=replace(sorter.slide, **values))


def fit_targets() -> dict[str, object]:
    """Return the targets of the fit as they are hashed: file, places and scales."""
    spheres = data.BELT_DEM["spheres"]
    return {"sha256": data.SHA256[spheres], "places_mm": FIT_PLACES_MM.tolist(), "scales": SCALES}


def fitted_record(path: Path = FILE) -> dict[str, Any]:
    """Return the file of fitted values; see `cache.read_calibration` for errors."""
    return cache.read_calibration(path, fit_targets(), "kilnflight.experiments.belt_calibration")


@lru_cache(maxsize=8)
def fitted_values(path: Path = FILE) -> FittedValues:
    """Return the fitted values; see `cache.read_calibration` for errors."""
    return cache.calibrated(FittedValues, path, fitted_record(path))


def calibrated_sorter(material: str = "spheres") -> Sorter:
    """Return the sorter with the fitted values and the entry times of a material."""
    return fitted_values().applied(Sorter(slide=Slide().feeding(material)))


def simulate_tracks(
    material: str,
    count: int | None = None,
    seed: int = 0,
    jobs: int = 1,
    sorter: Sorter | None = None,
) -> pd.DataFrame:
    """Simulate one material on the belt in batches.

    Finished batches are kept on disk.

    Batches of particles are independent, each with a seed of its own. So the tracks do not depend
    on the number of processes.

    Parameters
    ----------
    material
        ``spheres``, ``cuboids`` or ``cylinders``.
    count
        Particles; None: as many as in the paper.
    seed
        The first particles of a longer run are those of a shorter one if both fill their
        batches.
    jobs
        Processes on this machine; the result does not depend on it.
    sorter
        None: the calibrated one. Its slide gets the entry times of the material, unless it has
        others than the default (`kilnflight.sorter.machine.Slide.feeding`).

    Returns
    -------
    DataFrame
        `kilnflight.tables.BELT_BODIES`, which holds the columns of ``BELT_TRACKS``. A batch
        begins when the belt is empty again.
    """
    check_material(material)
    engine()
    sorter = calibrated_sorter() if sorter is None else sorter
    sorter = replace(sorter, slide=sorter.slide.feeding(material))
    count = BULKS[material].count if count is None else count
    check_count(count, "simulate_tracks: count", least=0)
    sizes = [min(BATCH, count - first) for first in range(0, count, BATCH)]
    folder = paths.derived().absolute()  # a reused process may have another one
    simulate = joblib.delayed(partial(_batch, sorter, material, seed, folder))
    run = joblib.Parallel(n_jobs=min(jobs, len(sizes)) or 1, return_as="generator")
    label = f"belt with {material}"
    with parallel.unwarned():
        batches = run(simulate(number, size) for number, size in enumerate(sizes))
        bar = tqdm(batches, desc=label, total=len(sizes), unit="batch", disable=None)
        return _joined(bar, sizes, sorter.conveyor.sampling_hz)


def _joined(
    batches: Iterable[pd.DataFrame], sizes: Iterable[int], sampling_hz: float
) -> pd.DataFrame:
    """Join batches, one after the other in time, with particles numbered through."""
    parts, frame, particle = [BELT_BODIES.empty()], 0, 0
    for part, size in zip(batches, sizes, strict=True):
        part["frame"] += frame
        part["particle"] += particle
        part["time_s"] = part["frame"] / sampling_hz
        frame, particle = int(part["frame"].max()) + 1, particle + size
        parts.append(part)
    return pd.concat(parts, ignore_index=True)


def _batch(
    sorter: Sorter, material: str, seed: int, folder: Path, number: int, size: int
) -> pd.DataFrame:
    bulk = BULKS[material]
    depends_on = {"sorter": sorter, "bulk": bulk, "seed": [seed, number], "size": size}
    depends_on["mujoco"] = engine().__version__
    order = list(BULKS).index(material)
    make = partial(sorter, bulk, size, np.random.default_rng([seed, order, number]))
    return cache.CachedTable("belt", make, depends_on, folder)()
