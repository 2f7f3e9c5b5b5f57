"""The eight campaigns of the thesis on the twin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
import pandas as pd

from kilnflight import kiln
from kilnflight.camera import calibrate_points
from kilnflight.checks import InputError
from kilnflight.detection import DoG
from kilnflight.detection.combination import Combination
from kilnflight.detection.wall import Cylinder, CylinderFit, InAir, crossing, distance_to_axis
from kilnflight.experiments import detection
from kilnflight.experiments.detection import BACKGROUNDS
from kilnflight.experiments.detection_methods import PASSES
from kilnflight.kiln import LONG_CHUNK, DetectionRun, KilnRun, TwinSource, Vector
from kilnflight.project.cache import CachedTable
from kilnflight.project.parallel import Workers
from kilnflight.recording.frames import Attributes
from kilnflight.twin.particles import FRACTIONS
from kilnflight.twin.scenes import PRESSURES_BAR


@dataclass(frozen=True)
class Settings:
    """What the labelled frames say about detection in a campaign, which shares none of them.

    Parameters
    ----------
    threshold
        Of DoG, grey values: the best on all labelled frames together.
    wall
        The cylinder, fitted to the wall in the first of them.
    in_air_mm
        Largest distance from its axis of what is in the air: where the Gaussians of the
        marked particles cross, and 40 mm more, as the thesis goes from 760 to 800 mm.
    """

    threshold: float
    wall: Cylinder
    in_air_mm: float

    def in_air(self, detections: pd.DataFrame) -> pd.DataFrame:
        """Return the detections that are not known to be on the wall (sections 4.1.3, 5.1.4)."""
        on_wall = InAir(self.in_air_mm).on_wall(detections[["x", "y", "z"]], self.wall)
        return detections[~on_wall].reset_index(drop=True)


def settings_from_labels(scale: str, seed: int = 0, frames: int = 0) -> Settings:
    """Return threshold, wall and limit from the five subsets; see `trial`."""
    depends_on = {"scale": scale, "seed": seed, "frames": frames}
    one = CachedTable("learned", partial(_learn, scale, seed, frames), depends_on)().iloc[0]
    centre, direction = (
        (float(one[f"{name}_x"]), float(one[f"{name}_y"]), float(one[f"{name}_z"]))
        for name in ("centre", "direction")
    )
    wall = Cylinder(centre, direction, float(one["radius_mm"]))
    return Settings(float(one["threshold"]), wall, float(one["in_air_mm"]))


def _learn(scale: str, seed: int, frames: int) -> pd.DataFrame:
    subsets = detection.labelled_subsets(scale, seed, frames)
    tried = detection.sum_counts(detection.compare_thresholds(subsets, scale), ["threshold"])
    threshold = float(tried["threshold"].to_numpy()[int(np.argmax(tried["f1"]))])
    first = subsets[0].recording.frame(subsets[0].wanted[0])
    points = calibrate_points(first.xyz)
    labels = PASSES["DBSCAN"][0](points)
    on_wall = labels == np.bincount(labels[labels >= 0]).argmax()
    wall = CylinderFit()(points[on_wall], seed)
    marked = [detection.positions(one, Combination(DoG(threshold)))[0] for one in subsets]
    known = pd.concat(marked).dropna(subset="z")
    far = distance_to_axis(known[["x", "y", "z"]], wall)
    flying = (known["label"] != 4).to_numpy()
    place = {f"centre_{axis}": value for axis, value in zip("xyz", wall.centre_mm, strict=True)}
    place |= {f"direction_{axis}": v for axis, v in zip("xyz", wall.direction, strict=True)}
    limit = crossing(far[flying], far[~flying]) + 40.0
    row = {"threshold": threshold, **place, "radius_mm": wall.radius_mm, "in_air_mm": limit}
    return pd.DataFrame([row])


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
    scale: str, learned: Settings, seed: int = 0, scenario: str = "base"
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
    fraction: str, bar: float, scale: str, learned: Settings, seed: int, scenario: str
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


class Measurement(NamedTuple):
    """The tables of all campaigns, each with ``fraction`` and ``pressure_bar`` in front."""

    tracks: pd.DataFrame
    trajectories: pd.DataFrame
    flights: pd.DataFrame
    slices: pd.DataFrame


def measure(wanted: Sequence[Campaign], workers: Workers | None = None) -> Measurement:
    """Return what the measurement finds in the campaigns, made where it is not there.

    ``particle`` tells particles of one campaign apart, not of all.
    """
    kiln.make_tables([one.run for one in wanted], workers)
    return Measurement(*(_together(step, wanted) for step in Measurement._fields))


def _together(step: str, wanted: Sequence[Campaign]) -> pd.DataFrame:
    parts = []
    for one in wanted:
        table = one.run.table(step)()
        table.insert(0, "fraction", one.fraction)
        table.insert(1, "pressure_bar", one.pressure_bar)
        parts.append(table)
    return pd.concat(parts, ignore_index=True)
