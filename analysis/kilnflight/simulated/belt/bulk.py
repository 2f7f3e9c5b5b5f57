"""Describe the particles of the belt papers: shape, size and number."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class Bulk:
    """One bulk material.

    Parameters
    ----------
    shape
        ``sphere``, ``cylinder`` or ``box``.
    half_mm
        Of a sphere: radius. Of a cylinder: radius, half of the height. Of a box: half
        edges, the shortest last, so that it lies on its largest face.
    count
        Particles in 0.2 kg (2020 paper, section 4).
    """

    shape: str
    half_mm: tuple[float, ...]
    count: int

    @property
    def rest_mm(self) -> float:
        """The height of the centre of a particle that lies on the belt."""
        return self.half_mm[0] if self.shape == "cylinder" else self.half_mm[-1]

    @property
    def outline_mm(self) -> npt.NDArray[np.float64]:
        """Half length, half width and corner radius (3,) in mm, lying, from above."""
        if self.shape == "sphere":
            return np.repeat(self.half_mm, 3)
        along, across = self.half_mm[:2]
        if self.shape == "cylinder":  # lies along its axis
            along, across = across, along
        return np.array([along, across, 0.0])


BULKS: dict[str, Bulk] = {
    "spheres": Bulk("sphere", (2.5,), 3713),
    "cuboids": Bulk("box", (3.0, 2.5, 1.0), 4357),
    "cylinders": Bulk("cylinder", (1.5, 4.5), 4427),
}
