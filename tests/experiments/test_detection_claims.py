from itertools import product
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from kilnflight.experiments import detection, detection_claims
from kilnflight.project import claims

SUBSETS = ("V1", "V2", "V3", "V4", "V5")


def outcomes(verdicts):
    return {verdict.id: verdict.verdict == claims.REPRODUCED for verdict in verdicts}


def by_subset(**f1):
    return pd.DataFrame({"subset": list(f1), "precision": 0.95, "f1": list(f1.values())})


def recall_table(**unlit):
    rows = [
        {"method": method, "subset": subset, "label": label, "recall": share}
        for method, shares in unlit.items()
        for subset, third in zip(SUBSETS, shares, strict=True)
        for label, share in ((2, 0.99), (3, third), (4, 0.9))
    ]
    return pd.DataFrame(rows)


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
    table = table.join(table[["tp", "fp", "fn"]].add_suffix("_pixels"))
    for label, tp in ((2, 10), (3, 6), (4, 4)):
        table[f"tp_{label}"], table[f"fn_{label}"] = tp, 10 - tp
    return table


def test_backgrounds_are_ranked_by_f1():
    f1 = pd.Series({"Median": 0.9, "Mean": 0.895, "Adaptive": 0.5, "ThreeFrame": 0.4})
    f1["TwoFrame"] = 0.3
    verdicts = detection_claims.background_verdicts(
        f1, f1 * 0 + 0.2, {"Mean": 5.0, "Median": 6.0}, "a frame"
    )
    assert outcomes(verdicts) == {f"bg-{n}": n in (1, 2, 3, 5) for n in range(1, 7)}
    assert verdicts[0].reason == "a frame; first in 20% of the draws"


def test_otsu_agrees_only_as_far_as_it_was_fitted():
    otsu = by_subset(V1=0.9, V2=0.9, V3=0.9, V4=0.9, V5=0.6, Total=0.85)
    sift = by_subset(V1=0.95, V2=0.9, V3=0.9, V4=0.9, V5=0.7, Total=0.9)
    recall = recall_table(Otsu=(0.2, 0.2, 0.2, 0.1, 0.3), SIFT=(0.4, 0.5, 0.5, 0.5, 0.8))
    times = pd.DataFrame({"threshold": [400, 1000], "measured_s": [2.0, 1.0]})
    verdicts = detection_claims.picture_verdicts(otsu, sift, recall, times, "a frame")
    missed = {"otsu-1", "otsu-4", "sift-2"}
    assert {name for name, reproduced in outcomes(verdicts).items() if not reproduced} == missed
    undecided = {verdict.id for verdict in verdicts if verdict.verdict == claims.NOT_DECIDABLE}
    assert undecided == {"otsu-1", "otsu-4"}
    assert "V5 0.80 in 0.35..0.75: NO" in {v.id: v.measured for v in verdicts}["sift-2"]


def test_the_total_of_a_clusterer_stands_beside_the_publication():
    printed = claims.published("table_5.8")
    table = detection_claims.cluster_table(cloud_attempts(), "dbscan")
    assert list(table.columns[:3]) == ["minPts", "epsilon_mm", "subset"]
    total = detection_claims.cluster_totals({"dbscan": table})["dbscan"]
    assert total["f1_published"].tolist() == printed["f1"].tolist()
    assert total["epsilon_mm"].tolist() == printed["epsilon_mm"].tolist()
    assert total["tp"].unique() == 40
    assert table.loc[table["subset"] != "Total", "f1_published"].isna().all()


def test_clusterers_that_are_alike_reproduce_no_difference():
    attempts = cloud_attempts()
    tables = {
        family: detection_claims.cluster_table(attempts, family)
        for family in detection_claims.TABLES
    }
    verdicts = detection_claims.cluster_verdicts(tables, attempts, "a frame")
    reproduced = outcomes(verdicts)
    assert reproduced["cluster-1"]  # FP falls and FN rises with the row
    assert not reproduced["cluster-4"]
    assert reproduced["cluster-7"]  # all of class 2
    assert reproduced["cluster-8"]  # 0.4 of class 4
    assert {v.id: v.measured for v in verdicts}["cluster-8"] == "V1 0.4, V4 0.4"


@pytest.mark.parametrize(("best", "gain"), [("SIFT+DBSCAN", True), ("OTSU+MO", False)])
def test_combinations_are_held_against_their_own_detector(best, gain):
    f1 = {"2D-OTSU": 0.8, "2D-SIFT": 0.85, "3D-DBSCAN Clustering": 0.6}
    pairs = [f"{d}+{c}" for c, d in product(("DBSCAN", "MO", "QCC"), ("OTSU", "SIFT"))]
    f1 |= {f"Combi {pair}": 0.95 if pair == best else 0.86 if gain else 0.84 for pair in pairs}
    total = pd.DataFrame({"f1": f1}).assign(precision=lambda t: t["f1"], recall=lambda t: t["f1"])
    verdicts = detection_claims.combination_verdicts(total, total["f1"] * 0 + 1, "a frame")
    expected = {"cluster-6": True, "combi-1": gain, "combi-2": gain, "combi-3": False}
    assert outcomes(verdicts) == {**expected, "combi-4": gain}


def test_a_method_that_is_better_on_every_frame_is_first_in_every_draw():
    frames = pd.DataFrame({"subset": ["V1"] * 3 + ["V2"] * 3, "frame": [0, 1, 2] * 2})
    good = frames.assign(method="good", tp=9, fp=1, fn=[1, 2, 1, 3, 1, 1])
    poor = frames.assign(method="poor", tp=5, fp=5, fn=5)
    table = pd.concat([good, poor], ignore_index=True).assign(seconds=0.1)
    table = table.join(table[["tp", "fp", "fn"]].add_suffix("_pixels"))
    f1, first = detection.f1_with_intervals(table, pd.Series({"good": 0.7}), 0)
    assert first.to_dict() == {"good": 1.0, "poor": 0.0}
    assert (f1["f1_low"] <= f1["f1"]).all()
    assert (f1["f1"] <= f1["f1_high"]).all()
    assert f1["f1_published"].tolist() == pytest.approx([0.7, np.nan], nan_ok=True)


def counts_of(subsets, methods):
    """Return two true positives of three particles for each method, as `detection.run` would."""
    table = pd.DataFrame({"method": list(methods), "tp": 2, "fp": 1, "fn": 1, "seconds": 0.1})
    table = table.join(table[["tp", "fp", "fn"]].add_suffix("_pixels"))
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


def test_readings_of_dilations_and_sizes_stand_beside_the_best_published_f1(monkeypatch):
    monkeypatch.setattr(detection_claims, "run", counts_of)
    table = detection_claims.morphology_readings(["V1", "V2"])
    ends = ["none", "once (this work)", "twice", "until unchanged"]
    assert table["dilations"].tolist() == 2 * ends
    assert table["size_rule"].tolist() == 4 * [False] + 4 * [True]
    assert table["tp"].tolist() == [4] * 8
    assert table["f1_published"].tolist() == [claims.published("table_5.9")["f1"].max()] * 8


def test_each_subset_has_its_threshold(monkeypatch):
    monkeypatch.setattr(detection_claims, "table_5_11_methods", lambda *values: {values: None})
    monkeypatch.setattr(
        detection_claims, "run", lambda subsets, methods: counts_of([subsets[0].name], methods)
    )
    thresholds = pd.Series({"V2": 400, "V1": 566})
    table = detection_claims.compare_methods([a_subset("V1"), a_subset("V2")], thresholds)
    assert table["subset"].tolist() == ["V1", "V2"]
    assert table["method"].tolist() == [(566.0, "roi of V1"), (400.0, "roi of V2")]


def test_f1_stands_beside_that_of_the_published_counts():
    table = counts_of(["V1"], ["Combi SIFT+DBSCAN", "mine"]).assign(frame=0)
    f1, first = detection_claims.f1_beside_published(table, 0)
    assert f1["f1"].tolist() == [2 / 3, 2 / 3]
    assert f1["f1_published"].tolist() == pytest.approx([0.9017, np.nan], nan_ok=True)
    recomputed = 2 * 3784 / (2 * 3784 + 222 + 603)
    assert f1["f1_published_recomputed"].tolist() == pytest.approx(
        [recomputed, np.nan], nan_ok=True
    )
    assert first.sum() == 1


def test_recall_has_a_column_for_each_class():
    table = counts_of(["V1", "V2"], ["b", "a"])
    for label, tp in ((2, 9), (3, 6), (4, 3)):
        table[f"tp_{label}"], table[f"fn_{label}"] = tp, 12 - tp
    recall = detection_claims.recall_by_class(table)
    assert list(recall) == ["method", "burning_in_air", "non_burning_in_air", "burning_on_wall"]
    assert recall.to_numpy().tolist() == [["b", 0.75, 0.5, 0.25], ["a", 0.75, 0.5, 0.25]]
