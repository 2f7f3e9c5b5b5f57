"""A short film of a recording, for a page."""

from __future__ import annotations

import io
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
from PIL import Image

from kilnflight.checks import InputError, check_count
from kilnflight.project.cache import write_whole
from kilnflight.twin.camera import FULL_SCALE
from kilnflight.twin.scene import Twin

WIDTH = 420  # pixels of the film
GREYS = 40  # more would double the file, fewer show steps on the wall
GAMMA = 0.6  # so that what does not burn is seen beside flames
LARGEST_BYTES = 1_500_000
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


def _shown(gray: npt.NDArray[np.uint16]) -> Image.Image:
    """Return a small picture of few greys."""
    rows, columns = gray.shape
    size = (min(WIDTH, columns), rows * min(WIDTH, columns) // columns)
    small = cv2.resize(gray.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    steps = np.round((small / FULL_SCALE) ** GAMMA * (GREYS - 1)).astype(np.uint8)
    picture = Image.fromarray(steps, mode="P")
    picture.putpalette(np.repeat(np.linspace(0, 255, GREYS).astype(np.uint8), 3).tobytes())
    return picture
