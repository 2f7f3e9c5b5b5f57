"""The thesis's eight campaigns in the simulated kiln: four fractions at 4.5 and 5 bar.

recordings -> `Measurement`, the tables of all -> `Results`, values measured and true

Threshold, wall and limit of the air come from the labelled frames; the outlet of the
lance is known. The truth enters no measured table, but it names the frames of a reduced
run (`busiest`). No flight is rejected, as in the thesis.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from pandas import DataFrame

from kilnflight import chain, regression
from kilnflight.arrays import Array, Flags, Texts
from kilnflight.chain import Chain, DetectionRun
from kilnflight.detection.combination import Combination
from kilnflight.detection.wall import Cylinder, InAir, crossing, fit_cylinder
from kilnflight.experiments.detection import labelled
from kilnflight.experiments.detection.labelled import BACKGROUNDS, sift
from kilnflight.experiments.flights.identified import BEYOND_CROSSING_MM
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
from kilnflight.regression import Regression
from kilnflight.scores.flights import MARKS_M, FlightValues
from kilnflight.simulated.kiln import truth
from kilnflight.simulated.kiln.fuel import FRACTIONS
from kilnflight.simulated.kiln.scene import Twin
from kilnflight.simulated.kiln.scenes import (
    PRESSURES_BAR,
    TwinSource,
    campaign_name,
    flight_frames,
    scene_name,
)
from kilnflight.store.cache import CachedTable
from kilnflight.store.parallel import Workers

CampaignKey = tuple[str, float]
KEYS = ["fraction", "pressure_bar"]
# Frames of a campaign by scale; 0: all. A flight lasts 60 to 165.
FRAMES = {"quick": 24, "standard": 200, "full": 0}
REASONS = (LEAVES, BEHIND, TOO_FAST)  # why a flight is refused
# What leaves the view counts with the time computed; what is lost within it does not
# (A.1).
COMPLETE = (LANDED, BURNT_OUT, LEFT)
# Two campaigns make a smoke run; a reduced run has those of one pressure.
CAMPAIGNS = {
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

    def in_air(self, detections: DataFrame) -> DataFrame:
        """Return the detections in the air or without depth, to be tracked (4.1.3).

        ``detections`` are `kilnflight.tables.DETECTIONS`; those on the wall are left
        out (5.1.4).
        """
        on_wall = InAir(self.in_air_mm).on_wall(detections[["x", "y", "z"]], self.wall)
        return detections[~on_wall].reset_index(drop=True)


def settings_from_labels(
    scale: str, seed: int = 0, scenario: str = "base"
) -> LearnedSettings:
    """Return threshold, wall and limit of the air found on labelled frames, cached.

    ``scale`` and ``scenario`` are those of
    `kilnflight.experiments.detection.labelled.labelled_subsets`.
    """

    def make() -> DataFrame:
        subsets = labelled.labelled_subsets(scale, seed, scenario=scenario)
        methods = labelled.from_thresholds(labelled.tried_thresholds(scale))
        threshold = labelled.best_threshold(labelled.score_methods(subsets, methods))
        wall = fit_cylinder(labelled.wall_points(subsets[0]), seed)
        placed = labelled.place_marked(subsets, wall).dropna(subset="z")
        on_wall = placed["label"] == 4
        distance = placed["distance_mm"]
        limit = crossing(distance[~on_wall], distance[on_wall])  # section 5.1.4
        in_air_mm = limit + BEYOND_CROSSING_MM
        row = {"threshold": threshold, "in_air_mm": in_air_mm}
        return DataFrame([row | vars(wall)])

    depends_on = {"scale": scale, "seed": seed, "scenario": scenario}
    row: Any = CachedTable("settings", make, depends_on)().to_dict("records")[0]
    threshold = row.pop("threshold")
    in_air_mm = row.pop("in_air_mm")
    return LearnedSettings(threshold, Cylinder(**row), in_air_mm)


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
    recorded = []
    for fraction, bar in keys or CAMPAIGNS[scale]:
        source = TwinSource(scene_name(campaign_name(fraction, bar), scenario), seed)
        twin = source.recording()
        count = FRAMES[scale] or len(twin)
        frames = busiest(*flight_frames(twin), count, len(twin))
        detection = DetectionRun(
            source,
            frames,
            detector=Combination(sift(settings.threshold)),
            background=BACKGROUNDS[scale],
            chunk=-(-len(twin) // 3),  # each chunk reads a window of the median again
        )
        ignition = None
        if FRACTIONS[fraction].sheet:  # papers alone are tested (5.3.2)
            ignition = Ignition()
        run = Chain(
            detection,
            exit_point_mm=twin.attributes.exit_point_mm,
            wall=settings.wall,
            in_air=InAir(settings.in_air_mm),
            rules=Rules(ignition=ignition, plausible=None),
        )
        recorded.append(Campaign(fraction, bar, run))
    return recorded


def busiest(begin: Array, end: Array, count: int, total: int) -> range:
    """Return the frames of a recording that contain the most whole flights.

    Windows begin at frame 0 or with a flight. Of equal windows the one with the longest
    time in flight is taken, then the first. The times of release and end are known
    before any frame is rendered.

    Parameters
    ----------
    begin, end
        Of `flight_frames`.
    count, total
        Number of frames wanted, and of those that the recording has.
    """
    count = min(count, total)
    starts = np.clip(np.append(np.floor(begin), 0.0), 0, total - count)
    first = np.unique(starts)[:, None]
    stop = first + count
    whole = ((begin >= first) & (end < stop)).sum(axis=1)
    flown = np.clip(np.minimum(end, stop) - np.maximum(begin, first), 0.0, None)
    best = int(first[np.lexsort((-flown.sum(axis=1), -whole))[0], 0])
    return range(best, best + count)


class Measurement(NamedTuple):
    """The tables of all campaigns, with ``fraction`` and ``pressure_bar`` in front.

    Each field has the name of the step of `kilnflight.chain.Chain` that makes it.
    """

    tracks: DataFrame  # detections in the air with ``particle``, the track; -1: none
    trajectories: DataFrame  # kilnflight.tables.TRAJECTORIES
    flights: DataFrame  # kilnflight.tables.FLIGHTS
    slices: DataFrame  # kilnflight.tables.SLICES

    def of(self, key: CampaignKey) -> Measurement:
        """Return the tables of one campaign, without its key."""
        return Measurement._make(
            of_campaign(table, key).drop(columns=KEYS).reset_index(drop=True)
            for table in self
        )


def measure_campaigns(campaigns: Sequence[Campaign], workers: Workers) -> Measurement:
    """Return the tables of all campaigns; missing ones are computed and cached.

    ``particle`` numbers the tracks of each campaign anew, so it is unique within one
    only. No flight is rejected, but a metre that is passed faster than
    `Plausible.fastest_m_s` is no row of the slices: nothing drives a particle so fast,
    and its polynomial is wrong there.
    """
    chain.make_tables([campaign.run for campaign in campaigns], workers)
    tables = Measurement._make(
        stack({each.key: each.run.table(step)() for each in campaigns})
        for step in Measurement._fields
    )
    possible = tables.slices["velocity_m_s"].abs() <= Plausible().fastest_m_s
    return tables._replace(slices=tables.slices[possible].reset_index(drop=True))


def stack(tables: Mapping[CampaignKey, DataFrame]) -> DataFrame:
    """Return one table of all campaigns, fraction and pressure as first columns."""
    return pd.concat(tables, names=KEYS).reset_index(KEYS).reset_index(drop=True)


def rows_by_campaign(rows: Mapping[CampaignKey, Mapping[Any, Any]]) -> DataFrame:
    """Return a table of one row per campaign, fraction and pressure first."""
    return stack({key: DataFrame([row]) for key, row in rows.items()})


def of_campaign(table: DataFrame, key: CampaignKey) -> DataFrame:
    """Return the rows of a campaign."""
    return table[(table[KEYS] == key).all(axis=1)]


def counted_flights(flights: DataFrame) -> DataFrame:
    """Return the flights from the lance (Fig. 4.21) that the run does not reject.

    By default it rejects none.
    """
    return kept(flights[flights["from_lance"]])


def of_counted(table: DataFrame, flights: DataFrame) -> DataFrame:
    """Return the rows of a table of all campaigns that belong to `counted_flights`.

    ``table`` and ``flights`` are fields of one `Measurement`; ``table`` has the column
    ``particle``.
    """
    return table.merge(counted_flights(flights)[[*KEYS, "particle"]])


class Results(NamedTuple):
    """Campaigns with their tables, and their flights' values, measured and true."""

    campaigns: list[Campaign]
    tables: Measurement
    measured: dict[CampaignKey, FlightValues]  # values of the `counted_flights`
    true: dict[CampaignKey, FlightValues]  # values of the `whole_flights`


def results(
    scale: str,
    seed: int,
    jobs: int,
    scenario: str = "base",
    keys: Sequence[CampaignKey] | None = None,
) -> Results:
    """Return the results of all `campaigns` of a scale, for the notebooks 50 to 56.

    Missing tables are computed in ``jobs`` processes and cached, and true positions
    likewise. Measured values are of the `counted_flights`, true ones of all
    `whole_flights`, detected or not.
    """
    settings = settings_from_labels(scale, seed, scenario)
    recorded = campaigns(scale, settings, seed, scenario, keys)
    workers = Workers(jobs)
    tables = measure_campaigns(recorded, workers)
    missing = [
        each
        for each in recorded
        if not truth.kept_marks(twin_of(each), each.frames).path.is_file()
    ]
    workers(true_positions, missing, [len(each.frames) for each in missing], "truth")
    true = {}
    for each in recorded:
        flights = twin_of(each).life.flights.take(whole_flights(each))
        true[each.key] = truth.true_flight_values(flights)
    measured = values_by_campaign(tables, true)
    return Results(campaigns=recorded, tables=tables, measured=measured, true=true)


def twin_of(campaign: Campaign) -> Twin:
    """Return the simulated recording of a campaign, with its truth."""
    recording = campaign.run.detection.source.recording()
    assert isinstance(recording, Twin)  # campaigns are simulated
    return recording


def true_positions(campaign: Campaign) -> DataFrame:
    """Return true positions of visible particles in the air, one row each.

    The columns are those of `kilnflight.simulated.kiln.truth.sightings`. Particles with
    fewer than five positions are left out. The table is cached.
    """
    return truth.followed(truth.kept_marks(twin_of(campaign), campaign.frames)())


def whole_flights(campaign: Campaign) -> Flags:
    """Return whether true flights begin and end within the frames, (n,).

    The mask (n,) has the order of ``twin_of(campaign).life.flights``.
    """
    begin, end = flight_frames(twin_of(campaign))
    frames = campaign.frames
    return np.asarray((begin >= frames.start) & (end < frames.stop))


def values_by_campaign(
    tables: Measurement, keys: Iterable[CampaignKey], complete: Texts = COMPLETE
) -> dict[CampaignKey, FlightValues]:
    """Return the `flight_values` of each campaign, from the tables of all campaigns."""
    return {key: flight_values(tables.of(key), complete) for key in keys}


def flight_values(tables: Measurement, complete: Texts = COMPLETE) -> FlightValues:
    """Return times, velocities and reach of one campaign's `counted_flights`.

    Flights with one of the endings ``complete`` have a dwell time (section 5.3.1,
    appendix A.1). Slices behind the lance are left out.

    Parameters
    ----------
    tables
        Tables of the campaign.
    complete
        Endings, such as `COMPLETE`.

    Returns
    -------
    FlightValues
        Times in s from the lance, velocities (n, 5) in m/s, distances in depth from it
        in m.
    """
    counted = counted_flights(tables.flights)
    wide = tables.slices.pivot(
        index="particle", columns="slice_m", values="velocity_m_s"
    )
    wide = wide.reindex(index=counted["particle"], columns=list(MARKS_M))
    lost = ~counted["ending"].isin(complete).to_numpy()
    fits = regression.fits(tables.trajectories)
    reached_mm = [
        fits[name].exit_point_mm[2] - straight_on(fits[name], end_s)[0, 2]
        for name, end_s in zip(counted["particle"], counted["end_s"], strict=True)
    ]
    return FlightValues(
        dwell_s=counted.loc[~lost, "dwell_s"].to_numpy(float),
        velocity_m_s=wide.to_numpy(float),
        ignition_s=counted["ignition_s"].to_numpy(float),
        reached_m=np.array(reached_mm, float) / 1000.0,
        lost=lost,
    )


# The other value of a choice that the thesis does not print: detections and tracks
# stay, regression and flights are computed again (data/reference/choices.csv).


def true_outlet(campaign: Campaign) -> Chain:
    """Return the run with the lance where it is, not where the camera sees it."""
    x, y, z = twin_of(campaign).scene.geometry.lance_mm.tolist()
    return replace(campaign.run, exit_point_mm=(x, y, z))


def rmse_alone(campaign: Campaign) -> Chain:
    """Return the run whose orders rise as long as the RMSE alone falls."""
    return replace(campaign.run, regression=Regression(measures=("rmse_mm",)))


def rejecting(campaign: Campaign) -> Chain:
    """Return the run that rejects impossible flights, as ``kilnflight run`` does."""
    rules = replace(campaign.run.rules, plausible=Plausible())
    return replace(campaign.run, rules=rules)


def gray_alone(campaign: Campaign) -> Chain:
    """Return the run that takes a rise of the grey value itself as ignition."""
    rules = campaign.run.rules
    if rules.ignition is None:
        return campaign.run
    gray = Ignition(above_background=False)
    return replace(campaign.run, rules=replace(rules, ignition=gray))


# Ids of data/reference/choices.csv.
OTHERS = {
    "F1": true_outlet,
    "F2": rmse_alone,
    "F6": rejecting,
    "F7": gray_alone,
}


def varied(results: Results, change: Callable[[Campaign], Chain], jobs: int) -> Results:
    """Return the results with other runs; ``jobs`` processes make missing tables."""
    changed = [each._replace(run=change(each)) for each in results.campaigns]
    tables = measure_campaigns(changed, Workers(jobs))
    measured = values_by_campaign(tables, results.measured)
    return results._replace(campaigns=changed, tables=tables, measured=measured)
