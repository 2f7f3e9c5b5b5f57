"""What outside readers rely on: the public calls with nothing, one and many.

Of each call: types, columns, the caller's index and order of rows, other number types,
input that stays as it was, and bad input, which is one `InputError` that names the
argument.
"""

from functools import partial

import numpy as np
import pandas as pd
import pytest

import kilnflight
from kilnflight import background
from kilnflight.association import GNN, JPDA, PDA, NearestNeighbor, joint_probabilities
from kilnflight.belt.tracker import BeltTracker
from kilnflight.camera import DepthCalibration
from kilnflight.checks import InputError
from kilnflight.detection import (
    DBSCAN,
    DoG,
    MorphologicalClustering,
    Otsu,
    QuasiClusterCenters,
)
from kilnflight.detection.otsu import otsu_threshold
from kilnflight.detection.wall import Cylinder
from kilnflight.flight import space_sliced_velocity
from kilnflight.flight.table import Rules
from kilnflight.regression import Regression, regress, regress_all
from kilnflight.scores import score_detections, score_tracks
from kilnflight.simulated.kiln import scenes
from kilnflight.store.parallel import Workers
from kilnflight.tracking import track
from kilnflight.tracking.filter import (
    ConstantAcceleration,
    ConstantVelocity,
    Gate,
    Motion,
)
from kilnflight.tracking.tracker import Management
from kilnflight.tracklets import STEPS, Connection, Elimination, postprocess
from kilnflight.tracklets.joining import Costs

CLUSTERERS = [
    DBSCAN(30.0, 4),
    MorphologicalClustering(40),
    QuasiClusterCenters(k=5, alpha=0.5),
]
DETECTORS = [DoG(500.0), Otsu()]
EXIT = (10.0, -20.0, 6000.0)


def flights(count=3, frames=12):
    """Straight flights far apart, in camera coordinates (mm) and pixels, frame by
    frame.
    """
    frame, particle = np.divmod(np.arange(frames * count), count)
    row, col = 20.0 + 60 * particle + 2.0 * frame, 10.0 + 5.0 * frame
    table = pd.DataFrame({"frame": frame, "particle": particle, "row": row, "col": col})
    return table.assign(
        x=10.0 + frame, y=-20.0 - frame, z=5800.0 - 40 * frame, points=9
    )


def one_flight(frames=20):
    """A trajectory of order 2 that leaves `EXIT` 0.1 s before frame 0, at 100 Hz."""
    time = np.arange(frames) / 100.0 + 0.1
    places = [
        10.0 + 300 * time,
        -20.0 + 50 * time - 400 * time**2,
        6000.0 - 9000 * time,
    ]
    return pd.DataFrame(dict(zip("xyz", places, strict=True))).assign(
        frame=np.arange(frames)
    )


def cloud():
    """Three balls of points, and one point far from them."""
    rng = np.random.default_rng(0)
    balls = [rng.normal(at, 8.0, (40, 3)) for at in (0.0, 300.0, 700.0)]
    return np.concatenate([*balls, [[3000.0, 0.0, 0.0]]])


def blobs(places, peak=8000.0):
    """A foreground with blobs of 3 px in standard deviation."""
    rows, cols = np.ogrid[:96, :128]
    return sum(
        (peak * np.exp(-((rows - r) ** 2 + (cols - c) ** 2) / 18) for r, c in places),
        np.zeros((96, 128)),
    )


def same_groups(one, other):
    """Return whether two arrays of labels group alike, with the same noise."""
    pairs = set(zip(one.tolist(), other.tolist(), strict=True))
    as_many = len(pairs) == len(set(one.tolist())) == len(set(other.tolist()))
    return as_many and np.array_equal(one == -1, other == -1)


def shuffled(table):
    """Return the rows in another order, with an index of their own."""
    mixed = table.sample(frac=1, random_state=1)
    return mixed.set_axis(np.arange(len(mixed)) * 3 + 100)


# Scores


def test_tracks_are_scored():
    table = flights()
    before = table.copy()
    one = table[table["particle"] == 1]
    score = score_tracks(
        shuffled(table), shuffled(one).astype({"frame": float}), gate=5.0
    )
    assert (score.tp, score.fn, score.fp, score.fn_tracks) == (12, 24, 0, 2)
    assert score.alpha == score.beta == pytest.approx(1 / 3)
    none = score_tracks(table, table.head(0), 5.0)
    assert (none.alpha, none.beta, none.jsc, none.jsc_theta, none.fn) == (
        0,
        0,
        0,
        0,
        36,
    )
    in_space = score_tracks(table, table.assign(row=0.0), 5.0, columns=["x", "y", "z"])
    assert in_space.jsc == 1.0
    pd.testing.assert_frame_equal(table, before)


@pytest.mark.parametrize(
    "kind", [list, np.array, lambda places: np.asfortranarray(places, "f4")]
)
def test_detections_are_scored(kind):
    truth_px, found = (
        kind([(0, 0), (0, 60), (200, 0)]),
        kind([(9, 0), (0, 40), (300, 0)]),
    )
    score = score_detections(truth_px, found)
    assert (score.tp, score.fp, score.fn) == (2, 1, 1)
    assert (score.precision, score.recall, score.f1) == pytest.approx(
        (2 / 3, 2 / 3, 2 / 3)
    )
    assert score.pairs.tolist() == [[0, 0], [1, 1]]
    for empty in ([], np.empty((0, 2))):
        assert score_detections(truth_px, empty).fn == 3
        none = score_detections(empty, empty)
        assert (none.tp, none.precision, none.recall, none.f1, len(none.pairs)) == (
            0,
            0,
            0,
            0,
            0,
        )


# Detection


@pytest.mark.parametrize("clusterer", CLUSTERERS)
def test_clusters_have_whole_labels(clusterer):
    points = cloud()
    before = points.copy()
    labels = clusterer(points)
    assert (labels.shape, labels.dtype.kind) == ((121,), "i")
    balls = [set(labels[k : k + 40]) - {-1} for k in (0, 40, 80)]
    assert all(balls)
    assert sum(map(len, balls)) == len(set.union(*balls))  # none is in two balls
    np.testing.assert_array_equal(points, before)
    single = points.astype(np.float32)
    assert same_groups(clusterer(single), clusterer(single.astype(np.float64)))
    np.testing.assert_array_equal(clusterer(np.asfortranarray(points)), labels)
    np.testing.assert_array_equal(
        clusterer(np.repeat(points, 2, axis=1)[:, ::2]), labels
    )
    np.testing.assert_array_equal(clusterer(points.tolist()), labels)
    for empty in ([], np.empty((0, 3))):
        assert clusterer(empty).shape == (0,)
    assert clusterer(points[:1]).shape == (1,)


@pytest.mark.parametrize("detector", DETECTORS)
@pytest.mark.parametrize("kind", [np.uint16, np.float32, np.float64, ">u2"])
def test_particles_of_a_foreground_are_rows_of_floats(detector, kind):
    places = [(30, 40), (60, 90), (70, 20)]
    image = blobs(places).astype(kind)
    before = image.copy()
    found = detector(image)
    assert (found.shape, found.dtype) == ((3, 3), np.float64)
    near = found[np.lexsort(found[:, ::-1].T)]
    np.testing.assert_allclose(near[:, :2], places, atol=0.5)
    assert (found[:, 2] > 2.0).all()
    np.testing.assert_array_equal(image, before)
    np.testing.assert_array_equal(detector(np.asfortranarray(image)), found)
    np.testing.assert_array_equal(detector(np.repeat(image, 2, axis=1)[:, ::2]), found)
    assert detector(blobs(places[:1]).astype(kind)).shape == (1, 3)
    assert detector(np.zeros((96, 128), kind)).shape == (0, 3)


# Background


@pytest.mark.parametrize("model", background.MODELS)
def test_each_wanted_frame_has_a_foreground(model):
    images = np.random.default_rng(0).integers(900, 1100, (200, 9, 12), dtype=np.uint16)
    before = images.copy()
    images[90, 4, 5] = 9000
    before[90, 4, 5] = 9000
    found = list(model(images, iter([90, 3, 199])))
    assert [(image.shape, image.dtype) for image in found] == 3 * [
        ((9, 12), np.float32)
    ]
    assert np.unravel_index(found[0].argmax(), (9, 12)) == (4, 5)
    (alone,) = model(images, [3])
    np.testing.assert_array_equal(alone, found[1])
    np.testing.assert_array_equal(images, before)
    assert list(model(images, [])) == []
    (still,) = model(images[:1], [0])
    assert not still.any()
    for kind in (np.float32, np.float64):
        np.testing.assert_allclose(
            next(model(images.astype(kind), [3])), alone, atol=1e-3
        )
    flipped = np.asfortranarray(images)[:, ::-1]
    np.testing.assert_array_equal(next(model(flipped, [3])), alone[::-1])


# Association, tracking, post-processing


def test_joint_probabilities_sum_to_one():
    likelihood = np.array([[0.5, 0.2, 0.0], [0.4, 0.0, 0.0]])
    before = likelihood.copy()
    found = joint_probabilities(likelihood, [0.1, 0.3])
    assert (found.shape, found.dtype) == ((2, 4), np.float64)
    events = {"--": 0.03, "0-": 0.15, "1-": 0.06, "-0": 0.04, "10": 0.08}
    shares = [[0.07, 0.15, 0.14, 0], [0.24, 0.12, 0, 0]]
    np.testing.assert_allclose(
        found, np.array(shares) / sum(events.values()), rtol=1e-12
    )
    single = joint_probabilities(
        np.asfortranarray(likelihood, np.float32), np.float32([0.1, 0.3])
    )
    np.testing.assert_allclose(single, found, rtol=1e-6)
    np.testing.assert_array_equal(likelihood, before)
    assert joint_probabilities(np.empty((0, 0)), []).shape == (0, 1)
    assert joint_probabilities(np.empty((0, 4)), []).shape == (0, 5)
    assert joint_probabilities(np.empty((2, 0)), [1.0, 2.0]).tolist() == [[1.0], [1.0]]
    assert joint_probabilities(np.zeros((1, 2)), [0.1]).tolist() == [[1.0, 0.0, 0.0]]


@pytest.mark.parametrize("associator", [GNN(), JPDA()])
def test_detections_are_linked(associator):
    table = shuffled(flights().rename(columns={"particle": "true"})).assign(note="kept")
    before = table.copy()
    found = track(table, associator=associator)
    pd.testing.assert_frame_equal(table, before)
    assert list(found.columns) == [*table.columns, "particle"]
    pd.testing.assert_frame_equal(
        found[["frame", "true", "note"]], table[["frame", "true", "note"]]
    )
    assert found["particle"].dtype.kind == "i"
    assert same_groups(found["particle"].to_numpy(), table["true"].to_numpy())
    ordered = track(table.sort_index(ascending=False), associator)["particle"]
    pd.testing.assert_series_equal(ordered.sort_index(), found["particle"].sort_index())
    others = track(table.astype({"frame": float, "row": "f4", "col": "f4"}), associator)
    assert same_groups(others["particle"].to_numpy(), table["true"].to_numpy())
    plain = track(table[["frame", "row", "col"]], associator)
    assert plain["particle"].nunique() == 3
    dropped = track(
        table.assign(particle=np.where(table["true"] == 1, -1, 0)), associator
    )
    assert set(dropped.loc[table["true"] == 1, "particle"]) <= {-1}
    assert len(track(table.head(1), associator)) == 1
    empty = track(table.head(0), associator)
    assert list(empty.columns) == list(found.columns)
    assert empty.empty


@pytest.mark.parametrize("steps", [STEPS, *((step,) for step in STEPS)])
def test_tracks_keep_rows_and_columns(steps):
    table = shuffled(flights()).assign(note="kept")
    before = table.copy()
    found = postprocess(table, steps=steps)
    pd.testing.assert_frame_equal(table, before)
    pd.testing.assert_frame_equal(
        found.drop(columns="particle"), table.drop(columns="particle")
    )
    assert same_groups(found["particle"].to_numpy(), table["particle"].to_numpy())
    turned = postprocess(table[::-1], steps=steps)["particle"]
    pd.testing.assert_series_equal(turned[::-1], found["particle"])
    unlinked = postprocess(table.assign(particle=-1), steps=steps)
    assert (unlinked["particle"] == -1).all()
    assert list(postprocess(table.head(0), steps=steps).columns) == list(table.columns)
    assert len(postprocess(table.head(1), steps=steps)) == 1


# Regression, flight, camera


@pytest.mark.parametrize("exit_point", [EXIT, list(EXIT), np.array(EXIT, np.float32)])
def test_a_track_is_regressed(exit_point):
    table = one_flight()
    before = table.copy()
    fit = regress(table, exit_point, frame_rate_hz=100.0)
    pd.testing.assert_frame_equal(table, before)
    assert fit.t0 == pytest.approx(-0.1, abs=1e-6)
    assert fit.orders == (2, 2, 2)
    expected = [[300, 0], [50, -400], [-9000, 0]]
    np.testing.assert_allclose(fit.coefficients, expected, atol=1e-2)
    np.testing.assert_allclose(fit.rmse_mm, 0, atol=1e-3)
    np.testing.assert_allclose([fit.r2, fit.r2_adjusted], 1, atol=1e-6)
    np.testing.assert_allclose(
        fit(table["frame"] / 100.0), table[list("xyz")], atol=1e-2
    )
    np.testing.assert_allclose(
        np.ravel(fit(0.05)), table.loc[5, list("xyz")], atol=1e-2
    )
    gaps = shuffled(pd.concat([table, table.tail(1).assign(frame=30, x=np.nan)]))
    assert regress(gaps, exit_point, 100.0).t0 == fit.t0
    clocked = table.assign(time_s=table["frame"] / 100.0).drop(columns="frame")
    assert regress(clocked, exit_point).t0 == fit.t0


# Bad input


NAN = np.nan
SETTINGS = [  # that are out of range
    (DBSCAN, {"eps": (0.0,), "min_points": (0,)}),
    (MorphologicalClustering, {"grid": (0, 2.5)}),
    (QuasiClusterCenters, {"k": (0,), "alpha": (-0.1,)}),
    (DoG, {"threshold": (-1.0,), "camera_blur": (2.0, -1.0, NAN)}),
    *(
        (kind, {"interval": (0, 2.5, None)})
        for kind in map(type, background.MODELS[:2])
    ),
    *((kind, {"window": (0, 2.5, None)}) for kind in map(type, background.MODELS[2:])),
    (background.Adaptive, {"learning_rate": (1.1,)}),
    (background.RunningGaussian, {"memory": (-0.1,), "k": (-1,)}),
    *((kind, {"size_weight": (-1.0, NAN, "a")}) for kind in (NearestNeighbor, JPDA)),
    (GNN, {"nonassignment_cost": (np.inf, "a", None)}),
    (PDA, {"detection_probability": (0.0, 1.0, NAN, "0.9")}),
    (Gate, {"distance": (-1.0, NAN, np.inf, "4"), "depth_mm": (-1.0, NAN, None)}),
    (ConstantVelocity, {"velocity": ((NAN, 0.0), (), 3.0, ("a", "b"))}),
    (ConstantVelocity, {"measurement_sd": (0.0, NAN, "2", None)}),
    (partial(Motion, (0.0, 0.0), noise=1.0), {"spreads": ((1.0,), (1.0,) * 4, 2.0)}),
    (Elimination, {"duration": (NAN, -1.0), "regularity": (1.5, NAN)}),
    (Connection, {"gap": (-1.0,), "costs": (2.0, None), "matching": ("dnn",)}),
    (Costs, {"angle": (NAN, -1.0), "feature": ("1",)}),
    (Rules, {"ignition": (True,), "plausible": ("no",)}),
    (BeltTracker, {"motion": (None, 1.0), "frame_s": (0.0, NAN)}),
    (ConstantAcceleration, {"acceleration_sd": (0.0, np.inf)}),
    (Management, {"visibility": (1.5, "a"), "invisible": (2.5,)}),
    (Regression, {"lowest": (0,), "highest": (10,), "gain": (-0.1,)}),
    (Workers, {"jobs": (0, 1.5)}),
]
BAD_SETTINGS = [
    (rf"\b{name}\b", partial(kind, **{name: value}))
    for kind, settings in SETTINGS
    for name, values in settings.items()
    for value in values
]


TABLE, FLIGHT = flights(), one_flight()
BAD_CALLS = [  # other faults than those of tests/faults
    ("gate", partial(score_tracks, TABLE, TABLE, 0.0)),
    ("columns", partial(score_tracks, TABLE, TABLE, 5.0, columns=[])),
    ("truth", partial(score_tracks, TABLE.head(0), TABLE, 5.0)),
    ("values", partial(otsu_threshold, np.array([0.0, 70_000.0]))),
    *(
        ("indices", lambda m=m: list(m(np.zeros((5, 4, 6)), [5])))
        for m in background.MODELS
    ),
    ("nonassignment", partial(joint_probabilities, [[0.0]], [0.0])),
    ("track", partial(regress, FLIGHT.head(3), EXIT, 100.0)),
    (r"\bz\b", partial(regress, FLIGHT.assign(z=1e200), EXIT, 100.0)),
    ("highest", partial(regress_all, FLIGHT, EXIT, 100.0, Regression(highest=7))),
    ("slice_m", lambda: space_sliced_velocity(regress(FLIGHT, EXIT, 100.0), 1e-7)),
    ("scene", partial(scenes.open_scene, "no-such")),
    ("gone", partial(kilnflight.open, "gone")),
    ("direction", partial(Cylinder, (0, 0, 0), (0, 0, 0), 700.0)),
    ("breakpoints", partial(DepthCalibration, (1.0,), ((1.0, 0.0),))),
    ("closed_left", partial(DepthCalibration, (1.0,), ((1.0,), (2.0,)), ("no",))),
    ("closed_left", partial(DepthCalibration, (1.0,), ((1.0,), (2.0,)), (True,) * 2)),
    ("coefficients", partial(DepthCalibration, (1.0,), ((NAN,), (2.0,)))),
    ("coefficients", partial(DepthCalibration, (1.0,), (1.0, 2.0))),
    ("link", lambda: track(TABLE[["frame", "row", "col"]], link="no")),
    ("progress", lambda: track(TABLE[["frame", "row", "col"]], progress=1)),
]


@pytest.mark.parametrize(("name", "call"), [*BAD_SETTINGS, *BAD_CALLS])
def test_bad_input_is_an_error_that_names_the_argument(name, call):
    with pytest.raises(InputError, match=name):
        call()
