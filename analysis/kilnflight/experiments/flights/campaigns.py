"""The thesis's eight campaigns in the simulated kiln: four fractions at 4.5 and 5 bar.

recordings -> `Measurement`, the tables of all -> `Results`, values measured and true

Threshold, wall and limit of the air come from the labelled frames; the outlet of the
lance is known. The truth enters no measured table, but it names the frames of a reduced
run (`busiest`). No flight is rejected, as in the thesis.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight import chain, regression
from kilnflight.arrays import Array
from kilnflight.chain import Chain, DetectionRun
from kilnflight.checks import InputError
from kilnflight.detection.combination import Combination
from kilnflight.detection.wall import Cylinder, InAir, crossing, fit_cylinder
from kilnflight.experiments.detection import labelled
from kilnflight.experiments.detection.labelled import BACKGROUNDS, sift
from kilnflight.experiments.flights.sources import TwinSource
from kilnflight.flight import (
    BEHIND,
    BURNT_OUT,
    LANDED,
    LEAVES,
    LEFT,
    TOO_FAST,
    Plausible,
    Rules,
    kept,
    straight_on,
)
from kilnflight.ignition import Ignition
from kilnflight.scores.flights import METRES, FlightValues
from kilnflight.simulated.kiln import truth
from kilnflight.simulated.kiln.fuel import FRACTIONS
from kilnflight.simulated.kiln.scene import Twin
from kilnflight.simulated.kiln.scenes import (
    PRESSURES_BAR,
    campaign_name,
    open_scene,
    scene_name,
)
from kilnflight.store.cache import CachedTable
from kilnflight.store.parallel import Workers
from kilnflight.tables import TRAJECTORIES

CampaignKey = tuple[str, float]
KEYS = ["fraction", "pressure_bar"]
FRAMES = {
    "quick": 24,
    "standard": 200,
    "full": 0,
}  # by scale; 0: all; a flight lasts 60 to 165
REASONS = (LEAVES, BEHIND, TOO_FAST)  # why a flight is refused
# What leaves the view counts with the time computed; what is lost within it does not
# (A.1).
COMPLETE = (LANDED, BURNT_OUT, LEFT)
# Campaigns by scale: two of a smoke run, those of one pressure if reduced.
CAMPAIGNS: dict[str, tuple[CampaignKey, ...]] = {
    "quick": (("wood chip", 4.5), ("paper shred", 4.5)),
    "standard": tuple((fraction, 4.5) for fraction in FRACTIONS),
    "full": tuple(product(FRACTIONS, PRESSURES_BAR)),
}


@dataclass(frozen=True)
class LearnedSettings:
    """Settings of the detection in campaigns, found on labelled frames.

    No campaign shares any of these frames.

    Parameters
    ----------
    threshold
        Threshold of DoG in grey values, with the best F1 on all labelled frames
        together.
    wall
        Cylinder fitted to the wall's points in the first labelled frame.
    in_air_mm
        Largest distance from the wall's axis that counts as in the air, in mm. It is
        the crossing of two Gaussians, of particles in the air and on the wall, plus 40
        mm. The thesis goes from 760 to 800 mm likewise.
    """

    threshold: float
    wall: Cylinder
    in_air_mm: float

    def in_air(self, detections: pd.DataFrame) -> pd.DataFrame:
        """Return the detections in the air or without depth, to be tracked (4.1.3).

        ``detections`` are `kilnflight.tables.DETECTIONS`; those on the wall are left
        out (5.1.4).
        """
        on_wall = InAir(self.in_air_mm).on_wall(detections[["x", "y", "z"]], self.wall)
        return detections[~on_wall].reset_index(drop=True)


def settings_from_labels(
    scale: str, seed: int = 0, scenario: str = "base"
) -> LearnedSettings:
    """Return threshold, wall and limit found on labelled frames, cached.

    The frames are those of ``scale``. The values come from the cached row of
    `_settings`.
    """
    make = partial(_settings, scale, seed, scenario)
    depends_on = {"scale": scale, "seed": seed, "scenario": scenario}
    values = CachedTable("settings", make, depends_on)().iloc[0].tolist()
    threshold, radius, in_air, x, y, z, dx, dy, dz = map(float, values)
    return LearnedSettings(threshold, Cylinder((x, y, z), (dx, dy, dz), radius), in_air)


def _settings(scale: str, seed: int, scenario: str) -> pd.DataFrame:
    """Return threshold, radius, limit, centre and axis, one row of nine columns.

    The threshold is in grey values, lengths are in mm; centre and direction of the
    cylinder's axis take three columns each. `settings_from_labels` reads the row by
    position.
    """
    subsets = labelled.labelled_subsets(scale, seed, scenario=scenario)
    counts = labelled.sum_counts(
        labelled.compare_thresholds(subsets, scale), ["threshold"]
    )
    best = counts.loc[counts["f1"] == counts["f1"].max(), "threshold"]
    threshold = float(best.max())  # of ties the highest
    points = labelled.wall_points(subsets[0].recording, subsets[0].frames[0])
    wall = fit_cylinder(points, seed)
    detectors = {subset.name: Combination(sift(threshold)) for subset in subsets}
    marked, _ = labelled.positions(subsets, detectors, wall)
    known = marked.dropna(subset="z")
    distance = known["distance_mm"].to_numpy()
    flying = (known["label"] != 4).to_numpy()
    limit = crossing(distance[flying], distance[~flying]) + 40.0
    values = [threshold, wall.radius_mm, limit, *wall.centre_mm, *wall.direction]
    return pd.DataFrame([values]).add_prefix("value_")


class Campaign(NamedTuple):
    """A recording of the simulated kiln, and the settings of its detection."""

    fraction: str
    pressure_bar: float
    run: Chain

    @property
    def key(self) -> CampaignKey:
        """Fraction and pressure."""
        return self.fraction, self.pressure_bar

    @property
    def frames(self) -> range:
        """The frames in which particles are detected."""
        return self.run.frames


def campaigns(
    scale: str,
    settings: LearnedSettings,
    seed: int = 0,
    scenario: str = "base",
    keys: Sequence[CampaignKey] | None = None,
) -> list[Campaign]:
    """Return the campaigns of a scale, without computing their tables.

    Parameters
    ----------
    scale
        "quick" (two campaigns, 24 frames each), "standard" (four at 4.5 bar, 200 frames
        each) or "full" (eight, all frames).
    settings
        Threshold, wall and limit from the labelled frames.
    seed
        Seed of the scenes.
    scenario
        One of `kilnflight.simulated.kiln.scenes.SCENARIOS`.
    keys
        Fraction and pressure of some; None: all of the scale.
    """
    if scale not in FRAMES:
        raise InputError(
            f"campaigns: no scale {scale!r}; there are {', '.join(FRAMES)}."
        )
    return [
        Campaign(
            fraction,
            bar,
            _run(campaign_name(fraction, bar), scale, settings, seed, scenario),
        )
        for fraction, bar in keys or CAMPAIGNS[scale]
    ]


def _run(
    name: str, scale: str, settings: LearnedSettings, seed: int, scenario: str
) -> Chain:
    """Return the run of a campaign: frames of the scale, detector, wall, lance."""
    source = TwinSource(scene_name(name, scenario), seed)
    twin = open_scene(source.name, seed)
    count = FRAMES[scale] or len(twin)
    frames = busiest(
        twin.life.release_s,
        twin.life.flights.end_s,
        twin.scene.frame_rate_hz,
        count,
        len(twin),
    )
    chunk = frames.stop
    if count == len(twin):
        # in thirds, for fewer windows of the median
        chunk = max(chain.CHUNK_FRAMES, -(-count // 3))
    detection = DetectionRun(
        source,
        frames.start,
        frames.stop,
        detector=Combination(sift(settings.threshold)),
        background=BACKGROUNDS[scale],
        chunk=chunk,
    )
    sheet = FRACTIONS[
        twin.scene.fraction
    ].sheet  # the test of grey values is for papers (5.3.2)
    return Chain(
        detection,
        exit_point_mm=twin.attributes.exit_point_mm,
        wall=settings.wall,
        in_air=InAir(settings.in_air_mm),
        rules=Rules(ignition=Ignition() if sheet else None, plausible=None),
    )


def busiest(
    release_s: Array, dwell_s: Array, frame_rate_hz: float, count: int, total: int
) -> range:
    """Return the frames of a recording in which most flights begin and end.

    Of equal ones those with the longest flights in them count, then the first. The rule
    needs the times of release and end alone, which are known before any frame is
    rendered.

    Parameters
    ----------
    release_s, dwell_s
        (n,) in s: when each particle leaves the lance, and for how long it flies.
    frame_rate_hz
        Of the recording.
    count, total
        Number of frames wanted, and of those that the recording has.
    """
    count = min(count, total)
    begin = release_s * frame_rate_hz
    end = begin + dwell_s * frame_rate_hz
    first = np.unique(
        np.clip(np.append(np.floor(begin), 0.0), 0, total - count)
    ).astype(int)
    last = first[:, None] + count
    whole = ((begin >= first[:, None]) & (end < last)).sum(axis=1)
    flown = np.clip(
        np.minimum(end, last) - np.maximum(begin, first[:, None]), 0.0, None
    )
    best = int(first[np.lexsort((-flown.sum(axis=1), -whole))[0]])
    return range(best, best + count)


class Measurement(NamedTuple):
    """The tables of all campaigns, with ``fraction`` and ``pressure_bar`` in front.

    Each field bears the name of the step of `kilnflight.chain.Chain` that makes it.
    """

    tracks: pd.DataFrame  # detections in the air with ``particle``, the track; -1: none
    trajectories: pd.DataFrame  # kilnflight.tables.TRAJECTORIES
    flights: pd.DataFrame  # kilnflight.tables.FLIGHTS
    slices: pd.DataFrame  # kilnflight.tables.SLICES


def measure_campaigns(
    campaigns: Sequence[Campaign], workers: Workers | None = None
) -> Measurement:
    """Return the tables of all campaigns; missing ones are computed and cached.

    ``particle`` numbers the tracks of each campaign anew, so it is unique within one
    only. No flight is rejected, but a metre that is passed faster than
    `Plausible.fastest_m_s` is no row of the slices: nothing drives a particle so fast,
    and its polynomial is wrong there.
    """
    chain.make_tables([campaign.run for campaign in campaigns], workers)
    steps = Measurement._fields
    tables = Measurement(
        *(
            stack({each.key: each.run.table(step)() for each in campaigns})
            for step in steps
        )
    )
    possible = tables.slices["velocity_m_s"].abs() <= Plausible().fastest_m_s
    return tables._replace(slices=tables.slices[possible].reset_index(drop=True))


def stack(tables: Mapping[CampaignKey, pd.DataFrame]) -> pd.DataFrame:
    """Return one table of all campaigns, fraction and pressure as first columns."""
    return pd.concat(tables, names=KEYS).reset_index(KEYS).reset_index(drop=True)


def rows_by_campaign(rows: Mapping[CampaignKey, Mapping[Any, Any]]) -> pd.DataFrame:
    """Return a table of one row per campaign, fraction and pressure first."""
    index = pd.MultiIndex.from_tuples(rows, names=KEYS)
    return pd.DataFrame(list(rows.values()), index).reset_index()


def of_campaign(table: pd.DataFrame, key: CampaignKey) -> pd.DataFrame:
    """Return the rows of a campaign."""
    return table[(table["fraction"] == key[0]) & (table["pressure_bar"] == key[1])]


def counted_flights(flights: pd.DataFrame) -> pd.DataFrame:
    """Return the flights from the lance (Fig. 4.21) that the run does not reject."""
    return kept(flights[flights["from_lance"]])


def from_lance(tables: Measurement, step: str) -> pd.DataFrame:
    """Return the rows of one table that belong to the `counted_flights`.

    ``step`` names the table: a field of `Measurement` with the column ``particle``.
    """
    counted = counted_flights(tables.flights)[[*KEYS, "particle"]]
    table: pd.DataFrame = getattr(tables, step)
    return table.merge(counted, on=[*KEYS, "particle"])


class Results(NamedTuple):
    """Campaigns with their tables, and their flights' values, measured and true."""

    campaigns: list[Campaign]
    tables: Measurement
    measured: dict[CampaignKey, FlightValues]  # of the `counted_flights`
    true: dict[CampaignKey, FlightValues]  # of the `whole_flights`


def results(
    scale: str,
    seed: int = 0,
    jobs: int = 1,
    scenario: str = "base",
    keys: Sequence[CampaignKey] | None = None,
) -> Results:
    """Return the results of all `campaigns` of a scale, for the notebooks 50 to 56.

    Missing tables are computed in ``jobs`` processes and cached, and true positions
    likewise. Measured values are of the `counted_flights`, true ones of all
    `whole_flights`, detected or not.
    """
    recorded = campaigns(
        scale, settings_from_labels(scale, seed, scenario), seed, scenario, keys
    )
    tables = measure_campaigns(recorded, Workers(jobs))
    marks = [truth.kept_marks(twin_of(each), each.frames).path for each in recorded]
    unknown = [
        each for each, path in zip(recorded, marks, strict=True) if not path.is_file()
    ]
    Workers(jobs)(
        true_positions, unknown, [len(each.frames) for each in unknown], "truth"
    )
    measured = values_by_campaign(tables, [each.key for each in recorded])
    whole = {
        each.key: twin_of(each).life.flights.take(whole_flights(each))
        for each in recorded
    }
    true = {key: truth.true_flight_values(flights) for key, flights in whole.items()}
    return Results(recorded, tables, measured, true)


def twin_of(campaign: Campaign) -> Twin:
    """Return the simulated recording of a campaign, with its truth."""
    recording = campaign.run.detection.source.recording()
    assert isinstance(recording, Twin)  # campaigns are simulated
    return recording


def true_positions(campaign: Campaign) -> pd.DataFrame:
    """Return true positions of visible particles in the air, one row each.

    The columns are those of `kilnflight.simulated.kiln.truth.sightings`. Particles with
    fewer than five positions are left out. The table is cached.
    """
    return truth.true_trajectories(twin_of(campaign), campaign.frames)


def whole_flights(campaign: Campaign) -> npt.NDArray[np.bool_]:
    """Return whether true flights begin and end within the frames, (n,).

    The mask (n,) has the order of ``twin_of(campaign).life.flights``.
    """
    twin = twin_of(campaign)
    frames = campaign.frames
    release = twin.life.release_s * twin.scene.frame_rate_hz
    over = release + twin.life.flights.end_s * twin.scene.frame_rate_hz
    return np.asarray((release >= frames.start) & (over < frames.stop))


def values_by_campaign(
    tables: Measurement, keys: Iterable[CampaignKey], complete: Sequence[str] = COMPLETE
) -> dict[CampaignKey, FlightValues]:
    """Return the `flight_values` of each campaign, from the tables of all campaigns."""
    parts = {key: [of_campaign(table, key) for table in tables[1:]] for key in keys}
    return {
        key: flight_values(trajectories, flights, slices, complete)
        for key, (trajectories, flights, slices) in parts.items()
    }


def flight_values(
    trajectories: pd.DataFrame,
    flights: pd.DataFrame,
    slices: pd.DataFrame,
    complete: Sequence[str] = COMPLETE,
) -> FlightValues:
    """Return times, velocities and reach of one campaign's `counted_flights`.

    Flights with one of the endings ``complete`` have a dwell time (section 5.3.1,
    appendix A.1). The others are censored when last detected. Slices behind the lance
    are left out.

    Parameters
    ----------
    trajectories, flights, slices
        `kilnflight.tables.TRAJECTORIES`, `FLIGHTS` and `SLICES` of the campaign.

    Returns
    -------
    FlightValues
        Times in s from the lance, velocities (n, 5) in m/s, distances in depth from it
        in m.
    """
    counted = counted_flights(flights)
    wide = slices.pivot(index="particle", columns="slice_m", values="velocity_m_s")
    wide = wide.reindex(
        index=counted["particle"], columns=[float(metre) for metre in METRES]
    )
    fits = regression.fits(trajectories[TRAJECTORIES.names])
    ends = zip(
        [fits[each] for each in counted["particle"]], counted["end_s"], strict=True
    )
    reached = [fit.exit_point_mm[2] - straight_on(fit, end)[0, 2] for fit, end in ends]
    lost = ~counted["ending"].isin(complete).to_numpy()
    dwell = counted.loc[~lost, "dwell_s"]
    ignition = counted["ignition_s"]
    seen = (counted["last_s"] - counted["t0_s"])[lost]
    times = [each.to_numpy(np.float64) for each in (dwell, ignition, seen)]
    far = np.array(reached, np.float64) / 1000.0
    return FlightValues(
        times[0], wide.to_numpy(np.float64), times[1], far, times[2], lost
    )
