"""Render pictures of particles on the belt (2016 paper, IV.B).

Pictures are rendered on demand: particles are drawn from true places with their shape
and direction, soft edges, motion blur and noise. What measures sees the pictures alone.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from pandas import DataFrame
from scipy.spatial.transform import Rotation

from kilnflight.arrays import Array, Picture, Single
from kilnflight.belt.camera import BELT
from kilnflight.checks import InputError
from kilnflight.compiled import compiled
from kilnflight.tables import BELT_TRACKS

ROWS = 708  # size of a picture in px (section IV.B), as are the next two
COLS = 1064
MM_PER_PX = 0.44  # at the belt
FRAMES_PER_S = 200.0
HEIGHT_MM = 1000.0  # of the camera above the belt; assumption
FLOOR_GRAY = 130.0  # of 255, beside the belt; assumption
PARTICLE_GRAY = 200.0  # wood; assumption
SOFT_PX = 1.0  # width of an edge; assumption
EXPOSURE_S = 0.001  # 3.4 px of blur at the belt's velocity; assumption


@dataclass(frozen=True)
class Bulk:
    """One bulk material of particles that lie on their largest face.

    Parameters
    ----------
    outline_mm
        Half length, half width and corner radius, from above.
    rest_mm
        Height of the centre above the belt.
    """

    outline_mm: tuple[float, float, float]
    rest_mm: float


# Spheres of 5 mm, boxes of 6 x 5 x 2 mm, cylinders of 9 mm by a diameter of 3 mm.
BULKS = {
    "spheres": Bulk(outline_mm=(2.5, 2.5, 2.5), rest_mm=2.5),
    "cuboids": Bulk(outline_mm=(3.0, 2.5, 0.0), rest_mm=1.0),
    "cylinders": Bulk(outline_mm=(4.5, 1.5, 0.0), rest_mm=1.5),
}


@dataclass(frozen=True)
class CameraView:
    """A pinhole camera above the middle of the belt, without distortion of the lens.

    Parameters
    ----------
    turned_deg
        Rotation about its own axis; assumption: mounted by hand.
    tilted_deg
        Angle against the vertical, along the belt; assumption.

    Notes
    -----
    The paper gives the picture's size, its scale and its rate. Height and the small
    errors of mounting are assumptions. They make "an imperfect calibration" matter: a
    particle's centre lies above the plane that the belt's corners calibrate.
    """

    turned_deg: float = 0.3
    tilted_deg: float = 0.3

    def pixels(self, places: Array) -> Array:
        """Return row and col in px (n, 2) of places (n, 3).

        A place is x, y and height above the belt in mm.
        """
        angles = [self.turned_deg, self.tilted_deg]
        turn = Rotation.from_euler("ZY", angles, degrees=True).as_matrix()
        middle = BELT.corners.mean(axis=0)
        # Seen from above: x to the right, y down, depth away from the camera.
        depth = HEIGHT_MM - places[:, 2]
        away = np.column_stack([places[:, :2] - middle, depth]) @ turn.T
        # The camera is moved sideways so that the tilted axis still meets the belt's
        # middle.
        away[:, :2] -= turn[:2, 2] * HEIGHT_MM
        scale = HEIGHT_MM / MM_PER_PX / away[:, 2:]
        centre = np.array([ROWS - 1, COLS - 1]) / 2
        return (away[:, :2] * scale)[:, ::-1] + centre


_VIEW = CameraView()


@dataclass(frozen=True)
class Pictures:
    """Synthetic pictures (rows, cols) of tracks, one per frame of the camera.

    ``pictures[k]`` renders frame k.

    Frame k is taken at k / frames_per_s, the middle of its exposure; a particle is seen
    where the tracks have a row at that time. The same seed gives the same bytes, in any
    order.

    Parameters
    ----------
    tracks
        `kilnflight.tables.BELT_TRACKS`.
    bulk
        Shape and size of the particles.
    seed
        Seed of the noise, of the belt's texture and of the particles' directions.
    view
        Camera.
    belt_gray
        Grey value of 255 of a dark belt; assumption.
    noise_gray
        Standard deviation of the noise, new in each frame; assumption.
    """

    tracks: DataFrame
    bulk: Bulk
    seed: int
    view: CameraView = _VIEW
    belt_gray: float = 60.0
    noise_gray: float = 3.0

    def __post_init__(self) -> None:
        """Check the tracks."""
        BELT_TRACKS.check(self.tracks)

    def __len__(self) -> int:
        """Return the number of frames up to the last time of the tracks."""
        if not len(self.tracks):
            return 0
        last = self.tracks["time_s"].max() * FRAMES_PER_S
        return 1 + int(np.floor(last + 1e-6))

    def __getitem__(self, frame: int) -> Picture:
        """Return the picture (rows, cols) of one frame."""
        return next(self.frames([frame]))

    def frames(self, numbers: Iterable[int]) -> Iterator[Picture]:
        """Yield the pictures of the requested frames, in that order."""
        visible = at_rate(self.tracks, FRAMES_PER_S)
        visible = visible.sort_values("frame", kind="stable")
        frame = visible["frame"].to_numpy()
        outlines = self._outlines(visible)
        empty = self._empty()
        for number in numbers:
            first, last = np.searchsorted(frame, [number, number + 1])
            picture = empty.copy()
            # Where two overlap, the later one is on top.
            for outline in outlines[first:last].tolist():
                _cover(picture, tuple(outline))
            generator = np.random.default_rng([self.seed, 1, int(number)])
            noise = generator.standard_normal(empty.shape, dtype=np.float32)
            noisy = picture + np.float32(self.noise_gray) * noise
            yield np.rint(noisy).clip(0, 255).astype(np.uint8)

    def _outlines(self, visible: DataFrame) -> Array:
        """Return the outline (n, 8) of each particle in the picture.

        Columns are row, col, direction (rad, from right to down), half length, half
        width, corner radius, and the way during the exposure, down and right. Lengths
        are in px. ``visible`` has a row per particle and frame.
        """
        places = visible[["x", "y"]].to_numpy()
        names, which = np.unique(visible["particle"].to_numpy(), return_inverse=True)
        generator = np.random.default_rng([self.seed, 2])
        angle = generator.uniform(0, np.pi, len(names))[which]  # one by particle
        tip = places + np.column_stack([np.cos(angle), np.sin(angle)])  # 1 mm ahead
        # The velocity is that to the particle's next row, in its last row that of the
        # row before it, of a single row 0.
        step = -visible.groupby("particle")[["x", "y", "time_s"]].diff(-1)
        velocity = step[["x", "y"]].div(step["time_s"], axis=0)
        velocity = velocity.groupby(visible["particle"]).ffill().fillna(0.0)
        ahead = places + EXPOSURE_S * velocity.to_numpy()
        height = np.full(len(visible), self.bulk.rest_mm)
        middle, end, along = (
            self.view.pixels(np.column_stack([each, height]))
            for each in (places, ahead, tip)
        )
        along -= middle
        scale = np.hypot(along[:, 0], along[:, 1])  # px per mm
        direction = np.arctan2(along[:, 0], along[:, 1])
        sizes = scale[:, None] * np.array(self.bulk.outline_mm)
        return np.column_stack([middle, direction, sizes, end - middle])

    def _empty(self) -> Single:
        """Return the picture (rows, cols) of the belt without particles."""
        shape = (ROWS, COLS)
        row, col = np.ogrid[:ROWS, :COLS]
        corners = self.view.pixels(np.column_stack([BELT.corners, np.zeros(4)]))
        inside = np.full(shape, np.inf)
        for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            down, right = end - start
            away = right * (row - start[0]) - down * (col - start[1])
            np.minimum(inside, away / np.hypot(down, right), out=inside)
        share = (0.5 + inside / SOFT_PX).clip(0.0, 1.0)
        picture = FLOOR_GRAY + share * (self.belt_gray - FLOOR_GRAY)
        texture = np.random.default_rng([self.seed, 0]).standard_normal(shape)
        return (picture.astype(np.float32) + 2.0 * texture).astype(np.float32)


@compiled
def _cover(picture: Single, outline: tuple[float, ...]) -> None:
    """Draw a rectangle with round corners into a picture (rows, cols), in place.

    ``outline`` is a row of `Pictures._outlines`. It is the mean of its places during
    the exposure, at most a pixel apart. Shares are of single precision.
    """
    row, col, angle, half_length, half_width, radius, down, ahead = outline
    count = max(1, math.ceil(math.hypot(down, ahead)))
    reach = math.hypot(half_length - radius, half_width - radius) + radius
    high = reach + SOFT_PX + 1.0 + abs(down) / 2
    wide = reach + SOFT_PX + 1.0 + abs(ahead) / 2
    c = np.float32(math.cos(angle))
    s = np.float32(math.sin(angle))
    length = np.float32(half_length - radius)
    width = np.float32(half_width - radius)
    corner = np.float32(radius)
    soft = np.float32(SOFT_PX)
    zero = np.float32(0.0)
    half = np.float32(0.5)
    one = np.float32(1.0)
    for i in range(max(0, int(row - high)), min(len(picture), int(row + high) + 2)):
        for j in range(
            max(0, int(col - wide)), min(picture.shape[1], int(col + wide) + 2)
        ):
            share = zero
            for k in range(count):
                moved = (k + 0.5) / count - 0.5
                below = np.float32(i - row - down * moved)
                right = np.float32(j - col - ahead * moved)
                u = abs(right * c + below * s) - length
                v = abs(below * c - right * s) - width
                distance = _distance(u, v) - corner
                share += min(max(half - distance / soft, zero), one)
            mixed = min(share / np.float32(count), one)
            value = picture[i, j]
            picture[i, j] = np.float32(value + mixed * (PARTICLE_GRAY - value))


@compiled
def _distance(u: np.float32, v: np.float32) -> np.float32:
    """Return the distance in px from a rectangle, given those from its sides' lines.

    Inside both are below 0, as is the result.
    """
    if u > 0 and v > 0:  # the nearest point is a corner
        return np.float32(math.sqrt(np.float64(u) ** 2 + np.float64(v) ** 2))
    return max(u, v)


def at_rate(tracks: DataFrame, frames_per_s: float) -> DataFrame:
    """Return the rows of tracks at the times of a slower camera, with its frames.

    ``tracks`` is `kilnflight.tables.BELT_TRACKS`, as is the result, by particle and
    frame.

    Raises
    ------
    InputError
        If the tracks have no rows at such times, as 100 Hz for a camera of 200
        frames/s.
    """
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
