import numpy as np
import pandas as pd
import pytest

from kilnflight.checks import InputError
from kilnflight.experiments import detection_intervals as intervals


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
    draws = intervals.resampled_rates(table, 0, draws=50)
    assert {name: rate.shape for name, rate in draws.items()} == dict.fromkeys(
        ("precision", "recall", "f1"), (50, 2)
    )
    assert draws["f1"]["one"].to_numpy() == pytest.approx(2 * 5 / 15)
    assert draws["recall"]["other"].to_numpy() == pytest.approx(0.8)
    assert (draws["precision"] == 1).all(axis=None)
    with pytest.raises(InputError, match="lacks a frame"):
        intervals.resampled(table.iloc[1:], ["tp"], 0)


def test_the_same_frames_are_drawn_for_every_method():
    table = attempts(one=(0, 4, 9), other=(1, 5, 10))
    sums = intervals.resampled(table, ["tp"], 3)
    apart = sums[("V1", "tp", "other")] - sums[("V1", "tp", "one")]
    assert (apart == 3).all()
    assert sums[("V1", "tp", "one")].nunique() > 5
    again = intervals.resampled(table, ["tp"], 3)
    pd.testing.assert_frame_equal(sums, again)


def test_each_subset_has_its_own_draws():
    table = attempts(one=(2, 2, 2))
    table.loc[table["subset"] == "V2", ["tp", "tp_3", "fn", "fn_3"]] = [5, 5, 5, 5]
    f1, recall = intervals.subset_f1(table, "one", 0), intervals.subset_recall(table, "one", 3, 0)
    assert list(f1) == list(recall) == ["V1", "V2"]
    assert f1.iloc[0].tolist() == pytest.approx([2 * 2 / 12, 2 * 5 / 15])
    assert (recall == [0.2, 0.5]).all(axis=None)


def test_the_interval_holds_the_f1():
    table = attempts(good=(9, 8, 7), poor=(5, 5, 5))
    f1 = intervals.f1_with_intervals(table, pd.Series({"good": 0.7}), 0)
    assert f1["f1"].between(f1["f1_low"], f1["f1_high"]).all()
    assert f1.loc["good", "f1_low"] < f1.loc["good", "f1"] < f1.loc["good", "f1_high"]
    assert f1["f1_published"].tolist() == pytest.approx([0.7, np.nan], nan_ok=True)
