from itertools import product

import numpy as np
import pandas as pd
import pytest

from kilnflight.detection.wall import Cylinder
from kilnflight.experiments import detection, detection_claims
from kilnflight.project import claims
from kilnflight.scores import rates
from kilnflight.twin.camera import Geometry

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
    seconds = pd.Series({400: 2.0, 1000: 1.0})
    verdicts = detection_claims.picture_verdicts(otsu, sift, recall, seconds, "a frame")
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


def test_the_wall_is_judged_by_the_crossing_and_forty_millimetres():
    geometry = Geometry()
    axis = tuple(geometry.axes[0])
    fits = {name: Cylinder(tuple(geometry.origin_mm), axis, 710.0) for name in ("V1", "V2")}
    cylinders = detection_claims.cylinder_table(fits, geometry)
    assert cylinders["direction_off_deg"].tolist() == pytest.approx([0, 0], abs=1e-5)
    names = ["crossing_plus_40", "crossing", "printed_800"]
    counts = pd.DataFrame({"threshold": names, "tp": [95, 90, 99], "fp": 5, "fn": [5, 10, 1]})
    tables = []
    for misses in (0, 10):
        table = counts.assign(subset="Total", fn=counts["fn"] + misses)
        tables.append(table.join(rates(table["tp"], table["fp"], table["fn"])))
    verdicts = detection_claims.wall_verdicts(cylinders, 720.0, *tables)
    assert all(outcomes(verdicts).values())
    assert verdicts[2].reason == "crossing + 40 mm = 760 mm; with 800 mm F1 0.971"


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
