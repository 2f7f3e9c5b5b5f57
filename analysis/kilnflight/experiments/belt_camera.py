"""Tracks from pictures of the belt, and their errors (2016 paper, section IV.B)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.spatial import KDTree
from tqdm import tqdm

from kilnflight.belt.camera import TRACKED, Calibration, FindCorners, Picture, calibrate_camera
from kilnflight.belt.pictures import Average, MeasureSpots, Spots, spots_table
from kilnflight.belt.tracker import BELT_FRAME_S, BeltTracker, Followed, Likelihoods
from kilnflight.checks import check_columns
from kilnflight.sorter.rendering import Pictures, at_rate, frames_together

Array = npt.NDArray[np.float64]

Integers = npt.NDArray[np.integer]
Look = Callable[[Picture, Picture, Array], Array]
FRAME_OFFSET_MM = 1e6  # a frame apart counts as this distance: more than any belt is long
_SPOTS, _NONE = Spots(), np.empty(0)


class PictureTracks(NamedTuple):
    """Measurements in the camera's pictures, and their tracks."""

    background: Picture
    calibration: Calibration
    spots: pd.DataFrame  # kilnflight.tables.BELT_SPOTS
    followed: Followed
    looks: Array = _NONE  # of each spot, if it was asked how they look


def track_pictures(
    pictures: Pictures, background_of: int = 200, spots: Spots = _SPOTS
) -> PictureTracks:
    """Calibrate, measure and track in pictures of the belt (IV.B).

    Parameters
    ----------
    pictures
        A recording of the belt.
    background_of
        Number of pictures, evenly spread, for the background and the area of one particle.
    spots
        How spots are found, without that area.

    Notes
    -----
    An empty belt gives empty tables; its corners are found all the same. A particle that rests
    for a part of the recording may leave a ghost or be missed
    (`kilnflight.belt.pictures.average`). A ghost is a track at rest, which never enters the
    prediction phase and is never predicted. A particle that passes over it is one spot with it.
    """
    return track_together([pictures], background_of, [spots])[0][0]


def track_together(
    pictures: Sequence[Pictures],
    background_of: int = 200,
    spots: Sequence[Spots] = (_SPOTS,),
    look: Look | None = None,
) -> list[list[PictureTracks]]:
    """Return `track_pictures` of each recording, by each way to find spots.

    Pictures are made once for all ways, and of all recordings frame by frame: those of one seed
    share their noise, most of the work.

    Parameters
    ----------
    pictures
        Recordings.
    background_of
        See `track_pictures`.
    spots
        Ways to find spots.
    look
        Returns how the spots look, (n,), from a picture, the background and ``row`` and ``col``.
    """
    watched = [_Watched(each, spots, look) for each in pictures]
    steps = [max(1, len(each) // background_of) for each in pictures]
    taken = [range(0, max(1, len(each)), step) for each, step in zip(pictures, steps, strict=True)]
    for which, frame, picture in frames_together(pictures, taken):
        watched[which].add(frame, picture, is_sample=frame % (10 * steps[which]) == 0)
    for each in watched:
        each.calibrate()
    every = frames_together(pictures, [range(len(each)) for each in pictures])
    total = sum(map(len, pictures))
    for which, frame, picture in tqdm(every, "pictures", total, unit="picture", disable=None):
        watched[which].measure(frame, picture)
    return [each.tracks() for each in watched]


class _Watched:
    """A recording while its pictures come: all for the background first, then all."""

    def __init__(self, pictures: Pictures, spots: Sequence[Spots], look: Look | None) -> None:
        self.pictures, self.spots, self.look = pictures, spots, look
        self.average, self.samples = Average(), list[Picture]()
        self.measures: list[MeasureSpots] = []
        self.found: list[list[Array]] = [[] for _ in spots]
        self.looks: list[list[Array]] = [[_NONE] for _ in spots]

    def add(self, frame: int, picture: Picture, is_sample: bool) -> None:
        """Take a picture for the background; samples are for the area of one particle, too."""
        self.average.add(picture)
        if is_sample and frame < len(self.pictures):
            self.samples.append(picture)

    def calibrate(self) -> None:
        """Set background, calibration and the area of one particle."""
        background = self.average.picture()
        calibration = calibrate_camera(FindCorners()(background))
        sized = [_sized(each, self.pictures, background, self.samples) for each in self.spots]
        self.measures = [MeasureSpots(background, each, calibration) for each in sized]
        self.samples = []

    def measure(self, frame: int, picture: Picture) -> None:
        """Find the spots of the next picture, and how they look."""
        for number, measure in enumerate(self.measures):
            rows = measure(picture, frame)
            self.found[number].append(rows)
            if self.look is not None:
                looks = self.look(picture, measure.background, rows[:, :2])
                self.looks[number].append(looks)

    def tracks(self) -> list[PictureTracks]:
        """Return what was found, followed, for each way to find spots."""
        results = []
        for measure, found, looks in zip(self.measures, self.found, self.looks, strict=True):
            spots = spots_table(found)
            followed = BeltTracker()(spots, len(self.pictures))
            parts = measure.background, measure.calibration, spots, followed
            results.append(PictureTracks(*parts, np.concatenate(looks)))
        return results


def _sized(
    spots: Spots, pictures: Pictures, background: Picture, samples: Sequence[Picture]
) -> Spots:
    """Return spots with the area of one particle, if the pictures show any.

    Samples are taken, all of the pictures if these show none.
    """
    if any(len(spots(picture, background)) for picture in samples):
        return spots.calibrated(samples, background)
    numbers = range(len(pictures))
    if any(len(spots(picture, background)) for picture in pictures.frames(numbers)):
        return spots.calibrated(pictures.frames(numbers), background)
    return spots


def particles_in_shared_spots(spots: pd.DataFrame, truth: pd.DataFrame) -> Integers:
    """Return the particles whose nearest spot was marked as several, in any frame.

    Two particles that touch are one spot at their common centroid. The tracker does not know that,
    and each measurement goes to one track. The truth shows what that costs.

    Parameters
    ----------
    spots
        ``frame``, ``x``, ``y``, ``touching``, as `kilnflight.tables.BELT_SPOTS`.
    truth
        ``frame``, ``particle``, ``x``, ``y`` of the particles in the same frames; only places
        in `kilnflight.belt.camera.TRACKED` count.

    Returns
    -------
    ndarray
        Their numbers, each once, ascending; empty where there is no spot.
    """
    check_columns(spots, ["frame", "x", "y", "touching"], "spots")
    check_columns(truth, ["frame", "particle", "x", "y"], "truth")
    inside = truth[TRACKED.contains(truth[["x", "y"]].to_numpy(np.float64))]
    inside = inside[inside["frame"].isin(spots["frame"])]
    several = spots["touching"].to_numpy()[_nearest(inside, spots)] == 1
    return np.unique(inside["particle"].to_numpy(np.int64)[several])


def place_errors(spots: pd.DataFrame, truth: pd.DataFrame) -> dict[str, float]:
    """Return place errors of single particles, spot minus nearest true centre.

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
        error = pd.Series(single[column].to_numpy(float) - nearest[column].to_numpy(float))
        errors[f"bias_{name}_mm"] = float(error.mean())
        errors[f"rms_{name}_mm"] = float((error**2).mean() ** 0.5)
    return errors


def describe_pictures(
    pictured: Mapping[str, PictureTracks], tracks: Mapping[str, pd.DataFrame]
) -> pd.DataFrame:
    """Return by material calibration, `place_errors`, and counts of tracks by end."""
    rows = []
    for material, (_, calibration, spots, followed, _) in pictured.items():
        row = {"material": material, "mm_per_px": calibration.mm_per_px}
        row |= {"corner_error_mm": calibration.error_mm, "hidden_corners": calibration.hidden}
        row |= place_errors(spots, at_rate(tracks[material], 1 / BELT_FRAME_S))
        row |= {"spots": len(spots), "touching_percent": 100 * spots["touching"].mean()}
        ends = followed.ends.query("valid == 1")["reason"].value_counts()
        rows.append(row | {"never_valid": (followed.ends["valid"] == 0).sum()} | dict(ends))
    return pd.DataFrame(rows).fillna(0)


def matrix_of_frame(spots: pd.DataFrame) -> tuple[pd.DataFrame, Integers]:
    """Return Fig. 3 of the first frame with at least five tracks and measurements.

    At least five of each.

    Returns
    -------
    DataFrame
        -ln of the likelihoods, NaN where impossible. Rows: the tracks, then ``new`` for each
        measurement. Columns: the measurements, then ``unobserved`` for each track.
    ndarray
        The measurement of each track in the likeliest association, -1: none.
    """
    tracker = BeltTracker()
    steps = tracker.steps(spots)
    step = next(step for step in steps if min(step.pairs.distance_squared.shape) >= 5)
    likelihoods = tracker.likelihoods(step.predicted, step.detected, step.pairs)
    matrix, (n, m) = whole_matrix(likelihoods), likelihoods.costs.shape
    rows = [f"track {name}" for name in step.tracks["particle"][:n]] + ["new"] * m
    columns = [f"z{k + 1}" for k in range(m)] + ["unobserved"] * n
    matrix = np.where(np.isinf(matrix), np.nan, matrix)
    return pd.DataFrame(matrix, rows, columns), likelihoods.detection()


def _nearest(table: pd.DataFrame, others: pd.DataFrame) -> npt.NDArray[np.intp]:
    """Return for each row which row of ``others`` is nearest to it in the same frame."""
    if not len(table):
        return np.empty(0, dtype=np.intp)
    places, other_places = (
        part[["frame", "x", "y"]].to_numpy(np.float64) * [FRAME_OFFSET_MM, 1.0, 1.0]
        for part in (table, others)
    )
    return np.asarray(KDTree(other_places).query(places)[1])


def whole_matrix(likelihoods: Likelihoods) -> Array:
    """Return the matrix of Fig. 3, (n + m, m + n), inf where a pair is impossible.

    Notes
    -----
    Rows n on are "new", each for one measurement; columns m on are "not observed", each for
    one track. The paper leaves open the corner of both. Here it is 0 (likelihood 1), so that
    it adds nothing to any solution.
    """
    n, m = likelihoods.costs.shape
    whole = np.full((n + m, m + n), np.inf)
    whole[:n, :m] = likelihoods.costs
    whole[n + np.arange(m), np.arange(m)] = -np.log(likelihoods.new)
    whole[np.arange(n), m + np.arange(n)] = -np.log(likelihoods.unobserved)
    whole[n:, m:] = 0.0
    return whole
