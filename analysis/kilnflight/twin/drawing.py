"""Particles into a picture: every pixel of every particle in one long array."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from kilnflight.twin.appearance import Blobs
from kilnflight.twin.optics import FULL_SCALE, Optics

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

VISIBLE_CONTRAST = 3.0  # times the noise: what a person would mark (twin.md, rule 5)
VISIBLE_PX = 5  # pixels of that contrast
LARGEST_PX = 120  # half a box at most; nothing that flies is larger at these depths


class Pixels(NamedTuple):
    """The pixels of all boxes; arrays (k,)."""

    blob: Index  # row in `Blobs`
    place: Index  # row * columns + column
    radius: npt.NDArray[np.float32]  # 1 on the ellipse


def cover(blobs: Blobs, rows: int, columns: int) -> Pixels:
    """Return the pixels within 1.6 radii of every ellipse, clipped to the picture."""
    half = np.sqrt(np.stack([blobs.spread_px2[:, 0, 0], blobs.spread_px2[:, 1, 1]]))
    half = np.minimum(np.ceil(1.6 * half), LARGEST_PX).astype(np.intp)
    size = 2 * half + 1
    count = size[0] * size[1]
    blob = np.repeat(np.arange(len(count)), count)
    inner = np.arange(len(blob)) - np.repeat(np.cumsum(count) - count, count)
    down, right = np.divmod(inner, size[1][blob])
    row = np.round(blobs.row).astype(np.intp)[blob] + down - half[0][blob]
    column = np.round(blobs.column).astype(np.intp)[blob] + right - half[1][blob]
    inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    blob, row, column = blob[inside], row[inside], column[inside]
    inverse = np.linalg.inv(blobs.spread_px2) if len(count) else np.empty((0, 2, 2))
    y, x = row - blobs.row[blob], column - blobs.column[blob]
    matrix = inverse[blob]
    square = matrix[:, 0, 0] * y * y + 2 * matrix[:, 0, 1] * x * y + matrix[:, 1, 1] * x * x
    near = square < 2.56
    radius = np.sqrt(square[near]).astype(np.float32)
    return Pixels(blob[near], (row * columns + column)[near], radius)


def paint(
    picture: npt.NDArray[np.float32], blobs: Blobs, pixels: Pixels, optics: Optics
) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Draw particles into a picture (rows, columns), in place.

    Returns
    -------
    marked : (k,) bool
        For each pixel of ``pixels``: whether it belongs to what a person would mark.
    visible : (m,) bool
        Which particles a person would mark: at least `VISIBLE_PX` pixels whose contrast
        exceeds `VISIBLE_CONTRAST` times the noise.
    """
    flat = picture.reshape(-1)
    behind = flat[pixels.place]
    softness = blobs.softness[pixels.blob]
    profile = blobs.dilution[pixels.blob] / (1 + np.exp((pixels.radius - 1) / softness))
    level = blobs.brightness[pixels.blob]
    change = np.where(blobs.adds[pixels.blob], level * profile, (level - behind) * profile)
    np.add.at(flat, pixels.place, change.astype(np.float32))
    seen = np.minimum(behind + change, FULL_SCALE) - np.minimum(behind, FULL_SCALE)
    contrast = np.abs(seen) > VISIBLE_CONTRAST * optics.noise(behind)
    marked = contrast & (pixels.radius <= 1.15)
    count = np.bincount(pixels.blob[marked], minlength=len(blobs.row))
    visible = count >= VISIBLE_PX
    return marked, visible
