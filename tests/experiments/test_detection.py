import time
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from kilnflight import background, kiln
from kilnflight.checks import InputError
from kilnflight.detection import DBSCAN, DoG, QuasiClusterCenters
from kilnflight.detection.combination import Combination, View
from kilnflight.detection.wall import Cylinder
from kilnflight.experiments import detection, detection_tables
from kilnflight.project import claims
from kilnflight.twin import scenes, truth

MEDIAN = background.Median(window=20)


@pytest.fixture(scope="module")
def subset(kept_scene):
    twin, frames = kept_scene("V3@small"), (75, 76)
    instances = {t: truth.instances(twin, t) for t in frames}
    return detection.Subset("V3", twin, frames, truth.marked(twin, frames), instances.get)


def perfect(subset):
    """Return a method that detects every particle: it knows a frame by its grey values."""
    known = {subset.recording.gray(t).tobytes(): t for t in subset.frames}

    def method(view):
        here = subset.particles["frame"] == known[view.gray.tobytes()]
        return subset.particles.loc[here, ["row", "col"]].to_numpy()

    return method


def test_a_perfect_method_has_full_marks_and_an_empty_one_none(subset):
    methods = {"all": perfect(subset), "none": lambda view: np.empty((0, 2))}
    table = detection.run([subset], methods, MEDIAN)
    total = detection.sum_counts(table, ["method"]).set_index("method")
    assert total.loc["all", ["precision", "recall", "f1"]].tolist() == [1, 1, 1]
    assert total.loc["all", "tp"] == len(subset.particles)
    assert total.loc["none", ["tp", "fp", "f1"]].tolist() == [0, 0, 0]
    assert total.loc["all", "f1_in_pixels"] > 0.9
    recall = detection_tables.class_recall(table, ["method"]).set_index(["method", "label"])
    there = subset.particles["label"].value_counts()
    for label in (2, 3, 4):
        assert recall.loc[("all", label), "tp"] == there.get(label, 0)
        assert recall.loc[("none", label), "fn"] == there.get(label, 0)


def test_the_first_call_which_may_compile_is_not_timed(subset):
    calls = []

    def method(view):
        calls.append(len(view.xyz))
        return np.empty((0, 2))

    table = detection.run([subset], {"one": method}, MEDIAN)
    assert calls[0] <= detection.WARM_UP_POINTS
    assert len(calls) == 1 + len(subset.frames)
    assert len(table) == len(subset.frames)


def test_45_px_as_a_diameter_pair_what_is_22_px_apart(subset):
    """Section 3.3 calls the threshold a diameter; Eq. 3.4 compares it with a distance."""
    middle = np.array(subset.recording.attributes.size) / 2
    here = subset.particles[subset.particles["frame"] == 75]
    off = np.hypot(here["row"] - middle[0], here["col"] - middle[1])
    alone = subset._replace(frames=(75,), particles=here.loc[[off.idxmin()]])
    row, col, label = alone.particles.iloc[0][["row", "col", "label"]]
    methods = {gap: lambda _, gap=gap: np.array([[row + gap, col]]) for gap in (22, 30, 46)}
    table = detection.run([alone], methods, MEDIAN)
    assert table["tp"].tolist() == [1, 1, 0]
    assert table["tp_near"].tolist() == table[f"tp_{label}_near"].tolist() == [1, 0, 0]
    assert table[f"fn_{label}_near"].tolist() == [0, 1, 1]
    total = detection.sum_counts(table, ["method"])
    assert total["f1_diameter_45_px"].tolist() == [1, 0, 0]


def test_detectors_of_each_kind_are_methods(subset):
    methods = {
        "picture": detection.from_foreground(DoG(1500.0)),
        "cloud": detection.from_cloud(DBSCAN(60.0, 4)),
        **detection.table_5_11_methods(1500.0, subset.recording.attributes.roi),
    }
    table = detection.run([subset._replace(frames=(75,))], methods, MEDIAN)
    assert list(table["method"]) == list(methods)
    assert (table[["tp", "fp", "fn"]] >= 0).all(axis=None)
    assert len(set(table["tp"] + table["fn"])) == 1
    printed = {"2D-OTSU", "3D-DBSCAN Clustering", "Combi SIFT+QCC"}
    assert printed < set(methods)


def test_cached_views_are_those_of_the_first_call(subset):
    holding = subset._replace(frames=(75, 77), background=MEDIAN, cache={})
    first = list(detection.subset_views(holding))
    again = list(detection.subset_views(holding._replace(frames=(77,))))
    assert [t for t, _ in first] == [75, 77]
    assert again[0][1] is first[1][1]
    anew = list(detection.subset_views(holding._replace(cache=None, frames=(77,))))
    for one, other in zip(anew[0][1], again[0][1], strict=True):
        np.testing.assert_array_equal(one, other)
    other = list(detection.subset_views(holding, background=background.Median(window=6)))
    assert other[1][1] is not first[1][1]
    assert not np.array_equal(other[1][1].foreground, first[1][1].foreground)
    assert next(view for _, view in detection.subset_views(holding)) is first[0][1]


def test_positions_are_means_of_the_points_in_the_pixels(subset):
    subset = subset._replace(frames=(75,), background=MEDIAN)
    wall = Cylinder((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 700.0)
    ((t, view),) = kiln.views(subset.recording, [75], MEDIAN)
    image = subset.instances(t)
    marked, detected = detection.positions([subset], {"V3": Combination(DoG(1500.0))}, wall)
    places = marked[["x", "y", "z"]].to_numpy()
    for particle, place in zip(marked["particle"], places, strict=True):
        points = view.xyz[image[view.pixels[:, 0], view.pixels[:, 1]] == particle]
        if len(points):
            np.testing.assert_allclose(place, points.mean(axis=0))
        else:
            assert np.isnan(place).all()
    assert marked["z"].notna().any()
    assert set(detected["subset"]) <= {"V3"}
    for table in (marked, detected):
        np.testing.assert_allclose(table["distance_mm"], np.hypot(table["x"], table["y"]))


def attempts(**true_positives):
    """Return ten particles per frame; a method detects so many of them, by subset."""
    rows = [
        {"subset": v, "frame": t, "method": m, "tp": tp[k], "fp": 0, "fn": 10 - tp[k]}
        for m, tp in true_positives.items()
        for k, v in enumerate(("V1", "V2", "V3"))
        for t in range(4)
    ]
    table = pd.DataFrame(rows).assign(seconds=0.1)
    counts = table[["tp", "fp", "fn"]]
    return table.join(counts.add_suffix("_pixels")).join(counts.add_suffix("_near"))


def test_the_parameter_of_a_subset_is_best_on_the_others():
    table = attempts(low=(1, 8, 8), high=(9, 2, 2)).rename(columns={"method": "threshold"})
    assert detection.leave_one_out(table) == {"V1": "low", "V2": "high", "V3": "high"}
    with pytest.raises(InputError, match="two subsets"):
        detection.leave_one_out(table[table["subset"] == "V1"])


def test_thresholds_ascend():
    assert list(detection.THRESHOLDS) == sorted(set(detection.THRESHOLDS))


def test_one_call_for_all_thresholds_is_the_detector_at_each():
    image = np.zeros((120, 160), dtype=np.float32)
    image[40:46, 50:56], image[90:93, 120:123] = 9000.0, 4000.0
    none = np.empty((0, 2), dtype=np.intp)
    view = View(image.astype(np.uint16), image.astype(np.uint16), image, none, np.empty((0, 3)))
    for change in (lambda foreground: foreground, lambda foreground: foreground / 4):
        methods = detection.from_thresholds((2000, 200, 700), change)
        assert sorted(methods) == [200, 700, 2000]
        for threshold, method in methods.items():
            expected = DoG(float(threshold))(change(image))
            np.testing.assert_array_equal(method(view), expected)
    assert detection.from_thresholds(()) == {}


def test_traces_are_where_a_particle_was_and_is_not(subset):
    subset = subset._replace(instances=lambda t: np.where(np.arange(6) == t % 6, 0, -1)[None])
    clean = np.zeros((1, 6))
    images = {"right": clean, "off": clean + 5.0, "now": np.where(np.arange(6) == 0, 9.0, 0.0)}
    assert detection_tables.background_traces(subset, 30, images, clean) == {
        "right": 0.0,
        "off": 5.0,
        "now": 0.0,
    }


def test_a_detection_is_right_if_it_is_paired(subset):
    subset = subset._replace(frames=(75,), background=MEDIAN, cache={})
    marked, detected = detection.positions([subset], {"V3": Combination(DoG(1500.0))})
    table = detection_tables.precision_by_case(marked, detected, subset.recording.attributes.roi)
    assert table["detections"].sum() == len(detected)
    assert (table["right"] <= table["detections"]).all()
    assert table["precision"].between(0, 1).all()


def counts_of(subsets, methods, _background=None):
    """Return two true positives of three particles for each method, as `detection.run` would."""
    table = pd.DataFrame({"method": list(methods), "tp": 2, "fp": 1, "fn": 1, "seconds": 0.1})
    counts = table[["tp", "fp", "fn"]]
    table = table.join(counts.add_suffix("_pixels")).join(counts.add_suffix("_near"))
    return pd.concat([table.assign(subset=name) for name in subsets], ignore_index=True)


def named_subset(name):
    recording = SimpleNamespace(attributes=SimpleNamespace(roi=f"roi of {name}"))
    return detection.Subset(name, recording, tuple(range(75, 85)), pd.DataFrame(), dict.get)


def test_one_threshold_at_a_time_is_timed_on_every_fifth_frame(monkeypatch):
    frames = []

    def run(subsets, methods):
        frames.extend(subset.frames for subset in subsets)
        return counts_of(["V1"], methods)

    monkeypatch.setattr(detection, "run", run)
    times = detection.time_thresholds([named_subset("V1")], "full")
    assert frames == [(75, 80)]
    assert set(range(400, 1001, 100)) | {100} <= set(times["threshold"])


def test_each_subset_has_its_threshold(monkeypatch):
    monkeypatch.setattr(detection, "table_5_11_methods", lambda *values: {values[:2]: None})
    monkeypatch.setattr(
        detection, "run", lambda subsets, methods: counts_of([subsets[0].name], methods)
    )
    thresholds = pd.Series({"V2": 400, "V1": 566})
    table = detection.compare_methods([named_subset("V1"), named_subset("V2")], thresholds)
    assert table["subset"].tolist() == ["V1", "V2"]
    assert table["method"].tolist() == [(566.0, "roi of V1"), (400.0, "roi of V2")]


def test_clouds_alone_are_left_out_where_the_picture_alone_changes(monkeypatch):
    names = ("2D-OTSU", "3D-QCC Clustering", "Combi OTSU+QCC")
    monkeypatch.setattr(detection, "table_5_11_methods", lambda *_: dict.fromkeys(names, None))
    monkeypatch.setattr(detection, "run", lambda _, methods: counts_of(["V1"], methods))
    table = detection.compare_methods([named_subset("V1")], pd.Series({"V1": 400}), False)
    assert table["method"].tolist() == ["2D-OTSU", "Combi OTSU+QCC"]


def test_another_background_keeps_no_view_of_the_first():
    subset = named_subset("V1")._replace(background=MEDIAN, cache={75: None})
    (other,) = detection.stopping_at_zero([subset])
    assert other.background == background.StopsAtZero(MEDIAN)
    assert other.cache == {}
    assert other.frames == subset.frames
    with pytest.raises(InputError, match="cannot stop at zero"):
        detection.stopping_at_zero([subset._replace(background=background.TwoFrame())])


def test_views_that_stop_at_zero_are_made_of_the_absolute_ones(subset):
    holding = subset._replace(frames=(75, 77), background=MEDIAN, cache={}, darker={})
    first = dict(detection.subset_views(holding))
    (other,) = detection.stopping_at_zero([holding])
    plain = dict(kiln.views(subset.recording, (75, 77), other.background))
    for views in (
        detection.subset_views(other),
        detection.subset_views(holding, other.background),
    ):
        for t, view in views:
            np.testing.assert_array_equal(view.foreground, plain[t].foreground)
            assert view.foreground.dtype == plain[t].foreground.dtype
            assert view.xyz is first[t].xyz  # so that labels can be shared
    assert set(other.cache) == {75, 77}


def test_labels_that_are_known_are_not_made_again(monkeypatch):
    calls = []
    monkeypatch.setattr(detection, "second_pass", lambda xyz, *_: calls.append(len(xyz)) or xyz)
    view = View(None, None, None, None, np.zeros((3, 3)))
    passes, known = detection.PASSES["MO"], {}
    for each in (view, view._replace(foreground=1), view._replace(xyz=np.ones((4, 3)))):
        assert detection._labels(passes, known, each) is each.xyz
    assert calls == [3, 4]


def test_readings_of_dilations_and_sizes_stand_beside_the_best_published_f1(monkeypatch):
    monkeypatch.setattr(detection, "run", counts_of)
    table = detection.morphology_readings(["V1", "V2"])
    ends = ["none", "once (this work)", "twice", "until unchanged"]
    assert table["dilations"].tolist() == 2 * ends
    assert table["size_rule"].tolist() == 4 * [False] + 4 * [True]
    assert table["tp"].tolist() == [4] * 8
    assert table["f1_published"].tolist() == [claims.published("table_5.9")["f1"].max()] * 8


def test_settings_of_qcc_share_one_search_and_find_what_each_finds_alone(subset, monkeypatch):
    searched, search = [], detection.nearest_neighbors

    def counted(cloud, k):
        searched.append(k)
        time.sleep(0.05)
        return search(cloud, k)

    monkeypatch.setattr(detection, "nearest_neighbors", counted)
    table = detection.compare_clusterers([subset])
    assert set(table["family"]) == set(detection.TABLES)  # the search itself is no row
    settings = claims.published("table_5.10")
    assert searched == [settings["K"].max()] * (1 + len(subset.frames))  # once to warm up
    alone = {
        row.Index: detection.from_cloud(QuasiClusterCenters(row.K, row.alpha))
        for row in settings.itertuples()
    }
    expected = detection.run([subset], alone, detection.UNUSED)
    found = table[table["family"] == "qcc"]
    names = [name for name in expected if name not in ("method", "seconds")]
    pd.testing.assert_frame_equal(found[names].reset_index(drop=True), expected[names])
    assert (found["seconds"] > 0.05).all()  # each holds the whole search


def test_every_scale_has_its_frames_its_window_and_its_subsets():
    assert detection.FRAMES.keys() == detection.WINDOWS.keys() == detection.SUBSETS.keys()
    for scale in (detection.DRAW, "full"):  # what is cited is of all five
        assert detection.SUBSETS[scale] == tuple(scenes.SUBSETS)
