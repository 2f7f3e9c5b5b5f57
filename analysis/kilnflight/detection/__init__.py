"""Detectors: a foreground or a point cloud -> particles.

==========  ==================  ================================  ================
method      equation            default                           source
==========  ==================  ================================  ================
`Otsu`      Eqs 2.11-2.20       none; particles from 5 px         Table 5.5
`DoG`       Eqs 2.21-2.28       local maximum of DoG 500          sec. 5.1.2, 5.1.3
==========  ==================  ================================  ================
"""

from typing import Protocol

import numpy as np
import numpy.typing as npt

from kilnflight.detection.dog import DoG
from kilnflight.detection.otsu import Otsu, otsu_threshold


class Detector2D(Protocol):
    """A foreground (rows, cols) -> particles (n, 3): row, col, radius in px."""

    def __call__(self, foreground: npt.NDArray[np.generic]) -> npt.NDArray[np.float64]:
        """Return the particles in a foreground."""
        ...


DETECTORS_2D: tuple[Detector2D, ...] = (Otsu(), DoG(threshold=500.0))

__all__ = ["DETECTORS_2D", "Detector2D", "DoG", "Otsu", "otsu_threshold"]
