"""What all peers share: which are installed, the table they read, the table they return."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
import pandas as pd

from kilnflight.checks import InputError, check_columns
from kilnflight.tables import DETECTIONS, Table

NEEDED = Table("detections to track", DETECTIONS.columns[:3])  # frame, row, col
PLACE = ["row", "col"]
PACKAGES = ("laptrack", "stonesoup", "trackpy")


def available() -> tuple[str, ...]:
    """Return the packages that are installed, of `PACKAGES`."""
    return tuple(name for name in PACKAGES if find_spec(name) is not None)


def need(package: str) -> None:
    """Import a package, or raise an `InputError` if it is not installed."""
    if package not in available():
        raise InputError(f"{package} is not installed: pip install kilnflight[peer]")
    with warnings.catch_warnings():  # progress bars of theirs complain about notebooks
        warnings.simplefilter("ignore")
        import_module(package)


def named(detections: pd.DataFrame, link: Callable[[pd.DataFrame], Any]) -> pd.DataFrame:
    """Return the table with the particles that a peer makes of it, as `tracking.track` does.

    ``link`` is given frame, row and col sorted, and returns one label per row.
    """
    check_columns(detections, NEEDED.names, NEEDED.name)
    particle = np.full(len(detections), -1, dtype=np.int64)
    wanted = np.arange(len(detections))
    if "particle" in detections.columns:
        wanted = np.flatnonzero(detections["particle"].to_numpy() != -1)
    if len(wanted):
        table = NEEDED.check(detections.iloc[wanted][NEEDED.names])
        order = np.lexsort(table[["col", "row", "frame"]].to_numpy().T)
        labels = np.asarray(link(table.iloc[order].reset_index(drop=True)))
        particle[wanted[order]] = pd.factorize(labels)[0]
    return detections.assign(particle=particle)
