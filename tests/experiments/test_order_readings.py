"""Which measure stops the orders of a regression (section 4.3)."""

import numpy as np
import pandas as pd

from kilnflight.experiments.order_readings import ByAdjustedR2, _by_fraction
from kilnflight.regression import Regression

EXIT = (0.0, 0.0, 6500.0)
TIME = np.linspace(0.02, 0.5, 60)


def flight(wave_mm):
    """A flight with a wave in depth, and a scatter that no order follows."""
    scatter = np.where(np.arange(60) % 2, 3.0, -3.0)
    x, y = 500 * TIME + scatter, -4900 * TIME**2 + scatter
    z = 6500 - 9000 * TIME + 2000 * TIME**2 + wave_mm * np.sin(9 * TIME) + scatter
    return np.column_stack([x, y, z])


def test_where_r2_is_nearly_one_it_stops_first():
    by_rmse = Regression()(TIME, flight(60.0), EXIT)
    by_r2 = ByAdjustedR2()(TIME, flight(60.0), EXIT)
    assert min(by_r2.r2_adjusted) > 0.99
    assert by_r2.orders == (2, 2, 2)
    assert by_rmse.orders[2] > 2
    assert by_rmse.rmse_mm[2] < by_r2.rmse_mm[2]


def test_a_wave_that_lower_orders_cannot_follow_raises_the_order_by_both():
    places = flight(3000.0)
    by_r2 = ByAdjustedR2()(TIME, places, EXIT)
    assert by_r2.orders[2] > 2
    lower = ByAdjustedR2(highest=by_r2.orders[2] - 1)(TIME, places, EXIT)
    assert by_r2.r2_adjusted[2] - lower.r2_adjusted[2] > 0.01 * abs(lower.r2_adjusted[2])


def test_refused_flights_count_but_are_in_no_median():
    flights = pd.DataFrame(
        {
            "fraction": "confetti",
            "particle": [1, 2, 3],
            "refused": ["", "", "leaves the kiln"],
            "ending": ["landed", "lost", "landed"],
            "dwell_s": [0.4, 0.9, 5.0],
            "rmse_z_mm": [100.0, 120.0, 900.0],
            **{f"order_{axis}": [2, 3, 4] for axis in "xyz"},
        }
    )
    row = _by_fraction(flights).loc["confetti"]
    assert (row["from_lance"], row["refused"], row["order_z"]) == (3, 1, 3.0)
    assert (row["dwell_s"], row["rmse_z_mm"]) == (0.4, 110.0)
