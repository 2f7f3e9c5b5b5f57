"""Pictures of particles at known places, against the plain definition."""

import numpy as np
import pandas as pd
import pytest

from kilnflight.belt.camera import BELT
from kilnflight.checks import InputError
from kilnflight.simulated.belt.rendering import BULKS, CameraView, Pictures, at_rate
from kilnflight.tables import BELT_TRACKS

LEVEL = CameraView(turned_deg=0.0, tilted_deg=0.0)


def one_track(x=500.0, y=90.0, frames=3, step=5):
    frame = step * np.arange(frames)
    columns = {"frame": frame, "particle": 0, "time_s": frame / 1000.0, "x": x, "y": y}
    return pd.DataFrame(columns)[BELT_TRACKS.names]


def test_a_level_camera_has_the_scale_of_the_paper():
    corners = LEVEL.pixels(np.column_stack([BELT.corners, np.zeros(4)]))
    np.testing.assert_allclose(corners[1] - corners[0], [0.0, 400 / 0.44])
    np.testing.assert_allclose(corners[3] - corners[0], [180 / 0.44, 0.0])
    np.testing.assert_allclose(corners.mean(axis=0), [353.5, 531.5])
    flat, high = LEVEL.pixels(np.array([[500.0, 60.0, 0.0], [500.0, 60.0, 4.0]])) - [
        353.5,
        531.5,
    ]
    np.testing.assert_allclose(high, flat * 1000 / (1000 - 4))
    middle = CameraView(turned_deg=-1.0, tilted_deg=1.0).pixels(
        np.array([[588.0, 90.0, 0.0]])
    )
    np.testing.assert_allclose(middle, [[353.5, 531.5]], atol=1e-9)


@pytest.mark.parametrize("name", BULKS)
def test_a_particle_has_its_area_and_its_place(name):
    bulk = BULKS[name]
    tracks = one_track(x=520.3, y=60.7)
    pictures = Pictures(tracks, bulk, 0, LEVEL, belt_gray=0.0, noise_gray=0.0)
    empty = Pictures(one_track(x=10.0), bulk, 0, LEVEL, belt_gray=0.0, noise_gray=0.0)
    window = np.s_[240:340, 330:430]
    share = (pictures[0].astype(float) - empty[0])[window] / 200.0
    flat = {"spheres": np.pi * 2.5**2, "cuboids": 6.0 * 5.0, "cylinders": 9.0 * 3.0}[
        name
    ]
    assert share.sum() * 0.44**2 == pytest.approx(flat, rel=0.02)
    rows, cols = np.mgrid[window]
    place = [(share * rows).sum() / share.sum(), (share * cols).sum() / share.sum()]
    expected = LEVEL.pixels(np.array([[520.3, 60.7, bulk.rest_mm]]))[0]
    np.testing.assert_allclose(place, expected, atol=0.1)


def test_frames_do_not_depend_on_which_others_are_requested():
    pictures = Pictures(one_track(frames=4), BULKS["spheres"], 3)
    assert len(pictures) == 4
    assert len(Pictures(BELT_TRACKS.empty(), BULKS["spheres"], 3)) == 0
    for frame, picture in zip([2, 0], pictures.frames([2, 0]), strict=True):
        np.testing.assert_array_equal(picture, pictures[frame])
    other = Pictures(one_track(frames=4), BULKS["spheres"], 4)
    assert (pictures[0] != other[0]).any()


def test_thinning_keeps_times():
    tracks = one_track(frames=28, step=1)
    late = tracks.assign(frame=tracks["frame"] + 7, time_s=tracks["time_s"] + 0.007)
    less = at_rate(late, 100.0)
    assert less["frame"].tolist() == [1, 2, 3]
    assert less["time_s"].tolist() == pytest.approx([0.01, 0.02, 0.03])
    pd.testing.assert_frame_equal(at_rate(late, 1000.0), late)
    with pytest.raises(InputError, match="tracks"):
        at_rate(one_track(frames=10, step=10), 200.0)  # 100 Hz
