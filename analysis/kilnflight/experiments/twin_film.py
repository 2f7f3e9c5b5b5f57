"""What recordings look like: a short film for a page, and each fraction beside its cloud."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.figure import Figure
from PIL import Image

from kilnflight.background import Median
from kilnflight.checks import InputError, check_count
from kilnflight.experiments.cloud_pictures import particle_cloud
from kilnflight.experiments.detection import labelled_subset
from kilnflight.experiments.tracking import flying_particles
from kilnflight.project.cache import write_whole
from kilnflight.project.style import COLOURS, PAGE_MM, canvas
from kilnflight.twin import truth
from kilnflight.twin.camera import FULL_SCALE
from kilnflight.twin.scene import Twin
from kilnflight.twin.scenes import cached_scene, campaign_name

WIDTH = 420  # pixels of the film
GREYS = 40  # more would double the file, fewer show steps on the wall
GAMMA = 0.6  # so that what does not burn is seen beside flames
LARGEST_BYTES = 1_200_000
CROP_PX = 640  # of a frame, a side
POINTS = 8000  # of a cloud that are drawn
STEP_MS = 60  # between pictures: 20 times slower than the recording at 330 frames/s


def write_film(twin: Twin, path: Path, first: int, frames: int = 60) -> int:
    """Write frames of a recording as an animated GIF that repeats; return its bytes.

    Raises
    ------
    InputError
        If there are no such frames, or the film would exceed `LARGEST_BYTES`.
    """
    check_count(frames, "write_film: frames")
    pictures = [_shown(twin.gray(t)) for t in range(first, first + frames)]
    content = io.BytesIO()
    rest = {"save_all": True, "append_images": pictures[1:], "duration": STEP_MS, "loop": 0}
    pictures[0].save(content, "GIF", **rest)
    size = content.getbuffer().nbytes
    if size > LARGEST_BYTES:
        raise InputError(f"write_film: {size} bytes for {frames} frames; ask for fewer.")
    write_whole(path, content.getvalue())
    return size


def recordings(keys: Sequence[tuple[str, float]], seed: int) -> dict[str, Twin]:
    """Return campaigns by their fraction."""
    return {name: cached_scene(campaign_name(name, bar), seed) for name, bar in keys}


def busiest(twin: Twin) -> int:
    """Return the frame, of every tenth, in which most particles fly."""
    return 10 * int(flying_particles(twin, range(0, len(twin), 10), 1).argmax())


def draw_fractions(twins: Mapping[str, Twin]) -> tuple[Figure, pd.DataFrame]:
    """Draw a crop of the busiest frame of each recording, and its cloud from the side.

    What is visible in the frames comes with the picture (`truth.sightings`).
    """
    picture, grid = canvas(2, len(twins), width_mm=PAGE_MM, height_mm=95, sharey="row")
    parts = []
    for (frames, side), (fraction, twin) in zip(grid.T, twins.items(), strict=True):
        t = busiest(twin)
        seen = truth.sightings(twin, t).query("visible")
        parts.append(seen.assign(fraction=fraction))
        gray = twin.gray(t)
        middle = seen[["row", "col"]].median().fillna(0).to_numpy()
        top, left = (
            int(np.clip(at - CROP_PX / 2, 0, max(length - CROP_PX, 0)))
            for at, length in zip(middle, gray.shape, strict=True)
        )
        crop = gray[top : top + CROP_PX, left : left + CROP_PX]
        look: dict[str, Any] = {"cmap": "gray", "vmin": 0, "vmax": 1}
        frames.imshow((crop / FULL_SCALE) ** GAMMA, **look)
        frames.set(title=f"{fraction}, frame {t}", xticks=[], yticks=[])
        cloud = particle_cloud(labelled_subset(twin, (t,), Median()), t)
        for flying, colour, size in ((False, "0.6", 0.2), (True, COLOURS[1], 1.2)):
            points = cloud[(cloud["particle"] >= 0) == flying]
            points = points.sample(min(len(points), POINTS), random_state=0)
            dots: dict[str, Any] = {"s": size, "color": colour, "linewidths": 0}
            side.scatter(points["z"] / 1000, points["y"] / 1000, rasterized=True, **dots)
        side.set(xlabel="depth z (m)", xlim=(2, 10), ylim=(-0.5, 1.0))
    grid[1, 0].set_ylabel("up, y (m)")
    columns = ["fraction", "frame", "particle", "row", "col", "pixels", "label", "x", "y", "z"]
    return picture, pd.concat(parts, ignore_index=True)[columns]


def _shown(gray: npt.NDArray[np.uint16]) -> Image.Image:
    """Return a small picture of few greys."""
    rows, columns = gray.shape
    size = (min(WIDTH, columns), rows * min(WIDTH, columns) // columns)
    small = cv2.resize(gray.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    steps = np.round((small / FULL_SCALE) ** GAMMA * (GREYS - 1)).astype(np.uint8)
    picture = Image.fromarray(steps, mode="P")
    picture.putpalette(np.repeat(np.linspace(0, 255, GREYS).astype(np.uint8), 3).tobytes())
    return picture
