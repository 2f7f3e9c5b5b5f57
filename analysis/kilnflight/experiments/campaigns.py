"""The thesis's eight campaigns on the twin: four fractions at 4.5 and 5 bar, whole or in part.

The threshold, the wall and the limit in the air come from the labelled frames
(`lessons`); the lance's outlet is known of every recording. No table of a campaign
is made with its truth. Nothing is taken for alight when first seen: the thesis prints no grey
value from which on a particle burns (`kilnflight.ignition.Ignition.bright`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import pandas as pd

from kilnflight import kiln
from kilnflight.camera import calibrate_points
from kilnflight.checks import InputError
from kilnflight.detection import DoG
from kilnflight.detection.combination import Combination
from kilnflight.detection.wall import InAir
from kilnflight.experiments.lessons import Learned
from kilnflight.experiments.trial import BACKGROUNDS
from kilnflight.kiln import LONG_CHUNK, DetectionRun, KilnRun, TwinSource, Vector
from kilnflight.project.parallel import Workers
from kilnflight.recording.frames import Attributes
from kilnflight.twin.fractions import FRACTIONS
from kilnflight.twin.outcomes import PRESSURES_BAR

# First frame and number of frames by scale; 0: all. The kiln is empty at first, and a flight
# lasts 100 to 165 frames.
FRAMES = {"quick": (100, 24), "standard": (100, 250), "full": (0, 0)}
FEWER = (("wood chip", 4.5), ("paper shred", 4.5))  # of a smoke run


class Campaign(NamedTuple):
    """A recording of the twin, and how its particles are found."""

    fraction: str
    pressure_bar: float
    run: KilnRun

    @property
    def frames(self) -> range:
        """The frames that are looked at."""
        return self.run.frames


def campaigns(
    scale: str, learned: Learned, seed: int = 0, scenario: str = "base"
) -> list[Campaign]:
    """Return the campaigns of a scale; nothing is made yet.

    Parameters
    ----------
    scale
        "quick" (two campaigns, 24 frames each), "standard" (250 frames of each) or "full".
    learned
        Threshold, wall and limit.
    seed
        Of the scenes.
    scenario
        One of `kilnflight.twin.scenes.SCENARIOS`.
    """
    if scale not in FRAMES:
        raise InputError(f"campaigns: no scale {scale!r}; there are {', '.join(FRAMES)}.")
    cells = [(fraction, bar) for fraction in FRACTIONS for bar in PRESSURES_BAR]
    return [
        _campaign(fraction, bar, scale, learned, seed, scenario)
        for fraction, bar in (FEWER if scale == "quick" else cells)
    ]


def _campaign(
    fraction: str, bar: float, scale: str, learned: Learned, seed: int, scenario: str
) -> Campaign:
    name = f"{fraction.replace(' ', '-').lower()}-{bar:.1f}-bar"
    source = TwinSource(name if scenario == "base" else f"{name}@{scenario}", seed)
    twin = source.recording()
    first, count = FRAMES[scale]
    stop = min(first + count, len(twin)) if count else len(twin)
    detector = Combination(DoG(learned.threshold))
    subtracted = BACKGROUNDS[scale]
    detection = DetectionRun(
        source, first, stop, detector, subtracted, LONG_CHUNK, differences=False
    )
    lance = exit_point(twin.attributes)
    return Campaign(
        fraction, bar, KilnRun(detection, lance, learned.wall, InAir(learned.in_air_mm))
    )


def exit_point(attributes: Attributes) -> Vector | None:
    """Return the outlet of the lance after Eq. 2.4, mm; None if it is not known."""
    if attributes.lance_mm is None:
        return None
    x, y, z = calibrate_points([attributes.lance_mm])[0].tolist()
    return x, y, z


class Measured(NamedTuple):
    """The tables of all campaigns, each with ``fraction`` and ``pressure_bar`` in front."""

    tracks: pd.DataFrame
    trajectories: pd.DataFrame
    flights: pd.DataFrame
    slices: pd.DataFrame


def measured(wanted: Sequence[Campaign], workers: Workers | None = None) -> Measured:
    """Return what the measurement finds in the campaigns, made where it is not there.

    ``particle`` tells particles of one campaign apart, not of all.
    """
    kiln.make_tables([one.run for one in wanted], workers)
    return Measured(*(_together(step, wanted) for step in Measured._fields))


def _together(step: str, wanted: Sequence[Campaign]) -> pd.DataFrame:
    parts = []
    for one in wanted:
        table = one.run.table(step)()
        table.insert(0, "fraction", one.fraction)
        table.insert(1, "pressure_bar", one.pressure_bar)
        parts.append(table)
    return pd.concat(parts, ignore_index=True)
