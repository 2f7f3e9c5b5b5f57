from dataclasses import replace

import numpy as np
import pytest

from kilnflight.twin import background
from kilnflight.twin.background import Background, Surroundings
from kilnflight.twin.camera import Geometry, Optics

SMALL = replace(
    Geometry(), rows=192, columns=256, focal_length_px=85.0 / 0.088, lance_pixel=(60.5, 117.0)
)
AROUND = Surroundings(flame_roi=(70, 122, 22, 78), edge_px=11)
BACK = Background(SMALL, Optics(), AROUND, seed=2)


def test_the_plate_is_darker_than_the_wall():
    point = SMALL.to_kiln(SMALL.unproject(*np.indices((192, 256)), BACK.depth_mm))
    plate = np.isclose(point[..., 0], SMALL.inlet_m)
    assert BACK.level[plate].mean() < 0.7 * BACK.level[~plate].mean()


def test_a_picture_depends_on_time_alone():
    picture = BACK.at(0.37)
    BACK.at(5.0)
    np.testing.assert_array_equal(picture, BACK.at(0.37))
    np.testing.assert_array_equal(picture, Background(SMALL, Optics(), AROUND, seed=2).at(0.37))
    assert not np.array_equal(picture, Background(SMALL, Optics(), AROUND, seed=3).at(0.37))


@pytest.mark.parametrize("rows", [50, 192])  # the last ones are fewer; all at once
def test_how_many_rows_are_lit_together_changes_no_bit(monkeypatch, rows):
    def pictures():
        background._depth_mm.cache_clear()
        scene = Background(SMALL, Optics(), AROUND, seed=2)
        return scene.level, scene.depth_mm, scene.solid_mm

    expected = pictures()
    monkeypatch.setattr(background, "ROWS", rows)
    for picture, same in zip(pictures(), expected, strict=True):
        np.testing.assert_array_equal(picture, same)
    assert np.isfinite(expected[2]).any()  # a tube is in the picture
