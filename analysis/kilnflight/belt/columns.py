"""The columns of the tables that motion models take, checked once for all models."""

from __future__ import annotations

from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.tables import BELT_ARRIVAL, BELT_LAST

Array = npt.NDArray[np.float64]


class Last(NamedTuple):
    """The columns of `kilnflight.tables.BELT_LAST`, (n,) each."""

    particle: npt.NDArray[np.int64]
    time_s: Array
    x: Array
    y: Array
    velocity_x_mm_s: Array
    velocity_y_mm_s: Array
    acceleration_x_mm_s2: Array
    acceleration_y_mm_s2: Array


class Arrival(NamedTuple):
    """The columns of `kilnflight.tables.BELT_ARRIVAL`, (n,) each."""

    particle: npt.NDArray[np.int64]
    time_s: Array
    y: Array
    velocity_y_mm_s: Array


Columns = TypeVar("Columns", Last, Arrival)


def checked_last(table: pd.DataFrame | Last) -> Last:
    """Return the columns; what is `Last` already was checked and is returned as it is."""
    if isinstance(table, Last):
        return table
    known = BELT_LAST.check(table)
    return Last(*(known[name].to_numpy() for name in BELT_LAST.names))


def checked_arrival(table: pd.DataFrame | Arrival) -> Arrival:
    """Return the columns; what is `Arrival` already was checked and is returned as it is."""
    if isinstance(table, Arrival):
        return table
    known = BELT_ARRIVAL.check(table)
    return Arrival(*(known[name].to_numpy() for name in BELT_ARRIVAL.names))


def only(columns: Columns, which: npt.NDArray[Any]) -> Columns:
    """Return some of the particles: ``which`` (n,) marks them."""
    return type(columns)(*(column[which] for column in columns))
