"""A small scene of the twin, which takes less time than one of the thesis."""

import pytest

from kilnflight.simulated.kiln import scenes
from kilnflight.simulated.kiln.scene import Twin


def make_twin():
    return scenes.open_scene("V1@small")


@pytest.fixture(scope="session")
def twin() -> Twin:
    return make_twin()
