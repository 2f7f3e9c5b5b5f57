"""Scores of tracks from the lance, with intervals and paired differences (Table 5.17).

The thesis marks trajectories "that originate from the lance and continue for some time"
(section 5.2.1) and keeps those "starting from the lance" (section 4.2.5). Neither place
nor time is printed. `from_lance` restricts true and tracked trajectories alike, with
and without post-processing. "For some time" is said of the truth alone, so `lasting`
restricts nothing else: a short false track is false.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight import tracklets
from kilnflight.publication import claims
from kilnflight.scores import score_tracks
from kilnflight.scores.intervals import DRAWS, LEAST, percentiles, track_draws
from kilnflight.scores.tracks import TrackScore

# The bare epsilon of Table 5.16, 10 px; Eq. 5.1 is the only place with a bare epsilon.
GATE_PX = 10.0
MEASURES = ("alpha", "beta", "jsc", "jsc_theta")
STAGES = ("without", "with")  # post-processing
TRACKERS = ("GNN", "JPDA")
KEYS = ["fraction", "tracker", "postprocessing"]
MEAN = "mean of fractions"
BOTH = "both"  # of `difference`
# Fractions of Table 5.17, as they are called here.
SINGULARS = {"Wood chips": "wood chip", "Confetti": "confetti"}
SINGULARS |= {"Paper shreds": "paper shred", "PE granules": "PE granule"}

# What counts as a start at the lance; no work prints it. Particles are faint at first,
# so tracks start some frames after the exit (section 4.3). Depth: one slice of Eq. 5.8.
# Picture: a jet widens by about 0.2 mm per mm, in that slice by 200 mm, more than 200
# px at the lance. Time: two pieces of one trajectory are at most 15 frames apart
# (t_epsilon,CONNECT, Table 5.16).
WITHIN_PX = 200.0
WITHIN_MM = 1000.0  # of the exit, in the picture and in depth
FIRST = 3  # positions, whose median is robust against one that is wrong
LEAST_FRAMES = 15  # of a true trajectory, from first to last

Key = tuple[str, ...]  # of `KEYS`


class Lance(NamedTuple):
    """The outlet of the lance in the picture (row, col in px), and its depth (mm)."""

    row: float
    col: float
    depth_mm: float


def from_lance(tracks: pd.DataFrame, lance: Lance) -> pd.DataFrame:
    """Return the rows of tracks that start at the lance.

    The median of the first `FIRST` positions must be within `WITHIN_PX` of the outlet,
    and within `WITHIN_MM` of its depth if that is known.

    Parameters
    ----------
    tracks
        ``frame``, ``particle`` (-1: in no track), ``row``, ``col``; ``z`` in mm, NaN
        without depth.
    lance
        Outlet of the lance.

    Notes
    -----
    This is a rule of the picture: tracks of Table 5.17 have no fit, and some no depth.
    Flights are judged in space, by their fit
    (`kilnflight.flight.criteria.starts_at_lance`).
    """
    kept = tracklets.tracked(tracks)
    first = kept.sort_values(["particle", "frame"]).groupby("particle").head(FIRST)
    px = np.hypot(first["row"] - lance.row, first["col"] - lance.col)
    off = pd.DataFrame({"px": px, "mm": (first["z"] - lance.depth_mm).abs()})
    start = off.groupby(first["particle"]).median()
    near = (start["px"] <= WITHIN_PX) & ~(start["mm"] > WITHIN_MM)
    return kept[kept["particle"].isin(start.index[near])]


def lasting(tracks: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of tracks that last `LEAST_FRAMES` frames, from first to last."""
    kept = tracklets.tracked(tracks)
    frames = kept.groupby("particle")["frame"]
    return kept[frames.transform("max") - frames.transform("min") + 1 >= LEAST_FRAMES]


def true_from_lance(truth: pd.DataFrame, lance: Lance) -> pd.DataFrame:
    """Return the rows of true trajectories that are scored: from the lance, and
    lasting.
    """
    return lasting(from_lance(truth, lance))


def score_from_lance(
    truth: pd.DataFrame, tracks: pd.DataFrame, lance: Lance
) -> TrackScore | None:
    """Return the score of tracks from the lance; None without a true trajectory from
    there.
    """
    true = true_from_lance(truth, lance)
    if true.empty:
        return None
    return score_tracks(true, from_lance(tracks, lance), GATE_PX, bridged=False)


def measures_of(score: TrackScore | None) -> dict[str, float]:
    """Return the four measures and counts of tracks; NaN if ``score`` is None."""
    names = (*MEASURES, "tp_tracks", "fn_tracks", "fp_tracks")
    return {
        name: np.nan if score is None else float(getattr(score, name)) for name in names
    }


class Scored(NamedTuple):
    """A cell of Table 5.17 with bootstrap draws of its measures.

    Attributes
    ----------
    key
        Fraction, tracker, "with" or "without" post-processing.
    score
        None without a true trajectory from the lance.
    draws
        (DRAWS, 4) draws of `MEASURES`. Draw k takes the same true trajectories in all
        cells of a window, so differences of cells are paired.
    """

    key: Key
    score: TrackScore | None
    draws: npt.NDArray[np.float64]


def score_cell(
    key: Key,
    truth: pd.DataFrame,
    tracks: pd.DataFrame,
    lance: Lance,
    seed: Sequence[int],
) -> Scored:
    """Return the scored cell of a window's tracks from the lance.

    Parameters
    ----------
    key
        Fraction, tracker, "with" or "without".
    truth, tracks
        True and measured tracks of the window, also those not from the lance.
    lance
        Its outlet.
    seed
        Seed of the bootstrap. Its first number must be the same in all cells of a
        window: it draws the true trajectories. The whole draws the false tracks.
    """
    score = score_from_lance(truth, tracks, lance)
    if score is None:
        return Scored(key, None, np.full((DRAWS, len(MEASURES)), np.nan))
    return Scored(key, score, track_draws(score, seed[:1], seed))


def tabulate(cells: Iterable[Scored]) -> pd.DataFrame:
    """Return the measures as Table 5.17, one row per cell, with 95 % intervals.

    Returns
    -------
    DataFrame
        `KEYS`; `MEASURES` and the numbers ``tp_tracks``, ``fn_tracks``, ``fp_tracks``;
        ``_low`` and ``_high`` of each measure, NaN with fewer than `LEAST` true
        trajectories.
    """
    rows = []
    for cell in cells:
        row = dict(zip(KEYS, cell.key, strict=True)) | measures_of(cell.score)
        for k, name in enumerate(MEASURES):
            low, high = _ends(cell.draws[:, k], [cell], 0.0)
            row |= {f"{name}_low": low, f"{name}_high": high}
        rows.append(row)
    return pd.DataFrame(rows)


def published() -> pd.DataFrame:
    """Return Table 5.17, one row per value: `KEYS`, ``measure``, ``published``."""
    table = claims.published("table_5.17")
    names = {
        "algorithm": "tracker",
        "post_processing": "postprocessing",
        "value": "published",
    }
    table = table.assign(fraction=table["fraction"].map(SINGULARS)).rename(
        columns=names
    )
    return table.assign(measure=table["measure"].str.lower())[
        [*KEYS, "measure", "published"]
    ]


def beside_published(measured: pd.DataFrame) -> pd.DataFrame:
    """Return the values of `tabulate`, one per row, beside those of Table 5.17.

    The columns are `KEYS`, ``measure``, ``recomputed``, ``low``, ``high`` and
    ``published``. Values that are not printed are left out.
    """
    ends = {"recomputed": "", "low": "_low", "high": "_high"}
    parts = [
        measured[KEYS].assign(
            measure=name, **{to: measured[name + end] for to, end in ends.items()}
        )
        for name in MEASURES
    ]
    return pd.concat(parts).merge(published())


def difference(
    cells: Mapping[Key, Scored], key: Key, measures: str
) -> dict[str, object]:
    """Return a paired difference with its 95 % interval, and the printed one.

    Parameters
    ----------
    cells
        Scored cells by key.
    key
        Fraction, tracker, stage. One entry may be "A - B", the difference of the two.
        `MEAN` averages over the fractions, `BOTH` over the trackers.
    measures
        Names joined by ", "; their mean is compared.

    Returns
    -------
    dict
        `KEYS`, ``measure``, ``recomputed``, ``low`` and ``high`` (NaN with fewer than
        `LEAST` true trajectories in a cell), ``published``.
    """
    every = {MEAN: dict.fromkeys(each[0] for each in cells), BOTH: TRACKERS}
    names = product(*(every.get(entry, [entry]) for entry in key))
    sides = [
        [tuple(part.split(" - ")[k] for part in name) for k in (0, -1)]
        for name in names
    ]
    chosen = measures.split(", ")
    nothing = dict.fromkeys(MEASURES, np.nan)

    def mean(table: Mapping[Any, Any]) -> float:
        of = [[table.get(side, nothing) for side in pair] for pair in sides]
        return float(
            np.mean([one[name] - two[name] for one, two in of for name in chosen])
        )

    estimate = mean({name: measures_of(cell.score) for name, cell in cells.items()})
    printed = mean(
        published().pivot(index=KEYS, columns="measure", values="published").T.to_dict()
    )
    pairs = [(cells[first], cells[second]) for first, second in sides]
    columns = [MEASURES.index(name) for name in chosen]
    draws = np.mean(
        [(a.draws - b.draws)[:, columns].mean(axis=1) for a, b in pairs], axis=0
    )
    low, high = _ends(draws, [cell for pair in pairs for cell in pair], -1.0)
    row = {
        **dict(zip(KEYS, key, strict=True)),
        "measure": measures,
        "recomputed": estimate,
    }
    return row | {"low": low, "high": high, "published": printed}


def differences(cells: Mapping[Key, Scored]) -> pd.DataFrame:
    """Return the differences that section 5.2.3 claims, by ``claim``.

    ``cells`` must hold the paper shreds of both trackers "with" post-processing. The
    false tracks of paper shreds (track-10) are counts; their interval assumes Poisson's
    law.

    Returns
    -------
    DataFrame
        ``claim`` (id) and the entries of `difference`, one row each.
    """
    fractions = list(dict.fromkeys(key[0] for key in cells))
    chips = [f"wood chip - {name}" for name in fractions if name != "wood chip"]
    confetti = [f"{name} - confetti" for name in ("paper shred", "PE granule")]
    ranks = chips + confetti * ("confetti" in fractions)
    two = ("alpha", "beta")
    trackers = ["JPDA - GNN"]
    kinds: list[tuple[str, Sequence[str], Sequence[str], str, Sequence[str]]] = [
        ("track-1", fractions, TRACKERS, "with - without", MEASURES),
        ("track-2", chips, TRACKERS, "without", two),
        ("track-3", fractions, trackers, "with", two),
        ("track-4", [MEAN], trackers, "with", ["alpha, beta, jsc"]),
        ("track-5", ranks, [BOTH], "with", ["alpha"]),
        ("track-9", [MEAN], [BOTH], "with - without", ["alpha, beta"]),
    ]
    rows = [
        {"claim": claim, **difference(cells, (fraction, tracker, stage), measures)}
        for claim, some, by, stage, each in kinds
        for fraction, tracker, measures in product(some, by, each)
    ]
    gnn, jpda = (
        measures_of(cells["paper shred", t, "with"].score)["fp_tracks"]
        for t in TRACKERS
    )
    key = ("track-10", "paper shred", *trackers, "with")
    half = 1.96 * np.sqrt(gnn + jpda)
    row = dict(zip(["claim", *KEYS], key, strict=True)) | {"measure": "false tracks"}
    ends = {"low": jpda - gnn - half, "high": jpda - gnn + half}
    return pd.DataFrame([*rows, row | {"recomputed": jpda - gnn, **ends}])


def _ends(
    draws: npt.NDArray[np.float64], cells: Sequence[Scored], least: float
) -> tuple[float, float]:
    """Return the ends of the 95 % interval of draws (DRAWS,), within ``least`` and 1.

    They are NaN if any of the cells has fewer than `LEAST` true trajectories. ``least``
    is 0 for measures and -1 for differences.
    """
    if min(0 if c.score is None else len(c.score.true_tracks) for c in cells) < LEAST:
        return np.nan, np.nan
    low, high = np.clip(percentiles(draws), least, 1.0)
    return float(low), float(high)
