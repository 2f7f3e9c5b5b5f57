"""Valves from exact positions and from pictures: halves, lots, best bars, feeds."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from kilnflight.belt import PredictionPhase
from kilnflight.belt.valves import ValveBar
from kilnflight.checks import InputError
from kilnflight.experiments import belt_2016, belt_splitting, belt_valves
from kilnflight.experiments.belt_valves import MODELS, Entering, draw_trial
from kilnflight.sorter.friction import MATERIALS
from kilnflight.sorter.machine import BULKS
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
    pictures = {"spheres": Pictures(bodies, BULKS["spheres"], 5)}
    return belt_valves.track_all(pictures)["spheres"]


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
    assert ghosts.counts() == {"particles": 300, "missed": 100, "doubled": 0, "tracks": 300}


def test_missed_and_doubled_particles_are_counted_and_predicted():
    last = pd.DataFrame({"particle": [7, 8, 9]})
    arrival = pd.DataFrame({"particle": [4, 5], "time_s": [0.1, 0.2], "y": [10.0, 50.0]})
    entering = Entering(last, np.array([5, 5, -1]), arrival, 788.0)
    assert entering.rows.tolist() == [1, 1, -1]
    assert entering.counts() == {"particles": 2, "missed": 1, "doubled": 1, "tracks": 3}
    predicted = pd.DataFrame(
        {"particle": [7, 8, 9], "time_s": [0.2, 0.23, 0.1], "y": [50.0, 50.0, 10.0]}
    )
    trial = draw_trial(entering, predicted, 0.5, seed=0)
    assert len(BAR.events(trial.predicted)) == 2  # two windows for one particle, none for the ghost
    shares = trial.separate(BAR)
    assert (shares.hit_share, shares.inadvertent_share) == (0.5, 0.0)
    assert trial.late_s == pytest.approx(-0.015)


def test_each_lot_is_blown_out_in_a_pass_of_its_own(exact):
    predicted = exact.predict(*exact.fit()[1][1:])
    trial = draw_trial(exact, predicted, 0.25, seed=1)
    chosen = trial.chosen.reshape(4, 300)
    assert (chosen.sum(axis=0) == 1).all()
    assert (chosen.sum(axis=1) == 75).all()
    hit = trial.separate(BAR).hit.reshape(4, 300)
    for lot in range(4):  # one pass by itself
        one = BAR(predicted[chosen[lot]], exact.arrival, chosen[lot])
        np.testing.assert_array_equal(one.hit, hit[lot])


def test_perfect_predictions_separate_all_on_the_belt(exact):
    true = exact.arrival[["particle", "time_s", "y"]]
    trial = draw_trial(exact, true, 0.1, seed=0)
    shares = trial.separate(replace(BAR, open_s=0.0))
    on_belt = trial.arrival["y"].between(0, 180).to_numpy()  # the friction model has no walls
    np.testing.assert_array_equal(shares.hit, trial.chosen & on_belt)
    assert shares.hit_share > 0.95


def test_the_best_bar_has_the_most_hits_within_the_limit(exact):
    predicted = exact.predict(*exact.fit()[1][1:])
    late = predicted.assign(time_s=predicted["time_s"] - 0.02)
    trial = draw_trial(exact, late, 0.1, seed=0)
    bars = belt_valves.best_bars(trial, BAR, [0.002, 0.05])
    shares = [trial.separate(bar) for bar in bars]
    assert [part.inadvertent_share for part in shares] <= [0.002, 0.05]
    assert shares[0].hit_share <= shares[1].hit_share
    assert shares[0].hit_share > trial.separate(BAR).hit_share + 0.5
    assert bars[0].delay_s == pytest.approx(trial.late_s, abs=0.0021)
    assert trial.late_s == pytest.approx(0.02 + draw_trial(exact, predicted, 0.1, 0).late_s)
    (least,) = belt_valves.best_bars(trial, BAR, [0.0])
    assert trial.separate(least).inadvertent_share <= shares[0].inadvertent_share


def test_the_curve_reports_the_half_that_it_was_not_fitted_to(exact):
    table = belt_valves.optimised(exact, BAR, seed=0, models=MODELS[:2], limits=[0.01, 0.05])
    assert table["model"].tolist() == ["IV-Straight"] * 2 + ["Straight"] * 2
    assert (table["fitted_inadvertent_percent"] <= table["limit_percent"]).all()
    assert table["hit_percent"].between(50, 100).all()
    assert not table["hit_percent"].equals(table["fitted_hit_percent"])
    again = belt_valves.optimised(exact, BAR, seed=0, models=MODELS[:2], limits=[0.01, 0.05])
    pd.testing.assert_frame_equal(table, again)


def test_longer_windows_and_wider_jets_hit_no_fewer(exact):
    bars = [replace(BAR, open_s=time) for time in (0.002, 0.01)]
    bars += [replace(BAR, valve_mm=width) for width in (2.0, 20.0)]
    table = belt_valves.compare_bars(exact, bars, seed=1)
    assert len(table) == 4 * len(MODELS)
    for _, rows in table.groupby("model"):
        for column in ("hit_percent", "inadvertent_percent"):
            values = rows[column].to_numpy()
            assert values[0] <= values[1]
            assert values[2] <= values[3]


def test_too_few_particles_for_the_lots_are_refused(exact):
    few = exact._replace(arrival=exact.arrival[:5])
    with pytest.raises(InputError, match="5 particles in 10 lots"):
        draw_trial(few, few.predict(*exact.fit()[1][1:]), 0.1, seed=0)
    with pytest.raises(InputError, match="blown"):
        draw_trial(exact, exact.predict(*exact.fit()[1][1:]), 1.0, seed=0)


def test_tracks_of_pictures_drive_the_valves(bodies, pictured):
    entering = belt_valves.of_pictures(pictured, bodies)
    counts = entering.counts()
    assert counts["particles"] == 40
    assert counts["tracks"] + counts["missed"] >= 40
    trial = draw_trial(entering, entering.predict(*entering.fit()[1][1:]), 0.2, seed=0)
    best = trial.separate(belt_valves.best_bars(trial, BAR, [0.05])[0])
    assert 0.8 < best.hit_share <= 1 - counts["missed"] / 40 + 0.05


def test_purity_over_the_feed(bodies, pictured):
    entering = belt_valves.of_pictures(pictured, bodies)
    table = belt_valves.vary_feed({1.0: entering, 2.0: entering}, BAR, seed=0, blown=0.2)
    assert table["feed"].tolist() == [1.0, 2.0] * len(belt_valves.OF_VELOCITY)
    names = ["recovery_percent", "purity_blown_out_percent", "purity_left_percent"]
    assert table[names].to_numpy().min() >= 0
    assert table[names].to_numpy().max() <= 100
    assert table["particles"].tolist() == [20, 40] * len(belt_valves.OF_VELOCITY)


def test_a_denser_feed_has_the_same_particles_in_less_time(monkeypatch):
    monkeypatch.setattr(belt_valves, "is_installed", lambda: False)
    monkeypatch.setattr(belt_2016, "is_installed", lambda: False)
    usual, dense = (belt_valves.simulate_feed("spheres", 30, 1, feed) for feed in (1.0, 2.0))
    assert usual["particle"].equals(dense["particle"])
    assert usual["x"].equals(dense["x"])
    starts = [part.groupby("particle")["time_s"].min() for part in (usual, dense)]
    np.testing.assert_allclose(starts[1], starts[0] / 2, atol=0.00051)
    with pytest.raises(InputError, match="feed"):
        belt_valves.simulate_feed("spheres", 30, 1, 0.0)


def test_a_denser_feed_of_the_sorter_comes_in_less_time(monkeypatch):
    """Twice the particles per second: every entry time is half as late."""
    slides = []
    monkeypatch.setattr(belt_valves, "is_installed", lambda: True)
    monkeypatch.setattr(
        belt_valves.simulation, "simulate_tracks", lambda *parts: slides.append(parts[-1].slide)
    )
    belt_valves.simulate_feed("spheres", 30, 1, 2.0)
    bulk, usual = BULKS["spheres"], belt_valves.simulation.calibrated_sorter().slide
    at = [slide(bulk, 50, 180.0, np.random.default_rng(1)).time_s for slide in (usual, slides[0])]
    np.testing.assert_allclose(2.0 * at[1], at[0])


def test_wrong_predictions_are_counted_from_pictures_and_from_exact_positions(bodies, pictured):
    several = {("spheres", "as published"): pictured}
    table = belt_splitting.compare_splitting(several, {"spheres": bodies}, BAR)
    exact = belt_2016.noise_free(bodies).query("approach == 'Tracking'")
    late = (exact["temporal_ms"] - exact["temporal_ms"].median()).abs() > 2.5
    aside = exact["lateral_mm"].abs() > 180 / 32 / 2
    assert table["wrong_exact"].tolist() == [sum(late | aside)]
    assert (table["wrong"] <= 40).all()
