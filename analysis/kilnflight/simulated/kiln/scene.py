"""The recording of a scene.

A `Scene` is a few parameters and a seed. `Twin` is its recording. Each frame is
rendered on demand from the seed and its number alone. So frames come in any order and
from any process, and nothing grows with the length.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from kilnflight.arrays import Array, Generator, Index, Single
from kilnflight.camera import EQUATION_2_4
from kilnflight.compiled import compiled
from kilnflight.recording.frames import Attributes, Frame, Gray, check_position
from kilnflight.simulated.kiln.background import Background
from kilnflight.simulated.kiln.feeding import class_of, feed_campaign, feed_subset
from kilnflight.simulated.kiln.geometry import FULL_SCALE
from kilnflight.simulated.kiln.inputs import Scene
from kilnflight.simulated.kiln.lenses import LensWall, Sight
from kilnflight.simulated.kiln.life import Life
from kilnflight.simulated.kiln.light import Looks, draw_looks
from kilnflight.simulated.kiln.picture import (
    Bodies,
    SceneView,
    cover,
    draw_bodies,
    paint,
    project,
)

LEAST_DEPTH_MM = 300.0  # nearer particles fill the picture or are behind the camera
NOISE_SPARE = 1 << 18  # values by which the noise table is longer than a picture


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
        scene = self.scene
        place = scene.geometry
        depth = scene.depth.captured(self.lance_seen_mm)
        x, y, z = place.unproject(*place.lance_pixel, depth).tolist()
        return Attributes(
            name=scene.name,
            frame_rate_hz=scene.frame_rate_hz,
            rows=place.rows,
            columns=place.columns,
            fraction=scene.fraction,
            pressure_bar=scene.pressure_bar,
            lance_mm=(x, y, z),
            roi=scene.roi,
            flame_roi=scene.interior.flame_roi,
            depth_calibration=EQUATION_2_4,
        )

    @property
    def lance_seen_mm(self) -> float:
        """Mean depth in mm of the points at the lance exit, with the calibration.

        The thesis takes the place of the kiln from the cloud, as it "is hardly
        measurable" (section 3.2); other errors are anew in each frame.
        """
        row, column = self.scene.geometry.lance_pixel
        error = self._calibration[round(row), round(column)]
        depth = self.scene.geometry.lance_depth_mm
        return float(depth + error * self.scene.depth.wall_scale(depth))

    @cached_property
    def _calibration(self) -> Single:
        place = self.scene.geometry
        seed = self.scene.calibration
        return self.scene.depth.calibration(place.rows, place.columns, seed)

    @cached_property
    def life(self) -> Life:
        """All particles, drawn once."""
        if self.scene.labelled:
            return feed_subset(self.scene)
        return feed_campaign(self.scene)

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

    @cached_property
    def _wall(self) -> LensWall:
        return LensWall(self.scene.depth, self._background, self._calibration)

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
        place = self.scene.geometry
        view = self.view(t)
        index, depth = self._wall.points(self._sight(t, view), self._random(t, 1))
        row, column = np.divmod(index, place.columns)
        captured = self.scene.depth.captured(depth)
        return Frame(
            index=t,
            time_s=self.time_s(t),
            gray=self.exposed(t, view.picture),
            pixels=np.stack([row, column], axis=1).astype(np.int32),
            xyz=place.unproject(row, column, captured).astype(np.float32),
            labels=view.labels,
        )

    def gray(self, t: int) -> Gray:
        """Return the grey values (rows, columns) of frame ``t`` alone.

        They are the same as the frame's own.
        """
        check_position(t, len(self), self.scene.name)
        return self.exposed(t, self.view(t).picture)

    def empty(self, t: int) -> Single:
        """Return the picture of frame ``t`` without particles and noise."""
        return self._background.at(self.time_s(t))

    def view(self, t: int) -> SceneView:
        """Return frame ``t`` before noise, and which particle covers which pixel."""
        place = self.scene.geometry
        optics = self.scene.optics
        time_s = self.time_s(t)
        moment = self.life.at(time_s)
        # Particles behind the camera, and those on the wall that do not burn, are not
        # seen.
        depth = place.to_camera(moment.position_m)[:, 2]
        seen = (depth > LEAST_DEPTH_MM) & (~moment.landed | moment.burning)
        far_first = np.argsort(-depth, kind="stable")
        moment = moment.take(far_first[seen[far_first]])
        blobs = project(moment, self._bodies, self._looks, place, optics, time_s)
        pixels = cover(blobs, place.rows, place.columns)
        solid_mm = self._background.solid_mm.take(pixels.place)
        pixels = pixels.take(blobs.depth_mm[pixels.blob] < solid_mm)
        picture = self._background.at(time_s)
        marked, visible = paint(picture, blobs, pixels, optics)
        shown = marked & visible[pixels.blob]
        kinds = class_of(moment)
        # A person sees the burner's flame, 1, where it is far brighter than the wall,
        # or saturated.
        labels = np.zeros(picture.shape, np.uint8)
        top, bottom, left, right = self.scene.interior.flame_roi
        flame = np.s_[top:bottom, left:right]
        labels[flame] = picture[flame] >= min(2.5 * optics.at_wall, FULL_SCALE)
        labels.reshape(-1)[pixels.place[shown]] = kinds[pixels.blob[shown]]
        return SceneView(
            picture=picture,
            moment=moment,
            blobs=blobs,
            pixels=pixels,
            shown=shown,
            visible=visible,
            kinds=kinds,
            labels=labels,
        )

    def exposed(self, t: int, picture: Single) -> Gray:
        """Return a picture as grey values with the noise of frame ``t``."""
        optics = self.scene.optics
        offset = int(self._random(t, 0).integers(NOISE_SPARE))
        noise = self._noise[offset : offset + picture.size].reshape(picture.shape)
        gain = np.float32(optics.shot_gain)
        read = np.float32(optics.read_noise**2)
        return _add_noise(picture, noise, gain, read)

    def _random(self, t: int, stream: int) -> Generator:
        """Return random numbers that depend on seed, frame and stream only."""
        key = np.array([self.scene.seed, (t << 8) + stream], np.uint64)
        return np.random.Generator(np.random.Philox(key=key))

    def _sight(self, t: int, view: SceneView) -> Sight:
        """Return the particles of frame ``t`` as the lenses see them."""
        camera = self.scene.depth
        end_s = self.life.release_s + self.life.flights.end_s
        flying = end_s > self.time_s(t)
        # The common error in mm of each particle's depth.
        size = np.where(flying, self._flying_errors_mm, camera.wall_particle_mm)
        error = camera.scale * size * self._random(t, 3).standard_normal(len(size))
        return self._wall.see_particles(view, error, self._random(t, 2))

    def particles_with_depth(self, t: int, view: SceneView) -> Index:
        """Return the particles with at least one valid point in frame ``t``."""
        deep = np.isin(view.pixels.place, self._sight(t, view).pixels)
        chosen = view.shown & deep
        return np.unique(view.moment.particle[view.pixels.blob[chosen]])

    @cached_property
    def _flying_errors_mm(self) -> Array:
        """Standard deviation of each particle's common error in flight, (n,)."""
        errors = dict(self.scene.depth.particle_error_mm)
        return np.asarray(self.life.table["fraction"].map(errors), float)


@compiled
def _add_noise(picture: Any, noise: Any, gain: Any, read: Any) -> Any:
    """Return grey values: a picture with noise of variance ``gain * picture + read``.

    All are float32. It is compiled as the passes of numpy take 8 to 11 ms a picture
    instead of 2.
    """
    full = np.float32(FULL_SCALE)
    gray = np.empty(picture.shape, np.uint16)
    for i in range(len(gray)):
        line = picture[i]
        of_noise = noise[i]
        target = gray[i]
        for x in range(len(line)):
            level = np.sqrt(gain * line[x] + read) * of_noise[x] + line[x]
            target[x] = np.uint16(min(max(level, np.float32(0)), full))
    return gray
