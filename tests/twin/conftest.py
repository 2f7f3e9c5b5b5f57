"""A small scene of the twin, which takes less time than one of the thesis."""

from dataclasses import replace

import pytest

from kilnflight.twin.background import Surroundings
from kilnflight.twin.camera import Geometry
from kilnflight.twin.fitted import second_depth, second_light
from kilnflight.twin.particles import Burst
from kilnflight.twin.scene import Scene, Twin

FEED = (
    Burst("confetti", 40, -0.4, 0.5),
    Burst("paper shred", 30, -0.4, 0.5),
    Burst("wood chip", 30, -0.5, 0.6),
)


def make_scene(**more):
    """A camera of a quarter of the rows and columns."""
    small = {"rows": 384, "columns": 512, "focal_length_px": 85.0 / 0.044}
    place = replace(Geometry(), lance_pixel=(121.0, 234.1), **small)
    around = Surroundings(flame_roi=(140, 245, 45, 155), edge_px=22)
    depth = replace(second_depth(), wall_points=10_175)
    given = {"geometry": place, "surroundings": around, "depth": depth, **more}
    return second_light(Scene("small", FEED, 60, 5, **given))


@pytest.fixture(scope="session")
def small_scene():
    return make_scene


@pytest.fixture(scope="session")
def twin():
    return Twin(make_scene())
