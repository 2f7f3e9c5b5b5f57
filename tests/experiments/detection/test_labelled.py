import numpy as np
import pandas as pd
import pytest

from kilnflight import background, chain
from kilnflight.detection import DoG
from kilnflight.detection.combination import Combination, second_pass
from kilnflight.detection.wall import Cylinder
from kilnflight.experiments.detection import labelled, sift_row, summaries
from kilnflight.publication import claims
from kilnflight.simulated.kiln import truth

MEDIAN = background.Median(window=20)


@pytest.fixture(scope="module")
def subset(kept_scene):
    twin, frames = kept_scene("V3@small"), (75, 76)
    instances = {t: truth.instances(twin, t) for t in frames}
    marked = truth.marked(twin, frames)
    return labelled.Subset("V3", twin, frames, marked, instances.get, MEDIAN, {})


def test_a_perfect_method_has_full_marks_and_an_empty_one_none(subset):
    known = {subset.recording.gray(t).tobytes(): t for t in subset.frames}

    def perfect(view):
        here = subset.particles["frame"] == known[view.gray.tobytes()]
        return subset.particles.loc[here, ["row", "col"]].to_numpy()

    methods = {"all": perfect, "none": lambda view: np.empty((0, 2))}
    table = labelled.run([subset], methods)
    total = labelled.sum_counts(table, ["method"]).set_index("method")
    assert total.loc["all", ["precision", "recall", "f1"]].tolist() == [1, 1, 1]
    assert total.loc["all", "tp"] == len(subset.particles)
    assert total.loc["none", ["tp", "fp", "f1"]].tolist() == [0, 0, 0]
    assert total.loc["all", "f1_in_pixels"] > 0.9
    recall = summaries.class_recall(table, ["method"]).set_index(["method", "label"])
    there = subset.particles["label"].value_counts()
    for label in (2, 3, 4):
        assert recall.loc[("all", label), "tp"] == there.get(label, 0)
        assert recall.loc[("none", label), "fn"] == there.get(label, 0)


def test_45_px_as_a_diameter_pair_what_is_22_px_apart(subset):
    """Section 3.3 calls the threshold a diameter; Eq. 3.4 compares it with a distance."""
    middle = np.array(subset.recording.attributes.size) / 2
    here = subset.particles[subset.particles["frame"] == 75]
    off = np.hypot(here["row"] - middle[0], here["col"] - middle[1])
    alone = subset._replace(frames=(75,), particles=here.loc[[off.idxmin()]])
    row, col = alone.particles.iloc[0][["row", "col"]]
    methods = {
        gap: lambda _, gap=gap: np.array([[row + gap, col]]) for gap in (22, 30, 46)
    }
    table = labelled.run([alone], methods)
    assert table["tp"].tolist() == [1, 1, 0]
    assert table["tp_near"].tolist() == [1, 0, 0]
    assert table["fn_near"].tolist() == [0, 1, 1]


def test_positions_are_means_of_the_points_in_the_pixels(subset):
    subset = subset._replace(frames=(75,))
    wall = Cylinder((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 700.0)
    ((t, view),) = chain.views(subset.recording, [75], MEDIAN)
    image = subset.instances(t)
    marked, detected = labelled.positions(
        [subset], {"V3": Combination(DoG(1500.0))}, wall
    )
    places = marked[["x", "y", "z"]].to_numpy()
    for particle, place in zip(marked["particle"], places, strict=True):
        points = view.xyz[image[view.pixels[:, 0], view.pixels[:, 1]] == particle]
        mean = points.mean(axis=0) if len(points) else np.full(3, np.nan)
        np.testing.assert_allclose(place, mean)
    assert marked["z"].notna().any()
    for table in (marked, detected):
        np.testing.assert_allclose(
            table["distance_mm"], np.hypot(table["x"], table["y"])
        )


def test_sift_with_each_edge_is_scored_at_the_threshold_of_the_other_subset(subset):
    """The total row adds what DoG finds at the two thresholds; the misfit is from
    print.
    """
    pair = [subset, subset._replace(name="V5", frames=(76,), cache={})]
    table = sift_row.edge_table(pair, "quick", (2.0, 10.0)).set_index(
        ["edge", "subset"]
    )
    for edge in (2.0, 10.0):
        one = table.loc[edge]
        for name, own in zip(("V3", "V5"), pair, strict=True):
            method = labelled.from_foreground(
                DoG(one.loc[name, "threshold"], edge=edge)
            )
            counts = labelled.run([own], {"SIFT": method})[["tp", "fp", "fn"]].sum()
            assert one.loc[name, ["tp", "fp", "fn"]].tolist() == counts.tolist()
        assert one.loc["Total", "fp"] == one.loc[["V3", "V5"], "fp"].sum()
        off = (
            100 * (one.loc["Total", "f1"] - 0.8749),
            2 * (one.loc["Total", "fp"] ** 0.5 - 354**0.5),
        )
        assert one.loc["Total", "misfit"] == pytest.approx(np.hypot(*off))
    assert table.loc[2.0]["tp"].sum() <= table.loc[10.0]["tp"].sum()


def test_all_eleven_methods_obey_the_rules_of_one_combination(subset):
    few = subset._replace(frames=(75,))
    roi = subset.recording.attributes.roi
    printed = claims.published("table_5.11")["method"].tolist()
    found = {}
    for largest in (90.0, 1e-3):
        methods = labelled.table_5_11_methods(
            Combination(DoG(500.0), largest_px=largest), roi, {}
        )
        assert list(methods) == printed
        table = labelled.run([few], methods).set_index("method")
        found[largest] = table["tp"] + table["fp"]
    assert (found[90.0] > 0)[["2D-OTSU", "2D-SIFT"]].all()
    assert found[1e-3][["2D-OTSU", "2D-SIFT"]].tolist() == [0, 0]
    clouds = [name for name in printed if name.startswith("3D")]
    assert found[1e-3][clouds].tolist() == found[90.0][clouds].tolist()


def test_rules_on_one_recording_share_clusters_but_not_keypoints(subset):
    """Each rule gives what it gives alone; clusters are found once, as by their
    clusterer.
    """
    few, known = subset._replace(frames=(75,)), {}
    counts = ["method", "tp", "fp", "fn"]
    for threshold in (200.0, 5000.0):
        rule = Combination(DoG(threshold))
        shared = labelled.run([few], labelled.table_5_11_methods(rule, None, known))
        alone = labelled.run([few], labelled.table_5_11_methods(rule, None, {}))
        pd.testing.assert_frame_equal(shared[counts], alone[counts])
        assert len(known) == 6 * 2  # also of the untimed first calls
    ((_, view),) = labelled.subset_views(few)
    for (passes, _, points), labels in known.items():
        xyz = view.xyz[:points]
        expected = second_pass(xyz, *passes) if passes[1:] else passes[0](xyz)
        np.testing.assert_array_equal(labels, expected)
