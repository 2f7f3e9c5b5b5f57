"""Valves from exact positions: lots and bars."""

from dataclasses import replace

import numpy as np
import pandas as pd

from kilnflight.belt import PredictionPhase
from kilnflight.belt.valves import ValveBar
from kilnflight.experiments.belt import lots
from kilnflight.experiments.belt.lots import Entering, draw_lots
from kilnflight.simulated.belt.friction import MATERIALS

BAR = ValveBar()


def test_a_doubled_particle_has_two_windows_and_a_ghost_none():
    last = pd.DataFrame({"particle": [7, 8, 9]})
    arrival = pd.DataFrame(
        {"particle": [4, 5], "time_s": [0.1, 0.2], "y": [10.0, 50.0]}
    )
    entering = Entering(last, np.array([5, 5, -1]), arrival, 788.0)
    assert entering.missed_share == 0.5
    predicted = last.assign(time_s=[0.2, 0.23, 0.1], y=[50.0, 50.0, 10.0])
    lots = draw_lots(entering, predicted, 0.5, seed=0)
    assert len(BAR.events(lots[0])[0]) == 2
    shares = BAR(*lots)
    assert (shares.hit_share, shares.inadvertent_share) == (0.5, 0.0)


def test_perfect_predictions_separate_all_on_the_belt():
    few = replace(MATERIALS["cuboids"], particles=300, feed_s=1.5)
    exact = lots.of_bodies(few(np.random.default_rng(0)), PredictionPhase())
    true = exact.arrival[["particle", "time_s", "y"]]
    predicted, arrival, chosen = draw_lots(exact, true, 0.1, seed=0)
    shares = replace(BAR, open_s=0.0)(predicted, arrival, chosen)
    on_belt = arrival["y"].between(0, 180).to_numpy()  # the friction model has no walls
    np.testing.assert_array_equal(shares.hit, chosen & on_belt)
    assert shares.hit_share > 0.95
