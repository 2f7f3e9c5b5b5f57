"""Which particles a bar of valves hits, given when and where they are predicted to arrive.

The purpose of every prediction in both papers (Fig. 1 of each): an array of nozzles across the
belt blows out what is not wanted. None of them evaluates it; numbers of a real bar are the
user's to set.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from kilnflight.checks import (
    InputError,
    check_count,
    check_finite,
    check_limit,
    check_positive,
    check_shape,
)

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


class Blown(NamedTuple):
    """What became of n particles."""

    hit: Flags  # (n,), was at a valve while it was open
    wanted: Flags  # (n,), was to be blown out

    @property
    def hit_share(self) -> float:
        """Share of the particles to be blown out that are; NaN if there is none."""
        return float(self.hit[self.wanted].mean()) if self.wanted.any() else np.nan

    @property
    def inadvertent_share(self) -> float:
        """Share of the others that are blown out with them; NaN if there is none."""
        return float(self.hit[~self.wanted].mean()) if not self.wanted.all() else np.nan


@dataclass(frozen=True)
class ValveBar:
    """Evenly spaced valves across the belt, each open for the same time.

    For each particle to be blown out, the valve nearest to its predicted place opens for
    ``open_s`` around its predicted time. A particle is hit if its centre passes an open valve,
    whoever that was opened for; its size and the air's way are neglected.
    """

    valves: int = 32  # a pitch of 5.6 mm, about one particle; not printed
    belt_mm: float = 180.0  # 2020 paper, section 3
    valve_mm: float | None = None  # width of a jet; None: the pitch, no gap and no overlap
    open_s: float = 0.005  # not printed

    def __post_init__(self) -> None:
        """Refuse what is no bar of valves."""
        check_count(self.valves, "ValveBar: valves")
        check_positive(self.belt_mm, "ValveBar: belt_mm")
        if self.valve_mm is not None:
            check_positive(self.valve_mm, "ValveBar: valve_mm")
        check_limit(self.open_s, "ValveBar: open_s")

    @property
    def pitch_mm(self) -> float:
        """The way from one valve to the next."""
        return self.belt_mm / self.valves

    @property
    def width_mm(self) -> float:
        """The width of a jet: as told, else the pitch."""
        return self.pitch_mm if self.valve_mm is None else self.valve_mm

    def __call__(
        self, wanted: Flags, predicted: tuple[Array, Array], true: tuple[Array, Array]
    ) -> Blown:
        """Return who is hit.

        Parameters
        ----------
        wanted
            (n,), which particles are to be blown out.
        predicted
            Times in s and places y in mm, (n,) each. Where either is NaN, no arrival was
            predicted and no valve opens.
        true
            The same as it happened; finite.

        Raises
        ------
        InputError
            If lengths differ, or what happened is not finite.
        """
        if wanted.dtype != np.bool_:
            raise InputError(f"ValveBar: wanted holds {wanted.dtype}, pass True and False.")
        for name, values in zip(
            ("predicted times", "predicted places", "true times", "true places"),
            (*predicted, *true),
            strict=True,
        ):
            check_shape(values, wanted.shape, f"ValveBar: {name}")
        check_finite(np.stack(true), "ValveBar: true times and places")
        known = wanted & np.isfinite(predicted[0]) & np.isfinite(predicted[1])
        nearest = np.floor(predicted[1][known] / self.pitch_mm)
        valve = nearest.clip(0, self.valves - 1).astype(np.int64)
        return Blown(self._hit(valve, predicted[0][known], *true), wanted)

    def _hit(self, valve: npt.NDArray[np.int64], opened: Array, time: Array, y: Array) -> Flags:
        """Return which true arrivals find a valve open; valve k opens around ``opened``."""
        pitch, half = self.pitch_mm, self.width_mm / 2
        nearest = np.floor(y / pitch).astype(np.int64)
        hit = np.zeros(len(time), dtype=bool)
        for step in range(-int(half / pitch) - 1, int(half / pitch) + 2):
            candidate = nearest + step
            reached = np.abs(y - (candidate + 0.5) * pitch) <= half
            for k in range(self.valves):
                there = np.flatnonzero(reached & (candidate == k))
                hit[there] |= self._open(np.sort(opened[valve == k]), time[there])
        return hit

    def _open(self, opened: Array, time: Array) -> Flags:
        """Return whether one valve, opened around these times, is open at others."""
        if not len(opened):
            return np.zeros(len(time), dtype=bool)
        after = np.searchsorted(opened, time).clip(0, len(opened) - 1)
        before = np.maximum(after - 1, 0)
        apart = np.minimum(np.abs(opened[after] - time), np.abs(opened[before] - time))
        return apart <= self.open_s / 2
