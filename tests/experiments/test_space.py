"""Pictures in space: up is up, right is right."""

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from mpl_toolkits.mplot3d import proj3d

from kilnflight.experiments import space
from kilnflight.regression import Fit
from kilnflight.twin.camera import Geometry

CURVE = Fit(
    (0.0, 0.0, 6500.0), 0.1, 0, (0.0, 0.1), (2, 2, 2),
    ((1.0, 0.0), (0.0, -4.9), (-9000.0, 0.0)), 0.2, 0.5, 60,
)  # fmt: skip
GRAY_TRACK = pd.DataFrame(
    {"particle": 3, "frame": [60, 70], "x": 0.0, "y": 1.0, "z": [5600.0, np.nan], "gray": 900.0}
)


def test_what_is_lower_in_the_picture_is_drawn_lower():
    geometry = Geometry()
    high, low = [300.0, 500.0, 6000.0], [300.0, -500.0, 6000.0]
    rows, _ = geometry.project(np.array([high, low]))
    assert rows[0] < rows[1]  # rows count down
    np.testing.assert_allclose(space.upright([high, low]), [[6.0, 6.0], [0.3, 0.3], [0.5, -0.5]])


@pytest.fixture
def room():
    """Empty axes of three dimensions."""
    figure = plt.figure()
    yield figure.add_subplot(projection="3d")
    plt.close(figure)


def test_a_falling_particle_ends_lower_on_the_drawn_axis(room):
    space.draw_curves(room, [CURVE], [GRAY_TRACK])
    up = room.lines[0].get_data_3d()[2]
    assert up[-1] - up[0] == pytest.approx(-4.9e-3 * 0.4**2)
    bottom, top = room.get_zlim()
    assert bottom < top


def test_what_lies_to_the_right_in_the_picture_is_drawn_to_the_right(room):
    _, columns = Geometry().project(np.array([[300.0, 0, 6000], [-300, 0, 6000]]))
    assert columns[0] > columns[1]
    space.draw_curves(room, [CURVE], [GRAY_TRACK])
    room.view_init(elev=0, azim=180)  # from the camera, along the depth
    room.figure.canvas.draw()
    right, left = (
        proj3d.proj_transform(*space.upright([place])[:, 0], room.get_proj())[0]
        for place in ([1.0, 0, 6000], [-1.0, 0, 6000])
    )
    assert right > left


def test_curves_start_at_the_lance_and_points_without_depth_are_left_out(room):
    space.draw_curves(room, [CURVE], [GRAY_TRACK])
    depth, across, _ = room.lines[0].get_data_3d()
    assert (depth[0], across[0]) == (pytest.approx(6.5), pytest.approx(0.0))
    assert len(room.lines[1].get_data_3d()[0]) == 1
