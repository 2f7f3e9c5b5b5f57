"""A scene: who is fed, kiln and camera; and its recording.

A `Scene` is a few parameters and a seed. `Twin` is its recording. Each frame is
rendered on demand from the seed and its number alone. So frames come in any order and
from any process, and nothing grows with the length.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from kilnflight.arrays import Array, Flags, Index, Picture, Single
from kilnflight.camera import EQUATION_2_4
from kilnflight.recording.frames import Attributes, Frame, Gray, check_position
from kilnflight.simulated.kiln.background import Background, Interior
from kilnflight.simulated.kiln.feeding import (
    LABELLED,
    feed_campaign,
    feed_subset,
    handfuls,
)
from kilnflight.simulated.kiln.geometry import FULL_SCALE, Geometry
from kilnflight.simulated.kiln.lenses import Lattice, LensCamera, LensWall, Sight
from kilnflight.simulated.kiln.life import Life, Moment
from kilnflight.simulated.kiln.light import Looks, Optics, draw_looks
from kilnflight.simulated.kiln.picture import (
    Blobs,
    Bodies,
    Pixels,
    cover,
    draw_bodies,
    paint,
    project,
)

LEAST_DEPTH_MM = 300.0  # nearer ones are behind the camera or fill the picture
NOISE_SPARE = 1 << 18  # values by which the noise table is longer than a picture


@dataclass(frozen=True)
class Scene:
    """All that determines a recording of the twin.

    A campaign has a ``fraction`` and a ``count`` of particles, a labelled subset
    ``labelled``: by class of Table 5.1 the labels within the region of interest and
    outside it, in ten frames.
    """

    name: str
    frames: int
    seed: int
    frame_rate_hz: float = 330.0  # 153.85 for PE granules (sec. 5.2.3)
    fraction: str = "mixed"
    pressure_bar: float = 4.5
    count: int = 0
    handful: float = 6.0  # mean number of particles in one; assumption
    labelled: tuple[tuple[int, tuple[int, int]], ...] = ()
    calibration: int = (
        0  # seed of the depth camera's: one for all recordings of a camera
    )
    geometry: Geometry = field(default_factory=Geometry)
    optics: Optics = field(default_factory=Optics)
    interior: Interior = field(default_factory=Interior)
    depth: LensCamera = field(default_factory=LensCamera)

    @property
    def roi(self) -> tuple[tuple[float, float], ...]:
        """Vertices (row, col) of the region of interest in px."""
        rows = self.geometry.rows
        columns = self.geometry.columns
        return tuple(
            (row * rows, column * columns) for row, column in self.interior.roi
        )


@dataclass(frozen=True)
class Twin:
    """The recording of a scene, rendered on demand, with its truth."""

    scene: Scene

    def __len__(self) -> int:
        """Return the number of frames."""
        return self.scene.frames

    @cached_property
    def attributes(self) -> Attributes:
        """The attributes of the whole recording."""
        scene, place = self.scene, self.scene.geometry
        row, column = place.lance_pixel
        lance = place.unproject(row, column, scene.depth.captured(self.lance_seen_mm))
        return Attributes(
            name=scene.name,
            frame_rate_hz=scene.frame_rate_hz,
            rows=place.rows,
            columns=place.columns,
            fraction=scene.fraction,
            pressure_bar=scene.pressure_bar,
            lance_mm=tuple(map(float, lance)),  # type: ignore[arg-type]
            roi=scene.roi,
            flame_roi=scene.interior.flame_roi,
            depth_calibration=EQUATION_2_4,
        )

    @property
    def lance_seen_mm(self) -> float:
        """The mean depth of the points at the lance's outlet: the calibration's error
        is in it.

        The thesis takes the place of the kiln from the cloud, as it "is hardly
        measurable" (section 3.2); other errors are anew in each frame.
        """
        place = self.scene.geometry
        row, column = place.lance_pixel
        error = self._calibration[round(row), round(column)]
        depth = place.lance_depth_mm
        return float(depth + error * self.scene.depth.wall_scale(depth))

    @cached_property
    def _calibration(self) -> Single:
        scene, place = self.scene, self.scene.geometry
        return scene.depth.calibration(place.rows, place.columns, scene.calibration)

    @cached_property
    def life(self) -> Life:
        """All particles, drawn once."""
        scene, generator = self.scene, np.random.default_rng([self.scene.seed, 0])
        place = scene.geometry
        share_on = scene.optics.share_on
        if scene.labelled:
            times = [self.time_s(t) for t in LABELLED]
            counts = dict(scene.labelled)
            return feed_subset(counts, times, scene.roi, place, share_on, generator)
        duration_s = scene.frames / scene.frame_rate_hz
        release_s = handfuls(scene.count, scene.handful, duration_s, generator)
        kind = scene.fraction, scene.pressure_bar
        return feed_campaign(kind, release_s, place, share_on, generator)

    @cached_property
    def _bodies(self) -> Bodies:
        return draw_bodies(self.life.table, self.scene.seed)

    @cached_property
    def _looks(self) -> Looks:
        fractions = self.life.table["fraction"].to_numpy(object)
        return draw_looks(fractions, self.scene.optics, self.scene.seed)

    @cached_property
    def _background(self) -> Background:
        scene = self.scene
        return Background(scene.geometry, scene.optics, scene.interior, scene.seed)

    @cached_property
    def _noise(self) -> Single:
        size = self.scene.geometry.rows * self.scene.geometry.columns + NOISE_SPARE
        generator = np.random.default_rng([self.scene.seed, 301])
        return generator.standard_normal(size, dtype=np.float32)

    def still(self) -> dict[str, npt.NDArray[Any]]:
        """Return the arrays that take seconds to make and do not change from frame to
        frame.
        """
        wall = {
            each.name: getattr(self._wall, each.name) for each in fields(LensWall)[2:]
        }
        return wall | {
            "level": self._background.level,
            "solid_mm": self._background.solid_mm,
        }

    def recall(self, still: dict[str, npt.NDArray[Any]]) -> None:
        """Take the arrays of `still` from an earlier run of the same scene."""
        for name in ("level", "solid_mm"):
            self._background.__dict__[name] = still.pop(name)
        place = self.scene.geometry
        camera = self.scene.depth
        lattice = Lattice(place.rows, place.columns, camera.lenses)
        self.__dict__["_wall"] = LensWall(camera, lattice, **still)

    def time_s(self, t: int) -> float:
        """Return the time of frame ``t``; the first one is at 0."""
        return t / self.scene.frame_rate_hz

    def frame(self, t: int) -> Frame:
        """Return frame ``t``, counted from 0.

        Raises
        ------
        InputError
            If there is no such frame.
        """
        check_position(t, len(self), self.scene.name)
        view = self.view(t)
        gray = self.exposed(t, view.picture)
        pixels, xyz = self._cloud(t, view)
        return Frame(t, self.time_s(t), gray, pixels, xyz, view.labels)

    def gray(self, t: int) -> Gray:
        """Return the grey values (rows, columns) of frame ``t`` alone.

        They are the same as the frame's own.
        """
        check_position(t, len(self), self.scene.name)
        return self.exposed(t, self.view(t).picture)

    def empty(self, t: int) -> Single:
        """Return the picture (rows, columns) at frame ``t`` without particles or noise."""
        return self._background.at(self.time_s(t))

    def view(self, t: int) -> SceneView:
        """Return the picture before noise, and which particle covers which pixel of it."""
        place = self.scene.geometry
        optics = self.scene.optics
        time = self.time_s(t)
        moment = self.life.at(time)
        background = self._background
        # leave out particles behind the camera, and those on the wall that do not burn
        in_front = place.to_camera(moment.position_m)[:, 2] > LEAST_DEPTH_MM
        moment = moment.take(in_front & (~moment.landed | moment.burning))
        blobs = project(moment, self._bodies, self._looks, place, optics, time)
        pixels = cover(blobs, place.rows, place.columns)
        picture = background.at(time)
        seen = blobs.depth_mm[pixels.blob] < background.solid_mm.take(pixels.place)
        pixels = Pixels._make(part[seen] for part in pixels)
        marked, visible = paint(picture, blobs, pixels, optics)
        order = np.argsort(moment.particle)
        of_blob = order[np.searchsorted(moment.particle, blobs.particle, sorter=order)]
        moment = moment.take(of_blob)
        labels = np.zeros((place.rows, place.columns), dtype=np.uint8)
        first, last, left, right = self.scene.interior.flame_roi
        # a person sees a flame where it is far brighter than the wall, or saturated
        bright = picture[first:last, left:right] >= min(
            2.5 * optics.at_wall, FULL_SCALE
        )
        labels[first:last, left:right][bright] = 1
        shown = marked & visible[pixels.blob]
        kinds = np.where(moment.landed, 4, np.where(moment.burning, 2, 3)).astype(
            np.uint8
        )
        labels.reshape(-1)[pixels.place[shown]] = kinds[pixels.blob[shown]]
        return SceneView(picture, moment, blobs, pixels, shown, visible, kinds, labels)

    def exposed(self, t: int, picture: Single) -> Gray:
        """Return the picture with noise as grey values: frame ``t`` decides which
        noise.
        """
        optics = self.scene.optics
        generator = self._random(t, 0)
        offset = int(generator.integers(NOISE_SPARE))
        noise = self._noise[offset : offset + picture.size].reshape(picture.shape)
        gain = np.float32(optics.shot_gain)
        read = np.float32(optics.read_noise**2)
        return np.asarray(
            _with_shot_noise(picture, noise, gain, read, np.float32(FULL_SCALE))
        )

    def _random(self, t: int, stream: int) -> np.random.Generator:
        """Return random numbers that depend on seed, frame and stream only."""
        key = np.array([self.scene.seed, (t << 8) + stream], dtype=np.uint64)
        return np.random.Generator(np.random.Philox(key=key))

    @cached_property
    def _wall(self) -> LensWall:
        scene, edge = self.scene, self.scene.interior.edge_px
        return LensWall.of(
            scene.depth, self._background, scene.optics, edge, self._calibration
        )

    def _sight(self, t: int, view: SceneView) -> Sight:
        """Return what the lenses see of the particles of frame ``t``."""
        error = self.particle_errors(t)
        generator = self._random(t, 2)
        optics = self.scene.optics
        shown = (view.blobs, view.pixels)
        return self._wall.look(
            view.picture, shown, error, view.labels, optics, generator
        )

    def _cloud(self, t: int, view: SceneView) -> tuple[npt.NDArray[np.int32], Single]:
        """Return pixels (n, 2) and captured positions (n, 3) of the points of a frame."""
        index, depth = self._wall.points(self._sight(t, view), self._random(t, 1))
        captured = self.scene.depth.captured(depth)
        row, column = np.divmod(index, self.scene.geometry.columns)
        xyz = self.scene.geometry.unproject(row, column, captured).astype(np.float32)
        return np.stack([row, column], axis=1).astype(np.int32), xyz

    def particles_with_depth(self, t: int, view: SceneView) -> Index:
        """Return the particles with at least one valid point in the view of frame
        ``t``.
        """
        has_point = np.zeros(view.labels.size, dtype=bool)
        has_point[self._sight(t, view).pixels] = True
        chosen = np.flatnonzero(view.shown & has_point[view.pixels.place])
        return np.unique(view.blobs.particle[view.pixels.blob[chosen]])

    @cached_property
    def _error_sizes(self) -> Array:
        """Standard deviation of each particle's common error in flight in mm, (n,)."""
        sizes = self.life.table["fraction"].map(
            dict(self.scene.depth.particle_error_mm)
        )
        return np.asarray(sizes.to_numpy(dtype=np.float64), dtype=np.float64)

    def particle_errors(self, t: int) -> Array:
        """Return the common error of every particle's depth in mm, (n,)."""
        camera = self.scene.depth
        generator = self._random(t, 3)
        over_s = self.life.release_s + self.life.flights.end_s
        sizes = np.where(
            over_s <= self.time_s(t), camera.wall_particle_mm, self._error_sizes
        )
        return camera.scale * sizes * generator.standard_normal(len(sizes))


@njit(cache=True)
def _with_shot_noise(picture: Any, noise: Any, gain: Any, read: Any, full: Any) -> Any:
    """Return grey values: a picture with noise of variance ``gain * picture + read``,
    all float32.

    Compiled: five passes of numpy over a picture take twice the time.
    """
    gray = np.empty(picture.shape, np.uint16)
    for i in range(len(gray)):
        line = picture[i]
        of_noise = noise[i]
        target = gray[i]
        for x in range(len(line)):
            level = np.sqrt(gain * line[x] + read) * of_noise[x] + line[x]
            target[x] = np.uint16(min(max(level, np.float32(0)), full))
    return gray


class SceneView(NamedTuple):
    """One frame before noise."""

    picture: Single
    moment: Moment  # in the order of the blobs
    blobs: Blobs
    pixels: Pixels
    shown: Flags  # of the pixels: labelled as a particle
    visible: Flags  # of the blobs: a person would mark it
    kinds: Picture  # of the blobs: label 2, 3 or 4
    labels: Picture
