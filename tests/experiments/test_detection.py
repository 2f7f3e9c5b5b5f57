import numpy as np
import pytest

from kilnflight import background, kiln
from kilnflight.detection import DoG
from kilnflight.detection.combination import Combination
from kilnflight.detection.wall import Cylinder
from kilnflight.experiments import detection, detection_tables
from kilnflight.twin import truth

MEDIAN = background.Median(window=20)


@pytest.fixture(scope="module")
def subset(kept_scene):
    twin, frames = kept_scene("V3@small"), (75, 76)
    instances = {t: truth.instances(twin, t) for t in frames}
    marked = truth.marked(twin, frames)
    return detection.Subset("V3", twin, frames, marked, instances.get, MEDIAN, {})


def test_a_perfect_method_has_full_marks_and_an_empty_one_none(subset):
    known = {subset.recording.gray(t).tobytes(): t for t in subset.frames}

    def perfect(view):
        here = subset.particles["frame"] == known[view.gray.tobytes()]
        return subset.particles.loc[here, ["row", "col"]].to_numpy()

    methods = {"all": perfect, "none": lambda view: np.empty((0, 2))}
    table = detection.run([subset], methods)
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


def test_45_px_as_a_diameter_pair_what_is_22_px_apart(subset):
    """Section 3.3 calls the threshold a diameter; Eq. 3.4 compares it with a distance."""
    middle = np.array(subset.recording.attributes.size) / 2
    here = subset.particles[subset.particles["frame"] == 75]
    off = np.hypot(here["row"] - middle[0], here["col"] - middle[1])
    alone = subset._replace(frames=(75,), particles=here.loc[[off.idxmin()]])
    row, col = alone.particles.iloc[0][["row", "col"]]
    methods = {gap: lambda _, gap=gap: np.array([[row + gap, col]]) for gap in (22, 30, 46)}
    table = detection.run([alone], methods)
    assert table["tp"].tolist() == [1, 1, 0]
    assert table["tp_near"].tolist() == [1, 0, 0]
    assert table["fn_near"].tolist() == [0, 1, 1]


def test_positions_are_means_of_the_points_in_the_pixels(subset):
    subset = subset._replace(frames=(75,))
    wall = Cylinder((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 700.0)
    ((t, view),) = kiln.views(subset.recording, [75], MEDIAN)
    image = subset.instances(t)
    marked, detected = detection.positions([subset], {"V3": Combination(DoG(1500.0))}, wall)
    places = marked[["x", "y", "z"]].to_numpy()
    for particle, place in zip(marked["particle"], places, strict=True):
        points = view.xyz[image[view.pixels[:, 0], view.pixels[:, 1]] == particle]
        mean = points.mean(axis=0) if len(points) else np.full(3, np.nan)
        np.testing.assert_allclose(place, mean)
    assert marked["z"].notna().any()
    for table in (marked, detected):
        np.testing.assert_allclose(table["distance_mm"], np.hypot(table["x"], table["y"]))
