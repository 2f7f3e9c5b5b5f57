"""What a slide does to particles before the belt: speed, spin, direction, place, time.

The vibrating feeder lets particles fall on a slide, and the slide hands them to the belt.
Its shape is not published, so it is kept to an energy balance over its drop ``h``::

    rolling        v^2 = 2 g h / (1 + kappa)            kappa = 2/5, moment of inertia / (m r^2)
    sliding        v^2 = 2 g h (1 - mu / tan(angle))    Coulomb friction

A sphere rolls unless friction is too weak for that; then it slides and turns slower. A
cylinder or a cuboid slides: long particles align with neither the slope nor across it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from kilnflight.belt.bulk import Bulk
from kilnflight.belt.friction import GRAVITY_MM_S2
from kilnflight.checks import (
    InputError,
    check_at_least,
    check_between,
    check_limit,
    check_positive,
)

Array = npt.NDArray[np.float64]
KAPPA = 0.4  # solid sphere


class Fed(NamedTuple):
    """Particles at the beginning of the belt, in the order in which they come; (n,) each."""

    time_s: Array  # ascending, from 0
    y: Array  # across the belt, mm
    velocity_mm_s: Array  # (n, 3): along the belt, across it, upwards
    spin_1_s: Array  # about the axis across the belt, forwards positive
    yaw_rad: Array  # orientation of the first half edge, or of the cylinder's axis


@dataclass(frozen=True)
class Slide:
    """A slide at the end of a vibrating feeder.

    No number of it is published. Drop and spreads are found with the spheres of the
    authors' tracks (`kilnflight.belt.friction_values`), the others are assumptions.
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
    rate_1_s: float = 270.0  # particles per second: about 4000 in 15 s, as in the files

    def __post_init__(self) -> None:
        """Refuse what is no slide."""
        for name in ("drop_mm", "width_mm", "rate_1_s"):
            check_positive(getattr(self, name), f"Slide: {name}")
        for name in ("friction", "speed_spread", "lateral_spread_mm_s"):
            check_at_least(getattr(self, name), 0.0, f"Slide: {name}")
        check_between(self.rolling_share, 0.0, 1.0, "Slide: rolling_share")
        check_limit(self.yaw_spread_deg, "Slide: yaw_spread_deg")
        check_between(self.exit_deg, 0.0, 60.0, "Slide: exit_deg")
        check_between(self.angle_deg, 1.0, 89.0, "Slide: angle_deg")

    def speed(self, bulk: Bulk) -> tuple[float, float]:
        """Return speed (mm/s) and velocity of the surface due to spin (mm/s) at the end."""
        steepness = np.tan(np.radians(self.angle_deg))
        sliding = 1.0 - self.friction / steepness  # share of the energy that is left
        rolling = 1.0 / (1.0 + KAPPA) if bulk.rolls else 0.0
        share = max(sliding, rolling)
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
    ) -> Fed:
        """Return particles as they reach the belt.

        Parameters
        ----------
        bulk
            Their material.
        count
            How many.
        belt_mm
            Width of the belt, of which the feeder covers the middle.
        generator
            Of the chances; the same state gives the same particles.
        """
        speed, surface = self.speed(bulk)
        factor = np.maximum(1.0 + self.speed_spread * generator.standard_normal(count), 0.1)
        down = np.radians(self.exit_deg)
        velocity = np.column_stack(
            [
                speed * factor * np.cos(down),
                self.lateral_spread_mm_s * generator.standard_normal(count),
                -speed * factor * np.sin(down),
            ]
        )
        free = self.width_mm - 2.0 * bulk.reach_mm
        if free <= 0 or self.width_mm > belt_mm:
            raise InputError(
                f"Slide: width_mm {self.width_mm} holds no particle, or is wider than the belt "
                f"({belt_mm} mm)."
            )
        return Fed(
            time_s=np.sort(generator.uniform(0.0, count / self.rate_1_s, count)),
            y=belt_mm / 2.0 + free * (generator.random(count) - 0.5),
            velocity_mm_s=velocity,
            spin_1_s=surface * factor / bulk.half_mm[0] if bulk.rolls else np.zeros(count),
            yaw_rad=self._yaw(count, generator),
        )

    def _yaw(self, count: int, generator: np.random.Generator) -> Array:
        if np.isinf(self.yaw_spread_deg):
            return generator.uniform(-np.pi, np.pi, count)
        return np.radians(self.yaw_spread_deg) * generator.standard_normal(count)
