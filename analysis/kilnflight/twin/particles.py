"""The four fractions: how single particles differ, and when they are fed.

The thesis shows the fractions on a photograph with a scale (Fig. 2.7) but prints neither
sizes nor masses. So every range here comes from handbooks or the product, as its comment
says; values are drawn uniformly from it. Particles are fed by hand, in bursts (sections
2.1.1 and 5.2.1). Lengths in metres, SI units throughout.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.checks import InputError, check_number

Array = npt.NDArray[np.float64]

Range = tuple[float, float]

# Mean number of particles in a burst; assumption. With 15, tried first, a window of Table 5.15
# could be empty, which the thesis's were not.
HANDFUL = 6.0
LEAD_S = 1.0  # from the begin of the feeding to the first frame
SLAB, SPHERE = 0, 2  # geometry exponent of one-dimensional heat conduction


@dataclass(frozen=True)
class Fraction:
    """The common properties of particles of one kind, and the limits of the others."""

    name: str
    length_m: Range
    width_m: Range
    thickness_m: Range
    density_kg_m3: Range
    round: bool = False  # as wide as long (discs and granules)
    sheet: bool = False  # tumbles; thin enough to have one temperature
    body: int = SLAB
    moisture: float = 0.06  # share of the dry mass
    heat_capacity_j_kg_k: float = 1400.0
    conductivity_w_m_k: float = 0.15
    emissivity: float = 0.9
    reflectivity: float = 0.5  # of the wall's light, for the camera
    # Volatiles leave by one reaction of first order; cellulose after Antal and Varhegyi 1995
    pyrolysis_1_s: float = 1.0e18
    pyrolysis_j_mol: float = 238e3
    volatile_share: float = 0.8  # of the dry mass
    devolatilisation_j_kg: float = 1.2e6  # heat to release a kg of volatiles
    char_time_s: float = 0.35  # time constant of char burn-out
    orientation: Range = (0.5, 1.0)  # mean projected over broadside area while tumbling
    lift_coefficient: float = 0.3
    launch_spread_deg: float = 3.0  # standard deviation about the lance's direction

    def draw(self, count: int, generator: np.random.Generator) -> Particles:
        """Return ``count`` particles; the same generator state gives the same ones."""
        if count < 0:
            raise InputError(f"{self.name}: {count} particles; a count is not below 0.")

        def uniform(limits: Range) -> Array:
            return generator.uniform(*limits, count)

        length, width, thickness = (
            uniform(getattr(self, name)) for name in ("length_m", "width_m", "thickness_m")
        )
        if self.round:
            width = length.copy()
        if self.body == SPHERE:
            thickness = length.copy()
        dry_mass = self._filled * length * width * thickness * uniform(self.density_kg_m3)
        generator.normal(size=count)  # not used: keeps the order of the draws
        return Particles(self, length, width, thickness, dry_mass, uniform(self.orientation))

    @property
    def _filled(self) -> float:
        """Share of the box of length, width and thickness that the body fills."""
        return np.pi / 6 if self.body == SPHERE else np.pi / 4 if self.round else 1.0

    @property
    def middle_mass_kg(self) -> float:
        """Mass at release, water included, of a particle in the middle of every range."""
        length, width, thickness, dry_density = map(
            np.mean, (self.length_m, self.width_m, self.thickness_m, self.density_kg_m3)
        )
        width = length if self.round else width
        thickness = length if self.body == SPHERE else thickness
        return float(self._filled * length * width * thickness * dry_density * (1 + self.moisture))


@dataclass(frozen=True)
class Particles:
    """Particles of one fraction; arrays are (n,)."""

    fraction: Fraction
    length_m: Array
    width_m: Array
    thickness_m: Array
    dry_mass_kg: Array
    orientation: Array

    def __post_init__(self) -> None:
        """Refuse arrays of different lengths."""
        lengths = {field.name: len(getattr(self, field.name)) for field in fields(self)[1:]}
        if len(set(lengths.values())) > 1:
            raise InputError(f"Particles: arrays differ in length: {lengths}.")

    def __len__(self) -> int:
        """Return the number of particles."""
        return len(self.length_m)

    def joined(self, others: Sequence[Particles]) -> Particles:
        """Return these particles followed by others of the same fraction."""
        parts = [self, *others]
        names = (field.name for field in fields(self)[1:])
        arrays = (np.concatenate([getattr(part, name) for part in parts]) for name in names)
        return Particles(self.fraction, *arrays)

    def table(self) -> pd.DataFrame:
        """Return fraction and size, one row per particle."""
        sizes = ("length", "width", "thickness")
        return pd.DataFrame(
            {"fraction": self.fraction.name}
            | {f"{size}_mm": 1000.0 * getattr(self, f"{size}_m") for size in sizes},
            index=range(len(self)),
        )

    @property
    def broadside_m2(self) -> Array:
        """Largest projected area, (n,)."""
        shape = np.pi / 4 if self.fraction.round else 1.0
        return shape * self.length_m * self.width_m

    @property
    def surface_m2(self) -> Array:
        """Area that takes up heat, (n,): both faces of a sheet or chip, all of a sphere."""
        if self.fraction.body == SPHERE:
            return np.pi * self.length_m**2
        edge = 2 * (self.length_m + self.width_m) * self.thickness_m
        return 2 * self.broadside_m2 + (0.0 if self.fraction.sheet else edge)

    @property
    def diameter_m(self) -> Array:
        """Diameter of the disc of the same broadside area, (n,)."""
        return np.sqrt(4 * self.broadside_m2 / np.pi)


# Spruce and pine, 420 to 600 kg/m3 and 8 % moisture (wood handbooks); sizes by Fig. 2.7.
WOOD_CHIPS = Fraction(
    name="wood chip",
    length_m=(8e-3, 18e-3),
    width_m=(4e-3, 10e-3),
    thickness_m=(1.2e-3, 3.0e-3),
    density_kg_m3=(420.0, 600.0),
    moisture=0.08,
    heat_capacity_j_kg_k=1700.0,
    conductivity_w_m_k=0.15,
    reflectivity=0.45,
    pyrolysis_1_s=9.3e9,  # pine (Wagenaar and others 1993, tar)
    pyrolysis_j_mol=149e3,
    lift_coefficient=0.15,
    launch_spread_deg=3.0,
)
# Discs of a hole punch out of office paper of 75 to 90 g/m2 at 0.1 mm.
CONFETTI = Fraction(
    name="confetti",
    length_m=(5e-3, 6e-3),
    width_m=(5e-3, 6e-3),
    thickness_m=(0.095e-3, 0.105e-3),
    density_kg_m3=(780.0, 860.0),
    round=True,
    sheet=True,
    reflectivity=0.70,
    lift_coefficient=0.30,
    launch_spread_deg=6.0,
)
# Cross-cut shredder, 20 to 45 mm by 4 to 8 mm, 70 to 90 g/m2 at 0.1 mm.
PAPER_SHREDS = Fraction(
    name="paper shred",
    length_m=(20e-3, 45e-3),
    width_m=(4e-3, 8e-3),
    thickness_m=(0.095e-3, 0.105e-3),
    density_kg_m3=(740.0, 860.0),
    sheet=True,
    reflectivity=0.70,
    lift_coefficient=0.45,
    launch_spread_deg=8.0,
)
# LDPE and HDPE granules of 3 to 4.8 mm, 915 to 950 kg/m3 (data sheets); transparent.
PE_GRANULES = Fraction(
    name="PE granule",
    length_m=(3.0e-3, 4.8e-3),
    width_m=(3.0e-3, 4.8e-3),
    thickness_m=(3.0e-3, 4.8e-3),
    density_kg_m3=(915.0, 950.0),
    round=True,
    body=SPHERE,
    moisture=0.0,
    heat_capacity_j_kg_k=2400.0,
    conductivity_w_m_k=0.35,
    emissivity=0.85,
    reflectivity=0.30,
    pyrolysis_1_s=1.0e15,  # LDPE (Westerhout and others 1997)
    pyrolysis_j_mol=241e3,
    volatile_share=1.0,
    orientation=(0.95, 1.0),
    lift_coefficient=0.0,
    launch_spread_deg=3.0,
)
FRACTIONS: dict[str, Fraction] = {
    kind.name: kind for kind in (WOOD_CHIPS, CONFETTI, PAPER_SHREDS, PE_GRANULES)
}


def find_fraction(name: str) -> Fraction:
    """Return a fraction by its name in the thesis."""
    if name not in FRACTIONS:
        raise InputError(f"unknown fraction {name!r}; there are {', '.join(FRACTIONS)}.")
    return FRACTIONS[name]


@dataclass(frozen=True)
class Burst:
    """A handful: particles of one fraction that leave the lance one after the other."""

    fraction: str
    count: int
    start_s: float  # 0 at the first frame; what flies in it was fed before
    duration_s: float = 0.4  # a handful takes 0.2 to 1 s; assumption

    def __post_init__(self) -> None:
        """Refuse an unknown fraction, a negative count or no duration."""
        find_fraction(self.fraction)
        check_number(self.duration_s, "Burst: duration_s", above=0)
        if self.count < 0:
            raise InputError(f"Burst: count {self.count} is below 0.")

    def release(self, generator: np.random.Generator) -> tuple[Particles, Array]:
        """Return the particles and the time in s at which each leaves the lance.

        The times are ascending.
        """
        particles = find_fraction(self.fraction).draw(self.count, generator)
        times = self.start_s + self.duration_s * generator.beta(2.0, 2.0, self.count)
        return particles, np.sort(times)


def air_load(feed: Sequence[Burst], air_kg_s: float) -> float:
    """Return the mass flow of particles over that of the lance's air, mean over particles.

    Every particle has the flow of its handful, and the mass of the middle of every range.
    """
    count = np.array([burst.count for burst in feed], dtype=np.float64)
    masses = np.array([find_fraction(burst.fraction).middle_mass_kg for burst in feed])
    flow = count * masses / np.array([burst.duration_s for burst in feed])
    return float((count * flow).sum() / max(count.sum(), 1.0) / air_kg_s)


def by_hand(
    fraction: Fraction,
    count: int,
    duration_s: float,
    generator: np.random.Generator,
) -> tuple[Burst, ...]:
    """Return bursts that feed ``count`` particles over a run.

    Parameters
    ----------
    fraction
        Kind of the particles.
    count
        Particles in all; the last burst takes the rest.
    duration_s
        Length of the run.
    generator
        Draws sizes (geometric distribution) and times.
    """
    sizes: list[int] = []
    while sum(sizes) < count:
        sizes.append(int(min(generator.geometric(1 / HANDFUL), count - sum(sizes))))
    starts = np.sort(generator.uniform(-LEAD_S, duration_s, len(sizes)))
    lengths = generator.uniform(0.2, 1.0, len(sizes))
    return tuple(
        Burst(fraction.name, size, float(start), float(length))
        for size, start, length in zip(sizes, starts, lengths, strict=True)
    )
