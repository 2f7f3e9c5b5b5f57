"""How far predictions are from what happened (2020 paper, section 5).

A deviation is prediction minus reference: positive means that the particle arrived
earlier than predicted (caption of Fig. 9; section 5.1 words it the other way round).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.belt import ARRIVAL_MODELS, COMBINATIONS
from kilnflight.belt.arrival import IV, ArrivalModel
from kilnflight.belt.columns import Arrival, Last, checked_arrival, checked_last, only
from kilnflight.belt.lateral import LateralModel
from kilnflight.belt.phase import Observed, PredictionPhase
from kilnflight.checks import InputError

Array = npt.NDArray[np.float64]

SUMMARY = ["n", "median", "q25", "q75", "whisker_low", "whisker_high", "iqr", "mae", "unpredicted"]


Deviations = Callable[
    [Observed, PredictionPhase, npt.NDArray[np.bool_]], Iterator[tuple[str, Array]]
]


Combinations = tuple[tuple[str, ArrivalModel, LateralModel], ...]


def summarise(deviation: Array) -> dict[str, float]:
    """Return count, quartiles, whiskers and mean absolute value of deviations, (n,).

    Particles without a prediction (NaN) are left out and counted as ``unpredicted``. The
    whiskers reach to the last value within 1.5 box lengths of the box, which is 2.7
    standard deviations from the median of a normal distribution (section 5.1).
    """
    known = deviation[np.isfinite(deviation)]
    if not len(known):
        raise InputError("no particle has a prediction; nothing can be summarised.")
    q25, median, q75 = np.quantile(known, [0.25, 0.5, 0.75])
    reach = 1.5 * (q75 - q25)
    inside = known[(known >= q25 - reach) & (known <= q75 + reach)]
    return {
        "n": len(known),
        "median": median,
        "q25": q25,
        "q75": q75,
        "whisker_low": inside.min(),
        "whisker_high": inside.max(),
        "iqr": q75 - q25,
        "mae": np.abs(known).mean(),
        "unpredicted": len(deviation) - len(known),
    }


@dataclass(frozen=True)
class Evaluation:
    """Compare all models on one bulk material, calibrated with a few of its particles.

    The paper uses "at most 1 % of all particles available (37 to 44)" once; here the draw
    is repeated, so that its effect can be told from the models'. Each draw is evaluated on
    the particles that it did not use.
    """

    share: float = 0.01  # of the particles, for calibration (sec. 5)
    draws: int = 200

    def __post_init__(self) -> None:
        """Refuse a share that leaves nothing to evaluate, or no draw."""
        if not 0 < self.share < 1 or self.draws < 1:
            raise InputError(
                f"Evaluation: share {self.share} must lie between 0 and 1, draws {self.draws} "
                "must be at least 1."
            )

    def __call__(
        self, observed: Observed, phase: PredictionPhase, deviations: Deviations, seed: int
    ) -> pd.DataFrame:
        """Return how far each model is off, one row per draw and model.

        Draw k depends on the seed and k alone, so that more draws keep the first ones.

        Parameters
        ----------
        observed, phase
            From `PredictionPhase.observe`, and the phase itself.
        deviations
            `arrival_deviations` (ms) or `lateral_deviations` (mm).
        seed
            Of the draws.

        Returns
        -------
        DataFrame
            Columns ``draw``, ``model`` and those of `SUMMARY`.

        Raises
        ------
        InputError
            If the share amounts to less than one particle.
        """
        particles = len(observed.last)
        size = int(self.share * particles)
        if size < 1:
            raise InputError(
                f"{self.share:.2%} of {particles} particles is less than one; use more particles "
                "or a larger share."
            )
        rows = []
        for draw, child in enumerate(np.random.SeedSequence(seed).spawn(self.draws)):
            chosen = np.random.default_rng(child).choice(particles, size, replace=False)
            calibration = np.zeros(particles, dtype=bool)
            calibration[chosen] = True
            for name, deviation in deviations(observed, phase, calibration):
                rows.append({"draw": draw, "model": name, **summarise(deviation)})
        return pd.DataFrame(rows)


class _Split(NamedTuple):
    """The particles of one draw, checked once for all models."""

    every: tuple[Last, Arrival]
    calibrating: tuple[Last, Arrival]
    others: tuple[Last, Arrival]

    def calibrated(self, model: ArrivalModel, target_mm: float) -> ArrivalModel:
        # The paper gives IV the median of all particles, "the most favorable conditions".
        use = self.every if isinstance(model, IV) else self.calibrating
        return model.calibrated(*use, target_mm)


def _split(observed: Observed, calibration: npt.NDArray[np.bool_]) -> _Split:
    last, arrival = checked_last(observed.last), checked_arrival(observed.arrival)
    parts = ((only(last, use), only(arrival, use)) for use in (calibration, ~calibration))
    return _Split((last, arrival), *parts)


def arrival_deviations(
    observed: Observed, phase: PredictionPhase, calibration: npt.NDArray[np.bool_]
) -> Iterator[tuple[str, Array]]:
    """Yield each arrival model's name and its deviations in ms on the other particles.

    ``calibration`` (n,) marks the particles that calibrate (IV takes all).
    """
    split = _split(observed, calibration)
    last, reference = split.others
    for model in ARRIVAL_MODELS:
        predicted = split.calibrated(model, phase.target_mm)(last, phase.target_mm)
        yield model.name, 1000.0 * (predicted - reference.time_s)


def predictions(
    observed: Observed,
    phase: PredictionPhase,
    calibration: npt.NDArray[np.bool_],
    combinations: Combinations = COMBINATIONS,
) -> Iterator[tuple[str, Array, Array]]:
    """Yield the name of each combination and when (s) and where (y, mm) the others arrive."""
    split = _split(observed, calibration)
    last, _ = split.others
    times: dict[ArrivalModel, Array] = {}  # several combinations share an arrival model
    for name, arrival, lateral in combinations:
        if arrival not in times:
            timed = split.calibrated(arrival, phase.target_mm)
            times[arrival] = timed(last, phase.target_mm)
        fitted = lateral.calibrated(*split.calibrating)
        yield name, times[arrival], fitted(last, times[arrival] - last.time_s)


def lateral_deviations(
    observed: Observed, phase: PredictionPhase, calibration: npt.NDArray[np.bool_]
) -> Iterator[tuple[str, Array]]:
    """Yield the name and the deviations in mm of each combination of Fig. 10."""
    reference = observed.arrival["y"].to_numpy()[~calibration]
    for name, _, y in predictions(observed, phase, calibration):
        yield name, y - reference


def over_draws(draws: pd.DataFrame) -> pd.DataFrame:
    """Return the median over the draws of every summary, one row per model.

    Columns other than ``draw`` and `SUMMARY` (model, data set, source) identify a row.
    """
    table = draws.groupby(_identity(draws), sort=False)[SUMMARY].median().reset_index()
    return table.astype({"n": int, "unpredicted": int})


def intervals(draws: pd.DataFrame, quantities: tuple[str, ...] = ("iqr", "mae")) -> pd.DataFrame:
    """Return between which values 95 % of the draws lie.

    Returns
    -------
    DataFrame
        What identifies a row, and for each quantity ``<quantity>_low``, ``<quantity>``
        (the median over the draws) and ``<quantity>_high``.
    """
    grouped = draws.groupby(_identity(draws), sort=False)
    parts = [
        grouped[name].quantile(share).rename(f"{name}{ending}")
        for name in quantities
        for share, ending in ((0.025, "_low"), (0.5, ""), (0.975, "_high"))
    ]
    return pd.concat(parts, axis=1).reset_index()


def _identity(draws: pd.DataFrame) -> list[str]:
    return [name for name in draws.columns if name != "draw" and name not in SUMMARY]
