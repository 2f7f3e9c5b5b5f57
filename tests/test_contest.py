import numpy as np
import pandas as pd
import pytest

from kilnflight import contest
from kilnflight.checks import InputError
from kilnflight.pursuit import Window


@pytest.fixture
def window():
    frame = np.tile(np.arange(10), 3)
    path = {"frame": frame, "row": frame * 5.0, "col": np.repeat([0.0, 200.0, 400.0], 10)}
    truth = pd.DataFrame(path).assign(particle=np.repeat([0, 1, 2], 10))
    return Window("wood chip", "W1", range(10), truth.drop(columns="particle"), truth, None)


def right(table):
    return table.assign(particle=(table["col"] // 200).astype(int))


def alone(table):
    return table.assign(particle=np.arange(len(table)))


def refuses(table):
    raise InputError("too dense.")


def test_the_best_setting_of_each_tracker_is_chosen(window):
    trackers = {"one": {"bad": alone, "good": right, "no": refuses}, "other": {"bad": alone}}
    tried = contest.best_setting([window], trackers)
    assert tried["chosen"].tolist() == [False, True, False, True]
    assert tried["beta"].iloc[1] == pytest.approx(1)
    assert np.isnan(tried["beta"].iloc[2])
    assert tried["note"].tolist() == ["", "", "not run: too dense.", ""]
    assert contest.chosen(tried, trackers) == {"one": right, "other": alone}


def test_who_refuses_a_window_has_rows_without_measures(window):
    scores = contest.scored([window], {"one": right, "other": refuses})
    assert scores["postprocessing"].tolist() == ["without", "with"] * 2
    assert scores["beta"].isna().tolist() == [False, False, True, True]


def test_nothing_to_choose_from_is_an_error(window):
    with pytest.raises(InputError, match="no windows"):
        contest.best_setting([], {"one": {"good": right}})
    with pytest.raises(InputError, match="refuses every setting"):
        contest.best_setting([window], {"one": {"no": refuses}})
