"""Sums of frame differences in small boxes, for the texture term of section 4.2.3."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import zarr

from kilnflight.checks import InputError
from kilnflight.stages import Stretch


@dataclass(frozen=True)
class Differences:
    """Sums of the differences to the background that `detections` has kept.

    Each is kept as the root of its grey values, rounded: of 10,000 that is off by 100 at
    most, less than the noise there.
    """

    wanted: Stretch

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the frames."""
        known = self.wanted.origin.recording().attributes
        return known.rows, known.columns

    def __call__(
        self, first_frame: int, last_frame: int, top: int, left: int, bottom: int, right: int
    ) -> npt.NDArray[np.float64]:
        """Return the sum over the frames first to last, both counted, in a box."""
        total = np.zeros((bottom - top, right - left))
        for frames in self.wanted.chunks:
            some = range(max(first_frame, frames.start), min(last_frame + 1, frames.stop))
            if some:
                store = _opened(self.wanted.differences_of(frames))
                cut = slice(some.start - frames.start, some.stop - frames.start)
                roots = np.asarray(store[cut, top:bottom, left:right], dtype=np.float64)
                total += np.sum(roots**2, axis=0)
        return total


def _opened(folder: Path) -> zarr.Array:
    try:
        return zarr.open_array(folder, mode="r")
    except (OSError, ValueError) as error:
        raise InputError(
            f"{folder}: frame differences cannot be read ({error}). Run `stages.detections` first."
        ) from error
