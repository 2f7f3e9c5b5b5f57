import numpy as np
import pytest

from kilnflight import background, kiln
from kilnflight.camera import calibrate_points
from kilnflight.checks import InputError
from kilnflight.detection import DBSCAN, DoG
from kilnflight.detection.combination import Combination
from kilnflight.detection.flame import segment_flame
from kilnflight.tables import DETECTIONS
from kilnflight.twin.scenes import open_scene

MEDIAN = background.Median(window=20)


@pytest.fixture(scope="module")
def twin():
    return open_scene("V3@small")


def test_a_view_is_the_frame_without_the_flame(twin):
    ((t, view),) = kiln.views(twin, [76], MEDIAN)
    frame = twin.frame(76)
    flame = segment_flame(frame.gray, twin.attributes.flame_roi)
    keep = ~flame.holds(frame.pixels)
    np.testing.assert_array_equal(view.gray, frame.gray)
    np.testing.assert_array_equal(view.previous, twin.gray(75))
    np.testing.assert_array_equal(view.pixels, frame.pixels[keep])
    np.testing.assert_array_equal(view.xyz, calibrate_points(frame.xyz)[keep])
    plain = next(iter(MEDIAN(kiln.Pictures(twin), [76])))
    np.testing.assert_array_equal(view.foreground, flame.cover(plain))
    assert t == 76


def test_the_first_frame_looks_at_the_one_after(twin):
    ((_, view),) = kiln.views(twin, [0], MEDIAN)
    np.testing.assert_array_equal(view.previous, twin.gray(1))


def test_detections_do_not_depend_on_what_else_is_asked(twin):
    detector = Combination(DoG(1500.0), DBSCAN(60.0, 4), DBSCAN(200.0, 10))
    several = kiln.detect(twin, [75, 76, 77], detector, MEDIAN)
    alone = kiln.detect(twin, [76], detector, MEDIAN)
    assert len(DETECTIONS.check(several)) == len(several) > 0
    np.testing.assert_array_equal(several[several["frame"] == 76], alone)


def test_no_frames_give_an_empty_table_and_unknown_ones_are_told(twin):
    assert len(DETECTIONS.check(kiln.detect(twin, [], background=MEDIAN))) == 0
    with pytest.raises(InputError):
        kiln.detect(twin, [len(twin)], background=MEDIAN)
