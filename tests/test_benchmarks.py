"""The benchmarks run: their peers and definitions still give what the package gives.

No time is asserted. The quick ones run whole, once; of the others what broke before is run on
little input, and all are imported.
"""

import importlib
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from tests.definitions import clusters

from kilnflight.detection import DBSCAN, MorphologicalClustering, QuasiClusterCenters

FOLDER = Path(__file__).resolve().parents[1] / "benchmarks"
MODULES = sorted(path.stem for path in FOLDER.glob("bench_*.py"))
QUICK = ("jpda", "regression", "tracklets")


@pytest.fixture
def folder(monkeypatch):
    """Make the benchmarks' folder importable, and every comparison run once."""
    monkeypatch.syspath_prepend(str(FOLDER))
    measure = importlib.import_module("measure")

    def once(what, ours, peer, repeats=1):
        return compare(what, ours, peer, 1)

    compare = measure.compare
    monkeypatch.setattr(measure, "compare", once)
    return monkeypatch


def bench(name):
    """Return a benchmark, made anew so that it compares once."""
    module = importlib.import_module(name)
    return importlib.reload(module)


@pytest.mark.parametrize("name", MODULES)
def test_every_benchmark_can_be_imported(folder, name):
    assert callable(bench(name).rows)


@pytest.mark.parametrize("name", QUICK)
def test_a_quick_benchmark_finds_its_peer_equal(folder, name):
    rows = bench(f"bench_{name}").rows()
    assert rows
    assert all(row.ours_s > 0 and row.peer_s > 0 for row in rows)


def test_the_definitions_of_clusters_are_those_of_the_package(folder):
    module = bench("bench_clustering")
    wall, quasi = module.surface(4000), QuasiClusterCenters(k=20)
    points = np.concatenate(
        [wall, np.add(wall, (0.0, 400.0, 0.0))]
    )  # and another one in front of it
    for ours, plain in (
        (DBSCAN(15.0, 10), partial(module.plain_dbscan, 15.0)),
        (MorphologicalClustering(40), partial(clusters.morphology, grid=40)),
        (quasi, partial(clusters.quasi_centers, k=quasi.k, alpha=quasi.alpha)),
    ):
        row = module.against("step", ours, plain, "definition", points)
        assert row.size == len(points)
        assert len(np.unique(ours(points))) > 1
