"""The evaluation of predictive tracking, written out once (2016 paper, section IV).

bodies -> velocity of the simulation, tracking, straight     (noise-free, Figs 6a and 6c)
       -> pictures -> spots -> tracking, straight            (images, Figs 6b and 6d)
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.belt import physics, simulation
from kilnflight.belt.appearance import Appearance
from kilnflight.belt.area import BELT, TRACKED
from kilnflight.belt.arrival import CV, ArrivalModel
from kilnflight.belt.corners import FindCorners
from kilnflight.belt.crossing import deviations, last_states
from kilnflight.belt.deviation import summarise
from kilnflight.belt.friction import MATERIALS
from kilnflight.belt.homography import Calibration, calibrate
from kilnflight.belt.matching import match
from kilnflight.belt.phase import PredictionPhase
from kilnflight.belt.pictures import Pictures, at_rate
from kilnflight.belt.spots import Spots, average, measure
from kilnflight.belt.tracker import (
    BELT_FRAME_S,
    BeltTracker,
    Followed,
    constant_acceleration,
    constant_velocity,
)
from kilnflight.checks import InputError, check_count
from kilnflight.tables import BELT_ARRIVAL, BELT_LAST, BELT_TRACKS

PHASE = PredictionPhase(TRACKED.end_mm, BELT.end_mm)  # the last 10 cm, section IV
# The same 10 cm where tracks end at the edge: 15 mm upstream, as in `PredictionPhase`.
UPSTREAM = PredictionPhase(PHASE.start_mm - 15.0, PHASE.target_mm - 15.0)
TRUTH_S = 0.001  # "the ground truth data was generated at 1000 Hz", section IV.B
NOISE_FREE_MM = 0.001  # standard deviation of a measurement without noise: none at all has no S
_CV = CV()
SIM, TRACKING, STRAIGHT = "Sim", "Tracking", "Straight"  # names of Fig. 6


def bodies(material: str, count: int, seed: int, jobs: int = 1) -> pd.DataFrame:
    """Return tracks at 1000 Hz: of the simulated sorter, or of the friction model without MuJoCo.

    The friction model feeds as many particles per second as the papers, about 270.

    Raises
    ------
    InputError
        If there is no such material, or the number is none.
    """
    if material not in MATERIALS:
        raise InputError(f"no material {material!r}; there are {', '.join(MATERIALS)}.")
    check_count(count, "bodies: count", least=0)
    if physics.is_installed():
        return simulation.tracks(material, count, seed, jobs)
    usual = MATERIALS[material]
    share = count / usual.particles
    fast = replace(usual, particles=count, feed_s=share * usual.feed_s, sampling_hz=1000.0)
    return replace(fast, steps_per_sample=2)(np.random.default_rng([seed, count]))


class Looked(NamedTuple):
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
    last = _with_velocity(observed.last, bodies)
    simulated = deviations(last, observed.arrival, PHASE.target_mm)
    frames = int(bodies["frame"].max()) + 1 if len(bodies) else 0
    followed = rate_1000()(bodies, frames)
    found = last_states(followed, TRUTH_S)
    found["particle"] = bodies["particle"].to_numpy()[found["row"]]
    tracked = _deviations(found, observed.arrival)
    return _table(
        (
            (SIM, simulated, "lateral_mm"),
            (TRACKING, tracked, "lateral_mm"),
            (STRAIGHT, simulated, "straight_mm"),
        )
    )


def sampled(bodies: pd.DataFrame, phase: PredictionPhase = UPSTREAM) -> pd.DataFrame:
    """Return the deviations of "sim" and "straight" on true positions at any rate.

    For the authors' public tracks: 100 Hz, ending at the edge, without velocities. The
    velocity is that of the parabola through the last three positions; nothing is tracked.
    """
    observed = phase.observe(bodies)
    simulated = deviations(observed.last, observed.arrival, phase.target_mm)
    return _table(((SIM, simulated, "lateral_mm"), (STRAIGHT, simulated, "straight_mm")))


def look(pictures: Pictures, background_of: int = 200) -> Looked:
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
    or go unseen (`kilnflight.belt.spots.average`). Either is a track at rest, or none: it never
    enters the prediction phase and is never predicted; who passes over a ghost is one spot with it.
    """
    step, frames = max(1, len(pictures) // background_of), max(1, len(pictures))
    background = average(pictures.frames(range(0, frames, step)))
    calibration = calibrate(FindCorners()(background))
    spots = _sized(pictures, background, 10 * step)
    seen = measure(pictures.frames(range(len(pictures))), background, spots, calibration)
    return Looked(background, calibration, seen, BeltTracker()(seen, len(pictures)))


def from_images(looked: Looked, bodies: pd.DataFrame, when: ArrivalModel = _CV) -> pd.DataFrame:
    """Return the deviations of both approaches on images, columns as in `noise_free`.

    Each track is matched with the particle that it followed; "straight" starts from the last
    measurement itself, not from the filter. ``when`` predicts the time of "tracking".
    """
    arrival = PHASE.observe(bodies).arrival
    found = last_states(looked.followed, BELT_FRAME_S)
    states = looked.followed.states
    measured = states[states["row"] >= 0]
    pairs = match(measured, at_rate(bodies, 1 / BELT_FRAME_S)).set_index("particle")["truth"]
    found["particle"] = found["particle"].map(pairs)
    found = found.dropna(subset="particle").astype({"particle": np.int64})
    tracked = _deviations(found, arrival, when)
    raw = found.assign(y=looked.spots["y"].to_numpy()[found["row"]])
    straight = _deviations(raw, arrival)
    return _table(((TRACKING, tracked, "lateral_mm"), (STRAIGHT, straight, "straight_mm")))


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
    fed, found = int(bodies["particle"].nunique()), len(times)
    again = int((times > 1).sum())
    return {"fed": fed, "predicted": found, "predicted_twice": again, "not_predicted": fed - found}


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
    for key, one in table.groupby(names, sort=False):
        for quantity in values:
            if one[quantity].notna().any():
                known = dict(zip(names, key, strict=True)) | {"quantity": quantity}
                rows.append(known | summarise(one[quantity].to_numpy()))
    return pd.DataFrame(rows)


def _sized(pictures: Pictures, background: npt.NDArray[np.uint8], step: int) -> Spots:
    """Return what finds particles, with the area of one if there is any in the pictures.

    Every ``step``-th picture is looked at, all of them if these show none.
    """
    usual = Spots()
    for wanted in (range(0, len(pictures), step), range(len(pictures))):
        if any(len(usual(one, background)) for one in pictures.frames(wanted)):
            return usual.calibrated(pictures.frames(wanted), background)
    return usual


def _check_1000(bodies: pd.DataFrame) -> None:
    """Raise an `InputError` unless frame k is at k ms and each particle is in all of its frames."""
    table = BELT_TRACKS.check(bodies).sort_values(["particle", "frame"], ignore_index=True)
    late = np.abs(table["time_s"].to_numpy() - TRUTH_S * table["frame"].to_numpy())
    if (late > 1e-6).any():
        row = table.iloc[int(np.argmax(late > 1e-6))]
        raise InputError(
            f"noise_free: frame {row['frame']:.0f} is at {row['time_s']:.6f} s; frame k must be at "
            "k ms. Take tracks at 1000 Hz, counted from 0 s, as of predictive.bodies. The authors' "
            "public tracks have 100 Hz; kilnflight.experiments.sorter evaluates them."
        )
    steps = table.groupby("particle")["frame"].diff().dropna()
    if (steps != 1).any():
        who = table.loc[steps.index[(steps != 1).to_numpy()][0]]
        raise InputError(
            f"noise_free: particle {who['particle']:.0f} skips or repeats a frame before frame "
            f"{who['frame']:.0f}; the tracker takes a gap for a loss. Leave such particles out."
        )


def _with_velocity(last: pd.DataFrame, bodies: pd.DataFrame) -> pd.DataFrame:
    """Return the last observations with the velocities of the simulation, where it has them."""
    names = ["velocity_x_mm_s", "velocity_y_mm_s"]
    if not set(names) <= set(bodies.columns):
        return last
    keys = ["particle", "time_s"]
    known = bodies[[*keys, *names]]
    return last.drop(columns=names).merge(known, on=keys, how="left")[BELT_LAST.names]


def with_acceleration(looked: Looked, frames: int) -> Looked:
    """Return the same spots followed by the filter of constant acceleration."""
    return looked._replace(followed=BeltTracker(constant_acceleration())(looked.spots, frames))


def _deviations(
    last: pd.DataFrame, arrival: pd.DataFrame, when: ArrivalModel = _CV
) -> pd.DataFrame:
    """Return the deviations of tracks whose particle arrived."""
    there = last[last["particle"].isin(arrival["particle"])]
    reference = arrival.set_index("particle").loc[there["particle"]].reset_index()
    return deviations(there[BELT_LAST.names], reference[BELT_ARRIVAL.names], PHASE.target_mm, when)


def _table(parts: tuple[tuple[str, pd.DataFrame, str], ...]) -> pd.DataFrame:
    rows = []
    for name, one, column in parts:
        temporal = np.nan if name == STRAIGHT else one["temporal_ms"]
        table = pd.DataFrame({"approach": name, "particle": one["particle"]})
        rows.append(table.assign(lateral_mm=one[column], temporal_ms=temporal))
    return pd.concat(rows, ignore_index=True)
