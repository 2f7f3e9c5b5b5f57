"""Pictures of particles on the belt, and spots in them (2016 paper, II.B, IV.B).

Pictures are rendered on demand: particles are drawn from true places with their shape and
direction, soft edges and noise. The measurement (`average`, `Spots`, `measure_spots`) sees the
pictures alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Self

import cv2
import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.belt.camera import BELT, TRACKED, Area, Calibration, CameraView
from kilnflight.belt.machine import Bulk
from kilnflight.checks import InputError, check_at_least, check_columns, check_positive
from kilnflight.tables import BELT_SPOTS, BELT_TRACKS

Array = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]

MARGIN_MM = 10.0  # more than the longest particle's half, so that none is cut
_VIEW = CameraView()


@dataclass(frozen=True)
class Pictures:
    """Pictures of tracks, one per frame of the camera.

    ``pictures[k]`` renders frame k.

    Frame k is taken at k / frames_per_s; a particle is seen where the tracks have a row at
    that time. The same seed gives the same bytes, in any order.
    """

    tracks: pd.DataFrame  # BELT_TRACKS; z and angle_rad of BELT_BODIES too, if known
    bulk: Bulk
    seed: int
    view: CameraView = _VIEW
    belt_gray: float = 60.0  # of 255; assumption, as are the next: a dark belt
    floor_gray: float = 130.0  # beside the belt
    particle_gray: float = 200.0  # wood
    noise_gray: float = 3.0  # standard deviation, new in each frame
    soft_px: float = 1.0  # width of an edge

    def __post_init__(self) -> None:
        """Raise an error for invalid tracks and for pictures without edges or contrast."""
        BELT_TRACKS.check(self.tracks)
        check_at_least(self.noise_gray, 0, "Pictures: noise_gray")
        check_positive(self.soft_px, "Pictures: soft_px")

    def __len__(self) -> int:
        """Return the number of frames up to the last time of the tracks."""
        if not len(self.tracks):
            return 0
        return 1 + int(np.floor(self.tracks["time_s"].max() * self.view.frames_per_s + 1e-6))

    def __getitem__(self, frame: int) -> Picture:
        """Return the picture (rows, cols) of one frame."""
        return next(self.frames([frame]))

    def frames(self, numbers: Iterable[int]) -> Iterator[Picture]:
        """Yield the pictures of the requested frames, in that order."""
        visible = at_rate(self.tracks, self.view.frames_per_s)
        visible = visible.sort_values("frame", kind="stable")
        frame, outlines, empty = visible["frame"].to_numpy(), self._outlines(visible), self._empty()
        noise = np.empty(empty.shape, dtype=np.float32)
        for number in numbers:
            first, last = np.searchsorted(frame, [number, number + 1])
            picture = empty.copy()
            self._draw(picture, outlines[first:last])
            rng = np.random.default_rng([self.seed, 1, number])
            rng.standard_normal(dtype=np.float32, out=noise)
            noise *= np.float32(self.noise_gray)
            picture += noise
            yield np.rint(picture, out=picture).clip(0, 255, out=picture).astype(np.uint8)

    def _outlines(self, visible: pd.DataFrame) -> Array:
        """Return row, col, direction, half length, half width and corner in px, (n, 6)."""
        x, y, angle = visible["x"].to_numpy(), visible["y"].to_numpy(), self._angles(visible)
        height = np.full(len(visible), self.bulk.rest_mm)
        if "z" in visible.columns:
            height = visible["z"].to_numpy(np.float64)
        middle = self.view.pixels(np.column_stack([x, y, height]))
        tip = np.column_stack([x + np.cos(angle), y + np.sin(angle), height])  # 1 mm ahead
        along = self.view.pixels(tip) - middle
        scale = np.hypot(along[:, 0], along[:, 1])  # px per mm
        direction = np.arctan2(along[:, 0], along[:, 1])
        return np.column_stack([middle, direction, scale[:, None] * self.bulk.outline_mm])

    def _angles(self, visible: pd.DataFrame) -> Array:
        """Return the direction of each row; one per particle, drawn, where none is known."""
        if "angle_rad" in visible.columns:
            return visible["angle_rad"].to_numpy(np.float64)
        names, which = np.unique(visible["particle"].to_numpy(), return_inverse=True)
        return np.random.default_rng([self.seed, 2]).uniform(0, np.pi, len(names))[which]

    def _empty(self) -> npt.NDArray[np.float32]:
        """Return the belt without particles, its edges soft."""
        shape = self.view.rows, self.view.cols
        row, col = np.ogrid[: shape[0], : shape[1]]
        corners = self.view.pixels(np.column_stack([BELT.corners, np.zeros(4)]))
        inside = np.full(shape, np.inf)
        for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            down, right = end - start
            away = right * (row - start[0]) - down * (col - start[1])
            np.minimum(inside, away / np.hypot(down, right), out=inside)
        picture = np.full(shape, self.floor_gray, dtype=np.float32)
        _blend(picture, self.belt_gray, 0.5 + inside / self.soft_px)
        texture = np.random.default_rng([self.seed, 0]).standard_normal(shape)
        return (picture + 2.0 * texture).astype(np.float32)

    def _draw(self, picture: npt.NDArray[np.float32], outlines: Array) -> None:
        """Draw rectangles with round corners; where two overlap the later one is on top."""
        for row, col, angle, length, width, corner in outlines:
            reach = np.hypot(length, width) + self.soft_px + 1.0
            window = tuple(
                slice(max(0, int(middle - reach)), max(0, int(middle + reach) + 2))
                for middle in (row, col)
            )
            below, right = np.ogrid[window]
            below, right = below - row, right - col
            c, s = np.cos(angle), np.sin(angle)
            u = np.abs(right * c + below * s) - (length - corner)
            v = np.abs(below * c - right * s) - (width - corner)
            outside = np.hypot(np.maximum(u, 0.0), np.maximum(v, 0.0))
            distance = outside + np.minimum(np.maximum(u, v), 0.0) - corner
            part = picture[window]
            share = 0.5 - distance[: part.shape[0], : part.shape[1]] / self.soft_px
            _blend(part, self.particle_gray, share)


def _blend(picture: npt.NDArray[np.float32], gray: float, share: Array) -> None:
    """Mix a share (0 to 1, cut off) of a grey value into a picture, in place."""
    picture += share.clip(0.0, 1.0) * (gray - picture.astype(np.float64))


def at_rate(tracks: pd.DataFrame, frames_per_s: float) -> pd.DataFrame:
    """Return the rows at the times of a slower camera, with its frames.

    Raises
    ------
    InputError
        If the tracks have no rows at such times, as 100 Hz for a camera of 200 frames/s, or the
        rate is not above 0.
    """
    check_positive(frames_per_s, "at_rate: frames_per_s")
    check_columns(tracks, BELT_TRACKS.names, BELT_TRACKS.name)
    exact = tracks["time_s"].to_numpy() * frames_per_s
    frame = np.rint(exact).astype(np.int64)
    kept = np.abs(exact - frame) < 1e-3
    ordered = tracks.assign(frame=frame)[kept].sort_values(["particle", "frame"])
    step = ordered.groupby("particle")["frame"].diff()
    if len(tracks) and (not kept.any() or (step > 1).mean() > 0.5):
        raise InputError(
            f"the tracks have no rows {frames_per_s:g} times a second; give tracks sampled at a "
            "multiple of that rate."
        )
    return ordered.reset_index(drop=True)


def average(pictures: Iterable[Picture]) -> Picture:
    """Return the mean of pictures, "the constant background" (section II.B).

    A particle that rests in all of them is part of the background and never found. One that rests
    in a share s of the pictures has s times its contrast c in the mean. By the threshold t of
    `Spots` it is found while it lies if (1 - s) c > t. Afterwards its place is found as a ghost,
    which never moves, if s c > t. For wood on a dark belt c is 140 and t is 40 grey values: no
    ghost below s = 0.29, not found above s = 0.71, both in between.
    """
    total, count = np.zeros(0), 0
    for picture in pictures:
        if picture.dtype != np.uint8 or (count and picture.shape != total.shape):
            raise InputError(
                f"picture {count}: {picture.dtype} of shape {picture.shape}; the background "
                "needs pictures of uint8, all of one shape."
            )
        total = total + picture if count else picture.astype(np.float64)
        count += 1
    if not count:
        raise InputError("no picture to take the background from; give at least one.")
    return np.rint(total / count).astype(np.uint8)


@dataclass(frozen=True)
class Spots:
    """Connected areas that differ from the background.

    One area is one particle or several.

    Particles that touch are one spot at their common centroid. Spots that are larger than
    ``touching_from`` times a single particle are marked and kept.

    Notes
    -----
    Section II.B names connected components and centroids, neither threshold nor sizes.
    """

    threshold: float = 40.0  # grey values of 255, above any noise of a camera; not printed
    least_px: float = 12.0  # smaller is noise: a disc of 1.7 mm across; not printed
    touching_from: float = 1.5  # of a single particle's area: half-way between one and two
    single_px: float = np.inf  # area of one particle, from calibration; inf: mark none

    def __post_init__(self) -> None:
        """Refuse settings that find everything or nothing."""
        check_positive(self.threshold, "Spots: threshold")
        check_at_least(self.least_px, 1, "Spots: least_px")
        check_at_least(self.touching_from, 1, "Spots: touching_from")
        if self.single_px != np.inf:
            check_positive(self.single_px, "Spots: single_px")

    def __call__(self, picture: Picture, background: Picture) -> Array:
        """Return row, col, area in px and whether several touch (1.0 or 0.0), (n, 4)."""
        if picture.shape != background.shape or picture.dtype != np.uint8:
            raise InputError(
                f"picture {picture.dtype} {picture.shape} and background {background.shape} do "
                "not fit; pass uint8 of one shape."
            )
        differs = cv2.absdiff(picture, background)
        _, mask = cv2.threshold(differs, self.threshold, 255, cv2.THRESH_BINARY)
        # The algorithm by Grana: with few, small spots three times as fast as the default.
        _, _, stats, centroids = cv2.connectedComponentsWithStatsWithAlgorithm(
            mask, 8, cv2.CV_32S, cv2.CCL_GRANA
        )
        area = stats[1:, cv2.CC_STAT_AREA].astype(np.float64)
        several = area > self.touching_from * self.single_px
        return np.column_stack([centroids[1:, ::-1], area, several])[area >= self.least_px]

    def calibrated(self, pictures: Iterable[Picture], background: Picture) -> Self:
        """Take the median area of all spots as that of one particle.

        Raises
        ------
        InputError
            If there is no spot in any of the pictures.
        """
        areas = [self(picture, background)[:, 2] for picture in pictures]
        if not sum(map(len, areas)):
            raise InputError(
                "Spots: no particle in the pictures to calibrate with; take some of a loaded belt."
            )
        return replace(self, single_px=float(np.median(np.concatenate(areas))))


def measure_spots(
    pictures: Iterable[Picture],
    background: Picture,
    spots: Spots,
    calibration: Calibration,
    area: Area = TRACKED,
) -> pd.DataFrame:
    """Return the spots of consecutive pictures in millimetres on the belt.

    Parameters
    ----------
    pictures
        Frames 0, 1, ... as uint8 arrays.
    background, spots, calibration
        From `average`, `Spots.calibrated` and `kilnflight.belt.camera.calibrate`.
    area
        Spots with their centroid in it are kept. Pictures are cut to it and a margin, which shows a
        particle at its border whole.

    Returns
    -------
    DataFrame
        `kilnflight.tables.BELT_SPOTS`; no rows for an empty belt.
    """
    window = calibration.window(area, MARGIN_MM / calibration.mm_per_px, background.shape)
    empty = np.ascontiguousarray(background[window])
    parts = [np.empty((0, 5))]
    for frame, picture in enumerate(pictures):
        if picture.shape != background.shape:
            raise InputError(
                f"frame {frame}: shape {picture.shape}, but the background has "
                f"{background.shape}. Take both with the same camera."
            )
        rows = spots(picture[window], empty)
        parts.append(np.column_stack([np.full(len(rows), frame), rows]))
    every = np.concatenate(parts)
    every[:, 1:3] += window[0].start, window[1].start
    places = calibration.millimetres(every[:, 1:3])
    table = pd.DataFrame(np.column_stack([every, places]), columns=BELT_SPOTS.names)
    table = table.astype({"frame": np.int64, "touching": np.int64})
    return table[area.contains(places)].reset_index(drop=True)
