"""Parts of the simulated sorter: particles, slide, belt and contacts.

The 2016 and 2020 papers.

The vibrating feeder lets particles fall on a slide, and the slide hands them to the belt.
Its shape is not published, so it is kept to an energy balance over its drop ``h``::

    rolling        v^2 = 2 g h / (1 + kappa)            kappa = 2/5, moment of inertia / (m r^2)
    sliding        v^2 = 2 g h (1 - mu / tan(angle))    Coulomb friction

A sphere rolls unless friction is too weak for that; then it slides and turns slower. A
cylinder or a cuboid slides: long particles align with neither the slope nor across it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from kilnflight.belt.models import BELT_EDGE_MM, BELT_START_MM, BELT_VELOCITY_MM_S, BELT_WIDTH_MM
from kilnflight.checks import (
    InputError,
    check_at_least,
    check_between,
    check_count,
    check_limit,
    check_positive,
)

Array = npt.NDArray[np.float64]

GRAVITY_MM_S2 = 9810.0
KAPPA = 0.4  # solid sphere
TOTAL_G = 200.0  # "approximately 0.2 kg of each bulk material was applied", 2020, section 4


@dataclass(frozen=True)
class Bulk:
    """One bulk material: the shape of its particles and how many there are.

    Parameters
    ----------
    shape
        ``sphere``, ``cylinder`` or ``box``, in MuJoCo's words.
    half_mm
        Its size in MuJoCo: radius; radius and half of the height; half edges. The shortest edge
        comes last, so that a box lies on its largest face.
    count
        Particles in 0.2 kg, as published; with the volume it gives the density.
    """

    shape: str
    half_mm: tuple[float, ...]
    count: int

    def __post_init__(self) -> None:
        """Refuse a shape with wrong lengths, and lengths or counts that are not positive."""
        if {"sphere": 1, "cylinder": 2, "box": 3}.get(self.shape) != len(self.half_mm):
            raise InputError(
                f"Bulk: shape {self.shape!r} with {len(self.half_mm)} lengths; a sphere has one "
                "(radius), a cylinder two (radius, half height), a box three (half edges)."
            )
        for length in self.half_mm:
            check_positive(length, "Bulk: half_mm")
        check_count(self.count, "Bulk: count")

    @property
    def density_g_mm3(self) -> float:
        """Return the density that makes ``count`` particles 0.2 kg.

        It is 711 to 823 kg/m^3, as beech has.
        """
        if self.shape == "sphere":
            volume = 4.0 / 3.0 * np.pi * self.half_mm[0] ** 3
        elif self.shape == "cylinder":
            volume = 2.0 * np.pi * self.half_mm[0] ** 2 * self.half_mm[1]
        else:
            volume = float(8.0 * np.prod(self.half_mm))
        return TOTAL_G / self.count / volume

    @property
    def reach_mm(self) -> float:
        """The radius of the smallest sphere around a particle."""
        return float(np.linalg.norm(self.half_mm))

    @property
    def rest_mm(self) -> float:
        """The height of the centre of a particle that lies on the belt."""
        return self.half_mm[0] if self.shape == "cylinder" else self.half_mm[-1]

    @property
    def outline_mm(self) -> Array:
        """Half length, half width and corner radius of a lying particle, seen from above."""
        if self.shape == "sphere":
            return np.repeat(self.half_mm, 3)
        along, across = self.half_mm[:2]
        if self.shape == "cylinder":  # lies along its axis
            along, across = across, along
        return np.array([along, across, 0.0])

    @property
    def rolls(self) -> bool:
        """Whether a particle rolls in any direction."""
        return self.shape == "sphere"


BULKS: dict[str, Bulk] = {
    "spheres": Bulk("sphere", (2.5,), 3713),
    "cuboids": Bulk("box", (3.0, 2.5, 1.0), 4357),
    "cylinders": Bulk("cylinder", (1.5, 4.5), 4427),
}
# Entry times in s of all particles after the first: last, mean and standard deviation, read off
# the authors' tracks. The feed swells and ebbs within seconds, differently for each material.
FEEDS: dict[str, tuple[float, float, float]] = {
    "spheres": (14.24, 5.92, 3.14),
    "cuboids": (17.3, 6.80, 3.33),
    "cylinders": (15.0, 6.41, 3.33),
}


def check_material(material: str) -> None:
    """Raise an `InputError` unless there is such a bulk material."""
    if material not in BULKS:
        raise InputError(f"no material {material!r}; there are {', '.join(BULKS)}.")


@dataclass(frozen=True)
class Conveyor:
    """A belt between two walls.

    Beyond the edge a particle flies on with the velocity it left with; nothing touches it there.
    """

    speed_mm_s: float = BELT_VELOCITY_MM_S  # sec. IV (2016), sec. 4 (2020)
    width_mm: float = BELT_WIDTH_MM
    start_mm: float = BELT_START_MM
    edge_mm: float = BELT_EDGE_MM
    end_mm: float = 800.0  # of the tracks, so that observations follow the edge
    sampling_hz: float = 1000.0  # both papers
    step_s: float = 0.0002  # the 2020 paper's DEM has 0.0001; see benchmarks/bench_sorter.py
    patience_s: float = 3.0  # a particle that takes longer to the edge is an error

    def __post_init__(self) -> None:
        """Refuse values that cannot be simulated."""
        for name in ("speed_mm_s", "width_mm", "sampling_hz", "step_s", "patience_s"):
            check_positive(getattr(self, name), f"Conveyor: {name}")
        if not self.start_mm < self.edge_mm <= self.end_mm:
            raise InputError(
                f"Conveyor: the belt runs from {self.start_mm} to {self.edge_mm} mm and tracks "
                f"end at {self.end_mm} mm; these must ascend."
            )
        steps = 1.0 / (self.sampling_hz * self.step_s)
        if abs(steps - round(steps)) > 1e-6 or steps < 0.5:
            raise InputError(
                f"Conveyor: one sample at {self.sampling_hz} Hz is no whole number of steps of "
                f"{self.step_s} s."
            )

    @property
    def steps(self) -> int:
        """Time steps from one sample to the next."""
        return round(1.0 / (self.sampling_hz * self.step_s))


@dataclass(frozen=True)
class Contacts:
    """The contacts of bodies: how they touch.

    The papers say "determined experimentally" and print no value.
    """

    belt_friction: float = 0.3  # wood on a plastic belt; handbooks give 0.2 to 0.4
    rolling_friction: float = 0.01  # arm over radius; assumption for wood on a belt
    particle_friction: float = 0.4  # wood on wood; handbooks give 0.25 to 0.5
    wall_friction: float = 0.4  # wood on metal; handbooks give 0.2 to 0.6
    spinning_mm: float = 0.01  # arm of the friction against turning on the spot; assumption
    # Of the normal contact with the belt, critically damped: no rebound. When one of the
    # next two is halved or doubled, the mean velocity 60 mm after landing changes by less than
    # 5 mm/s, that of a single particle by less than 9.
    belt_time_s: float = 0.0012
    slip_time_s: float = 0.004  # of friction; see `kilnflight.sorter.bodies`
    body_time_s: float = 0.0024  # of contacts between bodies and with walls
    # Share of critical damping, for the restitution of wood: handbooks give 0.5 to 0.6. Spheres
    # part with 0.51 to 0.59 of their closing speed, depending on where within a step of 0.2 ms
    # they meet. At 0.05 ms it is 0.54 to 0.55.
    body_damping: float = 0.22

    def __post_init__(self) -> None:
        """Refuse coefficients below 0 and times that are not positive."""
        for name in ("belt_friction", "belt_time_s", "slip_time_s", "body_time_s", "body_damping"):
            check_positive(getattr(self, name), f"Contacts: {name}")
        for name in ("rolling_friction", "particle_friction", "wall_friction", "spinning_mm"):
            check_at_least(getattr(self, name), 0.0, f"Contacts: {name}")

    def check_step(self, step_s: float) -> None:
        """Raise an `InputError` if contacts are too stiff for a time step."""
        shortest = min(self.belt_time_s, self.body_time_s * self.body_damping)
        if not step_s <= shortest / 2.0:
            raise InputError(
                f"Sorter: step_s {step_s!r} is too long for contacts of {shortest} s; take at most "
                f"half of that, or softer contacts."
            )


class Feed(NamedTuple):
    """Particles at the beginning of the belt, in the order in which they come.

    Arrays are (n,) each.
    """

    time_s: Array  # ascending, from 0
    y: Array  # across the belt, mm
    velocity_mm_s: Array  # (n, 3): along the belt, across it, upwards
    spin_1_s: Array  # about the axis across the belt, forwards positive
    yaw_rad: Array  # orientation of the first half edge, or of the cylinder's axis


@dataclass(frozen=True)
class Slide:
    """A slide at the end of a vibrating feeder.

    No number of it is published. Drop and spreads are fitted to the spheres of the authors' tracks
    (`kilnflight.sorter.simulation.FittedValues`), the others are assumptions.
    """

    drop_mm: float = 100.0  # height over which particles gain speed; assumption
    angle_deg: float = 45.0  # of the slope; assumption
    friction: float = 0.4  # wood on steel: handbooks give 0.2 to 0.6, the middle of it
    rolling_share: float = 1.0  # of the slide's spin that a sphere brings to the belt; assumption
    exit_deg: float = 8.0  # downwards, of the motion where the belt begins; assumption
    speed_spread: float = 0.05  # standard deviation over mean; assumption
    lateral_spread_mm_s: float = 20.0  # standard deviation across the belt; assumption
    yaw_spread_deg: float = np.inf  # about the belt's direction; inf: any; not published
    width_mm: float = 140.0  # of the feeder: the tracks begin between 20 and 160 mm of 180
    feed_s: float = FEEDS["spheres"][0]
    feed_mean_s: float = FEEDS["spheres"][1]
    feed_std_s: float = FEEDS["spheres"][2]

    def __post_init__(self) -> None:
        """Refuse lengths, angles and shares that no slide has."""
        for name in ("drop_mm", "width_mm", "feed_s", "feed_mean_s", "feed_std_s"):
            check_positive(getattr(self, name), f"Slide: {name}")
        for name in ("friction", "speed_spread", "lateral_spread_mm_s"):
            check_at_least(getattr(self, name), 0.0, f"Slide: {name}")
        check_between(self.rolling_share, 0.0, 1.0, "Slide: rolling_share")
        if not self.feed_std_s**2 < self.feed_mean_s * (self.feed_s - self.feed_mean_s):
            raise InputError(
                f"Slide: no feed of {self.feed_s} s has entry times of mean {self.feed_mean_s} s "
                f"and standard deviation {self.feed_std_s} s."
            )
        check_limit(self.yaw_spread_deg, "Slide: yaw_spread_deg")
        check_between(self.exit_deg, 0.0, 60.0, "Slide: exit_deg")
        check_between(self.angle_deg, 1.0, 89.0, "Slide: angle_deg")

    def feeding(self, material: str) -> Slide:
        """Return this slide with the entry times of a material, see `FEEDS`.

        A slide with other entry times than the default keeps them.
        """
        check_material(material)
        if (self.feed_s, self.feed_mean_s, self.feed_std_s) != FEEDS["spheres"]:
            return self
        last, mean, spread = FEEDS[material]
        return replace(self, feed_s=last, feed_mean_s=mean, feed_std_s=spread)

    def speed(self, bulk: Bulk) -> tuple[float, float]:
        """Return speed (mm/s) and velocity of the surface due to spin (mm/s) at the end."""
        steepness = np.tan(np.radians(self.angle_deg))
        sliding = 1.0 - self.friction / steepness  # share of the energy that is left
        share = max(sliding, 1.0 / (1.0 + KAPPA) if bulk.rolls else 0.0)
        if share <= 0:
            raise InputError(
                f"Slide: with friction {self.friction} nothing slides down {self.angle_deg} "
                "degrees; make it steeper or smoother."
            )
        speed = np.sqrt(2.0 * GRAVITY_MM_S2 * self.drop_mm * share)
        if not bulk.rolls:
            return float(speed), 0.0
        # Torque of kinetic friction over the time that the slide takes, at most rolling.
        turned = self.friction / (KAPPA * max(steepness - self.friction, 1e-12))
        return float(speed), float(self.rolling_share * speed * min(turned, 1.0))

    def __call__(
        self, bulk: Bulk, count: int, belt_mm: float, generator: np.random.Generator
    ) -> Feed:
        """Return ``count`` particles as they reach a belt of a width.

        The feeder covers the middle of the belt. Entry times have a beta distribution. Fewer
        particles than the bulk has come in proportionally less time, so each share of them comes
        at the rate of the whole run. The same state of the generator gives the same particles.
        """
        free = self.width_mm - 2.0 * bulk.reach_mm
        if free <= 0 or self.width_mm > belt_mm:
            raise InputError(
                f"Slide: width_mm {self.width_mm} holds no particle, or is wider than the belt "
                f"({belt_mm} mm)."
            )
        speed, surface = self.speed(bulk)
        factor = np.maximum(1.0 + self.speed_spread * generator.standard_normal(count), 0.1)
        down = np.radians(self.exit_deg)
        across = self.lateral_spread_mm_s * generator.standard_normal(count)
        mean, spread = self.feed_mean_s / self.feed_s, (self.feed_std_s / self.feed_s) ** 2
        total = mean * (1.0 - mean) / spread - 1.0  # of both shapes of the beta distribution
        time_s = self.feed_s * np.sort(generator.beta(mean * total, (1.0 - mean) * total, count))
        time_s = (time_s - time_s[:1]) * count / bulk.count
        y = belt_mm / 2.0 + free * (generator.random(count) - 0.5)
        if np.isinf(self.yaw_spread_deg):
            yaw = generator.uniform(-np.pi, np.pi, count)
        else:
            yaw = np.radians(self.yaw_spread_deg) * generator.standard_normal(count)
        along, upwards = speed * factor * np.cos(down), -speed * factor * np.sin(down)
        spin = surface * factor / bulk.half_mm[0] if bulk.rolls else np.zeros(count)
        return Feed(time_s, y, np.column_stack([along, across, upwards]), spin, yaw)
