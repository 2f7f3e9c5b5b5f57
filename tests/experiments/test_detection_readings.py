from types import SimpleNamespace

import pandas as pd
import pytest

from kilnflight.background import Median, StopsAtZero, TwoFrame
from kilnflight.checks import InputError
from kilnflight.experiments import detection, detection_readings
from kilnflight.project import claims


def a_subset(background):
    return detection.Subset("V1", SimpleNamespace(), (75,), pd.DataFrame(), dict.get, background)


def test_another_background_keeps_no_view_of_the_first():
    subset = a_subset(Median(window=20))._replace(cache={75: None})
    (other,) = detection_readings.stopping_at_zero([subset])
    assert other.background == StopsAtZero(Median(window=20))
    assert other.cache == {}
    assert other.frames == subset.frames
    with pytest.raises(InputError, match="cannot stop at zero"):
        detection_readings.stopping_at_zero([a_subset(TwoFrame())])


def test_counts_of_the_diameter_take_the_place_of_the_others():
    names = ("tp", "fp", "fn", "tp_3", "fn_3")
    table = pd.DataFrame({name: [9] for name in names}).assign(subset="V1", tp_pixels=8)
    table = table.assign(**{f"{name}_near": k for k, name in enumerate(names)})
    near = detection_readings.as_diameter(table)
    assert near[list(names)].iloc[0].tolist() == [0, 1, 2, 3, 4]
    assert near[["subset", "tp_pixels"]].iloc[0].tolist() == ["V1", 8]
    assert table["tp"].tolist() == [9]


def test_a_verdict_says_its_reading_and_what_the_other_gives():
    held = [claims.judge("bg-4", 0.005, note="a frame"), claims.judge("bg-3", 0.005)]
    other = [claims.judge("bg-4", 0.3, because="twin")]
    both = detection_readings.beside(held, other, "this", "that")
    assert [verdict.verdict for verdict in both] == [claims.REPRODUCED] * 2
    assert both[0].reason == "a frame; this is with this; with that it is not reproduced (0.3)"
    assert both[1] == held[1]
    (same,) = detection_readings.beside(held[:1], held, "this", "that")
    assert same.reason == "a frame; this is with this; with that it is the same"
    failed = [claims.with_cause(other[0])]  # a choice that no work prints decides
    (choice,) = detection_readings.beside(failed, held[:1], "this", "that")
    assert (choice.because, claims.JUDGED in choice.reason) == ("method", False)
    (twin,) = detection_readings.beside(failed, other, "this", "that")
    assert (twin.because, claims.JUDGED in twin.reason) == ("twin", True)
    time = [claims.undecidable("sift-4", "a time of our own", because="method")]
    assert detection_readings.beside(time, time, "this", "that") == time


def test_readings_of_dilations_and_sizes_stand_beside_the_best_published_f1(monkeypatch):
    def counted(subsets, methods):
        table = pd.DataFrame({"method": list(methods), "tp": 2, "fp": 1, "fn": 1, "seconds": 0.1})
        counts = table[["tp", "fp", "fn"]]
        table = table.join(counts.add_suffix("_pixels")).join(counts.add_suffix("_near"))
        return pd.concat([table.assign(subset=name) for name in subsets], ignore_index=True)

    monkeypatch.setattr(detection_readings, "run", counted)
    table = detection_readings.morphology_readings(["V1", "V2"])
    ends = ["none", "once (this work)", "twice", "until unchanged"]
    assert table["dilations"].tolist() == 2 * ends
    assert table["size_rule"].tolist() == 4 * [False] + 4 * [True]
    assert table["tp"].tolist() == [4] * 8
    assert table["f1_published"].tolist() == [claims.published("table_5.9")["f1"].max()] * 8


def test_the_agreed_columns_come_first_and_so_do_absolute_differences():
    readings = [detection_readings.STOPS, detection_readings.ABSOLUTE, detection_readings.STOPS]
    table = pd.DataFrame({"model": list("abc"), "reading": readings, "tp": [1, 2, 3]})
    ordered = detection_readings.reading_last(table)
    assert list(ordered) == ["model", "tp", "reading"]
    assert ordered["model"].tolist() == ["b", "a", "c"]
