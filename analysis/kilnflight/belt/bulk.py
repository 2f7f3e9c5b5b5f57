"""The three bulk materials of the 2020 paper as rigid bodies (section 4, "Scenarios")."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilnflight.checks import InputError, check_count, check_positive

TOTAL_G = 200.0  # "approximately 0.2 kg of each bulk material was applied"


@dataclass(frozen=True)
class Bulk:
    """One bulk material: the shape of its particles and how many there are.

    Parameters
    ----------
    shape
        ``sphere``, ``cylinder`` or ``box``, in MuJoCo's words.
    half_mm
        What MuJoCo calls its size: radius; radius and half of the height; half edges, the
        shortest last, so that a box lies on its largest face.
    count
        Particles in 0.2 kg, as published; with the volume it gives the density.
    """

    shape: str
    half_mm: tuple[float, ...]
    count: int

    def __post_init__(self) -> None:
        """Refuse what is no body."""
        wanted = {"sphere": 1, "cylinder": 2, "box": 3}.get(self.shape)
        if wanted != len(self.half_mm):
            raise InputError(
                f"Bulk: shape {self.shape!r} with {len(self.half_mm)} lengths; a sphere has one "
                "(radius), a cylinder two (radius, half height), a box three (half edges)."
            )
        for length in self.half_mm:
            check_positive(length, "Bulk: half_mm")
        check_count(self.count, "Bulk: count")

    @property
    def volume_mm3(self) -> float:
        """The volume of one particle."""
        if self.shape == "sphere":
            return 4.0 / 3.0 * np.pi * self.half_mm[0] ** 3
        if self.shape == "cylinder":
            return 2.0 * np.pi * self.half_mm[0] ** 2 * self.half_mm[1]
        return float(8.0 * np.prod(self.half_mm))

    @property
    def density_g_mm3(self) -> float:
        """The density that makes ``count`` particles 0.2 kg: 711 to 823 kg/m^3, as beech has."""
        return TOTAL_G / self.count / self.volume_mm3

    @property
    def reach_mm(self) -> float:
        """The radius of the smallest sphere around a particle."""
        return float(np.linalg.norm(self.half_mm))

    @property
    def rest_mm(self) -> float:
        """The height of the centre of a particle that lies on the belt."""
        return self.half_mm[0] if self.shape == "cylinder" else self.half_mm[-1]

    @property
    def rolls(self) -> bool:
        """Whether a particle rolls in any direction."""
        return self.shape == "sphere"


BULKS: dict[str, Bulk] = {
    "spheres": Bulk("sphere", (2.5,), 3713),
    "cuboids": Bulk("box", (3.0, 2.5, 1.0), 4357),
    "cylinders": Bulk("cylinder", (1.5, 4.5), 4427),
}
