"""How far headline numbers move with inputs that the publications only bound.

Each scenario of the twin, a draw of its pose among them, is flown, rendered and evaluated as the
base is. Threshold and wall are found anew on its own labelled frames, as a user would on a kiln of
that kind. The settings of the tracker stay. Flights are true ones: what a scenario changes in them
is told apart from what the chain adds (`kilnflight.experiments.accuracy`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from kilnflight.experiments import detection, tracking, twin_statements
from kilnflight.experiments.campaigns import settings_from_labels
from kilnflight.experiments.tracking_scores import FROM_LANCE, STAGES, tabulate
from kilnflight.project import claims
from kilnflight.project.parallel import run_all
from kilnflight.project.style import COLOURS, PAGE_MM, PUBLISHED, PUBLISHED_BAR, canvas
from kilnflight.scores.flights import outcomes
from kilnflight.twin import truth
from kilnflight.twin.fitted import Kiln
from kilnflight.twin.particles import FRACTIONS
from kilnflight.twin.poses import POSE_SCENARIOS
from kilnflight.twin.scenes import PRESSURES_BAR, campaign_name, open_scene, scene_name

BASE = "base"
DRAWS = tuple(name for name in POSE_SCENARIOS if name != "pose")  # the mode is the base
# Other inputs that the publications only bound: feeding in handfuls, a colder wall towards the
# outlet, no jet at all, a lance of two and a half times the bore, and a recording of another day.
OTHERS = ("dumped", "wall-profile", "no-jet", "wide-lance", "run-effects")
# Headline outcomes of flights, of `kilnflight.scores.flights.outcomes`.
OUTCOMES = (
    "dwell median (s)",
    "velocity 0-1 m (m/s)",
    "remaining 2 m (%)",
    "remaining 3 m (%)",
    "ignited (%)",
)
COLUMNS = ["scenario", "quantity", "case", "value"]
GNN, F1, ALPHA = "GNN", "F1", "alpha of GNN"


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
    return table.assign(scenario=scenario, quantity=F1)[COLUMNS]


def tracking_numbers(
    scenario: str, scale: str, tracker: tracking.Tracker, seed: int, jobs: int
) -> pd.DataFrame:
    """Return alpha of a tracker with post-processing, tracks from the lance, by fraction."""
    settings = settings_from_labels(scale, seed, scenario)
    windows = tracking.windows(scale, settings, seed, jobs=jobs, scenario=scenario)
    cells = tracking.cells(windows, tracking.follow_all(windows, {GNN: tracker}), [FROM_LANCE])
    table = tabulate(cells)
    after = table[table["postprocessing"] == STAGES[1]]
    columns = {"case": after["fraction"], "value": after["alpha"]}
    return pd.DataFrame(columns).assign(scenario=scenario, quantity=ALPHA)[COLUMNS]


def of_all(
    numbers: Callable[..., pd.DataFrame], scenarios: Sequence[str], *rest: Any, jobs: int = 1
) -> pd.DataFrame:
    """Return one of the numbers above of several scenarios, ``rest`` its other arguments."""
    parts = run_all(numbers, [(name, *rest) for name in scenarios], jobs)
    return pd.concat(parts or [pd.DataFrame(columns=COLUMNS)], ignore_index=True)


def printed() -> pd.DataFrame:
    """Return what is published: ``quantity``, ``case``, ``published_low``, ``published_high``.

    Nothing for alpha: of the few frames here it is another number than that of Table 5.17.
    """
    facts = twin_statements.facts().query("pressure_bar == @PRESSURES_BAR[0]")
    names = {"outcome": "quantity", "fraction": "case"}
    names |= {"low": "published_low", "high": "published_high"}
    flights = facts.rename(columns=names)[list(names.values())]
    f1 = claims.published("table_5.11").rename(columns={"method": "case"})[["case", "f1"]]
    ends = {"published_low": f1["f1"].astype(float), "published_high": f1["f1"].astype(float)}
    f1 = f1[["case"]].assign(quantity=F1, **ends)
    return pd.concat([flights, f1], ignore_index=True)


def by_scenario(numbers: pd.DataFrame) -> pd.DataFrame:
    """Return each number in every scenario, a column for each; NaN where it was not asked.

    ``numbers`` has `COLUMNS`; the index is ``quantity`` and ``case``, the base comes first.
    """
    keys = ["quantity", "case"]
    wide = numbers.pivot(index=keys, columns="scenario", values="value")
    wide = wide.reindex(columns=numbers["scenario"].unique())
    return wide.reindex(pd.MultiIndex.from_frame(numbers[keys].drop_duplicates()))


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
        give them, ``lowest`` and ``highest``; ``draws`` and ``scenarios``, how many have a value;
        and what is `printed`. NaN where no draw has a value.
    """
    wide = by_scenario(numbers)
    drawn = wide.reindex(columns=list(draws))
    table = pd.DataFrame({"base": wide[BASE], "draws_low": drawn.min(axis=1)})
    table["draws_median"], table["draws_high"] = drawn.median(axis=1), drawn.max(axis=1)
    table["low"], table["high"] = wide.min(axis=1), wide.max(axis=1)
    known = wide.dropna(how="all")
    table["lowest"] = known.idxmin(axis=1).reindex(wide.index, fill_value="")
    table["highest"] = known.idxmax(axis=1).reindex(wide.index, fill_value="")
    table["draws"], table["scenarios"] = drawn.notna().sum(axis=1), wide.notna().sum(axis=1)
    return table.reset_index().merge(printed(), how="left")


def draw_bands(table: pd.DataFrame) -> Figure:
    """Draw `bands`: published, base, range of the draws (broad) and of all scenarios (thin)."""
    cases = table.groupby("quantity", sort=False).size()
    quantities = list(cases.index)
    tall = [int(cases.iloc[k : k + 2].max()) + 2 for k in range(0, len(cases), 2)]
    size: dict[str, Any] = {"width_mm": PAGE_MM, "height_mm": 15 + 5.5 * sum(tall)}
    picture, grid = canvas(len(tall), 2, height_ratios=tall, **size)
    for axes, quantity in zip(grid.flat, quantities, strict=False):
        _draw_quantity(axes, table[table["quantity"] == quantity])
        axes.set_xlabel("median of the dwell time (s)" if quantity == OUTCOMES[0] else quantity)
    for axes in list(grid.flat)[len(quantities) :]:
        axes.axis("off")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    picture.legend(handles, labels, loc="outside upper center", ncols=4)
    return picture


def _draw_quantity(axes: Axes, rows: pd.DataFrame) -> None:
    """Draw the bands of one quantity, a line for each case."""
    y = range(len(rows))
    axes.hlines(y, rows["low"], rows["high"], color="black", lw=0.8, ls="-", label="all scenarios")
    wide: dict[str, Any] = {"color": COLOURS[6], "lw": 5, "ls": "-"}
    axes.hlines(y, rows["draws_low"], rows["draws_high"], label="draws of the pose", **wide)
    axes.plot(rows["base"], y, "|", color="black", ms=8, mew=1.4, ls="none", label="base")
    below = [place + 0.3 for place in y]
    bar: dict[str, Any] = {**PUBLISHED_BAR, "label": ""}
    axes.hlines(below, rows["published_low"], rows["published_high"], **bar)
    exact = rows["published_low"].where(rows["published_low"] == rows["published_high"])
    axes.plot(exact, below, **PUBLISHED)
    axes.set_yticks(y, rows["case"])
    axes.set_ylim(len(rows) - 0.4, -0.5)


def describe(table: pd.DataFrame) -> str:
    """Return the bands of headline numbers, a sentence each: of the draws, in brackets of all.

    Without brackets where no other scenario was asked. Alpha is left out: its few frames move it
    more than the pose does.
    """
    rows = table.set_index(["quantity", "case"])
    shown = (
        (OUTCOMES[0], "confetti", "median dwell time of confetti (s)", "2f"),
        (OUTCOMES[1], "wood chip", "first velocity of wood chips (m/s)", "1f"),
        (OUTCOMES[3], "wood chip", "share of wood chips beyond 3 m (%)", "0f"),
        (OUTCOMES[4], "confetti", "share of confetti that ignites (%)", "0f"),
        (F1, "Combi SIFT+DBSCAN", "F1 of SIFT with DBSCAN", "2f"),
    )
    told = []
    for quantity, case, words, digits in shown:
        if (quantity, case) in rows.index:
            row = rows.xs((quantity, case)).to_dict()
            names = ("draws_low", "draws_high", "low", "high")
            low, high, least, most = (f"{row[name]:.{digits}}" for name in names)
            others = f" [{least} to {most}]" if row["scenarios"] > row["draws"] + 1 else ""
            number = f"{row['draws']} draw{'s' if row['draws'] != 1 else ''}"
            told.append(f"{words} {low} to {high}{others} ({number})")
    return " ".join(f"{words[0].upper()}{words[1:]}." for words in told)
