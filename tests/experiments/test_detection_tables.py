from itertools import product

import numpy as np
import pandas as pd
import pytest

from kilnflight.checks import InputError
from kilnflight.experiments import detection, detection_tables
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
        for family, table in detection.TABLES.items()
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
    table = detection_tables.cluster_table(cloud_attempts(), "dbscan")
    assert list(table.columns[:3]) == ["minPts", "epsilon_mm", "subset"]
    total = detection_tables.cluster_totals({"dbscan": table})["dbscan"]
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


def test_times_are_medians_beside_the_published():
    times = pd.DataFrame({"subset": "V1", "threshold": [400, 400, 400, 100]})
    times["seconds"] = [0.1, 0.3, 0.9, 0.5]
    table = detection_tables.time_table(times).set_index("threshold")
    assert table.loc[400, ["computation_time_s", "measured_s"]].tolist() == [6.609, 0.3]
    assert table["measured_s"].drop(400).isna().all()
    attempts = pd.DataFrame({"method": ["SIFT", "SIFT", "8 bits", "Otsu"], "subset": "V1"})
    attempts = attempts.assign(threshold=[400, 100, 400, 0], seconds=np.nan)
    attempts["chosen"] = attempts["threshold"] == 400
    sift = detection_tables.chosen_sift(attempts, times)
    assert sift[["method", "threshold", "seconds"]].to_numpy().tolist() == [["SIFT", 400, 0.3]]


def test_f1_stands_beside_that_of_the_published_counts():
    table = counts_of(["V1"], ["Combi SIFT+DBSCAN", "mine"]).assign(frame=0)
    f1 = detection_tables.f1_beside_published(table, 0)
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
    recall = detection_tables.recall_by_class(table)
    assert list(recall) == ["method", "burning_in_air", "non_burning_in_air", "burning_on_wall"]
    assert recall.to_numpy().tolist() == [["b", 0.75, 0.5, 0.25], ["a", 0.75, 0.5, 0.25]]


def attempts(**true_positives):
    """Return ten particles per frame; a method detects so many of them, by frame."""
    rows = [
        {"subset": subset, "frame": t, "method": method, "tp": tp, "fp": 0, "fn": 10 - tp}
        for method, detected in true_positives.items()
        for subset in ("V1", "V2")
        for t, tp in enumerate(detected)
    ]
    table = pd.DataFrame(rows).assign(seconds=0.1)
    counts = table[["tp", "fp", "fn"]]
    table["tp_3"], table["fn_3"] = table["tp"], table["fn"]
    return table.join(counts.add_suffix("_pixels")).join(counts.add_suffix("_near"))


def test_draws_are_paired_and_of_frames_that_are_all_alike_do_not_vary():
    table = attempts(one=(5, 5, 5), other=(8, 8, 8))
    draws = detection_tables.resampled_rates(table, 0, draws=50)
    assert {name: rate.shape for name, rate in draws.items()} == dict.fromkeys(
        ("precision", "recall", "f1"), (50, 2)
    )
    assert draws["f1"]["one"].to_numpy() == pytest.approx(2 * 5 / 15)
    assert draws["recall"]["other"].to_numpy() == pytest.approx(0.8)
    assert (draws["precision"] == 1).all(axis=None)
    with pytest.raises(InputError, match="lacks a frame"):
        detection_tables.resampled(table.iloc[1:], ["tp"], 0)


def test_the_same_frames_are_drawn_for_every_method():
    table = attempts(one=(0, 4, 9), other=(1, 5, 10))
    sums = detection_tables.resampled(table, ["tp"], 3)
    apart = sums[("V1", "tp", "other")] - sums[("V1", "tp", "one")]
    assert (apart == 3).all()
    assert sums[("V1", "tp", "one")].nunique() > 5
    again = detection_tables.resampled(table, ["tp"], 3)
    pd.testing.assert_frame_equal(sums, again)


def test_each_subset_has_its_own_draws():
    table = attempts(one=(2, 2, 2))
    table.loc[table["subset"] == "V2", ["tp", "tp_3", "fn", "fn_3"]] = [5, 5, 5, 5]
    tp, fp, fn = detection_tables.subset_draws(table, "one", ["tp", "fp", "fn_3"], 0)
    assert list(tp) == list(fn) == ["V1", "V2"]
    assert (tp == [6, 15]).all(axis=None)
    assert (fn == [24, 15]).all(axis=None)
    assert (fp == 0).all(axis=None)


def test_the_interval_holds_the_f1():
    table = attempts(good=(9, 8, 7), poor=(5, 5, 5))
    f1 = detection_tables.f1_with_intervals(table, pd.Series({"good": 0.7}), 0)
    assert f1["f1"].between(f1["f1_low"], f1["f1_high"]).all()
    assert f1.loc["good", "f1_low"] < f1.loc["good", "f1"] < f1.loc["good", "f1_high"]
    assert f1["f1_published"].tolist() == pytest.approx([0.7, np.nan], nan_ok=True)


def test_counts_of_the_diameter_take_the_place_of_the_others():
    names = ("tp", "fp", "fn", "tp_3", "fn_3")
    table = pd.DataFrame({name: [9] for name in names}).assign(subset="V1", tp_pixels=8)
    table = table.assign(**{f"{name}_near": k for k, name in enumerate(names)})
    near = detection_tables.as_diameter(table)
    assert near[list(names)].iloc[0].tolist() == [0, 1, 2, 3, 4]
    assert near[["subset", "tp_pixels"]].iloc[0].tolist() == ["V1", 8]
    assert table["tp"].tolist() == [9]


def test_the_agreed_columns_come_first_and_so_do_absolute_differences():
    readings = [detection_tables.STOPS, detection_tables.ABSOLUTE, detection_tables.STOPS]
    table = pd.DataFrame({"model": list("abc"), "reading": readings, "tp": [1, 2, 3]})
    ordered = detection_tables.reading_last(table)
    assert list(ordered) == ["model", "tp", "reading"]
    assert ordered["model"].tolist() == ["b", "a", "c"]


def test_kinds_that_spread_alike_cross_in_the_middle():
    placed = pd.DataFrame({"label": [2, 3, 2, 4, 4, 4]})
    placed["distance_mm"] = [450.0, 500.0, 550.0, 650.0, 700.0, 750.0]
    assert detection_tables.axis_thresholds(placed) == pytest.approx(
        {"crossing_plus_40": 640, "crossing": 600, "printed_800": 800, "all_in_air": 10_000}
    )


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
    counts = table[["tp", "fp", "fn"]]
    return table.join(counts.add_suffix("_pixels")).join(counts.add_suffix("_near"))


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
