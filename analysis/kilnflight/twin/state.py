"""What a particle is while it flies; internal to `kilnflight.twin.flight`."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from kilnflight.twin.forces import DRYING_K
from kilnflight.twin.fractions import Fraction, Particles

Array = npt.NDArray[np.float64]

UNLIT, BURNING, CHAR = 0, 1, 2


@dataclass
class State:
    """The particles that still fly: what is fixed, and what changes; arrays (active, ...)."""

    kind: Fraction
    index: npt.NDArray[np.intp]  # row of the particle among all
    diameter_m: Array
    broadside_m2: Array
    surface_m2: Array
    half_m: Array  # half thickness or radius
    dry_kg: Array
    ignition_k: Array
    orientation: Array
    position: Array  # (active, 3)
    velocity: Array  # (active, 3)
    turbulence: Array  # (active, 3)
    lift: Array  # (active, 3) unit vectors
    nodes_k: Array  # (active, nodes): middles of the shells, from inside out
    surface_k: Array
    volatiles_kg: Array
    char_kg: Array
    burning: npt.NDArray[np.int8]
    met: npt.NDArray[np.bool_]  # (active, 3): ignition criteria fulfilled one step ago

    @classmethod
    def at_rest(cls, particles: Particles, nodes: int, temperature_k: float) -> State:
        """Return all particles, cold and without motion."""
        n, kind, dry = len(particles), particles.fraction, particles.dry_mass_kg
        return cls(
            kind=kind,
            index=np.arange(n),
            diameter_m=particles.diameter_m,
            broadside_m2=particles.broadside_m2,
            surface_m2=particles.surface_m2,
            half_m=particles.thickness_m / 2,
            dry_kg=dry,
            ignition_k=particles.ignition_k,
            orientation=particles.orientation,
            position=np.zeros((n, 3)),
            velocity=np.zeros((n, 3)),
            turbulence=np.zeros((n, 3)),
            lift=np.tile([0.0, 0.0, 1.0], (n, 1)),
            nodes_k=np.full((n, 1 if kind.sheet else nodes), temperature_k),
            surface_k=np.full(n, temperature_k),
            volatiles_kg=dry * kind.volatile_share,
            char_kg=dry * (1 - kind.volatile_share),
            burning=np.full(n, UNLIT, dtype=np.int8),
            met=np.zeros((n, 3), dtype=bool),
        )

    def keep(self, rows: npt.NDArray[np.bool_]) -> None:
        """Drop the particles whose flight has ended."""
        for one in fields(self):
            if one.name != "kind":
                setattr(self, one.name, getattr(self, one.name)[rows])

    @property
    def char_share(self) -> Array:
        """Char that is left over the char there was, (active,); 1 where there is none."""
        whole = self.dry_kg * (1 - self.kind.volatile_share)
        return np.divide(self.char_kg, whole, out=np.ones_like(whole), where=whole > 0)

    @property
    def area_share(self) -> Array:
        """Share of the broadside area that is left, (active,): charred sheets crumble."""
        return np.where((self.burning == CHAR) & self.kind.sheet, self.char_share, 1.0)

    @property
    def release_mass_kg(self) -> Array:
        """Mass at release, water included, (active,)."""
        return self.dry_kg * (1 + self.kind.moisture)

    @property
    def mass_kg(self) -> Array:
        """Present mass, (active,); ash keeps it above 2 % of the mass at release."""
        low, high = DRYING_K
        wet = 1 - np.clip((self.nodes_k.mean(axis=1) - low) / (high - low), 0.0, 1.0)
        now = self.volatiles_kg + self.char_kg + self.kind.moisture * self.dry_kg * wet
        return np.maximum(now, 0.02 * self.release_mass_kg)
