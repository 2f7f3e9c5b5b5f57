"""Tracks of the simulated sorter, made once and kept on disk.

Batches of particles are independent of each other, each with a seed of its own, so that the
tracks do not depend on the number of processes; finished batches are kept.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import joblib
import numpy as np
import pandas as pd
from tqdm import tqdm

from kilnflight.belt.bulk import BULKS
from kilnflight.belt.friction_values import calibrated_sorter
from kilnflight.belt.machine import Sorter
from kilnflight.belt.physics import engine
from kilnflight.checks import InputError, check_count
from kilnflight.project import paths
from kilnflight.project.cache import CachedTable
from kilnflight.tables import BELT_BODIES

BATCH = 500  # particles that are simulated together: about two seconds of feed


def batches(count: int) -> list[int]:
    """Return how many particles each batch has."""
    check_count(count, "simulation: count", least=0)
    return [min(BATCH, count - first) for first in range(0, count, BATCH)]


def tracks(
    material: str,
    count: int | None = None,
    seed: int = 0,
    jobs: int = 1,
    sorter: Sorter | None = None,
) -> pd.DataFrame:
    """Return the bodies of one material on the belt, batch after batch, from disk if kept.

    Parameters
    ----------
    material
        ``spheres``, ``cuboids`` or ``cylinders``.
    count
        Particles; as many as in the paper unless told.
    seed
        Of all chances. The first particles of a longer run are not those of a shorter one
        unless both fill their batches.
    jobs
        Processes on this machine; the result does not depend on it.
    sorter
        The calibrated one unless told.

    Returns
    -------
    DataFrame
        `kilnflight.tables.BELT_BODIES`, which holds the columns of ``BELT_TRACKS``. A batch
        begins when the belt is empty again.
    """
    if material not in BULKS:
        raise InputError(f"no material {material!r}; there are {', '.join(BULKS)}.")
    engine()
    sorter = calibrated_sorter() if sorter is None else sorter
    sizes = batches(BULKS[material].count if count is None else count)
    folder = paths.derived().absolute()  # a process that is used again may know another
    one = joblib.delayed(partial(_batch, sorter, material, seed, folder))
    run = joblib.Parallel(n_jobs=min(jobs, len(sizes)) or 1, return_as="generator")
    made = run(one(number, size) for number, size in enumerate(sizes))
    bar = tqdm(made, desc=f"belt with {material}", total=len(sizes), unit="batch", disable=None)
    parts, frame, particle = [BELT_BODIES.empty()], 0, 0
    for part, size in zip(bar, sizes, strict=True):
        part["frame"] += frame
        part["particle"] += particle
        part["time_s"] = part["frame"] / sorter.conveyor.sampling_hz
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
    return CachedTable("belt", make, depends_on, folder)()
