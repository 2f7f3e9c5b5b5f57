"""The few inputs that are not published: fitted once, read from their files.

Two scripts write the files beside this module, and compare their targets with the published
values. ``python -m kilnflight.experiments.twin_calibration`` fits flight and ignition to two of
the eight campaigns. ``python -m kilnflight.experiments.twin_exposure`` fits the picture to Otsu's
row of Table 5.5.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from kilnflight.project import cache
from kilnflight.twin.background import Surroundings
from kilnflight.twin.camera import FULL_SCALE, Geometry, Optics
from kilnflight.twin.flight import Flight
from kilnflight.twin.gas import Gas
from kilnflight.twin.life import OnTheWall
from kilnflight.twin.scene import Scene

FLIGHT_FILE = Path(__file__).with_name("calibrated.json")
LIGHT_FILE = Path(__file__).with_name("exposure.json")


class Kiln(NamedTuple):
    """All that decides a flight: its settings, the gas (at any pressure) and the geometry."""

    flight: Flight
    gas: Gas
    geometry: Geometry


@dataclass(frozen=True)
class FlightInputs:
    """The fitted inputs of flight and ignition.

    The defaults are those of `Flight` and `Gas`.
    """

    lance_length_m: float = Flight.lance_length_m
    solids_friction: float = Flight.solids_friction
    jet_persistence: float = Gas.jet_persistence
    launch_elevation_deg: float = Flight.launch_elevation_deg
    launch_spread_factor: float = Flight.launch_spread_factor
    extinction_1_s: float = Flight.extinction_1_s

    def applied(self, flight: Flight, gas: Gas) -> tuple[Flight, Gas]:
        """Return flight and gas with these inputs, all others as they were."""
        values = asdict(self)
        persistence = values.pop("jet_persistence")
        return replace(flight, **values), replace(gas, jet_persistence=persistence)


@dataclass(frozen=True)
class LightInputs:
    """The fitted inputs of the picture.

    The defaults are those of `Optics` and the like.
    """

    wall_level: float = Optics.wall_level  # exposure and gain
    # Flame before the wall over full scale: from 1 on it is overexposed.
    flame_reach: float = (Optics.wall_level + Optics.flame_level) / FULL_SCALE
    irradiance: float = Optics.irradiance  # contrast of those that do not burn
    share_on: float = OnTheWall.share_on  # flicker of the flames on the wall
    # Duration of these flames. A median over half a second takes long ones for background, so it
    # is counted as flicker.
    body_s: float = OnTheWall.body_s
    burner_level: float = Surroundings.flame_level  # the burner's flame: how far it saturates
    burner_flicker: float = Surroundings.flame_flicker  # and how much its rim moves

    def applied(self, scene: Scene) -> Scene:
        """Return a scene with these inputs, all others as they were."""
        optics = replace(
            scene.optics,
            wall_level=self.wall_level,
            flame_level=self.flame_reach * FULL_SCALE - self.wall_level,
            irradiance=self.irradiance,
        )
        wall = replace(scene.on_the_wall, share_on=self.share_on, body_s=self.body_s)
        burner = replace(
            scene.surroundings, flame_level=self.burner_level, flame_flicker=self.burner_flicker
        )
        return replace(scene, optics=optics, on_the_wall=wall, surroundings=burner)


@lru_cache(maxsize=8)
def flight_inputs(path: Path = FLIGHT_FILE) -> FlightInputs:
    """Return the fitted inputs of flight and ignition.

    See `cache.read_calibration` for errors.
    """
    content = cache.read_calibration(path, None, "kilnflight.experiments.twin_calibration")
    return cache.calibrated(FlightInputs, path, content)


@lru_cache(maxsize=8)
def light_inputs(path: Path = LIGHT_FILE) -> LightInputs:
    """Return the fitted inputs of the picture.

    See `cache.read_calibration` for errors.
    """
    content = cache.read_calibration(path, None, "kilnflight.experiments.twin_exposure")
    return cache.calibrated(LightInputs, path, content)


def first_kiln() -> Kiln:
    """Return the kiln of the first twin, with its fitted inputs."""
    return Kiln(*flight_inputs().applied(Flight(), Gas()), Geometry())
