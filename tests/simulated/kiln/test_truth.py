"""What a person notes for tracking, and the windows of tracking, on hand-made cases."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from kilnflight.simulated.kiln import scenes, truth
from kilnflight.simulated.kiln.geometry import FULL_SCALE
from kilnflight.simulated.kiln.picture import Pixels
from kilnflight.simulated.kiln.scene import SceneView

STEP = FULL_SCALE / 255  # of an 8-bit screen


def view_of(rises, wall):
    """A view of particles in rows of a picture; ``rises`` are by how much each pixel is
    lighter.
    """
    picture = np.full((len(rises), 9), wall, np.float32)
    for row, values in zip(picture, rises, strict=True):
        row[: len(values)] += values
    blob = np.repeat(np.arange(len(rises)), [len(values) for values in rises])
    place = np.concatenate(
        [9 * k + np.arange(len(values)) for k, values in enumerate(rises)]
    )
    nothing = np.zeros(len(place))
    return SceneView(
        picture=picture,
        moment=None,
        blobs=None,
        pixels=Pixels(blob, place, nothing.astype(np.float32)),
        shown=np.ones(len(place), bool),
        visible=np.ones(len(rises), bool),
        kinds=nothing,
        labels=np.zeros(picture.shape, np.uint8),
    )


def test_a_place_is_noted_at_the_centroid_of_pixels_lighter_by_four_steps():
    rises = [
        [
            5 * STEP,
            5 * STEP,
            5 * STEP,
            3 * STEP,
            5 * STEP,
            4 * STEP,
        ],  # columns 0, 1, 2, 4, 5
        [-20 * STEP] * 9,  # darker
        [9 * STEP] * 4,  # too few pixels
        [3.9 * STEP] * 9,  # too faint
    ]
    view = view_of(rises, wall=80 * STEP)
    row, col = truth._light_centroids(view, np.full((4, 9), 80 * STEP, np.float32))
    np.testing.assert_allclose(row, [0, np.nan, np.nan, np.nan])
    np.testing.assert_allclose(col, [12 / 5, np.nan, np.nan, np.nan])


def test_what_is_overexposed_before_an_overexposed_wall_is_not_seen():
    rises = [[2 * FULL_SCALE] * 6] * 2
    view = view_of(rises, wall=FULL_SCALE)
    empty = np.array([[1.1 * FULL_SCALE], [0.5 * FULL_SCALE]], np.float32) * np.ones(9)
    row, col = truth._light_centroids(view, empty.astype(np.float32))
    np.testing.assert_allclose(row, [np.nan, 1])
    np.testing.assert_allclose(col, [np.nan, 2.5])


def test_notes_are_the_marks_with_their_places(twin):
    frames = [60, 80]
    table = truth.noted(twin, frames)
    pd.testing.assert_frame_equal(
        table.drop(columns=["noted_row", "noted_col"]), truth.marked(twin, frames)
    )
    seen = truth.at_notes(table)
    assert 0 < len(seen) < len(table)
    close = table.loc[seen.index, ["row", "col"]].to_numpy()
    apart = np.hypot(*(seen[["row", "col"]].to_numpy() - close).T)
    assert np.median(apart / seen["radius_px"]) < 0.5
    assert set(table["label"][seen.index]) >= {2}


def test_particles_on_the_wall_and_short_ones_are_not_followed():
    table = pd.DataFrame(
        {"particle": np.repeat([0, 1, 2], [5, 4, 6]), "frame": [*range(15)]}
    )
    table["label"] = np.where(table["particle"] == 2, 4, 3)
    assert truth.followed(table)["particle"].tolist() == [0] * 5


class Campaign(SimpleNamespace):
    """A recording of which nothing is known but when particles fly, in frames."""

    def __len__(self):
        return 2000


def campaign(fraction, *flights, rate=100.0):
    release, end = np.transpose([np.array(flight) / rate for flight in flights])
    flights = SimpleNamespace(end_s=end - release)
    scene = SimpleNamespace(name="x", fraction=fraction, frame_rate_hz=rate)
    return Campaign(
        life=SimpleNamespace(release_s=release, flights=flights), scene=scene
    )


def test_windows_hold_whole_flights_as_printed():
    """Seven chips in 300 frames: first cut at the end of a window, later whole."""
    cut = [(350 + k, 420) for k in range(7)]
    whole = [(1000 + k, 1120) for k in range(7)]
    brief = [(1050, 1060)]
    twin = campaign("wood chip", *cut, *whole, *brief)
    started, ended = scenes.started_and_whole(
        twin, np.array([100, 150, 400, 1000]), 300
    )
    assert started.tolist() == [7, 7, 0, 7]
    assert ended.tolist() == [0, 7, 0, 7]
    assert scenes.tracking_window(twin, by_starts=True) == range(100, 400)
    assert scenes.tracking_window(twin) == range(
        130, 430
    )  # as near to 100, and none is cut


@pytest.mark.parametrize(("rate", "first"), [(330.0, 500), (100.0, 960)])
def test_all_flights_that_start_count_where_a_window_is_shorter_than_a_flight(
    rate, first
):
    cut = [(500 + k, 700) for k in range(32)]
    whole = [(1000 + k, 1050) for k in range(31)]
    twin = campaign("paper shred", *cut, *whole, rate=rate)
    assert scenes.tracking_window(twin).start == first
