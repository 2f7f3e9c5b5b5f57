r"""Background subtraction: only what moves stays.

Section 2.2.1 of the thesis, with the values of Table 5.4.

    stack of gray frames -> model(frames, indices) -> one foreground per requested frame

=================  ================  ============================================  =========
model              equation          default                                       source
=================  ================  ============================================  =========
`TwoFrame`         Eq. 2.5           3 frames before                               Table 5.4
`ThreeFrame`       Eq. 2.6           3 frames before and after                     Table 5.4
`Mean`             sec. 2.2.1        25 frames before and 25 after                 Table 5.4
`Median`           sec. 2.2.1        75 frames before and 75 after                 Table 5.4
`Adaptive`         Eqs 2.7, 2.8      25 frames before and 25 after, alpha 0.05     Table 5.4
`RunningGaussian`  Eqs 2.9, 2.10     10 frames, alpha 0.99, k 0.4                  Table 5.4
=================  ================  ============================================  =========

The foreground is the absolute difference of frame and background, as Eqs 2.5, 2.6 and
2.10 have it. Dark particles before a bright wall count as bright ones before a dark
wall. For mean, median and adaptive learning no difference is printed, and section 3.1 says
that dark particles may be lost. `StopsAtZero` is that reading; the thesis decides for neither.
The foreground is float32, in grey values; its value for a frame does not depend on which other
frames are asked for. `Mean`, `Median`, `Adaptive` and `RunningGaussian` also have
``backgrounds(frames, indices)``, the images of Fig. 5.2.
"""

from collections.abc import Iterable, Iterator
from typing import Protocol

from kilnflight.background.difference import (
    Foreground,
    Frames,
    StopsAtZero,
    ThreeFrame,
    TwoFrame,
)
from kilnflight.background.recursive import Adaptive, RunningGaussian
from kilnflight.background.static import Mean, Median


class BackgroundModel(Protocol):
    """Subtract a background from each frame of a stack."""

    def __call__(self, frames: Frames, indices: Iterable[int]) -> Iterator[Foreground]:
        """Yield each requested frame's foreground, (rows, cols) float32."""
        ...


MODELS: tuple[BackgroundModel, ...] = (
    TwoFrame(),
    ThreeFrame(),
    Mean(),
    Median(),
    Adaptive(),
    RunningGaussian(),
)

__all__ = [
    "MODELS",
    "Adaptive",
    "BackgroundModel",
    "Mean",
    "Median",
    "RunningGaussian",
    "StopsAtZero",
    "ThreeFrame",
    "TwoFrame",
]
