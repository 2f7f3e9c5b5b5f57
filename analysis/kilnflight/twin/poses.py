"""Where camera and lance stand: four numbers that the publications only bound, as draws.

``python -m kilnflight.experiments.twin_pose`` writes pose.json beside this module: the mode of
their posterior and `DRAWS` draws from it. Scenes take them as ``@pose`` and ``@pose-00`` to
``@pose-15``. A first search was lost before it was published; these values are of a second one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import NamedTuple

from kilnflight.checks import InputError
from kilnflight.project import cache
from kilnflight.twin.camera import Geometry
from kilnflight.twin.scene import Scene

POSE_FILE = Path(__file__).with_name("pose.json")
MODULE = "kilnflight.experiments.twin_pose"
DRAWS = 16
PRINTED_RADIUS_MM = 772.1827  # Table 5.12, for a kiln of 700 mm
FIRST_SCALE = PRINTED_RADIUS_MM / Geometry.kiln_radius_mm  # as the first twin took it


@dataclass(frozen=True)
class Pose:
    """Height of the axis, depth of the lance, its elevation, and the scale of lengths.

    The defaults are the geometry of the first twin and a lance along the axis.
    """

    axis_height_mm: float = Geometry.axis_height_mm  # over the camera at depth 0
    lance_depth_mm: float = Geometry.lance_depth_mm  # of the lance exit
    elevation_deg: float = 0.0  # of the lance over the axis
    scale: float = FIRST_SCALE  # lengths as the thesis's camera had them over true ones

    def placed(self, place: Geometry) -> Geometry:
        """Return a geometry in this pose.

        The camera saw the far end of the kiln ``scale`` times as far away as it is.
        """
        nearer = FIRST_SCALE / self.scale
        across, up, depth = (nearer * value for value in Geometry.axis_far_mm)
        return replace(
            place,
            axis_far_mm=(across, up, depth),
            inlet_depth_mm=nearer * Geometry.inlet_depth_mm,
            axis_height_mm=self.axis_height_mm,
            lance_depth_mm=self.lance_depth_mm,
        )

    def applied(self, scene: Scene) -> Scene:
        """Return a scene in this pose, all else as it was."""
        flight = replace(scene.flight, launch_elevation_deg=self.elevation_deg)
        return replace(scene, geometry=self.placed(scene.geometry), flight=flight)


class Poses(NamedTuple):
    """The posterior as it is frozen."""

    mode: Pose
    draws: tuple[Pose, ...]


@lru_cache(maxsize=8)
def read_poses(path: Path = POSE_FILE) -> Poses:
    """Return the mode and the draws; see `cache.read_calibration` for errors."""
    content = cache.read_calibration(path, None, MODULE)
    rows = [{"inputs": row} for row in content.get("draws", [])]
    draws = tuple(cache.calibrated(Pose, path, row) for row in rows)
    if len(draws) != DRAWS:
        raise InputError(f"calibration {path}: {len(draws)} draws, expected {DRAWS}.")
    return Poses(cache.calibrated(Pose, path, content), draws)


def _posed(number: int | None, scene: Scene) -> Scene:
    """Return a scene in the pose of a draw; None: in the mode's."""
    poses = read_poses()
    return (poses.mode if number is None else poses.draws[number]).applied(scene)


POSE_SCENARIOS: dict[str, Callable[[Scene], Scene]] = {
    "pose": partial(_posed, None),
    **{f"pose-{number:02d}": partial(_posed, number) for number in range(DRAWS)},
}
