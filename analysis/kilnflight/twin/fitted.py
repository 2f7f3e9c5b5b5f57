"""The few inputs that are not published: fitted once, read from their files.

Two scripts write the files beside this module, and compare their targets with the published
values. ``python -m kilnflight.experiments.twin_calibration`` fits flight and ignition to two of
the eight campaigns. ``python -m kilnflight.experiments.twin_exposure`` fits the picture to Otsu's
row of Table 5.5. A third, ``python -m kilnflight.experiments.twin_flight``, fits the second look at
flight and ignition to the same two campaigns. A fourth, ``python -m
kilnflight.experiments.twin_light``, fits the second look's picture to Otsu's row again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from kilnflight.project import cache
from kilnflight.twin.background import Surroundings
from kilnflight.twin.burner import Burner
from kilnflight.twin.burning import VolatileIgnition
from kilnflight.twin.camera import FULL_SCALE, Geometry, Optics
from kilnflight.twin.flight import Flight
from kilnflight.twin.gas import Gas
from kilnflight.twin.lenses import LensCamera
from kilnflight.twin.life import OnTheWall
from kilnflight.twin.light import Light
from kilnflight.twin.plates import Plates
from kilnflight.twin.poses import Pose
from kilnflight.twin.scene import Scene

FLIGHT_FILE = Path(__file__).with_name("calibrated.json")
SECOND_FLIGHT_FILE = Path(__file__).with_name("flight.json")
LIGHT_FILE = Path(__file__).with_name("exposure.json")
SECOND_LIGHT_FILE = Path(__file__).with_name("light.json")
DEPTH_FILE = Path(__file__).with_name("depth.json")
# Of the wall in the second look: in a cavity of one temperature slag and bricks differ little
TEXTURE_K = 10.0


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
class SecondInputs:
    """The fitted inputs of the second look at flight and ignition.

    The defaults are those of `Flight`, `Gas` and `VolatileIgnition`.
    """

    lance_length_m: float = Flight.lance_length_m
    wall_friction: float = Flight.wall_friction
    lance_stream_m_s: float = Gas.stream_m_s
    launch_spread_factor: float = Flight.launch_spread_factor
    chemical_time_s: float = VolatileIgnition.chemical_time_s

    def applied(self, flight: Flight, gas: Gas) -> tuple[Flight, Gas]:
        """Return flight and gas with these inputs and the physics of the second look.

        The lance is choked and particles bounce through it, gas goes back around the jet, volatiles
        ignite, and sheets are plates.
        """
        flight = replace(
            flight,
            lance_length_m=self.lance_length_m,
            wall_friction=self.wall_friction,
            launch_spread_factor=self.launch_spread_factor,
            bouncing=True,
            volatiles=VolatileIgnition(chemical_time_s=self.chemical_time_s),
            plates=Plates(),
        )
        return flight, replace(gas, choked=True, lance_stream_m_s=self.lance_stream_m_s)


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


def kiln_with(inputs: FlightInputs) -> Kiln:
    """Return the kiln of the first twin with inputs of flight and ignition."""
    return Kiln(*inputs.applied(Flight(), Gas()), Geometry())


def first_kiln() -> Kiln:
    """Return the kiln of the first twin, with its fitted inputs."""
    return kiln_with(flight_inputs())


def second_kiln_with(inputs: SecondInputs, pose: Pose) -> Kiln:
    """Return the kiln of the second look with inputs of flight and ignition, in a pose."""
    flight = Flight(launch_elevation_deg=pose.elevation_deg)
    return Kiln(*inputs.applied(flight, Gas()), pose.placed(Geometry()))


@lru_cache(maxsize=8)
def second_kiln(path: Path = SECOND_FLIGHT_FILE) -> Kiln:
    """Return the kiln of the second look, with its fitted inputs and the pose of their fit.

    See `cache.read_calibration` for errors.
    """
    content = cache.read_calibration(path, None, "kilnflight.experiments.twin_flight")
    pose = cache.calibrated(Pose, path, {"inputs": content.get("pose", {})})
    return second_kiln_with(cache.calibrated(SecondInputs, path, content), pose)


@dataclass(frozen=True)
class SecondLightInputs:
    """The fitted inputs of the picture in the second look.

    A first search was lost before it landed, so the values were searched again. Where its
    result is known (exposure, spread, wall flames) the search begins with it.
    """

    wall_level: float = 12_500.0  # exposure and gain
    soot_1_m: float = Light.soot_1_m
    irradiance: float = 1.2  # light on a particle over the wall's own
    irradiance_spread: float = 0.222
    share_on: float = 0.381
    body_s: float = 0.563

    def applied(self, scene: Scene) -> Scene:
        """Return a scene in the second look's light, all else as it was."""
        light = Light(soot_1_m=self.soot_1_m, irradiance_spread=self.irradiance_spread)
        level = {"wall_level": self.wall_level, "irradiance": self.irradiance}
        return replace(
            scene,
            optics=replace(scene.optics, light=light, **level),
            on_the_wall=replace(scene.on_the_wall, share_on=self.share_on, body_s=self.body_s),
            surroundings=replace(scene.surroundings, burner=Burner(), texture_k=TEXTURE_K),
        )


@lru_cache(maxsize=8)
def second_light(path: Path = SECOND_LIGHT_FILE) -> SecondLightInputs:
    """Return the fitted inputs of the picture in the second look.

    See `cache.read_calibration` for errors.
    """
    content = cache.read_calibration(path, None, "kilnflight.experiments.twin_light")
    return cache.calibrated(SecondLightInputs, path, content)


@dataclass(frozen=True)
class DepthInputs:
    """What published numbers decide of the depth camera of the second look."""

    contrast: float  # Table 5.2
    wall_points: int  # section 5.1.3
    particle_error_mm: Mapping[str, float]  # Table 5.18, RMSE in z

    def camera(self) -> LensCamera:
        """Return the camera with these inputs, all else as it is chosen."""
        error = tuple((name, float(mm)) for name, mm in self.particle_error_mm.items())
        return LensCamera(
            contrast=self.contrast, wall_points=self.wall_points, particle_error_mm=error
        )


@lru_cache(maxsize=8)
def second_depth(path: Path = DEPTH_FILE) -> LensCamera:
    """Return the depth camera of the second look.

    See `cache.read_calibration` for errors.
    """
    content = cache.read_calibration(path, None, "kilnflight.experiments.twin_depth")
    return cache.calibrated(DepthInputs, path, content).camera()
