"""Why JPDA loses or gains against GNN: one part of it after the other exchanged.

Section 5.2.3 expects of JPDA a slight advantage, since it averages, and blames its small gate and
its covariances for what it misses. Each variant here is JPDA in its chosen setting but for one
part; the last but two is JPDA in the setting that is best with any gate. All are compared with it,
after post-processing, on the same true tracks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.figure import Figure

from kilnflight.association import GNN, JPDA, PDA, Associator, Pairs, one_hot
from kilnflight.experiments.tracking import Tracker, Window, compare, follow
from kilnflight.experiments.tracking_scores import ALL, FEW, FROM_LANCE, MEAN
from kilnflight.project import style
from kilnflight.tracking.tracker import AVERAGED, record, track

Array = npt.NDArray[np.float64]
SAME_SETTING = "GNN in JPDA's setting"
BEST_SETTING = "best setting with any gate"
Tried = partial  # of `track`, with associator, motion, gate and management


@dataclass(frozen=True)
class Clutter:
    """JPDA with the density of clutter of Eq. 4.13 times a factor."""

    factor: float
    jpda: Associator = field(default_factory=JPDA)

    def __call__(self, pairs: Pairs) -> Array:
        """Return weights (n, 1 + m)."""
        return self.jpda(pairs._replace(gate_area=np.asarray(pairs.gate_area) / self.factor))


@dataclass(frozen=True)
class Heaviest:
    """The joint probabilities of JPDA decide, but each track takes one detection alone.

    The filter is not pulled to what lies between two particles.
    """

    jpda: Associator = field(default_factory=JPDA)

    def __call__(self, pairs: Pairs) -> Array:
        """Return weights (n, 1 + m) of 0 and 1."""
        weights = self.jpda(pairs)
        taken = np.full(len(weights), -1)
        owner = record(weights)
        taken[owner[owner >= 0]] = np.flatnonzero(owner >= 0)
        return one_hot(taken, weights.shape[1] - 1)


def unaveraged(detections: pd.DataFrame, tracker: Tracker) -> pd.DataFrame:
    """Return a tracker's tracks at the heaviest detections, not at their weighted means."""
    tracks = tracker(detections)
    names = [name for name in AVERAGED if name in detections.columns]
    return tracks.assign(**{name: detections[name] for name in names})


def variants(
    jpda: Tried[pd.DataFrame], gnn: Tried[pd.DataFrame], any_gate: Tried[pd.DataFrame]
) -> dict[str, Tracker]:
    """Return JPDA, and JPDA with one part exchanged, by name; all in their chosen settings.

    What is the same for both is no variant.
    """
    parts = jpda.keywords

    def but(**changed: object) -> Tracker:
        return partial(track, **{**parts, **changed})

    names = {"gate": "gate", "motion": "noise", "management": "missed frames"}
    other = {key: gnn.keywords[key] for key in names if gnn.keywords[key] != parts[key]}
    return {
        "JPDA": jpda,
        "recorded at the heaviest detection": partial(unaveraged, tracker=jpda),
        "what is used starts tracks": but(management=replace(parts["management"], used=1.0)),
        "one detection moves the filter": but(associator=Heaviest()),
        "each track alone (PDA)": but(associator=PDA()),
        **{f"{names[key]} of GNN": but(**{key: value}) for key, value in other.items()},
        "P_D 0.7": but(associator=JPDA(detection_probability=0.7)),
        "P_D 0.99": but(associator=JPDA(detection_probability=0.99)),
        "clutter a tenth": but(associator=Clutter(0.1)),
        "clutter ten times": but(associator=Clutter(10.0)),
        BEST_SETTING: any_gate,
        SAME_SETTING: but(associator=GNN()),
        "GNN": gnn,
    }


def ablate(windows: Sequence[Window], trackers: Mapping[str, Tracker]) -> pd.DataFrame:
    """Return `tracking.compare` of trackers after post-processing, the first as reference."""

    def processed(tracker: Tracker, window: Window) -> pd.DataFrame:
        return follow(window, tracker)["with"]

    return compare(windows, {name: partial(processed, each) for name, each in trackers.items()})


def draw(table: pd.DataFrame) -> Figure:
    """Draw the gains of all variants over JPDA with their intervals, a panel per reading."""
    readings = table["reading"].unique()
    size = {"width_mm": style.PAGE_MM, "height_mm": 95}
    picture, (panels,) = style.canvas(1, len(readings), **size, sharex=True, sharey=True)
    for axes, reading in zip(panels, readings, strict=True):
        part = _means(table, reading)
        for shift, measure, face in ((-0.15, "alpha", "black"), (0.15, "beta", "white")):
            low, high = (part[f"{measure}_gain_{end}"] for end in ("low", "high"))
            gain, at = part[f"{measure}_gain"], np.arange(len(part)) + shift
            axes.plot([low, high], [at, at], "-", color="0.4", lw=0.8)
            axes.plot(gain, at, "o", color="black", mfc=face, ms=4, label=measure)
        axes.axvline(0.0, color="black", lw=0.6)
        axes.set_yticks(np.arange(len(part)), part["variant"])
        axes.set(xlabel="gain over JPDA", title=reading)
    panels[0].invert_yaxis()
    handles = panels[0].get_legend_handles_labels()
    picture.legend(*handles, loc="outside upper center", ncols=2)
    return picture


def _means(table: pd.DataFrame, reading: str) -> pd.DataFrame:
    """Return the rows of means over fractions in a reading, without JPDA's own."""
    rows = (table["reading"] == reading) & (table["fraction"] == MEAN)
    return table[rows & (table["variant"] != "JPDA")]


def describe(table: pd.DataFrame) -> str:
    """Describe in a sentence what GNN gains and which exchanged parts matter.

    Of the tracks from the lance; of all, where no true one starts there (a smoke run).
    """
    reading = FROM_LANCE if FROM_LANCE in set(table["reading"]) else ALL
    gains = _means(table, reading).set_index("variant")
    parts = gains.drop(index=["GNN", SAME_SETTING, BEST_SETTING])
    whole, same = gains.loc["GNN"], float(gains["alpha_gain"][SAME_SETTING])
    free = float(gains["alpha_gain"][BEST_SETTING])
    matter = parts[(parts["alpha_gain_low"] > 0) | (parts["alpha_gain_high"] < 0)]
    named = "; ".join(f"{name} {row['alpha_gain']:+.3f}" for name, row in matter.iterrows())
    ends = f"{whole['alpha_gain_low']:+.3f} to {whole['alpha_gain_high']:+.3f}"
    if np.isnan(whole["alpha_gain_low"]):
        ends, named = f"no interval: {FEW}", "not known"
    return (
        f"Alpha of tracks ({reading}): GNN has {whole['alpha_gain']:+.3f} against JPDA "
        f"({ends}), in JPDA's setting "
        f"{same:+.3f}. JPDA's best setting with any gate has {free:+.3f}. Exchanged alone, "
        f"these parts of JPDA change its alpha beyond the interval: {named or 'none'}."
    )
