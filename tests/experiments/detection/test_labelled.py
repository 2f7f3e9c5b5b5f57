import numpy as np
import pytest
from identify import sift_row

from kilnflight import background, chain
from kilnflight.detection import DoG, QuasiClusterCenters
from kilnflight.detection.combination import Combination, second_pass
from kilnflight.detection.wall import Cylinder
from kilnflight.experiments.detection import labelled, summaries

MEDIAN = background.Median(window=20)


@pytest.fixture(scope="module")
def subset(kept_scene):
    twin = kept_scene("V3@small")
    return labelled.Subset.of(twin, (75, 76), MEDIAN)._replace(name="V3")


def test_a_perfect_method_has_full_marks_and_an_empty_one_none(subset):
    known = {subset.recording.gray(t).tobytes(): t for t in subset.frames}

    def perfect(view):
        here = subset.particles["frame"] == known[view.gray.tobytes()]
        return subset.particles.loc[here, ["row", "col"]].to_numpy()

    methods = {"all": perfect, "none": lambda view: np.empty((0, 2))}
    table = labelled.score_methods([subset], methods)
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
    """Section 3.3 calls 45 px a diameter; Eq. 3.4 compares them with a distance."""
    middle = np.array(subset.recording.attributes.size) / 2
    here = subset.particles[subset.particles["frame"] == 75]
    off = np.hypot(here["row"] - middle[0], here["col"] - middle[1])
    alone = subset._replace(frames=(75,), particles=here.loc[[off.idxmin()]])
    row, col = alone.particles.iloc[0][["row", "col"]]
    methods = {
        gap: lambda _, gap=gap: np.array([[row + gap, col]]) for gap in (22, 30, 46)
    }
    table = labelled.score_methods([alone], methods)
    assert table["tp"].tolist() == [1, 1, 0]
    assert table["tp_near"].tolist() == [1, 0, 0]
    assert table["fn_near"].tolist() == [0, 1, 1]


def test_positions_are_means_of_the_points_in_the_pixels(subset):
    subset = subset._replace(frames=(75,))
    wall = Cylinder((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 700.0)
    ((t, view),) = chain.views(subset.recording, [75], MEDIAN)
    image = subset.instances(t)
    marked = labelled.place_marked([subset], wall)
    detected = labelled.with_distance(Combination(DoG(1500.0))(view), wall)
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
            counts = labelled.score_methods([own], {"SIFT": method})[
                ["tp", "fp", "fn"]
            ].sum()
            assert one.loc[name, ["tp", "fp", "fn"]].tolist() == counts.tolist()
        assert one.loc["Total", "fp"] == one.loc[["V3", "V5"], "fp"].sum()
        off = (
            100 * (one.loc["Total", "f1"] - 0.8749),
            2 * (one.loc["Total", "fp"] ** 0.5 - 354**0.5),
        )
        assert one.loc["Total", "misfit"] == pytest.approx(np.hypot(*off))
    assert table.loc[2.0]["tp"].sum() <= table.loc[10.0]["tp"].sum()


def test_keypoints_above_the_largest_are_left_out(subset):
    (view,) = subset._replace(frames=(75,)).views()
    detector = DoG(500.0)
    counts = [
        len(labelled.from_foreground(detector, largest)(view))
        for largest in (1e-3, 20.0, 90.0)
    ]
    assert counts[0] == 0 < counts[1] <= counts[2]


def test_clusters_are_found_once_and_as_by_their_clusterer(subset):
    (view,) = subset._replace(frames=(75,)).views()
    clusters = labelled.SharedClusters()
    alone = (QuasiClusterCenters(30, 0.1),)
    for passes in (*labelled.PASSES.values(), alone):
        labels = clusters(view, *passes)
        expected = second_pass(view.xyz, *passes) if passes[1:] else alone[0](view.xyz)
        np.testing.assert_array_equal(labels, expected)
        assert clusters(view, *passes) is labels
    few = view._replace(xyz=view.xyz[:100], pixels=view.pixels[:100])
    assert len(clusters(few, *alone)) == 100
