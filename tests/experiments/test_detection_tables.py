from itertools import product

import numpy as np
import pandas as pd
import pytest

from kilnflight.checks import InputError
from kilnflight.experiments import detection, detection_tables
from kilnflight.project import claims
from kilnflight.twin.camera import Geometry


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
        for family, table in detection.TABLES.items()
        for subset, row in product(("V1", "V4"), claims.published(table).index)
    ]
    table = pd.DataFrame(rows).assign(seconds=0.1)
    return table.join(table[["tp", "fp", "fn"]].add_suffix("_pixels"))


def test_the_total_of_a_clusterer_stands_beside_the_publication():
    printed = claims.published("table_5.8")
    table = detection_tables.cluster_table(cloud_attempts(), "dbscan")
    assert list(table.columns[:3]) == ["minPts", "epsilon_mm", "subset"]
    total = table[table["subset"] == "Total"]
    assert total["f1_published"].tolist() == printed["f1"].tolist()
    assert total["epsilon_mm"].tolist() == printed["epsilon_mm"].tolist()
    assert total["tp"].unique() == 40
    assert table.loc[table["subset"] != "Total", "f1_published"].isna().all()


def attempts(**true_positives):
    """Return ten particles per frame; a method detects so many of them, by frame."""
    rows = [
        {"subset": subset, "frame": t, "method": method, "tp": tp, "fp": 0, "fn": 10 - tp}
        for method, detected in true_positives.items()
        for subset in ("V1", "V2")
        for t, tp in enumerate(detected)
    ]
    table = pd.DataFrame(rows).assign(seconds=0.1)
    return table.join(table[["tp", "fp", "fn"]].add_suffix("_pixels"))


def test_draws_are_paired_and_of_frames_that_are_all_alike_do_not_vary():
    table = attempts(one=(5, 5, 5), other=(8, 8, 8))
    draws = detection_tables.resampled_rates(table, 0, draws=50)
    assert {name: rate.shape for name, rate in draws.items()} == dict.fromkeys(
        ("precision", "recall", "f1"), (50, 2)
    )
    assert draws["f1"]["one"].to_numpy() == pytest.approx(2 * 5 / 15)
    assert draws["recall"]["other"].to_numpy() == pytest.approx(0.8)
    assert (draws["precision"] == 1).all(axis=None)
    varied = detection_tables.resampled_rates(attempts(one=(0, 4, 9), other=(1, 5, 10)), 3)
    apart = varied["recall"]["other"] - varied["recall"]["one"]
    np.testing.assert_allclose(apart, 0.1)  # the same frames for both
    assert varied["recall"]["one"].nunique() > 5


def test_one_frame_per_subset_gives_no_interval():
    table = attempts(one=(5,), other=(8,))
    assert len(detection_tables.resampled_rates(table, 0)["f1"]) == 0
    f1 = detection_tables.f1_with_intervals(table, pd.Series(dtype=float), 0)
    assert f1[["f1_low", "f1_high"]].isna().all(axis=None)


def test_the_interval_holds_the_f1():
    table = attempts(good=(9, 8, 7), poor=(5, 5, 5))
    f1 = detection_tables.f1_with_intervals(table, pd.Series({"good": 0.7}), 0)
    assert f1["f1"].between(f1["f1_low"], f1["f1_high"]).all()
    assert f1.loc["good", "f1_low"] < f1.loc["good", "f1"] < f1.loc["good", "f1_high"]
    assert f1["f1_published"].tolist() == pytest.approx([0.7, np.nan], nan_ok=True)


@pytest.mark.parametrize(("name", "f1"), [("table_5.5", 0.6432), ("table_5.6", 0.7827)])
def test_the_published_f1_stands_beside_each_subset(name, f1):
    table = pd.DataFrame({"subset": ["V5", "mine", "Total"], "f1": [0.6, 0.7, 0.8]})
    beside = detection_tables.beside_published(table, name)
    pd.testing.assert_frame_equal(beside[["subset", "f1"]], table)
    total = claims.published(name)["f1"].iloc[-1]
    assert beside["f1_published"].tolist() == pytest.approx([f1, np.nan, total], nan_ok=True)


def test_particles_are_classified_by_their_distance_from_the_axis():
    marked = pd.DataFrame({"frame": 0, "row": [10.0, 200.0, 400.0], "col": 10.0, "subset": "V1"})
    marked = marked.assign(label=[2, 3, 4], distance_mm=[300.0, 790.0, 760.0])
    thresholds = {"low": 750.0, "high": 800.0}
    table = detection_tables.classification_table(marked, marked, thresholds, None)
    counts = table.set_index(["threshold", "subset"])[["tp", "fp", "fn"]]
    assert counts.loc[("low", "V1")].tolist() == [1, 0, 1]
    assert counts.loc[("high", "Total")].tolist() == [2, 1, 0]
    more = pd.concat([marked, marked.assign(frame=1), marked.assign(subset="V2")])
    table = detection_tables.classification_table(more, more, thresholds, None)
    counts = table.set_index(["threshold", "subset"])
    assert counts.loc[("low", "V1"), ["tp", "fp", "fn"]].tolist() == [2, 0, 2]
    assert counts.loc[("high", "V2"), ["tp", "fp", "fn"]].tolist() == [2, 1, 0]
    assert counts.loc[("high", "Total"), ["tp", "fp", "fn"]].tolist() == [6, 3, 0]
    assert counts.loc[("high", "Total"), ["precision", "recall"]].tolist() == [2 / 3, 1]


def by_subset(**true_positives):
    """Return ten particles per frame; a method detects so many of them, by subset."""
    rows = [
        {"subset": v, "frame": t, "method": m, "tp": tp[k], "fp": 0, "fn": 10 - tp[k]}
        for m, tp in true_positives.items()
        for k, v in enumerate(("V1", "V2", "V3"))
        for t in range(4)
    ]
    table = pd.DataFrame(rows).assign(seconds=0.1)
    return table.join(table[["tp", "fp", "fn"]].add_suffix("_pixels"))


def test_counts_by_subset_stand_above_their_total():
    table = by_subset(one=(5, 8, 2)).drop(columns="method").assign(threshold=100)
    rows = detection_tables.with_total(table, ["threshold", "subset"])
    assert rows["subset"].tolist() == ["V1", "V2", "V3", "Total"]
    assert rows["tp"].iloc[-1] == rows["tp"].iloc[:3].sum()


def test_all_published_rates_stand_beside_each_method():
    printed = claims.published("table_5.11")
    table = printed[["method", *detection_tables.RATES]].assign(reading="absolute")
    beside = detection_tables.beside_published(table, "table_5.11")
    for rate in detection_tables.RATES:
        assert beside[f"{rate}_published"].tolist() == beside[rate].tolist()


def test_a_wall_that_is_a_plane_has_no_cylinder():
    generator, geometry = np.random.default_rng(0), Geometry()
    angle, along = generator.uniform(0, np.pi, 500), generator.uniform(0, 3000, 500)
    bent = np.column_stack([700 * np.cos(angle), 700 * np.sin(angle), along])
    flat = np.column_stack([generator.uniform(-300, 300, 500), np.full(500, -100.0), along])
    first, table = detection_tables.cylinder_table({"bent": bent, "flat": flat}, 0, geometry)
    assert first.radius_mm == pytest.approx(700)
    assert table["subset"].tolist() == ["bent", "flat"]
    assert table[["radius_mm", "inliers", "rms_mm"]].isna().all(axis=1).tolist() == [False, True]
    assert (table["radius_published_mm"] == 772.1827).all()
    with pytest.raises(InputError, match="no cylinder"):
        detection_tables.cylinder_table({"flat": flat, "bent": bent}, 0, geometry)
