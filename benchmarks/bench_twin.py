"""The twin's rendering against drawing one particle at a time."""

from __future__ import annotations

import numpy as np
from measure import Row, compare

from kilnflight.simulated.kiln import picture as drawing
from kilnflight.simulated.kiln import scenes


def one_by_one(picture: np.ndarray, blobs: drawing.Blobs) -> np.ndarray:
    """Draw each particle over the whole picture, as one writes it first."""
    row, column = np.indices(picture.shape, dtype=np.float32)
    for k in range(len(blobs.row)):
        y = row - blobs.row[k]
        x = column - blobs.column[k]
        inverse = np.linalg.inv(blobs.ellipse_px2[k])
        square = (
            inverse[0, 0] * y * y + 2 * inverse[0, 1] * x * y + inverse[1, 1] * x * x
        )
        radius = np.sqrt(np.minimum(square, drawing.LARGEST_RADIUS**2))
        last = 1 / (1 + np.exp((drawing.LARGEST_RADIUS - 1) / blobs.softness[k]))
        profile = 1 / (1 + np.exp((radius - 1) / blobs.softness[k])) - last
        profile *= blobs.dilution[k] / (1 - last)
        level = blobs.brightness[k]
        picture = picture + (level - (1 - blobs.passes[k]) * picture) * profile
    return picture


def rows() -> list[Row]:
    """Return the comparison of drawing the particles of one frame of V1."""
    twin = scenes.open_scene("V1")
    twin.frame(80)  # what is made once per scene
    view = twin.view(80)
    geometry = twin.scene.geometry
    blobs = drawing.Blobs._make(
        part[:20] for part in view.blobs
    )  # the peer takes seconds for it
    empty = np.full((geometry.rows, geometry.columns), 4000.0, dtype=np.float32)

    def ours() -> np.ndarray:
        picture = empty.copy()
        pixels = drawing.cover(blobs, geometry.rows, geometry.columns)
        drawing.paint(picture, blobs, pixels, twin.scene.optics)
        return picture

    np.testing.assert_allclose(ours(), one_by_one(empty, blobs), rtol=1e-4)
    what = (
        "drawing 20 particles into a frame",
        "particles",
        20,
        "one particle at a time",
    )
    return [compare(what, ours, lambda: one_by_one(empty, blobs))]
