from itertools import product

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kilnflight.checks import InputError
from kilnflight.experiments import grid_search
from kilnflight.experiments import other_trackers as peers
from kilnflight.experiments.grid_search import Grid, kilnflight_grids, peer_grids
from kilnflight.experiments.tracking import Window

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


def chosen_one(window, grid):
    tried = grid_search.grid_search([window], {"one": grid})
    best = tried[tried["chosen"]]
    assert len(best) == 1
    return best.iloc[0], tried


def test_the_best_setting_of_each_tracker_is_chosen(window):
    choice = {0.0: alone, 1.0: right, 2.0: refuses}
    one = Grid(choice.get, {"way": (0.0, 1.0, 2.0)}, {"way": (0.0, 1.0, 2.0)})
    other = Grid(choice.get, {"way": (0.0,)}, {"way": (0.0,)})
    trackers = {"one": one, "other": other}
    tried = grid_search.grid_search([window], trackers)
    assert tried["chosen"].tolist() == [False, True, False, True]
    assert tried["beta"].iloc[1] == pytest.approx(1)
    assert np.isnan(tried["beta"].iloc[2])
    assert tried["note"].tolist() == ["", "", "not run: too dense.", ""]
    assert tried["at_end"].tolist() == ["", "", "", ""]
    assert grid_search.chosen_trackers(tried, trackers) == {"one": right, "other": alone}


@settings(deadline=None, max_examples=10)  # each climbs a dozen settings
@given(top=st.tuples(st.integers(1, 8), st.integers(1, 8)), first=st.sampled_from(LONG))
def test_the_climb_ends_inside_of_what_was_tried(top, first):
    grid = hill(*top, first=(first,))
    best, tried = chosen_one(a_window(20), grid)
    assert best["setting"] == f"p0 {top[0]}, p1 {top[1]}"
    assert best["at_end"] == ""
    around = {grid.text(setting) for setting in grid.neighbors(tuple(map(float, top)))}
    assert len(around) == 4
    assert around < set(tried["setting"])
    assert not tried["setting"].duplicated().any()


def test_an_end_of_the_grid_is_named(window):
    best, tried = chosen_one(window, hill(9.0, 4.0, first=(3.0, 4.0)))
    assert best["at_end"] == "p0"
    assert (tried.loc[~tried["chosen"], "at_end"] == "").all()


def test_a_tracker_that_refuses_a_neighbor_stays_where_it_is(window):
    def build(way):
        return right if way == 1 else refuses

    best, tried = chosen_one(window, Grid(build, {"way": (0.0, 1.0, 2.0)}, {"way": (1.0,)}))
    assert best["setting"] == "way 1"
    assert len(tried) == 3


@pytest.mark.parametrize(
    ("values", "first"),
    [((2.0, 1.0), (1.0,)), ((1.0, 1.0), (1.0,)), ((1.0, 2.0), (3.0,)), ((1.0,), ())],
)
def test_a_grid_without_neighbours_is_refused(values, first):
    with pytest.raises(InputError, match="Grid: step has the values"):
        Grid(lambda step: right, {"step": values}, {"step": first})


def test_every_setting_on_the_grid_has_its_own_name_and_a_tracker():
    for grid in [*kilnflight_grids().values(), *peer_grids().values()]:
        first = list(product(*(grid.start[name] for name in grid.parameters)))
        settings = first + grid.neighbors(first[0])
        assert len({grid.text(setting) for setting in settings}) == len(set(settings))
        for setting in settings:
            assert callable(grid.build(*setting))
    starts = [kilnflight_grids()[name].start.values() for name in ("GNN", "JPDA")]
    first, other = (len(list(product(*start))) for start in starts)
    assert first == other > 10
    assert peer_grids()["trackpy"].build(15.0, 2, 1) == peers.Trackpy(15.0, 2, True)


def test_a_tracker_that_refuses_a_window_has_rows_without_measures(window):
    scores = grid_search.score([window], {"one": right, "other": refuses})
    assert scores["postprocessing"].tolist() == ["without", "with"] * 2
    assert scores["beta"].isna().tolist() == [False, False, True, True]


def test_peers_that_are_not_installed_have_no_grid(monkeypatch):
    monkeypatch.setattr(peers, "available", lambda: ("laptrack",))
    assert list(grid_search.all_grids()) == ["GNN, ours", "JPDA, ours", "laptrack"]
    monkeypatch.setattr(peers, "available", lambda: ("stonesoup",))
    assert list(grid_search.all_grids())[2:] == ["GNN, Stone Soup", "JPDA, Stone Soup"]


def test_slow_trackers_are_tried_on_the_first_frames(monkeypatch):
    monkeypatch.setattr(grid_search, "SLOW_FRAMES", 6)
    grids = {"one": hill(0.0), grid_search.SLOW[0]: hill(0.0)}
    tried = grid_search.grid_search([a_window(10)], grids)
    frames = tried.groupby("tracker")["frames"].unique().explode()
    assert frames.to_dict() == {"one": 10, grid_search.SLOW[0]: 6}


def test_chosen_settings_stand_beside_the_range_of_all():
    rows = [("a", "x", 0.9, 0.5, True), ("a", "y", 0.8, 0.1, False), ("a", "z", 0.7, 0.3, False)]
    columns = ["tracker", "setting", "alpha", "beta", "chosen"]
    table = grid_search.chosen_settings(pd.DataFrame(rows, columns=columns))
    assert table.to_dict("records") == [
        {"tracker": "a", "setting": "x", "alpha": 0.9, "beta": 0.5}
        | {"beta_min": 0.1, "beta_median": 0.3, "beta_max": 0.5}
    ]


def test_leaders_are_described_with_ours_and_who_did_not_run():
    rows = [
        ("chip", "GNN, ours", "without", 0.5),
        ("chip", "peer", "without", 0.6),
        ("shred", "GNN, ours", "without", 0.4),
        ("shred", "peer", "without", np.nan),
        ("chip", "GNN, ours", "with", 0.7),
        ("shred", "GNN, ours", "with", 0.8),
    ]
    table = pd.DataFrame(rows, columns=["fraction", "tracker", "postprocessing", "beta"])
    assert grid_search.describe_leaders(table) == (
        "Largest beta without post-processing chip peer 0.600 (ours 0.500); shred GNN, ours 0.400 "
        "(means: GNN, ours 0.450). Largest beta with post-processing chip GNN, ours 0.700; shred "
        "GNN, ours 0.800 (means: GNN, ours 0.750). Not run on every window: peer."
    )


def test_nothing_to_choose_from_is_an_error(window):
    with pytest.raises(InputError, match="no windows"):
        grid_search.grid_search([], {"one": hill(1.0)})
    no = Grid(lambda way: refuses, {"way": (0.0, 1.0)}, {"way": (0.0,)})
    with pytest.raises(InputError, match="refuses every setting"):
        grid_search.grid_search([window], {"one": no})


def test_the_first_frames_of_a_window(window):
    short = grid_search.first_frames(window, 4)
    assert short.frames == range(4)
    for table in (short.detections, short.truth):
        assert table["frame"].tolist() == [0, 1, 2, 3] * 3
    assert grid_search.first_frames(window, 99).frames == window.frames
