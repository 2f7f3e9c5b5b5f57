"""Synthetic pictures of particles on the belt, rendered on demand (2016 paper, section IV.B).

Particles are drawn from true places with their shape and direction, soft edges and noise.
The pictures are input: nothing that measures in them is told what they were made of.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from numba import njit

from kilnflight.belt.view import View
from kilnflight.checks import InputError, check_at_least, check_columns, check_positive
from kilnflight.tables import BELT_TRACKS

Array = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class Shape:
    """A particle from above: a rectangle with round corners, its centre above the belt."""

    length_mm: float
    width_mm: float
    corner_mm: float  # radius of its corners
    height_mm: float  # of its centre

    def __post_init__(self) -> None:
        """Refuse what has no outline."""
        for name in ("length_mm", "width_mm", "height_mm"):
            check_positive(getattr(self, name), f"Shape: {name}")
        check_at_least(self.corner_mm, 0, "Shape: corner_mm")
        if 2 * self.corner_mm > min(self.length_mm, self.width_mm):
            raise InputError(f"Shape: corner_mm {self.corner_mm} is more than half a side.")


# 2020 paper, section 4; cylinders and cuboids lie on their largest side.
SHAPES = {
    "spheres": Shape(5.0, 5.0, 2.5, 2.5),
    "cuboids": Shape(6.0, 5.0, 0.0, 1.0),
    "cylinders": Shape(9.0, 3.0, 0.0, 1.5),
}


_VIEW = View()


@dataclass(frozen=True)
class Pictures:
    """Pictures of tracks, one per frame of the camera; ``pictures[k]`` renders frame k.

    Frame k is taken at k / frames_per_s; a particle is seen where the tracks have a row at
    that time. The same seed gives the same bytes, in any order.
    """

    tracks: pd.DataFrame  # BELT_TRACKS; z and angle_rad of BELT_BODIES too, if known
    shape: Shape
    seed: int
    view: View = _VIEW
    belt_gray: float = 60.0  # of 255; assumption, as are the next: a dark belt
    floor_gray: float = 130.0  # beside the belt
    particle_gray: float = 200.0  # wood
    noise_gray: float = 3.0  # standard deviation, new in each frame
    soft_px: float = 1.0  # width of an edge

    def __post_init__(self) -> None:
        """Refuse tracks that are none, and pictures without edges or contrast."""
        BELT_TRACKS.check(self.tracks)
        check_at_least(self.noise_gray, 0, "Pictures: noise_gray")
        check_positive(self.soft_px, "Pictures: soft_px")

    def __len__(self) -> int:
        """Return the number of frames up to the last time of the tracks."""
        return 1 + _frames(self.tracks, self.view).max() if len(self.tracks) else 0

    def __getitem__(self, frame: int) -> Picture:
        """Return the picture (rows, cols) of one frame."""
        return next(self.frames([frame]))

    def frames(self, wanted: Any) -> Any:
        """Yield the pictures of the frames asked for, in that order."""
        seen = at_rate(self.tracks, self.view.frames_per_s)
        places = self._outlines(seen)
        order = np.argsort(seen["frame"].to_numpy(), kind="stable")
        sorted_frames, places = seen["frame"].to_numpy()[order], places[order]
        empty, spread = self._empty(), np.float32(self.noise_gray)
        noise = np.empty(empty.shape, dtype=np.float32)
        for frame in wanted:
            first, last = np.searchsorted(sorted_frames, [frame, frame + 1])
            picture = empty.copy()
            _draw(picture, places[first:last], float(self.particle_gray), float(self.soft_px))
            rng = np.random.default_rng([self.seed, 1, frame])
            rng.standard_normal(dtype=np.float32, out=noise)
            yield _exposed(picture, spread, noise)

    def _outlines(self, seen: pd.DataFrame) -> Array:
        """Return row, col, direction, half length, half width and corner in px, (n, 6)."""
        shape, x, y = self.shape, seen["x"].to_numpy(), seen["y"].to_numpy()
        angle = _angles(seen, self.seed)
        height = np.full(len(seen), shape.height_mm)
        if "z" in seen.columns:
            height = seen["z"].to_numpy(np.float64)
        middle = self.view.pixels(np.column_stack([x, y, height]))
        tip = np.column_stack([x + np.cos(angle), y + np.sin(angle), height])  # 1 mm ahead
        along = self.view.pixels(tip) - middle
        scale = np.hypot(along[:, 0], along[:, 1])  # px per mm
        sizes = np.array([shape.length_mm / 2, shape.width_mm / 2, shape.corner_mm])
        direction = np.arctan2(along[:, 0], along[:, 1])
        return np.column_stack([middle, direction, scale[:, None] * sizes])

    def _empty(self) -> npt.NDArray[np.float32]:
        """Return the belt without particles, its edges soft."""
        corners = self.view.pixels(np.column_stack([self.view.belt.corners, np.zeros(4)]))
        picture = np.full((self.view.rows, self.view.cols), self.floor_gray, dtype=np.float32)
        _draw_belt(picture, corners, float(self.belt_gray), float(self.soft_px))
        texture = np.random.default_rng([self.seed, 0]).standard_normal(picture.shape)
        return (picture + 2.0 * texture).astype(np.float32)


def at_rate(tracks: pd.DataFrame, frames_per_s: float) -> pd.DataFrame:
    """Return the rows at the times of a slower camera, ``frame`` counted by it.

    Raises
    ------
    InputError
        If the tracks have no rows at such times (100 Hz for a camera of 200 frames/s, say).
    """
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


def _frames(tracks: pd.DataFrame, view: View) -> npt.NDArray[np.int64]:
    return np.floor(tracks["time_s"].to_numpy() * view.frames_per_s + 1e-6).astype(np.int64)


def _angles(seen: pd.DataFrame, seed: int) -> Array:
    """Return the direction of each row; one per particle, drawn, where none is known."""
    if "angle_rad" in seen.columns:
        return seen["angle_rad"].to_numpy(np.float64)
    names, who = np.unique(seen["particle"].to_numpy(), return_inverse=True)
    return np.random.default_rng([seed, 2]).uniform(0, np.pi, len(names))[who]


@njit(cache=True)
def _draw(picture: Any, outlines: Any, gray: float, soft: float) -> None:
    """Draw rectangles with round corners; where two overlap the later one is on top."""
    rows, cols = picture.shape
    for k in range(len(outlines)):
        row, col, angle, a, b, corner = outlines[k]
        reach = np.hypot(a, b) + soft + 1.0
        c, s = np.cos(angle), np.sin(angle)
        for i in range(max(0, int(row - reach)), min(rows, int(row + reach) + 2)):
            for j in range(max(0, int(col - reach)), min(cols, int(col + reach) + 2)):
                u = abs((j - col) * c + (i - row) * s) - (a - corner)
                v = abs((i - row) * c - (j - col) * s) - (b - corner)
                outside = np.hypot(max(u, 0.0), max(v, 0.0))
                distance = outside + min(max(u, v), 0.0) - corner
                share = min(max(0.5 - distance / soft, 0.0), 1.0)
                picture[i, j] += share * (gray - picture[i, j])


@njit(cache=True)
def _exposed(picture: Any, spread: Any, noise: Any) -> Any:
    """Return picture + spread * noise (float32 all) as grey values of eight bits, rounded."""
    gray = np.empty(picture.shape, dtype=np.uint8)
    for i in range(picture.shape[0]):
        for j in range(picture.shape[1]):
            value = np.rint(picture[i, j] + spread * noise[i, j])
            gray[i, j] = np.uint8(min(max(value, np.float32(0.0)), np.float32(255.0)))
    return gray


@njit(cache=True)
def _draw_belt(picture: Any, corners: Any, gray: float, soft: float) -> None:
    """Draw a convex area; corners (4, 2), row and col, clockwise as seen."""
    for i in range(picture.shape[0]):
        for j in range(picture.shape[1]):
            inside = 1e9
            for k in range(4):
                p, q = corners[k], corners[(k + 1) % 4]
                d0, d1 = q[0] - p[0], q[1] - p[1]
                away = (d1 * (i - p[0]) - d0 * (j - p[1])) / np.hypot(d0, d1)
                inside = min(inside, away)
            share = min(max(0.5 + inside / soft, 0.0), 1.0)
            picture[i, j] += share * (gray - picture[i, j])
