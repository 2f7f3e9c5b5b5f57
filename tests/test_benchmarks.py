"""The benchmarks run: their peers and definitions still give what the package gives.

No time is asserted. The quick ones run whole, once, that of the clusterers on little
input, and all are imported.
"""

import importlib
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[1] / "benchmarks"
QUICK = ("bench_jpda", "bench_regression", "bench_tracklets", "bench_clustering")


@pytest.mark.parametrize(
    "name", sorted(path.stem for path in FOLDER.glob("bench_*.py"))
)
def test_a_benchmark_can_be_imported_and_a_quick_one_finds_its_peer_equal(
    name, monkeypatch
):
    monkeypatch.syspath_prepend(str(FOLDER))
    measure = importlib.import_module("measure")
    monkeypatch.setattr(measure, "TURN_S", 0.0)
    compare = measure.compare
    monkeypatch.setattr(
        measure, "compare", lambda *given, **kw: compare(*given, **kw, repeats=1)
    )
    module = importlib.reload(importlib.import_module(name))
    if name == "bench_clustering":
        monkeypatch.setattr(module, "cloud", lambda: module.surface(1000))
    rows = module.rows() if name in QUICK else []
    assert all(row.lowest == row.ratio == row.highest > 0 for row in rows)
    assert bool(rows) == (name in QUICK)
