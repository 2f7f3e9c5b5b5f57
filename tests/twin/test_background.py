from dataclasses import replace

import numpy as np

from kilnflight.twin.background import Background, Surroundings
from kilnflight.twin.camera import Geometry, Optics

SMALL = replace(
    Geometry(), rows=192, columns=256, focal_length_px=85.0 / 0.088, lance_pixel=(60.5, 117.0)
)
AROUND = Surroundings(flame_roi=(70, 122, 22, 78), edge_px=11)
BACK = Background(SMALL, Optics(), AROUND, seed=2)


def test_a_picture_depends_on_time_alone():
    picture = BACK.at(0.37)
    BACK.at(5.0)
    np.testing.assert_array_equal(picture, BACK.at(0.37))
    np.testing.assert_array_equal(picture, Background(SMALL, Optics(), AROUND, seed=2).at(0.37))
    assert not np.array_equal(picture, Background(SMALL, Optics(), AROUND, seed=3).at(0.37))
