"""Sums of frame differences in small boxes, for the texture term of section 4.2.3."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
import zarr

from kilnflight.checks import InputError
from kilnflight.kiln import TILE, DetectionRun


@dataclass(frozen=True)
class Differences:
    """Sums of the differences to the background that were stored with detections.

    Each is kept as the root of its grey values, rounded: of 10,000 that is off by 100 at
    most, less than the noise there.
    """

    run: DetectionRun

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the frames."""
        known = self.run.source.recording().attributes
        return known.rows, known.columns

    def __call__(
        self, first_frame: int, last_frame: int, top: int, left: int, bottom: int, right: int
    ) -> npt.NDArray[np.float64]:
        """Return the sum over the frames first to last, both counted, in a box."""
        total = np.zeros((bottom - top, right - left))
        for frames in self.run.chunks:
            some = range(max(first_frame, frames.start), min(last_frame + 1, frames.stop))
            if some:
                folder = self.run.differences_of(frames)
                cut = slice(some.start - frames.start, some.stop - frames.start)
                for place, inside, within in _parts(top, left, bottom, right):
                    roots = _tile(folder, *place)[(cut, *within)].astype(np.uint16)
                    total[inside] += np.sum(roots * roots, axis=0, dtype=np.uint32)
        return total


def _parts(
    top: int, left: int, bottom: int, right: int
) -> Iterator[tuple[tuple[int, int], tuple[slice, slice], tuple[slice, slice]]]:
    """Yield the tiles that a box touches: which, where in the box, and where in the tile."""
    height, width = TILE
    for row in range(top // height, (bottom - 1) // height + 1):
        for col in range(left // width, (right - 1) // width + 1):
            rows = max(top, row * height), min(bottom, (row + 1) * height)
            cols = max(left, col * width), min(right, (col + 1) * width)
            inside = slice(rows[0] - top, rows[1] - top), slice(cols[0] - left, cols[1] - left)
            within = tuple(
                slice(ends[0] - at * size, ends[1] - at * size)
                for ends, at, size in ((rows, row, height), (cols, col, width))
            )
            yield (row, col), inside, (within[0], within[1])


@lru_cache(maxsize=32)  # 20 MB each: what pairs in 300 frames look at, again and again
def _tile(folder: Path, row: int, col: int) -> npt.NDArray[np.uint8]:
    """Return the roots (frames, rows, cols) of one tile in all frames of a chunk."""
    try:
        # the files of many frames in one go: asked one by one, they cost twice the time
        with zarr.config.set({"codec_pipeline.batch_size": 32}):
            store = zarr.open_array(folder, mode="r")
    except (OSError, ValueError) as error:
        raise InputError(
            f"{folder}: frame differences cannot be read ({error}). Run `kiln.detections` first."
        ) from error
    height, width = TILE
    rows, cols = slice(row * height, (row + 1) * height), slice(col * width, (col + 1) * width)
    return np.asarray(store[:, rows, cols], dtype=np.uint8)
