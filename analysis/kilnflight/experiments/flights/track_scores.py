"""Scores of tracks from the lance, with intervals and paired differences (Table 5.17).

The thesis marks trajectories "that originate from the lance and continue for some time"
(section 5.2.1) and keeps those "starting from the lance" (section 4.2.5). Neither place
nor time is printed. `from_lance` restricts true and tracked trajectories alike, with
and without post-processing. "For some time" is said of the truth alone, so `lasting`
restricts nothing else: a short false track is false.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from pandas import DataFrame

from kilnflight import tracklets
from kilnflight.arrays import Array, Numbers, Texts, Two
from kilnflight.publication import claims
from kilnflight.scores import score_tracks
from kilnflight.scores.intervals import DRAWS, LEAST, percentiles, track_draws
from kilnflight.scores.tracks import TrackScore

# Epsilon without an index in Table 5.16; Eq. 5.1 alone has one.
GATE_PX = 10.0
MEASURES = ("alpha", "beta", "jsc", "jsc_theta")
STAGES = ("without", "with")  # post-processing
TRACKERS = ("GNN", "JPDA")
KEYS = ["fraction", "tracker", "postprocessing"]
# Fractions of Table 5.17, as they are called here.
SINGULARS = {
    "Wood chips": "wood chip",
    "Confetti": "confetti",
    "Paper shreds": "paper shred",
    "PE granules": "PE granule",
}

# What counts as a start at the lance; no work prints it. Particles are faint at first,
# so tracks start some frames after the exit (section 4.3). Depth: one slice of Eq. 5.8.
# Picture: a jet widens by about 0.2 mm per mm, in that slice by 200 mm, more than 200
# px at the lance.
WITHIN_PX = 200.0
WITHIN_MM = 1000.0  # depth from the exit
FIRST = 3  # positions, whose median is robust against one that is wrong
# Frames of a true trajectory, from first to last: two pieces of one are at most so far
# apart (t_epsilon,CONNECT, Table 5.16).
LEAST_FRAMES = 15

Key = tuple[str, ...]  # values of `KEYS`


class Lance(NamedTuple):
    """The outlet of the lance in the picture (row, col in px), and its depth (mm)."""

    row: float
    col: float
    depth_mm: float


def from_lance(tracks: DataFrame, lance: Lance) -> DataFrame:
    """Return the rows of tracks that start at the lance, without rows in no track.

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
    distance = DataFrame({"px": px, "mm": (first["z"] - lance.depth_mm).abs()})
    start = distance.groupby(first["particle"]).median()
    too_deep = start["mm"] > WITHIN_MM  # False for NaN
    near = (start["px"] <= WITHIN_PX) & ~too_deep
    return kept[kept["particle"].isin(start.index[near])]


def lasting(tracks: DataFrame) -> DataFrame:
    """Return the rows of tracks that last `LEAST_FRAMES` frames, from first to last."""
    kept = tracklets.tracked(tracks)
    frames = kept.groupby("particle")["frame"]
    return kept[frames.transform("max") - frames.transform("min") + 1 >= LEAST_FRAMES]


def score_from_lance(
    truth: DataFrame, tracks: DataFrame, lance: Lance
) -> TrackScore | None:
    """Return the score of tracks from the lance.

    It is None if no true trajectory starts there and lasts.
    """
    true = lasting(from_lance(truth, lance))
    if true.empty:
        return None
    return score_tracks(true, from_lance(tracks, lance), GATE_PX, bridged=False)


def measures_of(score: TrackScore | None) -> Numbers:
    """Return the four measures and counts of tracks; NaN if ``score`` is None."""
    names = (*MEASURES, "tp_tracks", "fn_tracks", "fp_tracks")
    if score is None:
        return dict.fromkeys(names, np.nan)
    return {name: float(getattr(score, name)) for name in names}


class Scored(NamedTuple):
    """A cell of Table 5.17: the tracks of a window, a tracker and a stage.

    Attributes
    ----------
    measures
        From `measures_of`, by name.
    draws
        (DRAWS, 4) bootstrap draws of `MEASURES`, NaN with fewer than `LEAST` true
        trajectories. Draw k takes the same true trajectories in all cells of a window,
        so differences of cells are paired.
    """

    measures: Numbers
    draws: Array


Cells = Mapping[Key, Scored]


def score_cell(
    truth: DataFrame, tracks: DataFrame, lance: Lance, seed: Sequence[int]
) -> Scored:
    """Return the scored cell of a window's tracks from the lance.

    Parameters
    ----------
    truth, tracks
        True and measured tracks of the window, also those not from the lance.
    lance
        Its outlet.
    seed
        Seed of the bootstrap. Its first number must be the same in all cells of a
        window: it draws the true trajectories. The whole draws the false tracks.
    """
    score = score_from_lance(truth, tracks, lance)
    draws = np.full((DRAWS, len(MEASURES)), np.nan)
    if score is not None and len(score.true_tracks) >= LEAST:
        draws = track_draws(score, seed=seed[:1], false_seed=seed)
    return Scored(measures_of(score), draws)


def _ends(draws: Array) -> Two:
    """Return the ends of an interval, NaN where a cell has too few trajectories."""
    if np.isnan(draws).any():
        return np.nan, np.nan
    low, high = percentiles(draws)
    return low, high


def tabulate(cells: Cells) -> DataFrame:
    """Return the measures as Table 5.17, one row per cell, with 95 % intervals.

    Returns
    -------
    DataFrame
        `KEYS`; `MEASURES` and the numbers ``tp_tracks``, ``fn_tracks``, ``fp_tracks``;
        ``_low`` and ``_high`` of each measure, NaN with fewer than `LEAST` true
        trajectories.
    """
    rows = []
    for key, cell in cells.items():
        row = dict(zip(KEYS, key, strict=True)) | cell.measures
        for name, draws in zip(MEASURES, cell.draws.T, strict=True):
            row[f"{name}_low"], row[f"{name}_high"] = _ends(draws)
        rows.append(row)
    return DataFrame(rows)


def published() -> DataFrame:
    """Return Table 5.17, one row per value: `KEYS`, ``measure``, ``published``."""
    table = claims.published("table_5.17")
    return DataFrame(
        {
            "fraction": table["fraction"].map(SINGULARS),
            "tracker": table["algorithm"],
            "postprocessing": table["post_processing"],
            "measure": table["measure"].str.lower(),
            "published": table["value"],
        }
    )


def beside_published(measured: DataFrame) -> DataFrame:
    """Return the values of `tabulate`, one per row, beside those of Table 5.17.

    The columns are `KEYS`, ``measure``, ``recomputed``, ``low``, ``high`` and
    ``published``. Values that are not printed are left out.
    """
    table = measured.melt(KEYS, MEASURES, "measure", "recomputed")
    for end in ("low", "high"):
        columns = [f"{name}_{end}" for name in MEASURES]
        table[end] = measured.melt(value_vars=columns)["value"]
    return table.merge(published())


class Group(NamedTuple):
    """Cells of one stage: all pairs of a fraction and a tracker."""

    fractions: Texts
    trackers: Texts = TRACKERS
    stage: str = "with"  # one of `STAGES`

    def keys(self) -> list[Key]:
        """Return the keys of the cells."""
        return list(product(self.fractions, self.trackers, [self.stage]))

    def names(self) -> Key:
        """Return what stands for the group in each column of `KEYS`."""
        fraction = self.fractions[0]
        tracker = self.trackers[0]
        if len(self.fractions) > 1:
            fraction = "mean of fractions"
        if len(self.trackers) > 1:
            tracker = "both"
        return fraction, tracker, self.stage


def difference(
    cells: Cells, first: Group, second: Group, measures: Texts
) -> dict[str, object]:
    """Return the first minus the second group with its 95 % interval, and as printed.

    Parameters
    ----------
    cells
        Scored cells by key.
    first, second
        Groups of as many cells, which are compared pair by pair.
    measures
        Some of `MEASURES`. Differences are averaged over pairs of cells and measures.

    Returns
    -------
    dict
        `KEYS`, "A - B" where the groups differ; ``measure``, ``recomputed``, ``low``
        and ``high`` (NaN with fewer than `LEAST` true trajectories in a cell),
        ``published`` (NaN if not printed).
    """
    names = []
    for one, other in zip(first.names(), second.names(), strict=True):
        names.append(one if one == other else f"{one} - {other}")

    def mean(table: DataFrame) -> float:
        values, other = (table.reindex(each.keys()) for each in (first, second))
        return np.mean(values[measures].to_numpy() - other[measures].to_numpy())

    ours = DataFrame({key: cell.measures for key, cell in cells.items()}).T
    printed = published().pivot(index=KEYS, columns="measure", values="published")
    pairs = zip(first.keys(), second.keys(), strict=True)
    draws = [cells[one].draws - cells[other].draws for one, other in pairs]
    columns = [MEASURES.index(name) for name in measures]
    low, high = _ends(np.mean(draws, axis=0)[:, columns].mean(axis=1))
    return {
        **dict(zip(KEYS, names, strict=True)),
        "measure": ", ".join(measures),
        "recomputed": mean(ours),
        "low": low,
        "high": high,
        "published": mean(printed),
    }


def contrasts(
    fractions: Texts,
) -> Iterator[tuple[str, Group, Group, list[str]]]:
    """Yield id, groups and measures of each difference that section 5.2.3 claims."""
    both = ["alpha", "beta"]
    others = [name for name in fractions if name != "wood chip"]
    for fraction, tracker, measure in product(fractions, TRACKERS, MEASURES):
        after = Group([fraction], [tracker])
        yield "track-1", after, after._replace(stage="without"), [measure]
    for other, tracker, measure in product(others, TRACKERS, both):
        chips = Group(["wood chip"], [tracker], "without")
        yield "track-2", chips, chips._replace(fractions=[other]), [measure]
    for fraction, measure in product(fractions, both):
        jpda = Group([fraction], ["JPDA"])
        yield "track-3", jpda, jpda._replace(trackers=["GNN"]), [measure]
    jpda = Group(fractions, ["JPDA"])
    yield "track-4", jpda, jpda._replace(trackers=["GNN"]), [*both, "jsc"]
    ranks = [("wood chip", other) for other in others]
    if "confetti" in fractions:
        ranks += [("paper shred", "confetti"), ("PE granule", "confetti")]
    for higher, lower in ranks:
        yield "track-5", Group([higher]), Group([lower]), ["alpha"]
    after = Group(fractions)
    yield "track-9", after, after._replace(stage="without"), both


def differences(cells: Cells) -> DataFrame:
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
    rows = [
        {"claim": claim, **difference(cells, first, second, measures)}
        for claim, first, second, measures in contrasts(fractions)
    ]
    gnn, jpda = (
        cells["paper shred", name, "with"].measures["fp_tracks"] for name in TRACKERS
    )
    half = 1.96 * np.sqrt(gnn + jpda)
    false_tracks = {
        "claim": "track-10",
        "fraction": "paper shred",
        "tracker": "JPDA - GNN",
        "postprocessing": "with",
        "measure": "false tracks",
        "recomputed": jpda - gnn,
        "low": jpda - gnn - half,
        "high": jpda - gnn + half,
    }
    return DataFrame([*rows, false_tracks])
