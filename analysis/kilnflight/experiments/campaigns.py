"""The thesis's eight campaigns on the twin: four fractions at 4.5 and 5 bar, whole or in part.

Threshold, wall and the limit of what is in the air come from the labelled frames; the outlet of
the lance is known of every recording. No table of a campaign is made with its truth. No
particle counts as burning when first detected: the thesis prints no grey value from which on a
particle burns (`kilnflight.ignition.Ignition.bright`).
"""

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
from kilnflight.detection.wall import Cylinder, CylinderFit, InAir, crossing
from kilnflight.experiments import detection, detection_methods
from kilnflight.experiments.detection import BACKGROUNDS
from kilnflight.kiln import LONG_CHUNK, DetectionRun, KilnRun, TwinSource, Vector
from kilnflight.project.cache import CachedTable
from kilnflight.project.parallel import Workers
from kilnflight.recording.frames import Attributes
from kilnflight.twin.particles import FRACTIONS
from kilnflight.twin.scenes import PRESSURES_BAR, campaign_name, open_scene


@dataclass(frozen=True)
class Settings:
    """Settings of the detection in campaigns, found on labelled frames that none of them shares.

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
    """Return threshold, wall and limit from the labelled frames of the five subsets."""
    depends_on = {"scale": scale, "seed": seed, "frames": frames}
    make = partial(_settings, scale, seed, frames)
    values = CachedTable("settings", make, depends_on)().iloc[0].tolist()
    threshold, radius, in_air, x, y, z, dx, dy, dz = map(float, values)
    return Settings(threshold, Cylinder((x, y, z), (dx, dy, dz), radius), in_air)


def _settings(scale: str, seed: int, frames: int) -> pd.DataFrame:
    """Return the settings as a table of one row: threshold, radius, limit, centre, direction."""
    subsets = detection.labelled_subsets(scale, seed, frames)
    counts = detection.sum_counts(detection.compare_thresholds(subsets, scale), ["threshold"])
    threshold = float(counts["threshold"].to_numpy()[int(np.argmax(counts["f1"]))])
    first = subsets[0].recording.frame(subsets[0].frames[0])
    wall = CylinderFit()(detection_methods.wall_points(first.xyz), seed)
    detectors = {subset.name: Combination(DoG(threshold)) for subset in subsets}
    marked, _ = detection.positions(subsets, detectors, wall)
    known = marked.dropna(subset="z")
    distance = known["distance_mm"].to_numpy()
    flying = (known["label"] != 4).to_numpy()
    limit = crossing(distance[flying], distance[~flying]) + 40.0
    row = {"threshold": threshold, "radius_mm": wall.radius_mm, "in_air_mm": limit}
    row |= {f"centre_{axis}": v for axis, v in zip("xyz", wall.centre_mm, strict=True)}
    row |= {f"direction_{axis}": v for axis, v in zip("xyz", wall.direction, strict=True)}
    return pd.DataFrame([row])


# First frame and number of frames by scale; 0: all. The kiln is empty at first, and a flight
# lasts 100 to 165 frames.
FRAMES = {"quick": (100, 24), "standard": (100, 250), "full": (0, 0)}
SMOKE_CAMPAIGNS = (("wood chip", 4.5), ("paper shred", 4.5))  # of a smoke run


class Campaign(NamedTuple):
    """A recording of the twin, and how its particles are found."""

    fraction: str
    pressure_bar: float
    run: KilnRun

    @property
    def key(self) -> tuple[str, float]:
        """Fraction and pressure."""
        return self.fraction, self.pressure_bar

    @property
    def frames(self) -> range:
        """The frames in which particles are detected."""
        return self.run.frames


def campaigns(
    scale: str, settings: Settings, seed: int = 0, scenario: str = "base"
) -> list[Campaign]:
    """Return the campaigns of a scale; nothing is made yet.

    Parameters
    ----------
    scale
        "quick" (two campaigns, 24 frames each), "standard" (250 frames of each) or "full".
    settings
        Threshold, wall and limit.
    seed
        Of the scenes.
    scenario
        One of `kilnflight.twin.scenes.SCENARIOS`.
    """
    if scale not in FRAMES:
        raise InputError(f"campaigns: no scale {scale!r}; there are {', '.join(FRAMES)}.")
    keys = [(fraction, bar) for fraction in FRACTIONS for bar in PRESSURES_BAR]
    return [
        _campaign(fraction, bar, scale, settings, seed, scenario)
        for fraction, bar in (SMOKE_CAMPAIGNS if scale == "quick" else keys)
    ]


def _campaign(
    fraction: str, bar: float, scale: str, settings: Settings, seed: int, scenario: str
) -> Campaign:
    name = campaign_name(fraction, bar)
    source = TwinSource(name if scenario == "base" else f"{name}@{scenario}", seed)
    twin = open_scene(source.name, seed)  # its flights are not worked out here
    first, count = FRAMES[scale]
    stop = min(first + count, len(twin)) if count else len(twin)
    detector = Combination(DoG(settings.threshold))
    subtracted = BACKGROUNDS[scale]
    detection = DetectionRun(
        source, first, stop, detector, subtracted, LONG_CHUNK, differences=False
    )
    lance = exit_point(twin.attributes)
    return Campaign(
        fraction, bar, KilnRun(detection, lance, settings.wall, InAir(settings.in_air_mm))
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


def measure(campaigns: Sequence[Campaign], workers: Workers | None = None) -> Measurement:
    """Return the tables of the campaigns, made where they are not there.

    ``particle`` tells particles of one campaign apart, not of all.
    """
    kiln.make_tables([campaign.run for campaign in campaigns], workers)
    return Measurement(*(_concatenate(step, campaigns) for step in Measurement._fields))


def _concatenate(step: str, campaigns: Sequence[Campaign]) -> pd.DataFrame:
    parts = []
    for campaign in campaigns:
        table = campaign.run.table(step)()
        table.insert(0, "fraction", campaign.fraction)
        table.insert(1, "pressure_bar", campaign.pressure_bar)
        parts.append(table)
    return pd.concat(parts, ignore_index=True)
