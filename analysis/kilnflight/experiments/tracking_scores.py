"""Scores of tracks in two readings: all tracks, and those from the lance (Fig. 4.21).

The thesis marks trajectories "that originate from the lance and continue for some time"
(section 5.2.1) and keeps those "starting from the lance" (section 4.2.5). Neither place nor time
is printed. `FromLance` is that restriction, for true and for tracked trajectories alike, with and
without post-processing: a false track elsewhere is no mistake, nor may it stand in for a flight.

Section 4.2.5 names the restriction at the end of post-processing, and Table 5.17's upper values
are the "direct tracking outcomes" (section 5.2.3). Read so, tracks without post-processing are
not restricted, while the truth is. This third reading stands beside the other two.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight import tracklets
from kilnflight.checks import InputError, check_columns, check_count, check_positive
from kilnflight.scores import score_tracks
from kilnflight.scores.intervals import Interval, TrackBootstrap
from kilnflight.scores.tracks import TrackScore

# The bare epsilon of Table 5.16, 10 px; Eq. 5.1 is the only place with a bare epsilon.
GATE_PX = 10.0
MEASURES = ("alpha", "beta", "jsc", "jsc_theta")
ALL, FROM_LANCE = "all", "from the lance"
AFTERWARDS = "from the lance, direct outcomes whole"  # the third reading
READINGS = (ALL, FROM_LANCE)  # the two that are reported everywhere
STAGES = ("without", "with")  # post-processing
KEYS = ["fraction", "tracker", "postprocessing", "reading"]
MEAN = "mean of fractions"
FEW = "fewer than six trajectories"  # of `TrackBootstrap.least`


class Lance(NamedTuple):
    """Where the outlet of the lance is: in the picture (px), and its depth (mm)."""

    row: float
    col: float
    depth_mm: float


@dataclass(frozen=True)
class FromLance:
    """Keep the tracks that start from the lance and continue for some time (sec. 5.2.1).

    A track starts at the lance if the median of its first positions is near the exit in the
    picture, and near it in depth where their depth is known. It continues if its last frame is
    late enough after its first one.

    Notes
    -----
    A rule of the picture: what Table 5.17 scores has no fit, and some of it no depth. Flights are
    judged in space, by their fit (`kilnflight.flight.StartsAtLance`).

    All four numbers are ours; they were fixed before any track was scored with them. Particles are
    faint at first, so that tracks start some frames after the exit (section 4.3), and the marked
    ones do "not start exactly from the lance" (section 5.2.1). Depth: one slice of Eq. 5.8, as of
    `kilnflight.flight`. Picture: a jet widens by about 0.2 mm per mm, so in that slice by 200 mm.
    That is more than 200 px at the lance, in a picture of 1536 x 2048. Time: two pieces of one
    trajectory are at most 15 frames apart (t_epsilon,CONNECT, Table 5.16); what is shorter than
    such a gap is a piece.
    """

    within_px: float = 200.0  # in the picture, from the exit; ours
    within_mm: float = 1000.0  # in depth, one slice of Eq. 5.8; ours
    points: int = 3  # first positions, whose median bears one that is wrong; ours
    frames: int = 15  # at least, from first to last; ours, from Table 5.16

    def __post_init__(self) -> None:
        """Refuse what is no distance and no number."""
        check_positive(self.within_px, "FromLance: within_px")
        check_positive(self.within_mm, "FromLance: within_mm")
        check_count(self.points, "FromLance: points")
        check_count(self.frames, "FromLance: frames")

    def __call__(self, tracks: pd.DataFrame, lance: Lance) -> pd.DataFrame:
        """Return the rows of such tracks, in the order they came; none is no error.

        Parameters
        ----------
        tracks
            ``frame``, ``particle``, ``row``, ``col``; ``z`` in mm, NaN where there is no depth.
        lance
            Outlet of the lance; without a number the picture cannot be judged.
        """
        check_columns(tracks, ["frame", "particle", "row", "col", "z"], "FromLance: tracks")
        if not np.isfinite(lance).all():
            raise InputError(f"FromLance: the lance is at {lance}. Give its row, column and depth.")
        kept = tracklets.tracked(tracks)
        first = kept.sort_values(["particle", "frame"]).groupby("particle").head(self.points)
        off = pd.DataFrame(
            {
                "px": np.hypot(first["row"] - lance.row, first["col"] - lance.col),
                "mm": (first["z"] - lance.depth_mm).abs(),
            }
        )
        start = off.groupby(first["particle"]).median()
        frames = kept.groupby("particle")["frame"].agg(["min", "max"])
        near = (start["px"] <= self.within_px) & ~(start["mm"] > self.within_mm)
        long = frames["max"] - frames["min"] + 1 >= self.frames
        return kept[kept["particle"].isin(start.index[near & long])]


def in_reading(
    reading: str,
    truth: pd.DataFrame,
    tracks: pd.DataFrame,
    lance: Lance | None,
    stage: str = "with",
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return truth and tracks of a stage as a reading has them, by the same rule."""
    if reading == ALL:
        return truth, tracks
    if reading not in (FROM_LANCE, AFTERWARDS):
        raise InputError(f"no reading {reading!r}; there are {ALL}, {FROM_LANCE}, {AFTERWARDS}.")
    if lance is None:
        raise InputError("in_reading: the window has no lance. Give its row, col and depth.")
    rule = FromLance()
    whole = reading == AFTERWARDS and stage == "without"
    return rule(truth, lance), tracks if whole else rule(tracks, lance)


def score_reading(
    reading: str,
    truth: pd.DataFrame,
    tracks: pd.DataFrame,
    lance: Lance | None,
    stage: str = "with",
) -> TrackScore | None:
    """Return the score of tracks in a reading; None if it leaves no true trajectory.

    No track that starts from the lance is a normal case: all measures are 0.
    """
    true, other = in_reading(reading, truth, tracks, lance, stage)
    return score_tracks(true, other, GATE_PX) if len(true) else None


def measures_of(score: TrackScore | None) -> dict[str, float]:
    """Return the four measures, JSC in its narrower wording, and counts of tracks.

    The narrower wording is the thesis's. Without a true trajectory all are NaN.
    """
    names = (*MEASURES, "jsc_spurious_only", "tp_tracks", "fn_tracks", "fp_tracks")
    return {name: np.nan if score is None else float(getattr(score, name)) for name in names}


def measure_tracks(truth: pd.DataFrame, tracks: pd.DataFrame) -> dict[str, float]:
    """Return `measures_of` all tracks."""
    return measures_of(score_reading(ALL, truth, tracks, None))


class Scored(NamedTuple):
    """One cell of Table 5.17 with what is drawn for its intervals.

    Attributes
    ----------
    key
        fraction, tracker, postprocessing, reading.
    score
        None without a true trajectory.
    draws
        (draws, 4) measures, of the same true trajectories in all cells of a window; NaN without
        one.
    """

    key: tuple[str, str, str, str]
    score: TrackScore | None
    draws: npt.NDArray[np.float64]


def scored(key: tuple[str, str, str, str], score: TrackScore | None, seed: Sequence[int]) -> Scored:
    """Return a cell; ``seed`` is the window's, and what else tells its cells apart."""
    bootstrap = TrackBootstrap()
    if score is None:
        return Scored(key, score, np.full((bootstrap.draws, len(MEASURES)), np.nan))
    return Scored(key, score, bootstrap(score, seed[:1], seed))


def row_of(cell: Scored) -> dict[str, float | str]:
    """Return a cell as a row: measures, and the ends of their 95 % intervals.

    With fewer true trajectories than `TrackBootstrap.least` an interval has no ends (NaN).
    """
    row: dict[str, float | str] = dict(zip(KEYS, cell.key, strict=True))
    row |= measures_of(cell.score)
    for k, name in enumerate(MEASURES):
        interval = _interval(float(row[name]), cell.draws[:, k], [cell])
        low, high = _ends(interval, 0.0)
        row |= {f"{name}_low": low, f"{name}_high": high}
    return row


def tabulate(cells: Iterable[Scored]) -> pd.DataFrame:
    """Return cells as a table of `row_of`."""
    return pd.DataFrame([row_of(cell) for cell in cells])


def gains(cells: Iterable[Scored], first: str) -> pd.DataFrame:
    """Return what trackers gain over one of them, by reading and fraction.

    Returns
    -------
    DataFrame
        ``tracker``, ``reading``, ``fraction`` (`MEAN`: of all), ``true_tracks``, the four
        measures, and for alpha and beta the gain over ``first`` with its 95 % interval
        (``_gain``, ``_gain_low``, ``_gain_high``; NaN: fewer than six true tracks in a window).
        Cells without a true track are left out.
    """
    by_key = {cell.key: cell for cell in cells if cell.score is not None}
    pairs: dict[tuple[str, str], list[tuple[Scored, Scored]]] = {}
    for (fraction, name, stage, reading), cell in by_key.items():
        base = by_key[fraction, first, stage, reading]
        pairs.setdefault((name, reading), []).append((cell, base))
    rows = []
    for (name, reading), whole in pairs.items():
        parts = {cell.key[0]: [(cell, base)] for cell, base in whole} | {MEAN: whole}
        for fraction, part in parts.items():
            measures = pd.DataFrame([measures_of(cell.score) for cell, _ in part])
            row: dict[str, object] = {"tracker": name, "reading": reading, "fraction": fraction}
            row["true_tracks"] = int(measures[["tp_tracks", "fn_tracks"]].to_numpy().sum())
            row |= measures[list(MEASURES)].mean()
            for measure in ("alpha", "beta"):
                gain = mean_difference(part, [measure])
                values = gain.estimate, *_ends(gain, -1.0)
                for end, value in zip(("", "_low", "_high"), values, strict=True):
                    row[f"{measure}_gain{end}"] = float(value)
            rows.append(row)
    return pd.DataFrame(rows)


def mean_difference(pairs: Sequence[tuple[Scored, Scored]], measures: Sequence[str]) -> Interval:
    """Return the mean over pairs of cells, and over measures, of first minus second.

    Cells of one window are drawn together, so that their difference is paired.
    """
    columns = [MEASURES.index(name) for name in measures]
    values, estimates = [], []
    for first, second in pairs:
        values.append((first.draws - second.draws)[:, columns].mean(axis=1))
        one, other = measures_of(first.score), measures_of(second.score)
        estimates.append(np.mean([one[name] - other[name] for name in measures]))
    cells = [cell for pair in pairs for cell in pair]
    return _interval(float(np.mean(estimates)), np.mean(values, axis=0), cells)


def _ends(interval: Interval, least: float) -> tuple[float, float]:
    """Return the ends of an interval, from ``least`` to 1; NaN where the sample is too small."""
    low, high = np.clip([interval.low, interval.high], least, 1.0)
    return (float(low), float(high)) if np.isfinite(interval.low) else (np.nan, np.nan)


def _interval(
    estimate: float, values: npt.NDArray[np.float64], cells: Sequence[Scored]
) -> Interval:
    """Return the interval of a value of some cells; without any truth it is unknown."""
    numbers = tuple(0 if c.score is None else len(c.score.true_tracks) for c in cells)
    return TrackBootstrap().interval(estimate, values, numbers)
