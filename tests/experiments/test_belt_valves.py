"""Valves from exact positions and from pictures: halves, lots, bars."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from kilnflight.belt import PredictionPhase
from kilnflight.belt.valves import ValveBar
from kilnflight.experiments import belt_2016, belt_valves
from kilnflight.experiments.belt_valves import MODELS, OF_VELOCITY, Entering, draw_lots
from kilnflight.sorter.bulk import BULKS
from kilnflight.sorter.friction import MATERIALS
from kilnflight.sorter.rendering import Pictures

BAR = ValveBar()


@pytest.fixture(scope="module")
def exact():
    few = replace(MATERIALS["cuboids"], particles=300, feed_s=1.5)
    return belt_valves.of_bodies(few(np.random.default_rng(0)), PredictionPhase())


@pytest.fixture(scope="module")
def bodies():
    few = replace(MATERIALS["spheres"], particles=40, feed_s=0.3, sampling_hz=1000.0)
    return replace(few, steps_per_sample=2)(np.random.default_rng(5))


@pytest.fixture(scope="module")
def pictured(bodies):
    return belt_2016.track_pictures(Pictures(bodies, BULKS["spheres"], 5))


def test_halves_hold_every_particle_and_track_once_and_by_time(exact):
    first, second = exact.halves()
    assert (len(first.arrival), len(second.arrival)) == (150, 150)
    assert first.arrival["time_s"].max() < second.arrival["time_s"].min()
    assert set(first.truth) == set(first.arrival["particle"])
    assert len(first.last) + len(second.last) == len(exact.last)


def test_a_track_without_a_particle_goes_by_its_own_time(exact):
    ghosts = exact._replace(truth=np.where(np.arange(300) % 3 == 0, -1, exact.truth))
    first, second = ghosts.halves()
    assert (first.truth == -1).sum() + (second.truth == -1).sum() == 100
    late = [half.last["time_s"][half.truth == -1] for half in (first, second)]
    assert late[0].max() <= late[1].min()
    assert ghosts.missed_share == pytest.approx(1 / 3)


def test_a_doubled_particle_has_two_windows_and_a_ghost_none():
    last = pd.DataFrame({"particle": [7, 8, 9]})
    arrival = pd.DataFrame({"particle": [4, 5], "time_s": [0.1, 0.2], "y": [10.0, 50.0]})
    entering = Entering(last, np.array([5, 5, -1]), arrival, 788.0)
    assert entering.rows.tolist() == [1, 1, -1]
    assert entering.missed_share == 0.5
    predicted = pd.DataFrame(
        {"particle": [7, 8, 9], "time_s": [0.2, 0.23, 0.1], "y": [50.0, 50.0, 10.0]}
    )
    lots = draw_lots(entering, predicted, 0.5, seed=0)
    assert len(BAR.events(lots[0])) == 2
    shares = BAR(*lots)
    assert (shares.hit_share, shares.inadvertent_share) == (0.5, 0.0)


def test_each_lot_is_blown_out_in_a_pass_of_its_own(exact):
    predicted = exact.predict(*exact.fit(MODELS)[1][1:])
    lots = draw_lots(exact, predicted, 0.25, seed=1)
    chosen = lots[2].reshape(4, 300)
    assert (chosen.sum(axis=0) == 1).all()
    assert (chosen.sum(axis=1) == 75).all()
    hit = BAR(*lots).hit.reshape(4, 300)
    for lot in range(4):  # one pass by itself
        one = BAR(predicted[chosen[lot]], exact.arrival, chosen[lot])
        np.testing.assert_array_equal(one.hit, hit[lot])


def test_perfect_predictions_separate_all_on_the_belt(exact):
    true = exact.arrival[["particle", "time_s", "y"]]
    predicted, arrival, chosen = draw_lots(exact, true, 0.1, seed=0)
    shares = replace(BAR, open_s=0.0)(predicted, arrival, chosen)
    on_belt = arrival["y"].between(0, 180).to_numpy()  # the friction model has no walls
    np.testing.assert_array_equal(shares.hit, chosen & on_belt)
    assert shares.hit_share > 0.95


def test_longer_windows_and_wider_jets_hit_no_fewer(exact):
    bars = [replace(BAR, open_s=time) for time in (0.002, 0.01)]
    bars += [replace(BAR, valve_mm=width) for width in (2.0, 20.0)]
    table = belt_valves.compare_bars(exact, bars, seed=1, blown=0.1)
    assert len(table) == 4 * len(MODELS)
    for _, rows in table.groupby("model"):
        for column in ("hit_percent", "inadvertent_percent"):
            values = rows[column].to_numpy()
            assert values[0] <= values[1]
            assert values[2] <= values[3]


def test_tracks_of_pictures_drive_the_valves(bodies, pictured):
    entering = belt_valves.of_pictures(pictured, bodies, belt_2016.PHASE)
    assert len(entering.arrival) == 40
    assert entering.missed_share < 0.2
    lots = draw_lots(entering, entering.predict(*entering.fit(OF_VELOCITY)[-1][1:]), 0.2, seed=0)
    shares = BAR(*lots)
    assert 0.7 < shares.hit_share <= 1 - entering.missed_share + 0.05
    table = belt_valves.compare_bars(entering, [BAR], 0, 0.2, OF_VELOCITY)
    assert table["model"].tolist() == [name for name, *_ in OF_VELOCITY]
    assert (table["lateral_q95_mm"] > 0).all()
