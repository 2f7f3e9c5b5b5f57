"""Evaluate predictive tracking (2016 paper, section IV).

::

    tracks at 1000 Hz -> velocity known, tracking, straight  (noise-free: Figs 6a, 6c)
          pictures -> spots -> tracking, straight            (images: Figs 6b, 6d)
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import pandas as pd
from pandas import DataFrame, Series
from tqdm import tqdm

from kilnflight.arrays import Array, Numbers, Tables, Texts
from kilnflight.belt.camera import (
    BELT,
    TRACKED,
    Area,
    Calibration,
    calibrate_camera,
    find_corners,
)
from kilnflight.belt.models import CV, LateralCV, Predictor, Straight
from kilnflight.belt.phase import PredictionPhase, last_states, summarise_deviations
from kilnflight.belt.pictures import MeasureSpots, Spots, average
from kilnflight.belt.tracker import (
    BELT_FRAME_S,
    Appearance,
    BeltTracker,
    Followed,
    constant_velocity,
)
from kilnflight.scores.intervals import percentiles
from kilnflight.simulated.belt.rendering import Pictures, at_rate
from kilnflight.store.parallel import run_all

# The last 10 cm of the belt (section IV).
PHASE_2016 = PredictionPhase(TRACKED.end_mm, BELT.end_mm)
# Particles in pictures: "over 1000", section IV; notebook 43 takes all in a full run.
PARTICLES = {"quick": 40, "standard": 120, "full": 1500}
TRUTH_HZ = 1000.0  # "the ground truth data was generated at 1000 Hz", section IV.B
# Standard deviation of a measurement without noise; none at all has no S.
NOISE_FREE_MM = 0.001
# Approaches of Fig. 6.
SIM = "Sim"
TRACKING = "Tracking"
STRAIGHT = "Straight"
BACKGROUND_OF = 200  # pictures, evenly spread
_REPLICATES = 1000  # draws of the bootstrap over particles


class PictureTracks(NamedTuple):
    """Measurements in the pictures of one recording, and their tracks."""

    calibration: Calibration
    spots: DataFrame  # kilnflight.tables.BELT_SPOTS
    followed: Followed  # its ``row`` counts the rows of ``spots``


def tracker_until(end_mm: float) -> BeltTracker:
    """Return the tracker at 200 frames/s of the belt up to x = ``end_mm``."""
    motion = constant_velocity(acceleration_mm_s2=2000.0)  # B5 of choices
    return BeltTracker(motion, Appearance(Area(end_mm=end_mm)))


def track_pictures(
    pictures: Pictures, end_mm: float = PHASE_2016.start_mm
) -> PictureTracks:
    """Measure spots in pictures up to x = ``end_mm`` and track them (IV.B).

    The camera is calibrated by the belt's corners in the background, the mean of evenly
    spread pictures.
    """
    step = max(1, len(pictures) // BACKGROUND_OF)
    shown = list(pictures.frames(range(0, len(pictures), step)))
    background = average(shown)
    measure = MeasureSpots(
        background,
        spots=Spots().calibrated(shown[::10], background),
        calibration=calibrate_camera(find_corners(background)),
        area=Area(end_mm=end_mm),
    )
    every = pictures.frames(range(len(pictures)))
    table = measure.table(tqdm(every, "pictures", len(pictures), disable=None))
    followed = tracker_until(end_mm)(table, len(pictures))
    return PictureTracks(measure.calibration, table, followed)


def track_all(
    pictures: Mapping[str, Pictures], jobs: int, end_mm: float = PHASE_2016.start_mm
) -> dict[str, PictureTracks]:
    """Return `track_pictures` of several recordings by name, in ``jobs`` processes."""
    pieces = [(each, end_mm) for each in pictures.values()]
    tracked = run_all(track_pictures, pieces, jobs)
    return dict(zip(pictures, tracked, strict=True))


def noise_free(bodies: DataFrame, phase: PredictionPhase = PHASE_2016) -> DataFrame:
    """Return deviations of three approaches on exact positions (Figs 6a and 6c).

    Parameters
    ----------
    bodies
        `kilnflight.tables.BELT_TRACKS` at 1000 Hz, the rate of `rate_1000`.
    phase
        Start and target of the prediction.

    Returns
    -------
    DataFrame
        ``approach`` (Sim, Tracking, Straight), ``particle``; ``lateral_mm`` and
        ``temporal_ms`` as in `deviations` (time NaN for Straight). Sim takes the
        velocity from the last three positions, Tracking from the filter.
    """
    last, arrival, _ = phase.observe(bodies)
    tracked = last_states(rate_1000(phase.start_mm)(bodies), 1 / TRUTH_HZ)
    tracked["particle"] = bodies["particle"].to_numpy()[tracked["row"]]
    states = {SIM: last, TRACKING: tracked, STRAIGHT: last}
    return _of_approaches(states, arrival, phase.target_mm)


def followed_particles(pictured: PictureTracks, bodies: DataFrame) -> DataFrame:
    """Return the last states of tracks from pictures, with the particle of each.

    Only valid tracks that enter the prediction phase are returned. ``bodies`` are the
    exact `kilnflight.tables.BELT_TRACKS` at 1000 Hz; `match` takes those at the
    camera's 200 frames/s.

    Returns
    -------
    DataFrame
        `kilnflight.tables.BELT_LAST` with ``particle`` the track; ``row`` of its last
        spot in ``pictured.spots``; ``truth``, the particle from `match` (-1: none).
    """
    last = last_states(pictured.followed, BELT_FRAME_S)
    states = pictured.followed.states
    pairs = match(states[states["row"] >= 0], at_rate(bodies, 1 / BELT_FRAME_S))
    return last.assign(truth=last["particle"].map(pairs).fillna(-1).astype(np.int64))


def from_images(
    pictured: PictureTracks, bodies: DataFrame, phase: PredictionPhase = PHASE_2016
) -> DataFrame:
    """Return deviations of Tracking and Straight from pictures (Figs 6b and 6d).

    The columns are those of `noise_free`; ``bodies`` are the exact
    `kilnflight.tables.BELT_TRACKS`. The tracks must end where ``phase`` starts. Those
    without a particle are left out. Straight keeps the last measured y, not the
    filtered.
    """
    arrival = phase.observe(bodies).arrival
    tracked = followed_particles(pictured, bodies)
    tracked = tracked.assign(particle=tracked["truth"])[tracked["truth"] >= 0]
    raw = tracked.assign(y=pictured.spots["y"].to_numpy()[tracked["row"]])
    return _of_approaches({TRACKING: tracked, STRAIGHT: raw}, arrival, phase.target_mm)


def _of_approaches(states: Tables, arrival: DataFrame, target_mm: float) -> DataFrame:
    """Return `deviations` of last states by approach, in one table."""
    tables = [
        deviations(approach, last, arrival, target_mm)
        for approach, last in states.items()
    ]
    return pd.concat(tables, ignore_index=True)


def match(states: DataFrame, truth: DataFrame) -> Series:
    """Return the particle nearest to each track, a Series over tracks (IV).

    Parameters
    ----------
    states, truth
        ``frame``, ``particle``, ``x``, ``y`` (mm) of tracks and of particles. The
        frames of both count at the same rate from the same moment.

    Notes
    -----
    The least distance counts: "the euclidean norm of the euclidean distances between
    all estimated positions and all corresponding ground truth positions". The paper
    leaves open how to treat a particle that is absent in some frames of a track; here
    it is no candidate. A track without a candidate is left out. Two tracks may match
    the same particle.
    """
    names = ["frame", "particle", "x", "y"]
    table = states[names].merge(truth[names], on="frame", suffixes=("", "_true"))
    squares = (table["x"] - table["x_true"]) ** 2 + (table["y"] - table["y_true"]) ** 2
    by_pair = squares.groupby([table["particle"], table["particle_true"]])
    pairs = by_pair.agg(["size", "mean"]).reset_index()
    whole = pairs["size"] == pairs["particle"].map(states["particle"].value_counts())
    nearest = pairs[whole].groupby("particle")["mean"].idxmin()
    return pairs.loc[nearest].set_index("particle")["particle_true"]


def deviations(
    approach: str, last: DataFrame, arrival: DataFrame, target_mm: float
) -> DataFrame:
    """Return how far predictions deviate from arrivals at the target.

    Parameters
    ----------
    approach
        `STRAIGHT` keeps the lateral position and predicts no time. `SIM` (the true
        velocity) and `TRACKING` go on at constant velocity.
    last
        `kilnflight.tables.BELT_LAST` with the true ``particle``; one may have several
        rows.
    arrival
        `kilnflight.tables.BELT_ARRIVAL`; particles that did not arrive are left out.
    target_mm
        The place x of the arrivals.

    Returns
    -------
    DataFrame
        A row per row of ``last`` whose particle arrived: ``approach``, ``particle``;
        ``lateral_mm`` and ``temporal_ms``, prediction minus truth, so positive if the
        particle arrived earlier than predicted (Fig. 6). NaN where no arrival is
        predicted, except the place of `STRAIGHT`.
    """
    lateral = Straight() if approach == STRAIGHT else LateralCV()
    predicted = DataFrame(Predictor(CV(), lateral, target_mm)(last))
    if approach == STRAIGHT:
        predicted["time_s"] = np.nan
    table = predicted.merge(arrival, on="particle", suffixes=("", "_true"))
    return DataFrame(
        {
            "approach": approach,
            "particle": table["particle"],
            "lateral_mm": table["y"] - table["y_true"],
            "temporal_ms": 1000.0 * (table["time_s"] - table["time_s_true"]),
        }
    )


def rate_1000(end_mm: float) -> BeltTracker:
    """Return the tracker for exact positions at 1000 Hz (section IV.A).

    It observes the belt up to x = ``end_mm``. Counts and lengths per frame are scaled,
    so that those per second equal the tracker's at 200 frames/s. A collision changes
    the velocity within a frame by up to 433 mm/s, the standard deviation between
    particles. With exact positions this number affects the gate only.
    """
    usual = Appearance()
    share = 1 / (TRUTH_HZ * BELT_FRAME_S)
    appearance = Appearance(
        area=Area(end_mm=end_mm),
        arrivals=usual.arrivals * share,
        entry_mm=usual.entry_mm * share,
        entry_blur_mm=usual.entry_blur_mm * share,
        clutter=usual.clutter * share,
    )
    change = 433.0 * np.sqrt(TRUTH_HZ / BELT_FRAME_S)  # mm/s^2 in 5 ms
    motion = constant_velocity(NOISE_FREE_MM, change)
    return BeltTracker(motion, appearance, 1 / TRUTH_HZ)


def summaries(table: DataFrame, groups: Texts, seed: int) -> DataFrame:
    """Return the box plots of Fig. 6 with 95 % intervals, a row per box.

    Parameters
    ----------
    table
        ``lateral_mm``, ``temporal_ms`` and the columns ``groups``.
    groups
        Columns that stay apart.
    seed
        Seed of the bootstrap, the same draws for each row.

    Returns
    -------
    DataFrame
        ``groups``, ``quantity`` (``lateral_mm`` or ``temporal_ms``, which is the unit
        of what follows); the columns `kilnflight.belt.phase.SUMMARY`; ``absolute_q95``,
        below which 95 % of the absolute deviations lie; ``mae_centred``, the mean
        absolute deviation from the mean; ``_low`` and ``_high`` of ``median``, ``iqr``
        and ``mae_centred`` (bootstrap over particles). Quantities without a value have
        no row.
    """
    rows = []
    for key, part in table.groupby(list(groups), sort=False):
        for quantity in ("lateral_mm", "temporal_ms"):
            values = part[quantity].to_numpy()
            if not np.isnan(values).all():
                row = dict(zip(groups, key, strict=True)) | {"quantity": quantity}
                rows.append(row | _summarise(values, seed))
    return DataFrame(rows)


def _summarise(deviation: Array, seed: int) -> Numbers:
    """Return the box plot of deviations (n,) with 95 % intervals, as in `summaries`."""
    known = deviation[~np.isnan(deviation)]
    size = (_REPLICATES, len(known))
    drawn = np.random.default_rng(seed).integers(0, len(known), size)
    found = summarise_deviations(deviation)
    found["absolute_q95"] = np.quantile(np.abs(known), 0.95)
    # A row for the particles themselves, then one for each draw.
    rows = np.vstack([known, known[drawn]])
    q25, median, q75 = np.quantile(rows, [0.25, 0.5, 0.75], axis=-1)
    away = np.abs(rows - rows.mean(axis=-1, keepdims=True)).mean(axis=-1)
    spreads = {"median": median, "iqr": q75 - q25, "mae_centred": away}
    for name, values in spreads.items():
        found[name] = values[0]
        found[f"{name}_low"], found[f"{name}_high"] = percentiles(values[1:])
    return found
