"""The two ends of "the measures" of section 4.3, which stop the orders of a regression.

The regression "is stopped if the optimization of the measures is less than 1 % for each order of
enhancement"; measures are RMSE, MAPE, R2 and adjusted R2. Of these RMSE gains most and stops
last, adjusted R2 cannot gain 1 % where it is above 0.99 and stops first.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.experiments.campaigns import KEYS, Campaign, measure_campaigns
from kilnflight.flight import LOST, kept
from kilnflight.project.parallel import Workers
from kilnflight.regression import Fit, Orders, Regression
from kilnflight.tables import AXES

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class ByAdjustedR2(Regression):
    """Raise the order of an axis only while adjusted R2 (Eq. 4.33) gains 1 % of itself."""

    about_mean: tuple[float, ...] = ()  # squares about the mean along each axis, of one track

    def _fit(self, time: Array, places: Array, exit_point: Array) -> Fit:
        squares = ((places - places.mean(axis=0)) ** 2).sum(axis=0) / np.square(self.scale_mm)
        this = replace(self, about_mean=tuple(squares.tolist()))
        return Regression._fit(this, time, places, exit_point)

    def choose(self, costs: Callable[[Orders], Array], highest: int, points: int) -> Orders:
        """Return the orders; the axis that gains most comes first."""
        variance = np.fmax(self.about_mean, np.finfo(float).tiny) / (points - 1)

        def adjusted(orders: Orders) -> Array:
            return 1 - costs(orders) / (points - np.array(orders) - 1) / variance

        orders: Orders = (self.lowest,) * 3
        while True:
            before, gains = adjusted(orders), np.full(3, -np.inf)
            higher = [(*orders[:k], orders[k] + 1, *orders[k + 1 :]) for k in range(3)]
            for k in range(3):
                if orders[k] < highest:
                    gains[k] = (adjusted(higher[k])[k] - before[k]) / max(abs(before[k]), 1e-9)
            best = int(np.argmax(gains))
            if gains[best] < self.gain:
                return orders
            orders = higher[best]


READINGS = {"RMSE": Regression(), "adjusted R2": ByAdjustedR2()}


def compare_orders(recorded: Sequence[Campaign], workers: Workers) -> pd.DataFrame:
    """Return what the flights from the lance are if one or the other measure stops the orders.

    Returns
    -------
    DataFrame
        ``measure``, ``fraction``; the mean orders ``order_x`` to ``order_z``; ``from_lance``: how
        many start at the lance, ``refused`` of them; of the rest the median ``rmse_z_mm``, and
        ``dwell_s`` of complete ones.
    """
    parts = {}
    for name, method in READINGS.items():
        runs = [each._replace(run=replace(each.run, regression=method)) for each in recorded]
        tables = measure_campaigns(runs, workers)
        started = tables.flights[tables.flights["from_lance"]]
        parts[name] = _by_fraction(started.merge(tables.trajectories, on=[*KEYS, "particle"]))
    return pd.concat(parts, names=["measure"]).reset_index()


def _by_fraction(flights: pd.DataFrame) -> pd.DataFrame:
    """Return numbers, mean orders and medians of flights from the lance by fraction."""
    groups = flights.groupby("fraction", sort=False)
    table = groups[[f"order_{axis}" for axis in AXES]].mean()
    table["from_lance"] = groups.size()
    table["refused"] = groups["refused"].agg(lambda reasons: (reasons != "").sum())
    counted = kept(flights)
    counted = counted.assign(dwell_s=counted["dwell_s"].mask(counted["ending"] == LOST))
    return table.join(counted.groupby("fraction")[["rmse_z_mm", "dwell_s"]].median())
