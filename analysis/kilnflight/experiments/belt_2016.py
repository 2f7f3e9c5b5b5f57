"""The evaluation of predictive tracking, written out once (2016 paper, section IV).

bodies -> velocity of the simulation, tracking, straight     (noise-free, Figs 6a and 6c)
       -> pictures -> spots -> tracking, straight            (images, Figs 6b and 6d)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.spatial import KDTree

from kilnflight.belt import sorter
from kilnflight.belt.bodies import is_installed
from kilnflight.belt.camera import BELT, TRACKED, Area, Calibration, FindCorners, calibrate
from kilnflight.belt.evaluation import last_states, summarise
from kilnflight.belt.friction import MATERIALS
from kilnflight.belt.machine import check_material
from kilnflight.belt.models import CA, CV, ArrivalModel, LateralCV
from kilnflight.belt.phase import PredictionPhase
from kilnflight.belt.pictures import Pictures, Spots, at_rate, average, measure
from kilnflight.belt.tracker import (
    BELT_FRAME_S,
    Appearance,
    BeltTracker,
    Followed,
    constant_acceleration,
    constant_velocity,
)
from kilnflight.checks import InputError, check_columns, check_count
from kilnflight.project import claims
from kilnflight.tables import BELT_ARRIVAL, BELT_LAST, BELT_TRACKS

PHASE = PredictionPhase(TRACKED.end_mm, BELT.end_mm)  # the last 10 cm, section IV
# The same 10 cm where tracks end at the edge: 15 mm upstream, as in `PredictionPhase`.
UPSTREAM = PredictionPhase(PHASE.start_mm - 15.0, PHASE.target_mm - 15.0)
TRUTH_S = 0.001  # "the ground truth data was generated at 1000 Hz", section IV.B
NOISE_FREE_MM = 0.001  # standard deviation of a measurement without noise: none at all has no S
SIM, TRACKING, STRAIGHT = "Sim", "Tracking", "Straight"  # names of Fig. 6
PLACED = ["frame", "particle", "x", "y"]
APART_MM = 1e6  # what one frame is worth beside a distance: more than any belt is long
_CV = CV()

Answer = dict[str, bool] | pd.Series  # conditions for `kilnflight.project.claims.judge`


def bodies(material: str, count: int, seed: int, jobs: int = 1) -> pd.DataFrame:
    """Return tracks at 1000 Hz: of the simulated sorter, or of the friction model without MuJoCo.

    The friction model feeds as many particles per second as the papers, about 270.

    Raises
    ------
    InputError
        If there is no such material, or the number is none.
    """
    check_material(material)
    check_count(count, "bodies: count", least=0)
    if is_installed():
        return sorter.tracks(material, count, seed, jobs)
    usual = MATERIALS[material]
    share = count / usual.particles
    fast = replace(usual, particles=count, feed_s=share * usual.feed_s, sampling_hz=1000.0)
    return replace(fast, steps_per_sample=2)(np.random.default_rng([seed, count]))


class PictureTracks(NamedTuple):
    """What the camera's pictures gave."""

    background: npt.NDArray[np.uint8]
    calibration: Calibration
    spots: pd.DataFrame  # kilnflight.tables.BELT_SPOTS
    followed: Followed


def noise_free(bodies: pd.DataFrame) -> pd.DataFrame:
    """Return the deviations of the three approaches on true positions at 1000 Hz (IV.A).

    Parameters
    ----------
    bodies
        `kilnflight.tables.BELT_TRACKS`, with the simulation's velocities if it has them;
        otherwise they are those of the parabola through the last three positions.

    Returns
    -------
    DataFrame
        ``approach`` (Sim, Tracking, Straight), ``particle``, ``lateral_mm``, ``temporal_ms``
        (NaN for Straight, which the paper leaves out).

    Raises
    ------
    InputError
        If the tracks are not at 1000 Hz, or a particle is missing in a frame.
    """
    _check_1000(bodies)
    observed = PHASE.observe(bodies)
    names, last = ["velocity_x_mm_s", "velocity_y_mm_s"], observed.last
    if set(names) <= set(bodies.columns):
        known = bodies[["particle", "time_s", *names]]
        last = last.drop(columns=names).merge(known, on=["particle", "time_s"], how="left")
    frames = int(bodies["frame"].max()) + 1 if len(bodies) else 0
    tracked = last_states(rate_1000()(bodies, frames), TRUTH_S)
    tracked["particle"] = bodies["particle"].to_numpy()[tracked["row"]]
    tables = [
        deviations(SIM, last, observed.arrival),
        deviations(TRACKING, tracked, observed.arrival),
        deviations(STRAIGHT, last, observed.arrival),
    ]
    return pd.concat(tables, ignore_index=True)


def sampled(bodies: pd.DataFrame) -> pd.DataFrame:
    """Return the deviations of "sim" and "straight" on true positions at any rate.

    For the authors' public tracks: 100 Hz, ending at the edge, without velocities. The
    velocity is that of the parabola through the last three positions; nothing is tracked.
    """
    last, arrival, _ = UPSTREAM.observe(bodies)
    tables = [deviations(name, last, arrival, UPSTREAM) for name in (SIM, STRAIGHT)]
    return pd.concat(tables, ignore_index=True)


def track_pictures(pictures: Pictures, background_of: int = 200) -> PictureTracks:
    """Return what is measured in pictures and tracked: the whole way of the images (IV.B).

    Parameters
    ----------
    pictures
        A recording of the belt.
    background_of
        Pictures, evenly spread, that background and the area of one particle come from.

    Notes
    -----
    An empty belt gives empty tables. Its corners are found all the same, in a picture of the
    belt alone if nothing was ever fed. What rests for a part of the recording may leave a ghost
    or go unseen (`kilnflight.belt.pictures.average`). Either is a track at rest, or none: it never
    enters the prediction phase and is never predicted; who passes over a ghost is one spot with it.
    """
    step, frames = max(1, len(pictures) // background_of), max(1, len(pictures))
    background = average(pictures.frames(range(0, frames, step)))
    calibration = calibrate(FindCorners()(background))
    spots = _sized(pictures, background, 10 * step)
    measured = measure(pictures.frames(range(len(pictures))), background, spots, calibration)
    return PictureTracks(background, calibration, measured, BeltTracker()(measured, len(pictures)))


def _sized(pictures: Pictures, background: npt.NDArray[np.uint8], step: int) -> Spots:
    """Return what finds particles, with the area of one if there is any in the pictures.

    Every ``step``-th picture is taken, all of them if these show none.
    """
    usual = Spots()
    for numbers in (range(0, len(pictures), step), range(len(pictures))):
        if any(len(usual(picture, background)) for picture in pictures.frames(numbers)):
            return usual.calibrated(pictures.frames(numbers), background)
    return usual


def from_images(
    pictured: PictureTracks, bodies: pd.DataFrame, when: ArrivalModel = _CV
) -> pd.DataFrame:
    """Return the deviations of both approaches on images, columns as in `noise_free`.

    Each track is matched with the particle that it followed; "straight" starts from the last
    measurement itself, not from the filter. ``when`` predicts the time of "tracking".
    """
    arrival = PHASE.observe(bodies).arrival
    tracked = last_states(pictured.followed, BELT_FRAME_S)
    states = pictured.followed.states
    measured = states[states["row"] >= 0]
    pairs = match(measured, at_rate(bodies, 1 / BELT_FRAME_S)).set_index("particle")["truth"]
    tracked["particle"] = tracked["particle"].map(pairs)
    tracked = tracked.dropna(subset="particle").astype({"particle": np.int64})
    raw = tracked.assign(y=pictured.spots["y"].to_numpy()[tracked["row"]])
    tables = [
        deviations(TRACKING, tracked, arrival, when=when),
        deviations(STRAIGHT, raw, arrival),
    ]
    return pd.concat(tables, ignore_index=True)


def match(states: pd.DataFrame, truth: pd.DataFrame) -> pd.DataFrame:
    """Return the true particle of each track: the one with the least distance function.

    Parameters
    ----------
    states
        Tracks: ``frame``, ``particle``, ``x``, ``y``, as `kilnflight.tables.BELT_STATES`.
    truth
        The same columns of the particles, in the same frames.

    Returns
    -------
    DataFrame
        ``particle`` (the track), ``truth``, ``rms_mm`` (root of the mean squared distance). A
        track that no particle accompanies in all of its frames has no row.

    Notes
    -----
    The function is "the euclidean norm of the euclidean distances between all estimated
    positions and all corresponding ground truth positions". The paper does not say what counts
    for a particle that is not there in some of the frames; here it is no candidate. Two tracks
    may match the same particle.
    """
    check_columns(states, PLACED, "states")
    check_columns(truth, PLACED, "truth")
    frames, row = np.unique(truth["frame"].to_numpy(), return_inverse=True)
    names, column = np.unique(truth["particle"].to_numpy(), return_inverse=True)
    known = np.full((len(frames), len(names), 2), np.nan)  # NaN: not there in that frame
    known[row, column] = truth[["x", "y"]].to_numpy()
    rows = []
    for track, table in states[PLACED].groupby("particle"):
        if not table["frame"].isin(frames).all():
            continue
        there = known[np.searchsorted(frames, table["frame"])]
        squares = ((there - table[["x", "y"]].to_numpy()[:, None]) ** 2).sum(axis=(0, 2))
        if np.isfinite(squares).any():
            best = np.nanargmin(squares)
            rows.append((track, names[best], np.sqrt(squares[best] / len(table))))
    pairs = pd.DataFrame(rows, columns=["particle", "truth", "rms_mm"])
    return pairs.astype({"particle": np.int64, "truth": np.int64, "rms_mm": np.float64})


def deviations(
    approach: str,
    last: pd.DataFrame,
    arrival: pd.DataFrame,
    phase: PredictionPhase = PHASE,
    when: ArrivalModel = _CV,
) -> pd.DataFrame:
    """Return how far predictions with a constant lateral velocity, or straight ones, are off.

    Parameters
    ----------
    approach
        Its name; STRAIGHT keeps the lateral position and has no time.
    last, arrival
        `kilnflight.tables.BELT_LAST` and `kilnflight.tables.BELT_ARRIVAL`; what did not arrive
        is left out.
    phase, when
        Where the edge of the belt is, and what predicts the time.

    Returns
    -------
    DataFrame
        ``approach``, ``particle``; ``lateral_mm`` (prediction minus truth); ``temporal_ms``,
        positive where the particle has arrived earlier than predicted (Fig. 6). NaN where the
        velocity never leads there.
    """
    last = BELT_LAST.check(last[last["particle"].isin(arrival["particle"])])
    truth = BELT_ARRIVAL.check(arrival).set_index("particle").loc[last["particle"]]
    y, time = last["y"].to_numpy(), np.full(len(last), np.nan)
    if approach != STRAIGHT:
        moving = (last["velocity_x_mm_s"] > 0).to_numpy()
        time[moving] = when(last[moving], phase.target_mm)
        y = LateralCV()(last, time - last["time_s"].to_numpy())
    columns = {"approach": approach, "particle": last["particle"].to_numpy()}
    columns["lateral_mm"] = y - truth["y"].to_numpy()
    return pd.DataFrame(columns | {"temporal_ms": 1000.0 * (time - truth["time_s"].to_numpy())})


def rate_1000() -> BeltTracker:
    """Return the tracker at 1000 Hz without noise: the same per second, in more frames.

    A collision changes a velocity at once, by up to what particles differ in (433 mm/s). With
    exact positions the filter's state does not depend on this number, only the gate does.
    """
    usual, share = Appearance(), TRUTH_S / BELT_FRAME_S
    appearance = replace(
        usual,
        arrivals=share * usual.arrivals,
        entry_mm=share * usual.entry_mm,
        entry_blur_mm=share * usual.entry_blur_mm,
        clutter=share * usual.clutter,
    )
    motion = constant_velocity(TRUTH_S, NOISE_FREE_MM, 433.0 / TRUTH_S)
    return BeltTracker(motion, appearance, frame_s=TRUTH_S)


def with_acceleration(pictured: PictureTracks, frames: int) -> PictureTracks:
    """Return the same spots followed by the filter of constant acceleration."""
    return pictured._replace(followed=BeltTracker(constant_acceleration())(pictured.spots, frames))


def predicted(bodies: pd.DataFrame, table: pd.DataFrame) -> dict[str, int]:
    """Return how many particles were fed, and predicted by tracking: once or more, twice, never.

    Parameters
    ----------
    bodies
        The true tracks.
    table
        From `from_images` or `noise_free`: a row for each track that was predicted.
    """
    times = table.loc[table["approach"] == TRACKING, "particle"].value_counts()
    fed, known = int(bodies["particle"].nunique()), len(times)
    again = int((times > 1).sum())
    return {"fed": fed, "predicted": known, "predicted_twice": again, "not_predicted": fed - known}


def count_predicted(
    pictured: Mapping[str, PictureTracks], tracks: Mapping[str, pd.DataFrame], images: pd.DataFrame
) -> pd.DataFrame:
    """Return `predicted` by material: of all particles, and of those seen as one with another.

    ``images`` has ``material`` and the columns of `from_images`.
    """
    rows = []
    for material, bodies in tracks.items():
        truth = at_rate(bodies, 1 / BELT_FRAME_S)
        shared = particles_in_shared_spots(pictured[material].spots, truth)
        table = images[images["material"] == material]
        for label, names in (("all", bodies["particle"]), ("seen with another", shared)):
            fed, arrived = (part[part["particle"].isin(names)] for part in (bodies, table))
            rows.append({"material": material, "particles": label, **predicted(fed, arrived)})
    return pd.DataFrame(rows)


def compare_filters(
    pictured: Mapping[str, PictureTracks], tracks: Mapping[str, pd.DataFrame]
) -> pd.DataFrame:
    """Return deviations from images by filter: constant velocity, constant acceleration.

    Returns
    -------
    DataFrame
        ``material``, ``filter``, ``n``; median and interquartile range of both deviations.
    """
    rows = []
    for material, measured in pictured.items():
        other = with_acceleration(measured, 1 + int(measured.spots["frame"].max()))
        for name, spots, when in (
            ("constant velocity", measured, CV()),
            ("constant acceleration, velocity kept", other, CV()),
            ("constant acceleration", other, CA()),
        ):
            table = from_images(spots, tracks[material], when)
            box = summaries(table[table["approach"] == TRACKING]).set_index("quantity")
            row = {"material": material, "filter": name, "n": int(box["n"].iloc[0])}
            rows.append(row | {f"{q}_{v}": box[v][q] for q in box.index for v in ("median", "iqr")})
    return pd.DataFrame(rows)


def shares_within(table: pd.DataFrame) -> pd.DataFrame:
    """Return the share of predictions off by less than 0.2 mm and than 1.5 mm, and their number.

    ``table`` has ``material``, ``data``, ``approach`` and ``lateral_mm``.
    """
    off = table["lateral_mm"].abs()
    within = table.assign(within_02_mm=off < 0.2, within_15_mm=off < 1.5, n=1)
    keys = ["material", "data", "approach"]
    parts = within.groupby(keys, sort=False)[["within_02_mm", "within_15_mm", "n"]]
    return parts.agg({"within_02_mm": "mean", "within_15_mm": "mean", "n": "size"})


def judge_materials(parts: Mapping[tuple[str, str], pd.DataFrame]) -> pd.DataFrame:
    """Return what the claims' criteria say of each source and material.

    Parameters
    ----------
    parts
        By source and material: what `tracking_answers` takes.

    Returns
    -------
    DataFrame
        ``id``, ``material``, ``source``, ``criterion_holds`` (yes, no), ``measured``,
        ``criterion``. Claims about images have the source "own pictures, 200 frames/s".
    """
    rows = []
    for (source, material), table in parts.items():
        for claim, answer in tracking_answers(table).items():
            verdict = claims.judge(claim, answer)
            holds = "yes" if verdict.verdict == claims.REPRODUCED else "no"
            of_images = claim in ("belt16-3", "belt16-5")
            where = "own pictures, 200 frames/s" if of_images else source
            row = {"id": claim, "material": material, "source": where, "criterion_holds": holds}
            rows.append(row | {"measured": verdict.measured, "criterion": verdict.criterion})
    return pd.DataFrame(rows).sort_values("id", kind="stable", ignore_index=True)


def summaries(table: pd.DataFrame) -> pd.DataFrame:
    """Return the box plots of Fig. 6: one row per what tells rows apart and quantity.

    Parameters
    ----------
    table
        ``approach``, ``lateral_mm``, ``temporal_ms`` and whatever else (material, data).
    """
    values = ["lateral_mm", "temporal_ms"]
    names = [name for name in table.columns if name not in (*values, "particle")]
    rows = []
    for key, part in table.groupby(names, sort=False):
        for quantity in values:
            if part[quantity].notna().any():
                known = dict(zip(names, key, strict=True)) | {"quantity": quantity}
                rows.append(known | summarise(part[quantity].to_numpy()))
    return pd.DataFrame(rows)


def _check_1000(bodies: pd.DataFrame) -> None:
    """Raise an `InputError` unless frame k is at k ms and each particle is in all of its frames."""
    table = BELT_TRACKS.check(bodies).sort_values(["particle", "frame"], ignore_index=True)
    late = np.abs(table["time_s"].to_numpy() - TRUTH_S * table["frame"].to_numpy())
    if (late > 1e-6).any():
        row = table.iloc[int(np.argmax(late > 1e-6))]
        raise InputError(
            f"noise_free: frame {row['frame']:.0f} is at {row['time_s']:.6f} s; frame k must be at "
            "k ms. Take tracks at 1000 Hz, counted from 0 s, as of belt_2016.bodies. The authors' "
            "public tracks have 100 Hz; kilnflight.experiments.belt_2020 evaluates them."
        )
    steps = table.groupby("particle")["frame"].diff().dropna()
    if (steps != 1).any():
        who = table.loc[steps.index[(steps != 1).to_numpy()][0]]
        raise InputError(
            f"noise_free: particle {who['particle']:.0f} skips or repeats a frame before frame "
            f"{who['frame']:.0f}; the tracker takes a gap for a loss. Leave such particles out."
        )


def particles_in_shared_spots(
    spots: pd.DataFrame, truth: pd.DataFrame, area: Area = TRACKED
) -> npt.NDArray[np.int64]:
    """Return the particles whose nearest spot was marked as several, in any frame.

    Two particles that touch are one spot at their common centroid, and nothing tells the
    tracker so: each measurement goes to one track. What that costs is counted with the truth.

    Parameters
    ----------
    spots
        ``frame``, ``x``, ``y``, ``touching``, as `kilnflight.tables.BELT_SPOTS`.
    truth
        ``frame``, ``particle``, ``x``, ``y`` of the particles in the same frames.
    area
        Only places in it count.

    Returns
    -------
    ndarray
        Their names, each once, ascending; none where there is no spot.
    """
    check_columns(spots, ["frame", "x", "y", "touching"], "spots")
    check_columns(truth, ["frame", "particle", "x", "y"], "truth")
    inside = truth[area.holds(truth[["x", "y"]].to_numpy(np.float64))]
    inside = inside[inside["frame"].isin(spots["frame"])]
    several = spots["touching"].to_numpy()[_nearest(inside, spots)] == 1
    return np.unique(inside["particle"].to_numpy(np.int64)[several])


def place_errors(spots: pd.DataFrame, truth: pd.DataFrame) -> dict[str, float]:
    """Return how far the places of single particles are off, spot minus nearest true centre.

    Parameters
    ----------
    spots
        ``frame``, ``x``, ``y``, ``touching``; those that are marked as several do not count.
    truth
        ``frame``, ``x``, ``y`` of the particles; a frame without any does not count.

    Returns
    -------
    dict
        ``bias_along_mm``, ``rms_along_mm``, ``bias_across_mm``, ``rms_across_mm`` (of the error
        itself, so that the bias is part of it); NaN where no spot counts.
    """
    check_columns(spots, ["frame", "x", "y", "touching"], "spots")
    check_columns(truth, ["frame", "x", "y"], "truth")
    single = spots[(spots["touching"] == 0) & spots["frame"].isin(truth["frame"])]
    nearest = truth.iloc[_nearest(single, truth)]
    errors = {}
    for name, column in (("along", "x"), ("across", "y")):
        off = pd.Series(single[column].to_numpy(float) - nearest[column].to_numpy(float))
        errors[f"bias_{name}_mm"] = float(off.mean())
        errors[f"rms_{name}_mm"] = float((off**2).mean() ** 0.5)
    return errors


def _nearest(table: pd.DataFrame, others: pd.DataFrame) -> npt.NDArray[np.intp]:
    """Return for each row which row of ``others`` is nearest to it in the same frame."""
    if not len(table):
        return np.empty(0, dtype=np.intp)
    places, known = (
        part[["frame", "x", "y"]].to_numpy(np.float64) * [APART_MM, 1.0, 1.0]
        for part in (table, others)
    )
    return np.asarray(KDTree(known).query(places)[1])


def tracking_answers(table: pd.DataFrame) -> dict[str, Answer]:
    """Return the answers to belt16-1 to belt16-5 that a table has data for.

    "Very similar" is read as not half as much again, "far worse" as more than twice as much.

    Parameters
    ----------
    table
        Of one material: ``data`` ("noise-free" or "images"), ``approach``, ``lateral_mm``,
        ``temporal_ms``, as `noise_free` and `from_images` give them.
    """
    off = table.set_index(["data", "approach"])["lateral_mm"].abs().sort_index()
    box = summaries(table[["data", "approach", "lateral_mm", "temporal_ms"]])
    box = box.set_index(["quantity", "data", "approach"]).sort_index()
    there = set(off.index)
    answers: dict[str, Answer] = {}
    if ("noise-free", SIM) in there:
        answers["belt16-1"] = pd.Series({"": (off["noise-free", SIM] < 0.2).mean()})
    if {("noise-free", name) for name in (SIM, TRACKING, STRAIGHT)} <= there:
        answers["belt16-2"] = _narrower(box["iqr"]["lateral_mm", "noise-free"])
    if ("images", TRACKING) in there:
        answers["belt16-3"] = pd.Series({"": (off["images", TRACKING] < 1.5).mean()})
    if ("noise-free", SIM) in there:
        answers["belt16-4"] = box["median"]["temporal_ms", "noise-free"]
    if {("images", TRACKING), ("noise-free", TRACKING)} <= there:
        answers["belt16-5"] = _larger(box["iqr"]["temporal_ms"], box["median"]["temporal_ms"])
    return answers


def _narrower(iqr: pd.Series) -> dict[str, bool]:
    """Return the conditions of belt16-2 from the lateral spread by approach."""
    sim, free, straight = (float(iqr[name]) for name in (SIM, TRACKING, STRAIGHT))
    return {
        f"Tracking {free:.3f} mm, Sim {sim:.3f} mm": free < 1.5 * sim,
        f"Straight {straight:.3f} mm": straight > 2 * max(sim, free),
    }


def _larger(iqr: pd.Series, median: pd.Series) -> dict[str, bool]:
    """Return the conditions of belt16-5 from spread and median by data and approach."""
    larger = {}
    for name, value in (("spread", iqr), ("bias", median.abs())):
        images, free = value["images", TRACKING], value["noise-free", TRACKING]
        larger[f"{name} from images {images:.2f}, noise-free {free:.2f} ms"] = bool(images > free)
    return larger
