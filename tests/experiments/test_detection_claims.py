from itertools import product
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from kilnflight.experiments import detection, detection_claims
from kilnflight.project import claims


def cloud_attempts():
    """Return a frame of two subsets with every published setting; ten particles of each class."""
    rows = [
        {
            "family": family,
            "row": row,
            "subset": subset,
            "tp": 20,
            "fp": 50 - 2 * row,
            "fn": 10 + row,
        }
        for family, table in detection_claims.TABLES.items()
        for subset, row in product(("V1", "V4"), claims.published(table).index)
    ]
    table = pd.DataFrame(rows).assign(seconds=0.1)
    counts = table[["tp", "fp", "fn"]]
    table = table.join(counts.add_suffix("_pixels")).join(counts.add_suffix("_near"))
    for label, tp in ((2, 10), (3, 6), (4, 4)):
        table[f"tp_{label}"], table[f"fn_{label}"] = tp, 10 - tp
    return table


def test_the_total_of_a_clusterer_stands_beside_the_publication():
    printed = claims.published("table_5.8")
    table = detection_claims.cluster_table(cloud_attempts(), "dbscan")
    assert list(table.columns[:3]) == ["minPts", "epsilon_mm", "subset"]
    total = detection_claims.cluster_totals({"dbscan": table})["dbscan"]
    assert total["f1_published"].tolist() == printed["f1"].tolist()
    assert total["epsilon_mm"].tolist() == printed["epsilon_mm"].tolist()
    assert total["tp"].unique() == 40
    assert table.loc[table["subset"] != "Total", "f1_published"].isna().all()


def counts_of(subsets, methods):
    """Return two true positives of three particles for each method, as `detection.run` would."""
    table = pd.DataFrame({"method": list(methods), "tp": 2, "fp": 1, "fn": 1, "seconds": 0.1})
    counts = table[["tp", "fp", "fn"]]
    table = table.join(counts.add_suffix("_pixels")).join(counts.add_suffix("_near"))
    return pd.concat([table.assign(subset=name) for name in subsets], ignore_index=True)


def a_subset(name):
    recording = SimpleNamespace(attributes=SimpleNamespace(roi=f"roi of {name}"))
    return detection.Subset(name, recording, tuple(range(75, 85)), pd.DataFrame(), dict.get)


def test_one_threshold_at_a_time_is_timed_on_every_fifth_frame(monkeypatch):
    frames = []

    def run(subsets, methods):
        frames.extend(subset.frames for subset in subsets)
        return counts_of(["V1"], methods)

    monkeypatch.setattr(detection_claims, "run", run)
    times = detection_claims.time_thresholds([a_subset("V1")], "full")
    assert frames == [(75, 80)]
    assert set(range(400, 1001, 100)) | {100} <= set(times["threshold"])


def test_times_are_medians_beside_the_published():
    times = pd.DataFrame({"subset": "V1", "threshold": [400, 400, 400, 100]})
    times["seconds"] = [0.1, 0.3, 0.9, 0.5]
    table = detection_claims.time_table(times).set_index("threshold")
    assert table.loc[400, ["computation_time_s", "measured_s"]].tolist() == [6.609, 0.3]
    assert table["measured_s"].drop(400).isna().all()
    attempts = pd.DataFrame({"method": ["SIFT", "SIFT", "8 bits", "Otsu"], "subset": "V1"})
    attempts = attempts.assign(threshold=[400, 100, 400, 0], seconds=np.nan)
    attempts["chosen"] = attempts["threshold"] == 400
    sift = detection_claims.chosen_sift(attempts, times)
    assert sift[["method", "threshold", "seconds"]].to_numpy().tolist() == [["SIFT", 400, 0.3]]


def test_each_subset_has_its_threshold(monkeypatch):
    monkeypatch.setattr(detection_claims, "table_5_11_methods", lambda *values: {values: None})
    monkeypatch.setattr(
        detection_claims, "run", lambda subsets, methods: counts_of([subsets[0].name], methods)
    )
    thresholds = pd.Series({"V2": 400, "V1": 566})
    table = detection_claims.compare_methods([a_subset("V1"), a_subset("V2")], thresholds)
    assert table["subset"].tolist() == ["V1", "V2"]
    assert table["method"].tolist() == [(566.0, "roi of V1"), (400.0, "roi of V2")]


def test_clouds_alone_are_left_out_where_the_picture_alone_changes(monkeypatch):
    names = ("2D-OTSU", "3D-QCC Clustering", "Combi OTSU+QCC")
    monkeypatch.setattr(
        detection_claims, "table_5_11_methods", lambda *_: dict.fromkeys(names, None)
    )
    monkeypatch.setattr(detection_claims, "run", lambda _, methods: counts_of(["V1"], methods))
    table = detection_claims.compare_methods([a_subset("V1")], pd.Series({"V1": 400}), False)
    assert table["method"].tolist() == ["2D-OTSU", "Combi OTSU+QCC"]


def test_f1_stands_beside_that_of_the_published_counts():
    table = counts_of(["V1"], ["Combi SIFT+DBSCAN", "mine"]).assign(frame=0)
    f1 = detection_claims.f1_beside_published(table, 0)
    assert f1["f1"].tolist() == [2 / 3, 2 / 3]
    assert f1["f1_published"].tolist() == pytest.approx([0.9017, np.nan], nan_ok=True)
    recomputed = 2 * 3784 / (2 * 3784 + 222 + 603)
    assert f1["f1_published_recomputed"].tolist() == pytest.approx(
        [recomputed, np.nan], nan_ok=True
    )


def test_recall_has_a_column_for_each_class():
    table = counts_of(["V1", "V2"], ["b", "a"])
    for label, tp in ((2, 9), (3, 6), (4, 3)):
        table[f"tp_{label}"], table[f"fn_{label}"] = tp, 12 - tp
    recall = detection_claims.recall_by_class(table)
    assert list(recall) == ["method", "burning_in_air", "non_burning_in_air", "burning_on_wall"]
    assert recall.to_numpy().tolist() == [["b", 0.75, 0.5, 0.25], ["a", 0.75, 0.5, 0.25]]
