"""Synthetic pictures of particles on the belt (2016 paper, IV.B).

Pictures are rendered on demand: particles are drawn from true places with their shape
and direction, soft edges, motion blur and noise. What measures sees the pictures alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd
from numba import njit
from scipy.spatial.transform import Rotation

from kilnflight.arrays import Array, Picture, Single
from kilnflight.belt.camera import BELT
from kilnflight.checks import InputError, check_columns, check_number
from kilnflight.simulated.belt.bulk import Bulk
from kilnflight.tables import BELT_TRACKS


@dataclass(frozen=True)
class CameraView:
    """A pinhole camera above the middle of the belt, without distortion of the lens.

    Notes
    -----
    The paper gives the picture's size, its scale and its rate. Height and the small
    errors of mounting are assumptions. They make "an imperfect calibration" matter: a
    particle's centre lies above the plane that the belt's corners calibrate.
    """

    rows: int = 708  # px, section IV.B
    cols: int = 1064  # px, section IV.B
    mm_per_px: float = 0.44  # at the belt, section IV.B
    frames_per_s: float = 200.0  # section IV.B
    height_mm: float = 1000.0  # above the belt; assumption
    turned_deg: float = 0.3  # about its own axis; assumption: mounted by hand
    tilted_deg: float = 0.3  # against the vertical, along the belt; assumption

    def pixels(self, places: Array) -> Array:
        """Return row and col in px (n, 2) of places (n, 3).

        A place is x, y and height above the belt in mm.
        """
        angles = [self.turned_deg, self.tilted_deg]
        turn = Rotation.from_euler("ZY", angles, degrees=True).as_matrix()
        middle = BELT.corners.mean(axis=0)
        # From above: x to the right, y down, depth away from the camera.
        away = (
            np.column_stack([places[:, :2] - middle, self.height_mm - places[:, 2]])
            @ turn.T
        )
        # The camera is moved sideways so that the tilted axis still meets the belt's
        # middle.
        away[:, :2] -= turn[:2, 2] * self.height_mm
        scale = self.height_mm / self.mm_per_px / away[:, 2:]
        return (away[:, :2] * scale)[:, ::-1] + np.array(
            [self.rows - 1, self.cols - 1]
        ) / 2


_VIEW = CameraView()


@dataclass(frozen=True)
class Pictures:
    """Synthetic pictures (rows, cols) of tracks, one per frame of the camera.

    ``pictures[k]`` renders frame k.

    Frame k is taken at k / frames_per_s, the middle of its exposure; a particle is seen
    where the tracks have a row at that time. The same seed gives the same bytes, in any
    order.
    """

    tracks: (
        pd.DataFrame
    )  # BELT_TRACKS; angle_rad, if known: of a particle from the x axis
    bulk: Bulk
    seed: int
    view: CameraView = _VIEW
    belt_gray: float = 60.0  # of 255; assumption, as are the next: a dark belt
    floor_gray: float = 130.0  # beside the belt
    particle_gray: float = 200.0  # wood
    noise_gray: float = 3.0  # standard deviation, new in each frame
    soft_px: float = 1.0  # width of an edge
    exposure_s: float = (
        0.001  # not printed; assumption: 3.4 px of blur at the belt's speed
    )

    def __post_init__(self) -> None:
        """Check the tracks."""
        BELT_TRACKS.check(self.tracks)

    def __len__(self) -> int:
        """Return the number of frames up to the last time of the tracks."""
        if not len(self.tracks):
            return 0
        return 1 + int(
            np.floor(self.tracks["time_s"].max() * self.view.frames_per_s + 1e-6)
        )

    def __getitem__(self, frame: int) -> Picture:
        """Return the picture (rows, cols) of one frame."""
        return next(self.frames([frame]))

    def frames(self, numbers: Iterable[int]) -> Iterator[Picture]:
        """Yield the pictures of the requested frames, in that order."""
        visible = at_rate(self.tracks, self.view.frames_per_s)
        visible = visible.sort_values("frame", kind="stable")
        frame = visible["frame"].to_numpy()
        outlines = self._outlines(visible)
        empty = self._empty()
        for number in numbers:
            first, last = np.searchsorted(frame, [number, number + 1])
            picture = empty.copy()
            self._draw(picture, outlines[first:last])
            generator = np.random.default_rng([self.seed, 1, int(number)])
            noise = generator.standard_normal(empty.shape, dtype=np.float32)
            yield _rounded(picture, noise, np.float32(self.noise_gray))

    def _outlines(self, visible: pd.DataFrame) -> Array:
        """Return the outline (n, 8) of each particle in the picture.

        Columns are row, col, direction (rad, from right to down), half length, half
        width, corner radius, and the way during the exposure, down and right. Lengths
        are in px. ``visible`` has a row per particle and frame.
        """
        x = visible["x"].to_numpy()
        y = visible["y"].to_numpy()
        angle = self._angles(visible)
        height = np.full(len(visible), self.bulk.rest_mm)
        middle = self.view.pixels(np.column_stack([x, y, height]))
        ahead = np.column_stack([x, y]) + self.exposure_s * _velocities(visible)
        way = self.view.pixels(np.column_stack([ahead, height])) - middle
        tip = np.column_stack(
            [x + np.cos(angle), y + np.sin(angle), height]
        )  # 1 mm ahead
        along = self.view.pixels(tip) - middle
        scale = np.hypot(along[:, 0], along[:, 1])  # px per mm
        direction = np.arctan2(along[:, 0], along[:, 1])
        return np.column_stack(
            [middle, direction, scale[:, None] * self.bulk.outline_mm, way]
        )

    def _angles(self, visible: pd.DataFrame) -> Array:
        """Return each row's direction (n,) in rad; if unknown, one drawn per particle."""
        if "angle_rad" in visible.columns:
            return visible["angle_rad"].to_numpy(np.float64)
        names, which = np.unique(visible["particle"].to_numpy(), return_inverse=True)
        return np.random.default_rng([self.seed, 2]).uniform(0, np.pi, len(names))[
            which
        ]

    def _empty(self) -> npt.NDArray[np.float32]:
        """Return the picture (rows, cols) of the belt without particles, its edges
        soft.
        """
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
        """Draw rectangles with round corners into a picture (rows, cols), in place.

        ``outlines`` (n, 8) are from `_outlines`; where two overlap the later one is on
        top. Each is the mean of its places during the exposure, at most a pixel apart.
        """
        for row, col, angle, length, width, corner, down, ahead in outlines.tolist():
            reach = (
                math.hypot(length - corner, width - corner)
                + corner
                + self.soft_px
                + 1.0
            )
            window = tuple(
                slice(max(0, int(middle - most)), max(0, int(middle + most) + 2))
                for middle, most in (
                    (row, reach + abs(down) / 2),
                    (col, reach + abs(ahead) / 2),
                )
            )
            count = max(1, math.ceil(math.hypot(down, ahead)))
            place = (row, col, down, ahead)
            sizes = (length - corner, width - corner, corner)
            turn = (math.cos(angle), math.sin(angle))
            soft = self.soft_px
            corner_px = (window[0].start, window[1].start)
            _cover(
                picture[window],
                corner_px,
                place,
                turn,
                sizes,
                soft,
                count,
                self.particle_gray,
            )


@njit(cache=True)
def _cover(
    part: Single,
    first: tuple[int, int],
    place: tuple[float, float, float, float],
    turn: tuple[float, float],
    sizes: tuple[float, float, float],
    soft_px: float,
    count: int,
    gray: float,
) -> None:
    """Mix the grey value of one particle into a window of a picture, in place.

    The window ``part`` (rows, cols) begins at pixel ``first``, row and col. ``place``
    is row, col and the way during the exposure, down and right, in px; the particle is
    drawn at ``count`` places on it. ``turn`` is cosine and sine of its direction.
    ``sizes`` are half length and half width without the corner radius, and that radius,
    in px. Shares are of single precision, as the plain definition in the tests has
    them.
    """
    row, col, down, ahead = place
    c = np.float32(turn[0])
    s = np.float32(turn[1])
    soft = np.float32(soft_px)
    length = np.float32(sizes[0])
    width = np.float32(sizes[1])
    corner = np.float32(sizes[2])
    zero = np.float32(0.0)
    half = np.float32(0.5)
    one = np.float32(1.0)
    for i in range(part.shape[0]):
        for j in range(part.shape[1]):
            share = zero
            for k in range(count):
                moved = (k + 0.5) / count - 0.5
                below = np.float32(first[0] + i - row - down * moved)
                right = np.float32(first[1] + j - col - ahead * moved)
                u = abs(right * c + below * s) - length
                v = abs(below * c - right * s) - width
                distance = min(max(u, v), zero) - corner
                if u > zero and v > zero:  # off a corner, else one of both is no way
                    far = math.sqrt(
                        np.float64(u) * np.float64(u) + np.float64(v) * np.float64(v)
                    )
                    distance = np.float32(far) - corner
                elif u > zero or v > zero:
                    distance = max(u, v) - corner
                share += min(max(half - distance / soft, zero), one)
            mixed = np.float64(min(share / np.float32(count), one))
            value = np.float64(part[i, j])
            part[i, j] = np.float32(value + mixed * (gray - value))


@njit(cache=True)
def _rounded(picture: Single, noise: Single, noise_gray: np.float32) -> Picture:
    """Return a picture (rows, cols) with noise, in whole grey values from 0 to 255.

    ``noise`` (rows, cols) has standard deviation 1, ``noise_gray`` scales it to grey
    values.
    """
    rounded = np.empty(picture.shape, np.uint8)
    for i in range(picture.shape[0]):
        for j in range(picture.shape[1]):
            value = np.rint(picture[i, j] + noise[i, j] * noise_gray)
            rounded[i, j] = np.uint8(
                min(max(value, np.float32(0.0)), np.float32(255.0))
            )
    return rounded


def _velocities(visible: pd.DataFrame) -> Array:
    """Return each row's velocity (n, 2) in mm/s, x and y, to the particle's next row.

    A particle's last row has that of the row before it, a single row 0.
    """
    step = -visible.groupby("particle")[["x", "y", "time_s"]].diff(-1)
    rates = (
        step[["x", "y"]]
        .div(step["time_s"], axis=0)
        .groupby(visible["particle"])
        .ffill()
    )
    return rates.fillna(0.0).to_numpy()


def _blend(picture: npt.NDArray[np.float32], gray: float, share: Array) -> None:
    """Mix a share of a grey value into a picture, both (rows, cols), in place.

    The share is clipped to 0 to 1.
    """
    picture += share.clip(0.0, 1.0) * (gray - picture.astype(np.float64))


def at_rate(tracks: pd.DataFrame, frames_per_s: float) -> pd.DataFrame:
    """Return the rows of tracks at the times of a slower camera, with its frames.

    ``tracks`` is `kilnflight.tables.BELT_TRACKS`, as is the result, by particle and
    frame.

    Raises
    ------
    InputError
        If the tracks have no rows at such times, as 100 Hz for a camera of 200
        frames/s, or the rate is not above 0.
    """
    check_number(frames_per_s, "at_rate: frames_per_s", above=0)
    check_columns(tracks, BELT_TRACKS.names, BELT_TRACKS.name)
    exact = tracks["time_s"].to_numpy() * frames_per_s
    frame = np.rint(exact).astype(np.int64)
    kept = np.abs(exact - frame) < 1e-3
    ordered = tracks.assign(frame=frame)[kept].sort_values(["particle", "frame"])
    step = ordered.groupby("particle")["frame"].diff()
    if len(tracks) and (not kept.any() or (step > 1).mean() > 0.5):
        raise InputError(
            f"the tracks have no rows {frames_per_s:g} times a second; give tracks "
            "sampled at a multiple of that rate."
        )
    return ordered.reset_index(drop=True)
