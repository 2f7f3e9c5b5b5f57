"""The grey values of the kiln without particles, which ignition compares with."""

from functools import lru_cache

import numpy as np
import numpy.typing as npt
from pandas import DataFrame

from kilnflight.arrays import Array
from kilnflight.background.sliding_median import stack_median
from kilnflight.detection.combination import mean_gray
from kilnflight.recording.frames import Source

EMPTY_FRAMES = 21  # whose median is the kiln without particles; ours


def background_gray(detections: DataFrame, source: Source, frames: range) -> Array:
    """Return the kiln's mean grey value (n,) behind each detection's disc.

    ``detections`` has row, col and radius_px. The kiln is the median of `EMPTY_FRAMES`
    pictures spread over ``frames``. `kilnflight.ignition.Ignition` compares a
    particle's grey values with it.
    """
    picture = _empty_kiln(source, frames).astype(float)
    discs = detections[["row", "col", "radius_px"]].to_numpy(float)
    return mean_gray(picture, discs)


@lru_cache(maxsize=1)  # a study reads one recording's flights several times
def _empty_kiln(source: Source, frames: range) -> npt.NDArray[np.floating]:
    """Return the median (rows, cols) of `EMPTY_FRAMES` pictures over ``frames``."""
    steps = np.linspace(frames.start, frames.stop - 1, EMPTY_FRAMES).round().astype(int)
    return stack_median([source.recording().gray(t) for t in np.unique(steps).tolist()])
