"""Evaluate predictions by what is observed behind the prediction phase.

2020 paper, Figs 2 and 5 and section 5; 2016 paper, section IV. A particle is observed
until the prediction phase begins. After that only its crossing of the target is used,
as the reference.

A deviation is prediction minus reference. Positive means that the particle arrived
earlier than predicted, as in the caption of Fig. 9; section 5.1 states the opposite.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from pandas import DataFrame

from kilnflight.arrays import Array, Flags, Generator, Index, Named, Numbers
from kilnflight.belt.models import (
    ARRIVAL_MODELS,
    BELT_EDGE_MM,
    COMBINATIONS,
    IV,
    SPREADS,
    ArrivalModel,
    LateralModel,
    Straight,
    time_to_cover,
)
from kilnflight.belt.tracker import LEFT, Followed
from kilnflight.checks import InputError, NotNegative, Number, Settings
from kilnflight.tables import BELT_ARRIVAL, BELT_LAST, BELT_TRACKS

CALIBRATION_SHARE = 0.01  # "at most 1 % of all particles" (sec. 5)
# Why `PredictionPhase.observe` leaves a particle out.
_LEFT_OUT = [
    "gap in the track",
    "fewer than three observations before the phase",
    "target never reached",
]
_KEPT = ""
# Keys of `summarise_deviations`.
SUMMARY = ["n", "median", "q25", "q75", "whisker_low", "whisker_high"]
SUMMARY += ["iqr", "mae", "unpredicted"]


class Observed(NamedTuple):
    """Last observations and arrivals, of the same particles in the same order.

    Particles that lack either are counted.
    """

    last: DataFrame  # kilnflight.tables.BELT_LAST
    arrival: DataFrame  # kilnflight.tables.BELT_ARRIVAL
    left_out: dict[str, int]  # reason -> number of particles


class PredictionPhase(Settings):
    """Start and target of a prediction, as places x along the belt in mm.

    The paper predicts from 150 mm before the edge of the belt to the edge (sec. 5). The
    public tracks end there: the last position of every particle is up to 15 mm before
    the edge. So the arrival is extrapolated from the last three positions. Tested at
    773 mm, where the tracks go on, its time is off by .001 to .003 ms (mean of the
    absolute error, by material).

    Parameters
    ----------
    start_mm
        Only observations before it are used.
    target_mm
        Place of the arrivals; the default is the edge of the belt.
    extrapolated_mm
        Longest distance before the target over which an arrival is extrapolated. The
        default is that of 10 ms, the time step of the public tracks.

    Examples
    --------
    >>> frame = np.arange(41)
    >>> tracks = DataFrame({"frame": frame, "particle": 0, "time_s": frame / 100})
    >>> tracks = tracks.assign(x=388 + 10.0 * frame, y=90.0)
    >>> last, arrival, left_out = PredictionPhase().observe(tracks)
    >>> last["x"].item(), last["velocity_x_mm_s"].round().item()
    (628.0, 1000.0)
    >>> arrival["time_s"].item()
    0.4
    """

    start_mm: Number = BELT_EDGE_MM - 150.0
    target_mm: Number = BELT_EDGE_MM
    extrapolated_mm: NotNegative = 15.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.start_mm < self.target_mm:
            raise InputError(
                f"PredictionPhase: target_mm {self.target_mm} is not beyond start_mm."
            )

    def observe(self, tracks: DataFrame) -> Observed:
        """Split tracks into last observations and arrivals at the target.

        Velocity and acceleration come from the parabola through the last three
        positions. With noise-free positions "only the last few observations are
        required" (sec. 5.1). For a constant acceleration the result is exact.

        Parameters
        ----------
        tracks
            `kilnflight.tables.BELT_TRACKS`, sampled evenly in time.

        Returns
        -------
        Observed
            Particles are left out, and counted by the first reason that applies: a gap
            in the track; fewer than three observations before the phase; the target
            never reached. A track that ends up to ``extrapolated_mm`` before the target
            reaches it.

        Raises
        ------
        InputError
            If a particle has two rows in one frame, or the time between frames varies.
        """
        table = BELT_TRACKS.check(tracks)
        table = table.sort_values(["particle", "frame"], kind="stable")
        _check_frames(table)
        columns = {name: table[name].to_numpy() for name in BELT_TRACKS.names}
        starts = np.flatnonzero(np.diff(columns["particle"], prepend=np.nan) != 0)
        ends = np.append(starts, len(table))[1:]
        frame = columns["frame"]
        x = columns["x"]
        before = _first(x >= self.start_mm, starts, ends) - 1
        after = _first(x >= self.target_mm, starts, ends)
        gap = frame[ends - 1] - frame[starts] + 1 != ends - starts
        ends_early = x[ends - 1] < self.target_mm - self.extrapolated_mm
        missed = (after == ends) & ends_early
        reason = np.select([gap, before - starts < 2, missed], _LEFT_OUT, _KEPT)
        kept = reason == _KEPT
        last = _last(columns, before[kept])
        arrival = self._arrival(columns, after[kept], ends[kept])
        arrives = arrival["time_s"].notna()
        reason[kept] = np.where(arrives, _KEPT, _LEFT_OUT[2])
        return Observed(
            last=last[arrives].reset_index(drop=True),
            arrival=arrival[arrives].reset_index(drop=True),
            left_out={each: int((reason == each).sum()) for each in _LEFT_OUT},
        )

    def carry(self, observed: Observed) -> Observed:
        """Extrapolate last states to the start of the phase by their own acceleration.

        At 100 Hz the last observation lies up to a step of 14 mm before the phase; at
        the paper's 1000 Hz (section 5) up to 1.4 mm. Only observations before the phase
        are used. A particle that would stop before keeps its state.
        """
        last = BELT_LAST.check(observed.last)
        wait = np.nan_to_num(_time_to(self.start_mm, last))
        return observed._replace(last=_moved(last, wait))

    def _arrival(self, columns: Named, after: Index, ends: Index) -> DataFrame:
        """Return the arrivals of n particles, BELT_ARRIVAL.

        A particle seen beyond the target arrives on the line between the positions
        around it (Fig. 5), any other on the parabola through its last three positions;
        NaN if that turns back.

        Parameters
        ----------
        columns
            Those of BELT_TRACKS, (rows,) each.
        after
            (n,) first row of each particle at or beyond the target, or its end.
        ends
            (n,) row after the last one of each particle.
        """
        state = _last(columns, after - 1)
        seen = after < ends
        row = after[seen]
        duration = columns["time_s"][row] - columns["time_s"][row - 1]
        for axis in ("x", "y"):
            step = columns[axis][row] - columns[axis][row - 1]
            state.loc[seen, f"velocity_{axis}_mm_s"] = step / duration
            state.loc[seen, f"acceleration_{axis}_mm_s2"] = 0.0
        return _moved(state, _time_to(self.target_mm, state))[BELT_ARRIVAL.names]


def _time_to(x_mm: float, last: DataFrame) -> Array:
    """Return the time in s (n,) to a place along the belt, at constant acceleration.

    ``last`` are states BELT_LAST before it. NaN for a particle that turns back.
    """
    names = ["x", "velocity_x_mm_s", "acceleration_x_mm_s2"]
    x, velocity, acceleration = last[names].to_numpy(float).T
    return time_to_cover(x_mm - x, velocity, acceleration)


def _moved(last: DataFrame, wait: Array) -> DataFrame:
    """Return states BELT_LAST moved by ``wait`` (n,) s at constant acceleration."""
    moved = last.assign(time_s=last["time_s"] + wait)
    for axis in ("x", "y"):
        velocity = last[f"velocity_{axis}_mm_s"]
        acceleration = last[f"acceleration_{axis}_mm_s2"]
        moved[axis] = last[axis] + wait * velocity + wait**2 * acceleration / 2
        moved[f"velocity_{axis}_mm_s"] = velocity + wait * acceleration
    return moved


def _check_frames(table: DataFrame) -> None:
    """Raise an `InputError` for two rows of a particle in one frame or uneven times.

    ``table`` is BELT_TRACKS by particle and frame. Velocities by parabola need even
    times.
    """
    steps = table.groupby("particle")[["frame", "time_s"]].diff().to_numpy()
    frames, seconds = steps[~np.isnan(steps[:, 0])].T
    if (frames == 0).any():
        raise InputError("tracks: a particle has two rows in one frame; keep one.")
    step = seconds / frames
    if len(step) and (step.min() <= 0 or np.ptp(step) > 1e-3 * np.median(step)):
        raise InputError(
            "tracks: time_s does not grow evenly with frame. Resample the tracks."
        )


def _first(flags: Flags, starts: Index, ends: Index) -> Index:
    """Return the first flagged row (n,) of each particle, or its end.

    ``flags`` (rows,) are by particle; ``starts`` and ``ends`` (n,) are each particle's
    first row and the one after its last.
    """
    rows = np.append(np.flatnonzero(flags), len(flags))
    return np.minimum(rows[np.searchsorted(rows, starts)], ends)


def _last(columns: Named, row: Index) -> DataFrame:
    """Return the states BELT_LAST at rows (n,), by parabolas through three positions.

    They are those of each row and of the two before it, evenly spaced in time.
    ``columns`` are those of BELT_TRACKS, (rows,) each.
    """
    step = columns["time_s"][row] - columns["time_s"][row - 1]
    state = {"particle": columns["particle"][row], "time_s": columns["time_s"][row]}
    for axis in ("x", "y"):
        newest, middle, oldest = (columns[axis][row - back] for back in range(3))
        state[axis] = newest
        state[f"velocity_{axis}_mm_s"] = (3 * newest - 4 * middle + oldest) / (2 * step)
        state[f"acceleration_{axis}_mm_s2"] = (newest - 2 * middle + oldest) / step**2
    return DataFrame(state)[BELT_LAST.names]


def last_states(followed: Followed, frame_s: float) -> DataFrame:
    """Return the filtered state of each track that enters the prediction phase.

    Parameters
    ----------
    followed
        From `kilnflight.belt.tracker.BeltTracker`, whose area ends where the phase
        begins.
    frame_s
        Time in s between two frames.

    Returns
    -------
    DataFrame
        `kilnflight.tables.BELT_LAST`, the filtered state in the frame of the last
        measurement, its `SPREADS`, and ``row`` of that measurement. Tracks that were
        valid and left at the end of the area: "only tracks that are deemed valid while
        entering the prediction phase trigger a separation event".
    """
    states = followed.states
    ends = followed.ends
    entering = ends.loc[(ends["valid"] == 1) & (ends["reason"] == LEFT), "particle"]
    measured = states[(states["row"] >= 0) & states["particle"].isin(entering)]
    ordered = measured.sort_values(["particle", "frame"])
    last = ordered.drop_duplicates("particle", keep="last")
    table = last.assign(time_s=last["frame"] * frame_s)
    return table[[*BELT_LAST.names, *SPREADS, "row"]].reset_index(drop=True)


def observe_followed(
    followed: Followed, measured: DataFrame, phase: PredictionPhase, frame_s: float
) -> Observed:
    """Return filtered states before the prediction phase and measured arrivals.

    Parameters
    ----------
    followed
        From `kilnflight.belt.tracker.BeltTracker`, whose area reaches beyond the
        target.
    measured
        The table given to the tracker (frame, x and y in mm), in the same order:
        ``row`` of a state is a row of it, or -1 in a frame without a measurement.
    phase
        Start and target. Particles that miss either are left out.
    frame_s
        Time in s between two frames.

    Returns
    -------
    Observed
        Its ``last`` are filtered states with their `SPREADS`, what a prediction starts
        from. Its arrivals
        come from the measured places, so that the filter does not judge itself.
    """
    states = followed.states[followed.states["row"] >= 0]
    states = states.assign(time_s=states["frame"] * frame_s)
    x, y = measured[["x", "y"]].to_numpy()[states["row"]].T
    observed = phase.observe(states.assign(x=x, y=y))
    filtered = observed.last[["particle", "time_s"]].merge(states)
    return observed._replace(last=filtered[[*BELT_LAST.names, *SPREADS]])


def summarise_deviations(deviation: Array) -> Numbers:
    """Return count, quartiles, whiskers and mean absolute value of deviations.

    Keys are those of `SUMMARY`; values are in the unit of ``deviation`` (n,). Particles
    without a prediction (NaN) are left out and counted as ``unpredicted``. The whiskers
    reach to the last value within 1.5 box lengths of the box (section 5.1): 2.7
    standard deviations from the median of a normal distribution.
    """
    predicted = deviation[np.isfinite(deviation)]
    if not len(predicted):
        raise InputError(
            "deviation: no particle has a prediction; nothing can be summarised."
        )
    q25, median, q75 = np.quantile(predicted, [0.25, 0.5, 0.75])
    reach = 1.5 * (q75 - q25)
    inside = predicted[(predicted >= q25 - reach) & (predicted <= q75 + reach)]
    return {
        "n": len(predicted),
        "median": median,
        "q25": q25,
        "q75": q75,
        "whisker_low": inside.min(),
        "whisker_high": inside.max(),
        "iqr": q75 - q25,
        "mae": np.abs(predicted).mean(),
        "unpredicted": len(deviation) - len(predicted),
    }


Deviations = Callable[[Observed, PredictionPhase, Flags], Iterator[tuple[str, Array]]]


def evaluate(
    observed: Observed,
    phase: PredictionPhase,
    deviations: Deviations,
    draws: int,
    seed: int,
) -> DataFrame:
    """Compare all models on one bulk material, one row per draw and model.

    The paper calibrates with "at most 1 % of all particles available (37 to 44)", drawn
    once. Here the draw is repeated, which separates its effect from the models'. Each
    draw is evaluated on the other particles. Draw k depends on the seed and k alone, so
    more draws keep the first ones.

    Parameters
    ----------
    observed, phase
        From `PredictionPhase.observe`, and the phase itself.
    deviations
        `arrival_deviations` (ms) or `lateral_deviations` (mm).
    draws, seed
        Number and seed of the draws.

    Returns
    -------
    DataFrame
        Columns ``draw``, ``model`` and those of `SUMMARY`.

    Raises
    ------
    InputError
        If 1 % of the particles is less than one.
    """
    particles = len(observed.last)
    size = int(CALIBRATION_SHARE * particles)
    if size < 1:
        raise InputError(
            f"observed: {CALIBRATION_SHARE:.0%} of {particles} particles is less "
            "than one."
        )
    rows = []
    for draw, child in enumerate(np.random.SeedSequence(seed).spawn(draws)):
        calibration = draw_particles(particles, size, np.random.default_rng(child))
        for name, deviation in deviations(observed, phase, calibration):
            summary = summarise_deviations(deviation)
            rows.append({"draw": draw, "model": name, **summary})
    return DataFrame(rows)


def draw_particles(count: int, size: int, generator: Generator) -> Flags:
    """Return which of ``count`` particles are drawn to calibrate, ``size`` of them."""
    drawn = np.zeros(count, bool)
    drawn[generator.choice(count, size, replace=False)] = True
    return drawn


def arrival_deviations(
    observed: Observed, phase: PredictionPhase, calibration: Flags
) -> Iterator[tuple[str, Array]]:
    """Yield each arrival model's name and its deviations (n - c,) in ms.

    ``calibration`` (n,) marks the c particles that calibrate; the deviations are those
    of the others. `IV` is calibrated with all, as in the paper.
    """
    models = [(model.name, model, Straight()) for model in ARRIVAL_MODELS]
    reference = observed.arrival["time_s"].to_numpy()[~calibration]
    for name, time, _ in predictions(observed, phase, calibration, models):
        yield name, 1000.0 * (time - reference)


def lateral_deviations(
    observed: Observed, phase: PredictionPhase, calibration: Flags
) -> Iterator[tuple[str, Array]]:
    """Yield each combination's name and its deviations (n - c,) in mm (Fig. 10).

    ``calibration`` (n,) marks the c particles that calibrate; the deviations are those
    of the others.
    """
    reference = observed.arrival["y"].to_numpy()[~calibration]
    for name, _, y in predictions(observed, phase, calibration):
        yield name, y - reference


def predictions(
    observed: Observed,
    phase: PredictionPhase,
    calibration: Flags,
    combinations: Sequence[tuple[str, ArrivalModel, LateralModel]] = COMBINATIONS,
) -> Iterator[tuple[str, Array, Array]]:
    """Yield each combination's name, predicted times (s) and places y (mm).

    Both are (n - c,). ``calibration`` (n,) marks the c particles that calibrate; the
    others are predicted. A combination is its name, arrival model and lateral model.
    """
    every: Any = observed[:2]
    # Models take columns by name faster than tables.
    known: Any = [dict(table[calibration].items()) for table in every]
    others: Any = dict(observed.last[~calibration].items())
    seen_s = others["time_s"].to_numpy()
    for name, arrival, lateral in combinations:
        # The paper gives IV all particles, "the most favorable conditions".
        sample = every if isinstance(arrival, IV) else known
        fitted = arrival.calibrated(sample[0], sample[1], phase.target_mm)
        time = fitted(others, phase.target_mm)
        yield name, time, lateral.calibrated(*known)(others, time - seen_s)
