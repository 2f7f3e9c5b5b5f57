import pandas as pd
import pytest

from kilnflight.checks import InputError
from kilnflight.scores import rates, score_detections, total_in_air


def test_who_flies_is_counted_as_in_tables_5_13_and_5_14():
    truth = [(0, 0), (0, 100), (100, 0), (100, 100), (200, 200)]
    flies = [True, True, True, False, False]
    itself = score_detections(truth, truth)
    told = [True, False, True, True, False]
    assert total_in_air([itself], [flies], [told]).loc[0, ["tp", "fp", "fn"]].tolist() == [2, 1, 1]
    found = score_detections(truth, [(0, 1), (0, 101), (101, 100), (300, 300)])
    table = total_in_air([found, itself], [flies, flies], [[True, False, True, True], told])
    # Not detected or told to be on the wall: two FN; on the wall and nothing at all: two FP.
    assert table.loc[0, ["tp", "fp", "fn"]].tolist() == [1 + 2, 2 + 1, 2 + 1]
    assert total_in_air([], [], []).loc[0, "tp"] == 0


def test_frames_add_up_and_nothing_adds_nothing():
    frames = [
        score_detections([(0, 0), (50, 50)], [(1, 1)]),
        score_detections([(9, 9)], [(9, 9), (99, 99)]),
    ]
    table = total_in_air(frames, [[True, True], [True]], [[True], [True, True]])
    assert table.columns.tolist() == ["tp", "fp", "fn", "precision", "recall", "f1"]
    assert table.loc[0, ["tp", "fp", "fn"]].tolist() == [2, 1, 1]
    pd.testing.assert_frame_equal(table[["precision", "recall", "f1"]], rates(2, 1, 1))
    assert total_in_air([], [], []).loc[0].tolist() == [0, 0, 0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: total_in_air([], [[True]], []), "0 scores, but 1 and 0 frames"),
        (lambda: total_in_air([score_detections([], [])], [[]], [[True]]), "detected of frame 0"),
    ],
)
def test_what_cannot_be_summed_is_told(call, message):
    with pytest.raises(InputError, match=message):
        call()
