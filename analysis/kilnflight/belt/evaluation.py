"""Deviations of predictions from observations.

Section IV of the 2016 paper, section 5 of the 2020 paper.

A deviation is prediction minus reference. Positive means that the particle arrived earlier than
predicted, as in the caption of Fig. 9; section 5.1 words it the other way round.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.belt import ARRIVAL_MODELS, COMBINATIONS
from kilnflight.belt.models import IV, ArrivalModel, Columns, LateralModel, checked, select
from kilnflight.belt.phase import Observed, PredictionPhase
from kilnflight.belt.tracker import LEFT, Followed
from kilnflight.checks import InputError, check_count, check_inside, check_positive
from kilnflight.tables import BELT_ARRIVAL, BELT_LAST, BELT_STATES

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Deviations = Callable[[Observed, PredictionPhase, Flags], Iterator[tuple[str, Array]]]
LastAndArrival = tuple[Columns, Columns]  # last observations and arrivals
Combinations = tuple[tuple[str, ArrivalModel, LateralModel], ...]

SUMMARY = ["n", "median", "q25", "q75", "whisker_low", "whisker_high", "iqr", "mae", "unpredicted"]


def last_states(followed: Followed, frame_s: float) -> pd.DataFrame:
    """Return the filtered state of each track as it enters the prediction phase.

    Parameters
    ----------
    followed
        From `kilnflight.belt.tracker.BeltTracker`, whose area ends where the phase begins.
    frame_s
        Time between two frames.

    Returns
    -------
    DataFrame
        `kilnflight.tables.BELT_LAST`, the filtered state in the frame of the last measurement, and
        ``row`` of that measurement. Tracks that were valid and left at the end of the area: "only
        tracks that are deemed valid while entering the prediction phase trigger a separation
        event".
    """
    check_positive(frame_s, "last_states: frame_s")
    states, ends = BELT_STATES.check(followed.states), followed.ends
    entering = ends.loc[(ends["valid"] == 1) & (ends["reason"] == LEFT), "particle"]
    measured = states[(states["row"] >= 0) & states["particle"].isin(entering)]
    last = measured.sort_values(["particle", "frame"]).groupby("particle").tail(1)
    table = last.assign(time_s=last["frame"] * frame_s)
    return table[[*BELT_LAST.names, "row"]].reset_index(drop=True)


def observe(
    followed: Followed, measured: pd.DataFrame, phase: PredictionPhase, frame_s: float
) -> Observed:
    """Return filtered states before the prediction phase, and measured arrivals.

    The arrivals are measured after the prediction phase.

    Parameters
    ----------
    followed, measured
        From `kilnflight.belt.tracker.BeltTracker`, and its measurements; its area covers the
        target, so that arrivals there are observed, too.
    phase
        Where observation ends, and the target; `PredictionPhase.observe` leaves tracks out.
    frame_s
        Time between two frames.
    """
    states = BELT_STATES.check(followed.states)
    states = states[states["row"] >= 0].assign(time_s=lambda table: table["frame"] * frame_s)
    places = measured[["x", "y"]].to_numpy()[states["row"].to_numpy()]
    tracks = states[["frame", "particle", "time_s"]].assign(x=places[:, 0], y=places[:, 1])
    observed = phase.observe(tracks)
    filtered = states.set_index(["particle", "time_s"])[BELT_LAST.names[2:]]
    keys = pd.MultiIndex.from_frame(observed.last[["particle", "time_s"]])
    return observed._replace(last=filtered.loc[keys].reset_index()[BELT_LAST.names])


def summarise_deviations(deviation: Array) -> dict[str, float]:
    """Return count, quartiles, whiskers and mean absolute value of deviations, (n,).

    Particles without a prediction (NaN) are left out and counted as ``unpredicted``. The whiskers
    reach to the last value within 1.5 box lengths of the box (section 5.1): 2.7 standard deviations
    from the median of a normal distribution.
    """
    predicted = deviation[np.isfinite(deviation)]
    if not len(predicted):
        raise InputError("no particle has a prediction; nothing can be summarised.")
    q25, median, q75 = np.quantile(predicted, [0.25, 0.5, 0.75])
    reach = 1.5 * (q75 - q25)
    inside = predicted[(predicted >= q25 - reach) & (predicted <= q75 + reach)]
    whiskers, mae = (inside.min(), inside.max()), np.abs(predicted).mean()
    values = (
        len(predicted),
        median,
        q25,
        q75,
        *whiskers,
        q75 - q25,
        mae,
        len(deviation) - len(predicted),
    )
    return dict(zip(SUMMARY, values, strict=True))


@dataclass(frozen=True)
class Evaluation:
    """Comparison of all models on one bulk material.

    The models are calibrated with a few of its particles.

    The paper draws "at most 1 % of all particles available (37 to 44)" once. Here the draw is
    repeated, which separates its effect from the models'. Each draw is evaluated on the particles
    that it did not use.
    """

    share: float = 0.01  # of the particles, for calibration (sec. 5)
    draws: int = 200

    def __post_init__(self) -> None:
        """Refuse a share that leaves nothing to evaluate, or no draw."""
        check_inside(self.share, 0, 1, "Evaluation: share")
        check_count(self.draws, "Evaluation: draws")

    def __call__(
        self, observed: Observed, phase: PredictionPhase, deviations: Deviations, seed: int
    ) -> pd.DataFrame:
        """Return the deviations of each model, one row per draw and model.

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
            calibration = np.zeros(particles, dtype=bool)
            calibration[np.random.default_rng(child).choice(particles, size, replace=False)] = True
            for name, deviation in deviations(observed, phase, calibration):
                rows.append({"draw": draw, "model": name, **summarise_deviations(deviation)})
        return pd.DataFrame(rows)


def arrival_deviations(
    observed: Observed, phase: PredictionPhase, calibration: Flags
) -> Iterator[tuple[str, Array]]:
    """Yield each arrival model's name and its deviations in ms.

    The deviations are those of the other particles.

    ``calibration`` (n,) marks the particles that calibrate (IV takes all).
    """
    every, calibrating, (last, arrival) = _split(observed, calibration)
    for model in ARRIVAL_MODELS:
        fitted = _calibrated(model, every, calibrating, phase.target_mm)
        yield model.name, 1000.0 * (fitted(last, phase.target_mm) - arrival["time_s"])


def lateral_deviations(
    observed: Observed, phase: PredictionPhase, calibration: Flags
) -> Iterator[tuple[str, Array]]:
    """Yield the name and the deviations in mm of each combination of Fig. 10."""
    reference = observed.arrival["y"].to_numpy()[~calibration]
    for name, _, y in predictions(observed, phase, calibration):
        yield name, y - reference


def predictions(
    observed: Observed,
    phase: PredictionPhase,
    calibration: Flags,
    combinations: Combinations = COMBINATIONS,
) -> Iterator[tuple[str, Array, Array]]:
    """Yield each combination's name, and when and where the others arrive.

    When is in s, where is y in mm.
    """
    every, calibrating, (last, _) = _split(observed, calibration)
    times: dict[ArrivalModel, Array] = {}  # several combinations share an arrival model
    for name, arrival, lateral in combinations:
        if arrival not in times:
            fitted = _calibrated(arrival, every, calibrating, phase.target_mm)
            times[arrival] = fitted(last, phase.target_mm)
        place = lateral.calibrated(*calibrating)
        yield name, times[arrival], place(last, times[arrival] - last["time_s"])


def _split(observed: Observed, calibration: Flags) -> tuple[LastAndArrival, ...]:
    """Return all particles, the calibration particles and the others, checked once."""
    last, arrival = checked(observed.last, BELT_LAST), checked(observed.arrival, BELT_ARRIVAL)
    calibrating = select(last, calibration), select(arrival, calibration)
    return (last, arrival), calibrating, (select(last, ~calibration), select(arrival, ~calibration))


def _calibrated(
    model: ArrivalModel, every: LastAndArrival, calibrating: LastAndArrival, target_mm: float
) -> ArrivalModel:
    # The paper gives IV the median of all particles, "the most favorable conditions".
    return model.calibrated(*(every if isinstance(model, IV) else calibrating), target_mm)
