"""Particles that a bar of valves hits, by predictions of their arrival.

The purpose of the predictions in both papers (Fig. 1 of each): an array of nozzles across the belt
blows particles out. Neither evaluates it; numbers of a real bar are for the user to set.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.belt import COMBINATIONS
from kilnflight.belt.evaluation import predictions
from kilnflight.belt.models import CVBC, IV, LateralCV, Straight
from kilnflight.belt.phase import Observed, PredictionPhase
from kilnflight.checks import (
    InputError,
    check_between,
    check_count,
    check_finite,
    check_limit,
    check_positive,
    check_shape,
)

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

# Fig. 10 and two more: what a line-scan camera implies (one velocity for all, straight), and
# constant velocity without its bias. Fig. 10 shows spreads, but a valve suffers from a bias.
MODELS = (
    ("IV-Straight", IV(), Straight()),
    *COMBINATIONS,
    ("CVBC-CV", CVBC(), LateralCV()),
)


class Separation(NamedTuple):
    """Which of n particles are hit, and which were to be."""

    hit: Flags  # (n,), was at a valve while it was open
    chosen: Flags  # (n,), was to be blown out

    @property
    def hit_share(self) -> float:
        """Share of blown-out particles among those to be blown out; NaN without any."""
        return float(self.hit[self.chosen].mean()) if self.chosen.any() else np.nan

    @property
    def inadvertent_share(self) -> float:
        """Share of blown-out particles among the others; NaN without any others."""
        return float(self.hit[~self.chosen].mean()) if not self.chosen.all() else np.nan


@dataclass(frozen=True)
class ValveBar:
    """Evenly spaced valves across the belt, each open for the same time.

    For each particle to be blown out, the valve nearest to its predicted place opens for
    ``open_s`` around its predicted time. A particle is hit if its centre passes an open valve,
    for whichever particle that was opened; its size and the air's way are neglected.
    """

    valves: int = 32  # a pitch of 5.6 mm, about one particle; not printed
    belt_mm: float = 180.0  # 2020 paper, section 3
    valve_mm: float | None = None  # width of a jet; None: the pitch, no gap and no overlap
    open_s: float = 0.005  # not printed

    def __post_init__(self) -> None:
        """Refuse a number, width or time that is not positive."""
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
        """The width of a jet: as set, else the pitch."""
        return self.pitch_mm if self.valve_mm is None else self.valve_mm

    def __call__(
        self, chosen: Flags, predicted: tuple[Array, Array], true: tuple[Array, Array]
    ) -> Separation:
        """Return which particles are hit.

        Parameters
        ----------
        chosen
            (n,), which particles are to be blown out.
        predicted
            Times in s and places y in mm, (n,) each. Where either is NaN, no arrival was
            predicted and no valve opens.
        true
            True times and places; finite.

        Raises
        ------
        InputError
            If lengths differ, or true values are not finite.
        """
        if chosen.dtype != np.bool_:
            raise InputError(f"ValveBar: chosen holds {chosen.dtype}, pass True and False.")
        names = ("predicted times", "predicted places", "true times", "true places")
        for name, values in zip(names, (*predicted, *true), strict=True):
            check_shape(values, chosen.shape, f"ValveBar: {name}")
        check_finite(np.stack(true), "ValveBar: true times and places")
        opens = chosen & np.isfinite(predicted[0]) & np.isfinite(predicted[1])
        time, place = predicted[0][opens], predicted[1][opens]
        nearest = np.floor(place / self.pitch_mm).clip(0, self.valves - 1)
        hit = np.zeros(len(chosen), dtype=bool)
        for valve in range(self.valves):
            distance = np.abs(true[1] - (valve + 0.5) * self.pitch_mm)
            passing = np.flatnonzero(distance <= self.width_mm / 2)
            hit[passing] |= self._open(np.sort(time[nearest == valve]), true[0][passing])
        return Separation(hit, chosen)

    def _open(self, opened: Array, time: Array) -> Flags:
        """Return whether one valve, opened around ascending times, is open at others."""
        padded = np.concatenate([[-np.inf], opened, [np.inf]])
        after = np.searchsorted(padded, time)
        difference = np.minimum(padded[after] - time, time - padded[after - 1])
        return difference <= self.open_s / 2


def hit_shares(
    observed: Observed,
    phase: PredictionPhase,
    bars: Iterable[ValveBar],
    seed: int,
    blown: float = 0.1,
    calibrating: float = 0.01,
) -> pd.DataFrame:
    """Return the shares of hit particles and inadvertent hits for each model and bar.

    Parameters
    ----------
    observed, phase
        From `PredictionPhase.observe`, and the phase itself; valves are at its target.
    bars
        Bars of valves to compare.
    seed
        Of the draw of calibration particles and of those to be blown out.
    blown
        Share of the particles to be blown out; an assumption, since no paper sorts them.
    calibrating
        Share that calibrates the models and is left out, 1 % as in the 2020 paper.

    Returns
    -------
    DataFrame
        ``model``, ``valves``, ``valve_mm`` (width of a jet), ``open_ms``, ``ejected`` (particles to
        be blown out), ``remaining`` (the others), ``hit_percent``, ``inadvertent_percent``.

    Raises
    ------
    InputError
        If there are too few particles for either share.
    """
    calibration, chosen = _drawn(len(observed.last), seed, blown, calibrating)
    arrival = observed.arrival[~calibration]
    true = arrival["time_s"].to_numpy(), arrival["y"].to_numpy()
    rows, bars, sizes = [], list(bars), (int(chosen.sum()), int((~chosen).sum()))
    for model, time, y in predictions(observed, phase, calibration, MODELS):
        for bar in bars:
            separation = bar(chosen, (time, y), true)
            percent = 100 * separation.hit_share, 100 * separation.inadvertent_share
            rows.append((model, bar.valves, bar.width_mm, 1000 * bar.open_s, *sizes, *percent))
    columns = ["model", "valves", "valve_mm", "open_ms", "ejected", "remaining"]
    return pd.DataFrame(rows, columns=[*columns, "hit_percent", "inadvertent_percent"])


def mean_hit_shares(
    observed: Mapping[str, Observed],
    phase: PredictionPhase,
    bars: Sequence[ValveBar],
    seeds: Iterable[int],
    blown: float = 0.1,
) -> pd.DataFrame:
    """Return means over the seeds of `hit_shares` for each ``data_set``, model and bar."""
    parts = {
        (name, seed): hit_shares(part, phase, bars, seed, blown)
        for (name, part), seed in product(observed.items(), seeds)
    }
    every = pd.concat(parts, names=["data_set", "seed"]).reset_index("data_set")
    keys = ["data_set", "model", "valves", "valve_mm", "open_ms"]
    return every.groupby(keys, sort=False).mean().reset_index()


def along(table: pd.DataFrame, name: str, bar: ValveBar) -> pd.DataFrame:
    """Return the rows of bars that are as a given one but for a column.

    Parameters
    ----------
    table
        Of `hit_shares`.
    name
        ``valves``, ``valve_mm`` or ``open_ms``, which may differ; "": none.
    bar
        The given one; as there, a jet is as wide as the pitch of its bar.
    """
    same = {
        "valves": table["valves"] == bar.valves,
        "valve_mm": table["valve_mm"] == bar.belt_mm / table["valves"],
        "open_ms": table["open_ms"] == 1000 * bar.open_s,
    }
    return table[np.all([rows for column, rows in same.items() if column != name], axis=0)]


def _drawn(count: int, seed: int, blown: float, calibrating: float) -> tuple[Flags, Flags]:
    """Draw the calibration particles, and those of the others to be blown out.

    The calibration particles are (count,).
    """
    check_between(blown, 0, 1, "hit_shares: blown")
    check_between(calibrating, 0, 1, "hit_shares: calibrating")
    rng = np.random.default_rng(seed)
    calibration = np.isin(np.arange(count), rng.permutation(count)[: int(calibrating * count)])
    evaluated = int((~calibration).sum())
    chosen = np.isin(np.arange(evaluated), rng.permutation(evaluated)[: int(blown * evaluated)])
    if not (calibration.any() and chosen.any()):
        raise InputError(
            f"hit_shares: of {count} particles {calibrating:.1%} calibrate and {blown:.1%} of the "
            "rest are blown out; that is less than one. Give more particles or larger shares."
        )
    return calibration, chosen
