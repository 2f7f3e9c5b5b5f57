"""How far headline numbers move with inputs that the publications only bound.

Each scenario of the twin, a draw of its pose among them, is flown, rendered and evaluated as the
base is. Threshold and wall are found anew on its own labelled frames, as a user would on a kiln of
that kind. The settings of the tracker stay. Flights are true ones: what a scenario changes in them
is told apart from what the chain adds (`kilnflight.experiments.accuracy`).
"""

from __future__ import annotations

from collections.abc import Iterable

import pandas as pd

from kilnflight.experiments import detection, tracking
from kilnflight.experiments.campaigns import settings_from_labels
from kilnflight.experiments.tracking_scores import FROM_LANCE, STAGES, tabulate
from kilnflight.scores.flights import outcomes
from kilnflight.twin import truth
from kilnflight.twin.fitted import Kiln
from kilnflight.twin.particles import FRACTIONS
from kilnflight.twin.scenes import PRESSURES_BAR, campaign_name, open_scene, scene_name

BASE = "base"
# Headline outcomes of flights, of `kilnflight.scores.flights.outcomes`.
OUTCOMES = (
    "dwell median (s)",
    "velocity 0-1 m (m/s)",
    "remaining 2 m (%)",
    "remaining 3 m (%)",
    "ignited (%)",
)
COLUMNS = ["scenario", "quantity", "case", "value"]


def flight_numbers(scenario: str, count: int, seed: int) -> pd.DataFrame:
    """Return the `OUTCOMES` of the true flights of each fraction at the lower pressure.

    Returns
    -------
    DataFrame
        `COLUMNS`; the case is the fraction.
    """
    rows = []
    for name in FRACTIONS:
        scene = open_scene(scene_name(campaign_name(name, PRESSURES_BAR[0]), scenario), seed).scene
        kiln = Kiln(scene.flight, scene.gas, scene.geometry)
        flown = truth.released(name, PRESSURES_BAR[0], kiln, count, seed)
        values = outcomes(truth.true_flight_values(flown))
        rows += [(scenario, quantity, name, values[quantity]) for quantity in OUTCOMES]
    return pd.DataFrame(rows, columns=COLUMNS)


def detection_numbers(scenario: str, scale: str, seed: int, frames: int = 0) -> pd.DataFrame:
    """Return F1 of the eleven methods of Table 5.11 on the labelled frames of a scenario.

    The threshold of SIFT is chosen as in notebook 24. ``frames`` are those of each subset, 0: as
    many as the scale has.
    """
    subsets = detection.labelled_subsets(scale, seed, frames, scenario)
    threshold = detection.chosen_thresholds(detection.compare_thresholds(subsets, scale))
    total = detection.sum_counts(detection.compare_methods(subsets, threshold), ["method"])
    table = pd.DataFrame({"case": total["method"], "value": total["f1"]})
    return table.assign(scenario=scenario, quantity="F1")[COLUMNS]


def tracking_numbers(
    scenario: str, scale: str, tracker: tracking.Tracker, seed: int, jobs: int
) -> pd.DataFrame:
    """Return alpha of a tracker with post-processing, tracks from the lance, by fraction."""
    settings = settings_from_labels(scale, seed, scenario)
    windows = tracking.windows(scale, settings, seed, jobs=jobs, scenario=scenario)
    cells = tracking.cells(windows, tracking.follow_all(windows, {"GNN": tracker}), [FROM_LANCE])
    table = tabulate(cells)
    after = table[table["postprocessing"] == STAGES[1]]
    columns = {"case": after["fraction"], "value": after["alpha"]}
    return pd.DataFrame(columns).assign(scenario=scenario, quantity="alpha of GNN")[COLUMNS]


def bands(numbers: pd.DataFrame, draws: Iterable[str]) -> pd.DataFrame:
    """Return the range of each number over draws, and over all scenarios.

    Parameters
    ----------
    numbers
        `COLUMNS`, with a scenario `BASE`.
    draws
        Scenarios that are draws of one input, alike in weight.

    Returns
    -------
    DataFrame
        ``quantity``, ``case``, ``base``; ``draws_low``, ``draws_median``, ``draws_high`` (least,
        median and greatest of the draws); ``low`` and ``high`` over all, and the scenarios that
        give them, ``lowest`` and ``highest``. NaN where no draw has a value.
    """
    keys = ["quantity", "case"]
    wide = numbers.pivot(index=keys, columns="scenario", values="value")
    wide = wide.reindex(pd.MultiIndex.from_frame(numbers[keys].drop_duplicates()))
    drawn = wide.reindex(columns=list(draws))
    table = pd.DataFrame({"base": wide[BASE], "draws_low": drawn.min(axis=1)})
    table["draws_median"], table["draws_high"] = drawn.median(axis=1), drawn.max(axis=1)
    table["low"], table["high"] = wide.min(axis=1), wide.max(axis=1)
    known = wide.dropna(how="all")
    table["lowest"] = known.idxmin(axis=1).reindex(wide.index, fill_value="")
    table["highest"] = known.idxmax(axis=1).reindex(wide.index, fill_value="")
    return table.reset_index()
