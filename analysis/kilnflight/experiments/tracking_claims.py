"""Tables 5.15 and 5.17 beside the print, and the claims of section 5.2.3.

A claim is judged in the reading "from the lance" (Fig. 4.21); what other readings would give is in
the verdict's note. JPDA's gate is smaller than GNN's (section 5.2.3); where JPDA in its best
setting with any gate would get another verdict, the claim is not decidable. The thesis prints no
intervals. Ours are by bootstrap over tracks (`kilnflight.scores.intervals.TrackBootstrap`). A
condition that fails, but whose interval holds both outcomes, is open: then the claim is not
decidable.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np
import pandas as pd

from kilnflight.experiments.plots import SYMBOLS
from kilnflight.experiments.tracking import Window, true_particles
from kilnflight.experiments.tracking_scores import (
    AFTERWARDS,
    ALL,
    FEW,
    FROM_LANCE,
    KEYS,
    MEASURES,
    Scored,
    in_reading,
    mean_difference,
    row_of,
)
from kilnflight.experiments.tuning import ANY_GATE
from kilnflight.project import claims
from kilnflight.scores.intervals import Interval

TRACKERS = ("GNN", "JPDA")
SINGULARS = {"Wood chips": "wood chip", "Confetti": "confetti"}
SINGULARS |= {"Paper shreds": "paper shred", "PE granules": "PE granule"}
HIGHEST = 0.43  # alpha and beta without post-processing, but for wood chips, Table 5.17
NEAR = 0.05  # of alpha and beta; "comparable" names no number, this is ours
Cells = Mapping[tuple[str, str, str, str], Scored]
Conditions = dict[str, bool | None]
OTHERS = (ALL, AFTERWARDS)  # readings that a verdict's note tells


def window_table(windows: Sequence[Window]) -> pd.DataFrame:
    """Return frames, trajectories, positions and detections of windows.

    Beside Table 5.15.
    """
    printed = claims.published("table_5.15")
    amount = printed["amount_of_trajectories"].set_axis(printed["fraction"].str.lower())
    rows = [
        {
            "fraction": window.fraction,
            "first_frame": window.frames.start,
            "frames": len(window.frames),
            "trajectories": window.truth["particle"].nunique(),
            "trajectories_from_lance": from_lance["particle"].nunique(),
            "positions": len(window.truth),
            "detections": len(window.detections),
            "of_no_particle": (true_particles(window.detections, window.truth) < 0).sum(),
            "trajectories_published": amount[window.fraction.lower()],
        }
        for window in windows
        for from_lance in in_reading(FROM_LANCE, window.truth, window.truth, window.lance)[:1]
    ]
    return pd.DataFrame(rows)


def with_table_5_17(measured: pd.DataFrame) -> pd.DataFrame:
    """Return measures of `tracking_scores.tabulate` with the published ones, ``*_published``."""
    wide = _printed().pivot(index=KEYS[:3], columns="measure", values="published")
    return measured.merge(wide.add_suffix("_published").reset_index(), how="left")


def _printed() -> pd.DataFrame:
    """Return Table 5.17 with our names: `KEYS` but the reading, ``measure``, ``published``."""
    printed = claims.published("table_5.17")
    names = {"algorithm": "tracker", "post_processing": "postprocessing", "value": "published"}
    fraction, measure = printed["fraction"].map(SINGULARS), printed["measure"].str.lower()
    return printed.assign(fraction=fraction, measure=measure).rename(columns=names)


def beside_table_5_17(measured: pd.DataFrame) -> pd.DataFrame:
    """Return measures in the reading of the print beside Table 5.17's.

    Parameters
    ----------
    measured
        Of `tracking_scores.tabulate`.

    Returns
    -------
    DataFrame
        `KEYS`, ``measure``; ``recomputed`` with ``low`` and ``high``, ``all_tracks`` (the other
        reading) and ``published``.
    """
    ends = {"recomputed": "", "low": "_low", "high": "_high"}
    values = pd.concat(
        measured[KEYS].assign(
            measure=name, **{to: measured[name + end] for to, end in ends.items()}
        )
        for name in MEASURES
    )
    cell = [*KEYS[:3], "measure"]
    whole = values[values["reading"] == ALL].rename(columns={"recomputed": "all_tracks"})
    return (
        values[values["reading"] == FROM_LANCE]
        .merge(whole[[*cell, "all_tracks"]])
        .merge(_printed()[[*cell, "published"]])
    )


def describe(beside: pd.DataFrame) -> str:
    """Return alpha after post-processing beside the print, and how many cells rise."""
    after = beside[(beside["postprocessing"] == "with") & (beside["measure"] == "alpha")]
    parts = []
    for fraction, rows in after.groupby("fraction", sort=False):
        values = [f"{row.recomputed:.2f} ({row.published:.2f})" for row in rows.itertuples()]
        name = str(fraction)
        parts.append(f"{name[0].upper()}{name[1:]}: {' and '.join(values)}.")
    place = ["fraction", "tracker", "measure"]
    wide = beside.pivot(index=place, columns="postprocessing")
    rises = [
        f"{(wide[values]['with'] > wide[values]['without']).sum()} ({reading})"
        for values, reading in (("recomputed", FROM_LANCE), ("all_tracks", ALL))
    ]
    return (
        f"Alpha of tracks from the lance after post-processing, {' and '.join(TRACKERS)} "
        f"(published). {' '.join(parts)} Of {len(wide)} cells rise {', '.join(rises)}."
    )


def describe_windows(table: pd.DataFrame) -> str:
    """Return how many detections of a `window_table` belong to no particle, by fraction."""
    parts = [
        f"{row.fraction} {row.of_no_particle} of {row.detections}" for row in table.itertuples()
    ]
    return f"Detections of no particle: {', '.join(parts)}."


def verdicts(cells: Cells) -> list[claims.Verdict]:
    """Return the verdicts on the claims of section 5.2.3, "from the lance".

    Parameters
    ----------
    cells
        By `Scored.key`, in all readings.
    """
    judged = [
        claims.undecidable(
            "track-6",
            "the sentence is about the thesis's program, which weighs joint events; ours computes "
            "the same probabilities otherwise, and its times decide nothing",
            because="criterion",
        )
    ]
    known = {key[0] for key, cell in cells.items() if cell.score is not None}
    if len(known) < len(SINGULARS) or not all(cell.score for cell in cells.values()):
        reason = "this run has no true trajectories from the lance in some of four fractions"
        return judged + [claims.undecidable(name, reason, because="chain") for name in TESTS]
    chosen, any_gate = _with_jpda(cells, "JPDA"), _with_jpda(cells, ANY_GATE)
    for name, (test, because) in TESTS.items():
        others = {read: claims.judge(name, test(chosen, read), because=because) for read in OTHERS}
        free = claims.judge(name, test(any_gate, FROM_LANCE), because=because)
        told = [f"{read}: {one.verdict}" for read, one in others.items()]
        note = f"from the lance; {'; '.join(told)}"
        verdict = claims.judge(name, test(chosen, FROM_LANCE), note=note, because=because)
        judged.append(claims.in_both_readings(verdict, free, "JPDA with any gate"))
    return judged


def _with_jpda(cells: Cells, name: str) -> Cells:
    """Return the cells of GNN and of one JPDA, as "JPDA"."""
    trackers = {"GNN": "GNN", name: "JPDA"}
    return {
        (fraction, trackers[tracker], stage, reading): cell
        for (fraction, tracker, stage, reading), cell in cells.items()
        if tracker in trackers
    }


def _state(interval: Interval, least: float = 0.0) -> bool | None:
    """Return whether a value is above a limit; None if not, but its interval allows it."""
    return True if interval.estimate > least else None if interval.high > least else False


def _words(interval: Interval) -> str:
    """Return a difference with the ends of its interval, if there are enough for one."""
    if not np.isfinite(interval.low):
        return f"{interval.estimate:+.2f} [{FEW}]"
    return f"{interval.estimate:+.2f} [{interval.low:+.2f}, {interval.high:+.2f}]"


def _worst(states: Iterable[bool | None]) -> bool | None:
    """Return False if any is, else None if any is, else True."""
    found = list(states)
    return False if False in found else None if None in found else True


def _rises(cells: Cells, reading: str) -> Conditions:
    """Return whether post-processing raises all measures (track-1)."""
    rises = {
        f"{fraction} {tracker} {SYMBOLS[name]}": mean_difference(
            [(cell, cells[fraction, tracker, "without", reading])], [name]
        )
        for (fraction, tracker, stage, read), cell in cells.items()
        for name in MEASURES
        if (stage, read) == ("with", reading)
    }
    states = {name: _state(interval) for name, interval in rises.items()}
    falls = [f"{name} {_words(rises[name])}" for name, state in states.items() if not state]
    beyond = sum(interval.low > 0 for interval in rises.values())
    text = f"{len(rises) - len(falls)} of {len(rises)} cells rise, {beyond} beyond their interval"
    return {f"{text}; not {', '.join(falls)}" if falls else text: _worst(states.values())}


def _low_before(cells: Cells, reading: str) -> Conditions:
    """Return whether alpha and beta are low but for wood chips, without steps (track-2)."""
    before = {key: cell for key, cell in cells.items() if key[2:] == ("without", reading)}
    chips = {key[1]: cell for key, cell in before.items() if key[0] == "wood chip"}
    low, apart = {}, {}
    for key, cell in before.items():
        if key[0] == "wood chip":
            continue
        row = row_of(cell)
        for name in ("alpha", "beta"):
            value, least = float(row[name]), float(row[f"{name}_low"])  # NaN: too few to say
            low[value] = True if value <= HIGHEST else False if least > HIGHEST else None
            apart[key[0], key[1], name] = mean_difference([(chips[key[1]], cell)], [name])
    smallest = min(apart, key=lambda key: apart[key].estimate)
    name = f"wood chip - {', '.join(smallest)} {_words(apart[smallest])}"
    return {
        f"{name}, the smallest, > 0": _worst(_state(interval) for interval in apart.values()),
        f"others at most {max(low):.2f} <= {HIGHEST}": _worst(low.values()),
    }


def _comparable(cells: Cells, reading: str) -> Conditions:
    """Return whether GNN and JPDA are comparable in alpha and beta (track-3).

    The limit `NEAR` is ours: within half of it they are, beyond twice of it they are not.
    """
    conditions: Conditions = {}
    for gnn, jpda in _both(cells, reading):
        for name in ("alpha", "beta"):
            apart = mean_difference([(jpda, gnn)], [name])
            far = apart.low > 2 * NEAR or apart.high < -2 * NEAR
            near = abs(apart.estimate) <= NEAR / 2
            conditions[f"{gnn.key[0]} {name} {_words(apart)}"] = (
                True if near else False if far else None
            )
    return conditions


def _advantage(cells: Cells, reading: str) -> Conditions:
    """Return whether JPDA is ahead in alpha, beta and JSC on average (track-4)."""
    pairs = [(jpda, gnn) for gnn, jpda in _both(cells, reading)]
    apart = mean_difference(pairs, ["alpha", "beta", "jsc"])
    ahead = True if apart.low > 0 else False if apart.high < 0 else None
    return {f"JPDA - GNN {_words(apart)} > 0": ahead}


def _ranks(cells: Cells, reading: str) -> Conditions:
    """Return whether confetti has the lowest alpha, wood chips the highest (track-5)."""
    after = {pair[0].key[0]: pair for pair in _both(cells, reading)}
    conditions: Conditions = {}
    for fraction in after:
        for more, less in (("wood chip", fraction), (fraction, "confetti")):
            if more != less:
                pairs = list(zip(after[more], after[less], strict=True))
                apart = mean_difference(pairs, ["alpha"])
                conditions[f"{more} - {less} {_words(apart)} > 0"] = _state(apart)
    return conditions


def _both(cells: Cells, reading: str) -> list[tuple[Scored, Scored]]:
    """Return GNN and JPDA with post-processing, by fraction."""
    fractions = dict.fromkeys(key[0] for key in cells)
    return [
        (cells[name, "GNN", "with", reading], cells[name, "JPDA", "with", reading])
        for name in fractions
    ]


# By claim: its test, and why it fails if it does. Ranks and levels are those of the twin's
# pictures; what a tracker does to them is a matter of the method.
TESTS: dict[str, tuple[Callable[[Cells, str], Conditions], str]] = {
    "track-1": (_rises, "method"),
    "track-2": (_low_before, "twin"),
    "track-3": (_comparable, "method"),
    "track-4": (_advantage, "method"),
    "track-5": (_ranks, "twin"),
}
