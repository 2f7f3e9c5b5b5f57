"""The tracking loop on hand-made flights."""

import numpy as np
import pandas as pd
import pytest

from kilnflight.association import GNN, JPDA, NearestNeighbor
from kilnflight.checks import InputError
from kilnflight.tracking import tracker
from kilnflight.tracking.filter import (
    ConstantAcceleration,
    ConstantVelocity,
    Detected,
    Gate,
    Motion,
)
from kilnflight.tracking.tracker import Management, choose_owners, track

trackers = pytest.mark.parametrize("associator", [GNN(), JPDA(), NearestNeighbor()])


def flight(start, velocity, frames=20, first=0, **columns):
    """One particle in straight flight, one row per frame."""
    time = np.arange(frames)
    row, col = np.asarray(start, dtype=float)[:, None] + np.outer(velocity, time)
    return pd.DataFrame({"frame": first + time, "row": row, "col": col, **columns})


def together(*flights):
    """The flights in one table, in the order of time; ``truth`` is the number of the
    flight.
    """
    table = pd.concat([first.assign(truth=k) for k, first in enumerate(flights)])
    return table.sort_values(["frame", "row"], ignore_index=True)


def right(result):
    """Return whether particles and truth group the rows alike."""
    pairs = result[["particle", "truth"]].drop_duplicates()
    return pairs["particle"].is_unique and pairs["truth"].is_unique


CROSSING = together(flight((100, 100), (10, 12)), flight((297, 105), (-10, 12)))
FLIGHT = flight((100, 200), (12, -7))


@trackers
@pytest.mark.parametrize("motion", [ConstantVelocity, ConstantAcceleration])
def test_two_that_cross_and_one_that_hides_for_three_frames(associator, motion):
    """They cross between two frames, so only their motion distinguishes them."""
    assert right(track(CROSSING, associator, motion()))
    hidden = FLIGHT[~FLIGHT["frame"].between(8, 10)]
    assert not track(hidden, associator)["particle"].any()


def test_tracks_end_that_are_hidden_too_long():
    for last, particles in ((10, 1), (11, 2)):
        hidden = FLIGHT[~FLIGHT["frame"].between(8, last)]
        management = Management(visibility=0.0, invisible=3)
        assert track(hidden, management=management)["particle"].nunique() == particles


@pytest.mark.parametrize(
    ("visibility", "seen", "expected"),
    [
        (
            0.5,
            [0, 2, 3],
            [0, 0, 0],
        ),  # 1 of 2 frames when it is seen again, not below the limit
        (
            0.51,
            [0, 2, 3],
            [0, 1, 1],
        ),  # the second frame is missed, and the track ends at once
        (0.4, [0, 1, 4, 5], [0, 0, 0, 0]),  # 2 of 4
        (0.4, [0, 1, 5, 6], [0, 0, 0, 0]),  # 2 of 5
        (0.4, [0, 1, 6, 7], [0, 0, 1, 1]),  # 2 of 6
        (0.4, [0, 3, 4], [0, 1, 1]),  # 1 of 3
        (0.0, [0, 3, 4], [0, 0, 0]),
    ],
)
def test_visibility_is_tested_from_the_first_frame_on(visibility, seen, expected):
    """Eq. 4.14; another particle keeps the frames coming."""
    other = flight((900, 900), (0, 0))
    table = together(FLIGHT[FLIGHT["frame"].isin(seen)], other)
    found = track(table, management=Management(visibility=visibility))
    names = found.loc[found["truth"] == 0, "particle"]
    assert pd.factorize(names)[0].tolist() == expected


def test_two_discs_at_one_pixel_are_two_detections_and_a_repeated_row_is_refused():
    two = FLIGHT.assign(radius_px=3.0, z=np.nan), FLIGHT.assign(radius_px=9.0, z=np.nan)
    assert track(pd.concat(two, ignore_index=True))["particle"].max() == 1
    with pytest.raises(InputError):
        track(pd.concat([two[0], two[0]], ignore_index=True))


def test_depth_keeps_two_apart_and_is_the_last_known():
    near = flight((100, 100), (10, 12), z=3000.0, points=40)
    far = flight((100.5, 100), (10, 12), z=6000.0, points=90)
    assert right(track(together(near, far)))
    near = flight((100, 100), (10, 0), 5, z=[3000.0, np.nan, np.nan, np.nan, np.nan])
    far = flight(
        (150, 100), (10, 0), 3, first=5, z=6000.0
    )  # as expected, but 3 m behind
    assert right(track(together(near, far)))
    assert not track(together(near.assign(z=np.nan), far))["particle"].any()


def test_a_gap_is_predicted_with_its_true_length():
    table = pd.concat(
        [flight((0, 0), (20, 5), 10), flight((500, 125), (20, 5), 5, first=25)]
    )
    patient = Management(visibility=0.0, invisible=30)
    assert not track(table, management=patient)["particle"].any()
    assert track(table)["particle"].tolist() == [0] * 10 + [1] * 5
    assert track(table.assign(frame=table["frame"] * 10**8))["particle"].is_unique


@trackers
def test_no_track_is_twice_in_a_frame_whatever_the_place_and_time(associator):
    rng = np.random.default_rng(0)
    table = pd.DataFrame(rng.integers(0, 400, (240, 2)), columns=["row", "col"]).astype(
        float
    )
    table.insert(0, "frame", np.repeat(np.arange(20), 12))
    result = track(table, associator)
    moved = table + {"frame": 300, "row": -77.0, "col": 12.0}
    pd.testing.assert_series_equal(
        track(moved, associator)["particle"], result["particle"]
    )
    used = result["particle"] == -1  # by a track that was recorded with another one
    assert used.any() == isinstance(associator, JPDA)
    assert not result[~used].duplicated(["frame", "particle"]).any()
    assert result[~used].groupby("particle")["frame"].min().is_monotonic_increasing


def test_a_probabilistic_track_is_recorded_at_the_mean_of_its_detections(monkeypatch):
    """Section 5.2.3; by hand: 0.6 and 0.2 of 0.8 weigh 3 to 1, 0.14 and 0.56 weigh 1 to
    4.
    """

    def undecided(last):
        rows = np.array([[0.2, 0.6, 0.2, 0.0], last])
        return lambda pairs: rows[pairs.track, 1 + pairs.detection]

    first = pd.DataFrame(
        {"frame": 0, "row": [0.0, 8.0], "col": 0.0, "z": 5000.0, "gray": 1.0}
    )
    second = first.iloc[[0, 0, 0]].assign(
        frame=1, row=[0.0, 4.0, 14.0], gray=[7.0, 8.0, 9.0]
    )
    second["z"] = [5000.0, 5400.0, np.nan]
    table = pd.concat([first, second], ignore_index=True)
    result = track(table, undecided([0.5, 0.0, 0.1, 0.4]))
    # the second track is rather missed (0.5 > 0.4), so it has used nothing; the first,
    # 4.0
    assert result["particle"].tolist() == [0, 1, 0, -1, 2]
    np.testing.assert_allclose(result["row"], [0.0, 8.0, 1.0, 4.0, 14.0])
    np.testing.assert_allclose(result["z"], [5000.0, 5000.0, 5100.0, 5400.0, np.nan])
    pd.testing.assert_series_equal(result["gray"], table["gray"])
    surer = track(table, undecided([0.3, 0.0, 0.14, 0.56]))
    assert surer["particle"].tolist() == [0, 1, 0, -1, 1]
    np.testing.assert_allclose(surer["row"], [0.0, 8.0, 1.0, 4.0, 12.0])
    monkeypatch.setattr(tracker, "USED", 0.3)
    lenient = track(table, undecided([0.3, 0.0, 0.14, 0.56]))
    assert lenient["particle"].tolist() == [0, 1, 0, 2, 1]


@pytest.mark.parametrize(
    ("weights", "owner"),
    [
        (
            [[0.1, 0.6, 0.2, 0.1], [0.1, 0.7, 0.05, 0.15]],
            [1, 0, -1],
        ),  # the larger weight first
        ([[0.55, 0.45], [0.6, 0.4], [1.0, 0.0]], [0]),  # 0.85 that it is of a track
        ([[0.8, 0.2], [0.75, 0.25]], [-1]),  # 0.45: rather of none
        ([[0.4, 0.25, 0.35]], [-1, 0]),  # neither beats "missed", both do (Eq. 4.10)
        ([[0.5, 0.25, 0.25]], [-1, -1]),
    ],
)
def test_the_track_for_which_a_detection_is_recorded(weights, owner):
    at, (n, m) = np.zeros((3, 2)), np.subtract(np.shape(weights), (0, 1))
    pairs = Gate()(
        at[:n], np.stack([np.eye(2)] * n), Detected(at[:1].repeat(m, axis=0))
    )
    assert choose_owners(pairs, np.array(weights)[:, 1:].ravel()).tolist() == owner


def test_places_may_be_named_x_and_y():
    renamed = CROSSING.rename(columns={"row": "y", "col": "x"})[["y", "frame", "x"]]
    result = track(renamed)
    assert list(result) == ["y", "frame", "x", "particle"]
    assert result["particle"].tolist() == track(CROSSING)["particle"].tolist()


def linked(places, **options):
    """Return the tracks of places row, col by frame, with ``link``.

    A track's next position has a variance of 11 px^2: 1 of each measurement, 9 of the
    velocity.
    """
    rows = [(t, *place) for t, found in enumerate(places) for place in found]
    table = pd.DataFrame(rows, columns=["frame", "row", "col"])
    motion = Motion((0.0, 0.0), (1.0, 3.0), 1e-9)
    return track(table, motion=motion, link=True, **options)


def test_a_link_is_sure_where_a_particle_is_expected_and_0_at_the_gate():
    sd = np.sqrt(11)
    for apart, link in ((0.0, 1.0), (1.0, 0.75), (3.0, 0.25), (3.99, 0.0025)):
        tracks = linked([[(5, 5)], [(5, 5 + apart * sd)]])
        assert tracks["particle"].tolist() == [0, 0]
        assert np.isnan(tracks["link"][0])
        assert tracks["link"][1] == pytest.approx(link)
    far = linked([[(5, 5)], [(5, 5 + 4.01 * sd)]])
    assert far["particle"].tolist() == [0, 1]
    assert far["link"].isna().all()


def test_a_link_of_jpda_is_its_weight():
    """Two detections at 1 and 2 standard deviations have 0.788 and 0.176 (Eq. 4.10)."""
    sd = np.sqrt(11)
    tracks = linked([[(5, 5)], [(5, 5 + sd), (5, 5 - 2 * sd)]], associator=JPDA())
    assert tracks["particle"].tolist() == [0, 0, -1]
    assert tracks["link"].round(3).fillna(0).tolist() == [0, 0.788, 0]


def test_a_link_is_less_sure_in_a_crowd_and_changes_no_track():
    rng = np.random.default_rng(0)
    places = [25 * np.indices((6, 6)).reshape(2, -1).T] * 20
    apart = [each + rng.normal(0, 0.5, each.shape) for each in places]
    wander = [each + rng.normal(0, 4.0, each.shape) for each in places]
    sure, unsure = (linked(each) for each in (apart, wander))
    assert sure["link"].median() > 0.8 > 0.6 > unsure["link"].median()
    assert unsure["link"].between(0, 1).sum() == unsure["link"].notna().sum()
    seen = unsure.drop(columns=["link", "particle"])
    motion = Motion((0.0, 0.0), (1.0, 3.0), 1e-9)
    again = track(seen, motion=motion)
    pd.testing.assert_frame_equal(again, unsure.drop(columns="link"))
