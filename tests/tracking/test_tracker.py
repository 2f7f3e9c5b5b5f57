import numpy as np
import pandas as pd
import pytest

from kilnflight.association import GNN, JPDA, NearestNeighbor
from kilnflight.checks import InputError
from kilnflight.tracking import tracker as tracking
from kilnflight.tracking.filter import ConstantAcceleration, ConstantVelocity
from kilnflight.tracking.tracker import Management, steps, track

trackers = pytest.mark.parametrize("associator", [GNN(), JPDA(), NearestNeighbor()])


def flight(start, velocity, frames=20, first=0, **columns):
    """Return one particle in straight flight, one row per frame."""
    time = np.arange(frames)
    row, col = np.asarray(start, dtype=float)[:, None] + np.outer(velocity, time)
    return pd.DataFrame({"frame": first + time, "row": row, "col": col, **columns})


def together(*flights):
    """Return the flights in one table, in the order of time, ``truth`` telling which is which."""
    table = pd.concat([first.assign(truth=k) for k, first in enumerate(flights)])
    return table.sort_values(["frame", "row"], ignore_index=True)


def clutter(seed, frames=20, per_frame=5, size=400.0):
    rng = np.random.default_rng(seed)
    frame = np.repeat(np.arange(frames), per_frame)
    row, col = rng.uniform(0, size, (2, len(frame))).round(1)
    return pd.DataFrame({"frame": frame, "row": row, "col": col})


def same_partition(one, other):
    """Whether two labellings tell the same rows apart."""
    pairs = pd.DataFrame({"one": np.asarray(one), "other": np.asarray(other)}).drop_duplicates()
    return pairs["one"].is_unique and pairs["other"].is_unique


@trackers
@pytest.mark.parametrize("motion", [ConstantVelocity(), ConstantAcceleration()])
def test_two_that_cross_keep_their_ways(associator, motion):
    """They cross between two frames, so nothing but their motion tells them apart."""
    table = together(flight((100, 100), (10, 12)), flight((297, 105), (-10, 12)))
    result = track(table, associator, motion)
    assert same_partition(result["particle"], result["truth"])


@trackers
def test_a_particle_that_hides_for_three_frames_comes_back(associator):
    table = flight((100, 200), (12, -7))
    hidden = table[~table["frame"].between(8, 10)]
    assert not track(hidden, associator)["particle"].any()


def test_a_particle_that_hides_for_too_long_is_a_new_one():
    table = flight((100, 200), (12, -7))
    management = Management(visibility=0.0, invisible=3)
    hidden = table[~table["frame"].between(8, 10)]
    assert track(hidden, management=management)["particle"].max() == 0
    hidden = table[~table["frame"].between(8, 11)]
    assert track(hidden, management=management)["particle"].max() == 1


def test_a_track_that_is_seldom_detected_is_given_up():
    """Seen in frames 0, 1, then every third: 3 of 7 frames are 0.43, 3 of 8 are 0.375."""
    table = flight((100, 200), (3, 2))
    seldom = table[table["frame"].isin([0, 1, 4, 8])]
    assert track(seldom)["particle"].tolist() == [0, 0, 0, 1]
    assert not track(seldom, management=Management(visibility_age=9))["particle"].any()
    assert not track(seldom, management=Management(visibility=0.0))["particle"].any()


def test_a_throw_needs_acceleration_or_noise():
    time = np.arange(20)
    table = pd.DataFrame({"frame": time, "row": 5.0 * time + 0.4 * time**2, "col": 9.0 * time})
    for motion in (ConstantVelocity(), ConstantAcceleration()):
        assert not track(table, motion=motion)["particle"].any()
    stiff = ConstantVelocity(acceleration_noise=1e-3, measurement_sd=0.1)
    assert track(table, motion=stiff)["particle"].any()


def test_depth_and_size_keep_two_apart_that_fly_as_one():
    near = flight((100, 100), (10, 12), z=3000.0, points=40)
    far = flight((100.5, 100), (10, 12), z=6000.0, points=90)
    result = track(together(near, far))
    assert same_partition(result["particle"], result["truth"])


def test_a_track_keeps_its_last_known_depth():
    """The second comes where the first was expected, but 3 m behind it."""
    near = flight((100, 100), (10, 0), 5, z=[3000.0, np.nan, np.nan, np.nan, np.nan])
    far = flight((150, 100), (10, 0), 3, first=5, z=6000.0)
    result = track(together(near, far))
    assert same_partition(result["particle"], result["truth"])
    nothing = track(together(near.assign(z=np.nan), far))  # never had one: passes
    assert not nothing["particle"].any()


def test_a_gap_is_predicted_with_its_true_length():
    table = pd.concat([flight((0, 0), (20, 5), 10), flight((500, 125), (20, 5), 5, first=25)])
    patient = Management(visibility=0.0, invisible=30)
    assert not track(table, management=patient)["particle"].any()
    assert track(table)["particle"].tolist() == [0] * 10 + [1] * 5
    long = flight((0, 0), (20, 5), 4)
    long.loc[3, "frame"] = 10**9
    assert track(long)["particle"].tolist() == [0, 0, 0, 1]


@trackers
def test_every_detection_is_in_one_track_or_used_and_no_track_twice_in_a_frame(associator):
    for seed in range(3):
        result = track(clutter(seed, per_frame=12), associator)
        assert result["particle"].dtype == np.int64
        used = result["particle"] == -1  # by a track that was recorded with another one
        assert used.any() == isinstance(associator, JPDA)
        result = result[~used]
        assert sorted(result["particle"].unique()) == list(range(result["particle"].nunique()))
        assert not result.duplicated(["frame", "particle"]).any()
        birth = result.groupby("particle")["frame"].min()
        assert birth.is_monotonic_increasing


def test_where_and_when_it_happens_does_not_matter():
    table = clutter(0, 10, 8).round()  # so that moving them is exact
    moved = table + {"frame": 300, "row": -77.0, "col": 12.0}
    pd.testing.assert_series_equal(track(table)["particle"], track(moved)["particle"])


def test_the_steps_hold_what_was_done():
    table = together(flight((100, 100), (10, 12)), flight((297, 105), (-10, 12)))
    for step in steps(table):
        rows, (n, m) = step.detected.rows, step.pairs.distance_squared.shape
        assert step.weights.shape == (n, 1 + m)
        assert (table["frame"].to_numpy()[rows] == step.detected.frame).all()
        recorded = step.tracks[step.tracks["row"] >= 0]
        assert sorted(recorded["particle"]) == sorted(step.particle)
        assert sorted(recorded["row"]) == sorted(rows)
    assert n == m == 2
    result = table.iloc[rows].assign(particle=step.particle).sort_values("particle")
    assert (abs(step.pairs.expected - result[["row", "col"]]) < 1.0).all(axis=None)


def test_of_two_tracks_that_want_one_detection_the_larger_weight_has_it():
    """The other takes what it wants next, if it beats "missed"; what is left was used by both."""

    def undecided(pairs):
        n, m = pairs.distance_squared.shape
        rows = (
            [[0.1, 0.6, 0.2, 0.1], [0.1, 0.7, 0.05, 0.15]] if (n, m) == (2, 3) else np.eye(n, 1 + m)
        )
        return np.asarray(rows)

    first = pd.DataFrame({"frame": 0, "row": [0.0, 1.0], "col": 0.0})
    second = pd.DataFrame({"frame": 1, "row": [0.0, 1.0, 2.0], "col": 0.0})
    result = track(pd.concat([first, second]), undecided)
    assert result["particle"].tolist() == [0, 1, 1, 0, -1]
    lenient = track(pd.concat([first, second]), undecided, management=Management(used=0.2))
    assert lenient["particle"].tolist() == [0, 1, 1, 0, 2]


def test_a_probabilistic_track_is_recorded_at_the_average_of_its_detections():
    """Section 5.2.3; by hand: 0.6 and 0.2 of 0.8 weigh 3 to 1, 0.1 and 0.4 weigh 1 to 4."""

    def undecided(pairs):
        n, m = pairs.distance_squared.shape
        rows = [[0.2, 0.6, 0.2, 0.0], [0.5, 0.0, 0.1, 0.4]] if (n, m) == (2, 3) else np.eye(n, 4)
        return np.asarray(rows)[:, : 1 + m]

    first = pd.DataFrame({"frame": 0, "row": [0.0, 8.0], "col": 0.0, "z": 5000.0, "gray": 1.0})
    second = first.iloc[[0, 0, 0]].assign(frame=1, row=[0.0, 4.0, 14.0], gray=[7.0, 8.0, 9.0])
    second["z"] = [5000.0, 5400.0, np.nan]
    table = pd.concat([first, second], ignore_index=True)
    result = track(table, undecided)
    # the second track is rather missed (0.5 > 0.4), so it has used nothing; the first, 4.0
    assert result["particle"].tolist() == [0, 1, 0, -1, 2]
    np.testing.assert_allclose(result["row"], [0.0, 8.0, 1.0, 4.0, 14.0])
    np.testing.assert_allclose(result["z"], [5000.0, 5000.0, 5100.0, 5400.0, np.nan])
    pd.testing.assert_series_equal(result["gray"], table["gray"])
    surer = track(table, lambda pairs: undecided(pairs) if len(pairs[0]) < 2 else SURER)
    assert surer["particle"].tolist() == [0, 1, 0, -1, 1]
    np.testing.assert_allclose(surer["row"], [0.0, 8.0, 1.0, 4.0, 12.0])
    np.testing.assert_allclose(surer["z"], [5000.0, 5000.0, 5100.0, 5400.0, 5400.0])


SURER = np.array([[0.2, 0.6, 0.2, 0.0], [0.3, 0.0, 0.14, 0.56]])


@trackers
def test_what_is_alone_in_its_gate_is_recorded_as_it_was_detected(associator):
    table = flight((100, 200), (12.34, -7.01), z=5000.0)
    result = track(table, associator)
    pd.testing.assert_frame_equal(result.drop(columns="particle"), table)


def test_a_detection_that_several_tracks_share_is_recorded_for_the_likeliest():
    shared = np.array([[0.55, 0.45], [0.6, 0.4], [1.0, 0.0]])  # 0.85 that it is of a track
    assert tracking.record(shared).tolist() == [0]
    doubtful = np.array([[0.8, 0.2], [0.75, 0.25]])  # 0.45: of none, rather
    assert tracking.record(doubtful).tolist() == [-1]
    together = np.array([[0.4, 0.25, 0.35]])  # neither beats "missed", both do (Eq. 4.10)
    assert tracking.record(together).tolist() == [-1, 0]
    assert tracking.record(np.array([[0.5, 0.25, 0.25]])).tolist() == [-1, -1]
    taken = np.array([[0.1, 0.5, 0.4], [0.9, 0.0, 0.1]])  # its track has a likelier one
    assert tracking.record(taken).tolist() == [0, -1]


@pytest.mark.parametrize(
    "names", [["frame", "x", "y"], ["y", "frame", "x"], ["col", "frame", "row"]]
)
def test_places_may_be_named_x_and_y(names):
    table = together(flight((100, 100), (10, 12)), flight((297, 105), (-10, 12)))
    other = table.rename(columns={"row": "y", "col": "x"}) if "x" in names else table
    result = track(other[names])
    assert list(result) == [*names, "particle"]
    assert result["particle"].tolist() == track(table)["particle"].tolist()


def test_columns_of_a_csv_with_gaps_are_taken():
    table = flight((1, 4), (1, 1), 3).astype({"frame": float})
    table["particle"] = pd.array([1, None, -1], dtype="Int64")
    table["points"] = pd.array([3, None, 4], dtype="Int64")
    assert track(table)["particle"].tolist() == [0, 0, -1]


def test_equal_detections_are_two_tracks():
    table = flight((1, 4), (1, 1), 3)
    twice = track(pd.concat([table, table]))
    assert twice.groupby("particle").size().tolist() == [3, 3]
    assert not twice.duplicated(["frame", "particle"]).any()


TABLE = flight((1, 4), (1, 1), 3, z=1.0, points=2, particle=0)


@pytest.mark.parametrize(
    ("table", "name"),
    [
        (None, "detections"),
        (np.zeros((3, 3)), "detections"),
        (TABLE.drop(columns="frame"), "frame"),
        (TABLE[["frame", "row"]], "col"),
        *((pd.concat([TABLE, TABLE[[name]]], axis=1), name) for name in ("row", "z", "particle")),
        *((TABLE.assign(frame=bad), "frame") for bad in (0.5, np.nan, np.inf, "0", -1)),
        *((TABLE.assign(row=bad), "row") for bad in (np.nan, np.inf, 1j, "far")),
        *((TABLE.assign(z=bad), "z") for bad in (np.inf, 1j, True, "far")),
        (TABLE.assign(points="few"), "points"),
    ],
)
def test_bad_input_names_the_column(table, name):
    with pytest.raises(InputError, match=rf"\b{name}\b"):
        track(table)


@pytest.mark.parametrize(
    ("name", "bad"),
    [
        ("visibility", 1.5),
        ("visibility", "a"),
        ("invisible", 2.5),
        ("visibility_age", -1),
        ("used", 2),
    ],
)
def test_bad_management_names_the_argument(name, bad):
    with pytest.raises(InputError, match=name):
        Management(**{name: bad})
