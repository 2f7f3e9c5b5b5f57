from itertools import product

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kilnflight.checks import InputError
from kilnflight.experiments import other_trackers as peers
from kilnflight.experiments import tuning
from kilnflight.experiments.tracking import Window
from kilnflight.experiments.tracking_scores import measure_tracks
from kilnflight.experiments.tuning import Grid, Trials, all_grids
from kilnflight.project.parallel import Workers

LONG = tuple(map(float, range(10)))


def a_window(length=10):
    frame = np.tile(np.arange(length), 3)
    path = {"frame": frame, "row": frame * 5.0, "col": np.repeat([0.0, 200.0, 400.0], length)}
    truth = pd.DataFrame(path).assign(particle=np.repeat([0, 1, 2], length))
    detections = truth.drop(columns="particle")
    return Window("wood chip", "W1", range(length), detections, truth, None)


@pytest.fixture
def window():
    return a_window()


def right(table):
    return table.assign(particle=(table["col"] // 200).astype(int))


def alone(table):
    return table.assign(particle=np.arange(len(table)))


def refuses(table):
    raise InputError("too dense.")


def hill(*top, values=LONG, first=(0.0,)):
    """A tracker that cuts tracks the more, the farther its parameters are from the top."""

    def build(*setting):
        pieces = 1 + int(sum(abs(a - b) for a, b in zip(setting, top, strict=True)))
        return lambda table: right(table).assign(
            particle=lambda t: t["particle"] * 100 + np.minimum(t["frame"], pieces - 1)
        )

    names = [f"p{k}" for k in range(len(top))]
    return Grid(build, dict.fromkeys(names, values), dict.fromkeys(names, first))


def worth_in(window):
    """The mean beta of all tracks of a window, or why there is none."""

    def worth(tracker):
        try:
            return {**measure_tracks(window.truth, tracker(window.detections)), "note": ""}
        except InputError as error:
            return {"beta": np.nan, "note": f"not run: {error}"}

    return worth


def chosen_one(window, grid, trials=99):
    tried = tuning.search("one", grid, worth_in(window), trials)
    best = tried[tried["chosen"]]
    assert len(best) == 1
    return best.iloc[0], tried


def test_the_best_setting_is_chosen(window):
    choice = {0.0: alone, 1.0: right, 2.0: refuses}
    grid = Grid(choice.get, {"way": (0.0, 1.0, 2.0)}, {"way": (0.0, 1.0, 2.0)})
    tried = tuning.search("one", grid, worth_in(window), 3)
    assert tried["chosen"].tolist() == [False, True, False]
    assert tried["beta"].iloc[1] == pytest.approx(1)
    assert np.isnan(tried["beta"].iloc[2])
    assert tried["note"].tolist() == ["", "", "not run: too dense."]
    assert tuning.chosen_trackers(tried, {"one": grid}) == {"one": right}


@settings(deadline=None, max_examples=10)  # each climbs a dozen settings
@given(top=st.tuples(st.integers(1, 8), st.integers(1, 8)), first=st.sampled_from(LONG))
def test_the_climb_ends_inside_of_what_was_tried(top, first):
    grid = hill(*top, first=(first,))
    best, tried = chosen_one(a_window(20), grid)
    assert best["setting"] == f"p0 {top[0]}, p1 {top[1]}"
    assert (best["p0"], best["p1"]) == top
    assert (best["at_end"], best["untried"]) == ("", 0)
    around = {grid.text(setting) for setting in grid.neighbors(tuple(map(float, top)))}
    assert len(around) == 4
    assert around < set(tried["setting"])
    assert not tried["setting"].duplicated().any()


@pytest.mark.parametrize("trials", [1, 5, 12, 40])
def test_every_tracker_has_the_same_number_of_trials(trials):
    """However early the best one is found: the start may be the top, or far from it."""
    for first in ((2.0,), (9.0,)):
        best, tried = chosen_one(a_window(20), hill(2, 2, first=first), trials)
        assert len(tried) == trials
    assert best["untried"] == 0 or trials < 40


def test_neighbours_that_were_not_tried_are_counted(window):
    best, tried = chosen_one(window, hill(5, 5, first=(5.0,)), trials=3)
    assert len(tried) == 3
    assert best["untried"] == 2


def test_an_end_of_the_grid_is_named_but_not_a_natural_one(window, grids):
    best, tried = chosen_one(window, hill(9.0, 4.0, first=(3.0, 4.0)))
    assert best["at_end"] == "p0"
    assert (tried.loc[~tried["chosen"], "at_end"] == "").all()
    trackpy = grids["trackpy"]
    assert trackpy.at_end((20.0, 0, 1)) == ""  # no fewer frames than none; it predicts or not
    assert trackpy.at_end((120.0, 90, 1)) == "step, missed_frames"


def test_jpda_has_the_gates_below_that_of_gnn(grids):
    """Section 5.2.3; the widest of them is the text's end, the narrowest one of ours."""
    below = grids["JPDA, ours"].below(2.0)
    assert below.parameters["gate"] == (0.25, 0.35, 0.5, 0.7, 1.0, 1.4)
    assert below.start["gate"] == (1.0, 1.4)
    assert below.at_end((1.4, 1.0, 3)) == ""
    assert below.at_end((0.25, 1.0, 3)) == "gate"
    with pytest.raises(InputError, match="no gate is below"):
        below.below(0.25)


def test_a_tracker_that_refuses_a_neighbor_stays_where_it_is(window):
    def build(way):
        return right if way == 1 else refuses

    best, tried = chosen_one(window, Grid(build, {"way": (0.0, 1.0, 2.0)}, {"way": (1.0,)}))
    assert best["setting"] == "way 1"
    assert len(tried) == 3


@pytest.fixture
def grids(monkeypatch):
    monkeypatch.setattr(peers, "available", lambda: peers.PACKAGES)
    return all_grids()


@pytest.mark.parametrize("jobs", [1, 2])
def test_trials_side_by_side_are_those_in_a_row_and_are_kept(window, jobs):
    grid, worth = hill(3.0, 4.0, first=(0.0, 5.0)), worth_in(window)
    run = Trials("a table", 10, Workers(jobs))
    tried = tuning.search("one", grid, worth, 12, run)
    pd.testing.assert_frame_equal(tried, tuning.search("one", grid, worth, 12))

    def killed(tracker):
        raise AssertionError("worked out again")

    pd.testing.assert_frame_equal(tuning.search("one", grid, killed, 12, run), tried)
    with pytest.raises(AssertionError, match="again"):
        tuning.search("one", grid, killed, 13, run)


def test_every_setting_on_the_grid_has_its_own_name_and_a_tracker(grids):
    for grid in grids.values():
        first = list(product(*(grid.start[name] for name in grid.parameters)))
        assert len(first) == 8  # as many trials for everyone
        settings = first + grid.neighbors(first[0])
        assert len({grid.text(setting) for setting in settings}) == len(set(settings))
        for setting in settings:
            assert callable(grid.build(*setting))
        assert all(sorted(set(values)) == list(values) for values in grid.parameters.values())
    assert grids["trackpy"].build(15.0, 2, 1) == peers.Trackpy(15.0, 2, True)
    jpda = grids["JPDA, ours"].build(1.4, 2.0, 3).keywords
    assert (type(jpda["associator"]).__name__, jpda["gate"].distance) == ("JPDA", 1.4)
    assert (jpda["motion"].acceleration_noise, jpda["management"].invisible) == (2.0, 3)
    assert type(grids["GNN, ours"].build(1.4, 2.0, 3).keywords["associator"]).__name__ == "GNN"


def test_peers_that_are_not_installed_have_no_grid(monkeypatch):
    monkeypatch.setattr(peers, "available", lambda: ("laptrack",))
    assert list(all_grids()) == [*tuning.OURS, "laptrack"]
    monkeypatch.setattr(peers, "available", lambda: ("stonesoup",))
    assert list(all_grids())[3:] == ["GNN, Stone Soup", "JPDA, Stone Soup"]


def test_a_peer_that_refuses_all_settings_has_none_and_says_so_when_called(window, monkeypatch):
    no = Grid(lambda way: refuses, {"way": (0.0, 1.0)}, {"way": (0.0,)})
    monkeypatch.setattr(tuning, "settings_from_labels", lambda *_: None)
    monkeypatch.setattr(
        tuning, "_tried", lambda *known: tuning.search(known[-1], no, worth_in(window), 9)
    )
    tried = tuning.tried_settings("quick", ["one"])
    assert not tried["chosen"].any()
    assert (tried["at_end"] == "").all()
    assert (tried["untried"] == 0).all()
    with pytest.raises(InputError, match="one refuses each of 2 settings; the first: too dense"):
        tuning.chosen_trackers(tried, {"one": no})["one"](window.detections)
    with pytest.raises(InputError, match="tried_settings: GNN, ours refuses each of 2"):
        tuning.tried_settings("quick", [tuning.OURS[0]])


def test_the_first_frames_of_a_window(window):
    short = tuning.first_frames(window, 4)
    assert short.frames == range(4)
    for table in (short.detections, short.truth):
        assert table["frame"].tolist() == [0, 1, 2, 3] * 3
    assert tuning.first_frames(window, 99).frames == window.frames


def test_a_search_that_begins_among_refused_settings_goes_on_to_smaller_ones():
    def worth(tracker):
        gate, missed = tracker
        beta = gate * (1 + missed) if gate < 2 else np.nan
        return {"beta": beta, "note": "" if gate < 2 else "not run: too dense"}

    values = {"gate": (0.5, 1.0, 2.0, 4.0, 8.0), "missed": (0.0, 1.0, 2.0)}
    grid = Grid(lambda *setting: setting, values, {"gate": (4.0, 8.0), "missed": (1.0, 2.0)})
    tried = tuning.search("one", grid, worth, 15)
    best = tried[tried["chosen"]].iloc[0]
    assert (best["gate"], best["missed"]) == (1.0, 2.0)
    assert tried["beta"].isna().to_list()[:4] == [True] * 4
