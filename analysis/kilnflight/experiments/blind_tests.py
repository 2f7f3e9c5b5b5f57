"""Blind tests of the twin's second look: printed tables that no input of it was fitted to.

They are Tables 5.8 to 5.11 and 5.17, and R2 of Table 5.18. Left out is the row of Otsu's method in
Table 5.11: it is the total of Table 5.5, to which the light was fitted. The first twin's numbers,
at full scale, stand beside (data/reference).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from kilnflight.checks import InputError
from kilnflight.experiments.detection_tables import ABSOLUTE
from kilnflight.experiments.plots import SYMBOLS
from kilnflight.experiments.tracking_scores import FROM_LANCE
from kilnflight.project import claims, paths
from kilnflight.project.figures import entries
from kilnflight.project.style import COLOURS, canvas

TWINS = ("first twin", "second look")
SUFFIX = "_published"
NAMES = {**SYMBOLS, "f1": "F1", "r2": "R2"}
FALSE = "false clusters per frame"
PUBLISHED_FRAMES = 50  # that were labelled by hand (section 5.1.1)


@dataclass(frozen=True)
class BlindTest:
    """A printed table, the saved one that holds ours, and what is compared."""

    table: str
    file: str
    keys: tuple[str, ...]
    quantities: tuple[str, ...] = ("precision", "recall", "f1")
    only: tuple[tuple[str, str], ...] = ()  # rows: column and value
    fitted: tuple[str, ...] = ()  # cases to which an input was fitted: no test


CLUSTERS = BlindTest(
    "5.8", "table-5-8-dbscan", ("minPts", "epsilon_mm"), only=(("subset", "Total"),)
)
TESTS = (
    CLUSTERS,
    BlindTest("5.9", "table-5-9-mo", ("R",), only=(("subset", "Total"),)),
    BlindTest("5.10", "table-5-10-qcc", ("K", "alpha"), only=(("subset", "Total"),)),
    BlindTest(
        "5.11",
        "table-5-11-detection",
        ("method",),
        only=(("reading", ABSOLUTE),),
        fitted=("2D-OTSU",),
    ),
    BlindTest(
        "5.17",
        "table-5-17-tracking",
        ("fraction", "tracker", "postprocessing"),
        ("alpha", "beta", "jsc", "jsc_theta"),
        (("reading", FROM_LANCE),),
    ),
    BlindTest("5.18", "table-5-18-regression", ("fraction", "axis"), ("r2",)),
)


def saved_table(test: BlindTest, folder: Path) -> pd.DataFrame:
    """Return the saved table of a test, or raise an `InputError` if it is not there."""
    path = folder / f"{test.file}.csv"
    if not path.is_file():
        raise InputError(f"{path} is missing; run the notebook of Table {test.table}.")
    return pd.read_csv(path)


def measured(test: BlindTest, folder: Path) -> pd.DataFrame:
    """Return what a saved table holds of a test, one row for each number that is printed, too.

    Returns
    -------
    DataFrame
        ``table``, ``case`` (settings in words), ``quantity``, ``published``, ``value``.

    Raises
    ------
    InputError
        If the table is not there.
    """
    rows = saved_table(test, folder)
    for column, value in test.only:
        rows = rows[rows[column] == value]
    forms = [f"{key} {{}}" if rows[key].dtype.kind in "if" else "{}" for key in test.keys]
    cases = [
        ", ".join(form.format(value) for form, value in zip(forms, row, strict=True))
        for row in rows[list(test.keys)].itertuples(index=False)
    ]
    parts = [
        pd.DataFrame(
            {
                "table": test.table,
                "case": cases,
                "quantity": quantity,
                "published": rows[quantity + SUFFIX].to_numpy(),
                "value": rows[quantity].to_numpy(),
            }
        )
        for quantity in test.quantities
    ]
    table = pd.concat(parts, ignore_index=True).dropna(subset="published")
    return table[~table["case"].isin(test.fitted)]


def compare(folder: Path | None = None) -> pd.DataFrame:
    """Return every number of the blind tests, printed and by both twins.

    Parameters
    ----------
    folder
        Of the saved tables; default figures/.

    Returns
    -------
    DataFrame
        ``table``, ``case``, ``quantity``, ``published``, ``first_twin`` (at full scale; NaN where
        it has none), ``second_look``, and ``nearer`` to print, one of `TWINS` or "alike".
    """
    folder = folder or paths.figures()
    table = pd.concat([measured(test, folder) for test in TESTS], ignore_index=True)
    first = pd.read_csv(paths.reference() / "first_twin_tables.csv", dtype={"table": str})
    table = table.rename(columns={"value": "second_look"}).merge(first, how="left")
    table.insert(4, "first_twin", table.pop("first_twin"))
    before = (table["first_twin"] - table["published"]).abs()
    now = (table["second_look"] - table["published"]).abs()
    unknown = before.isna() | now.isna()
    known = [unknown, now < before, before < now]
    nearer = np.select(known, ["", TWINS[1], TWINS[0]], default="alike")
    return table.assign(nearer=nearer)


def false_clusters(folder: Path | None = None) -> pd.DataFrame:
    """Return the false positives of DBSCAN per labelled frame, Table 5.8, by its parameters.

    Parameters
    ----------
    folder
        Of the saved tables; default figures/.

    Returns
    -------
    DataFrame
        ``minPts``, ``epsilon_mm``, ``published``, ``first_twin``, ``second_look``, ``over_print``
        (the second look's over what is printed).

    Raises
    ------
    InputError
        If the table of DBSCAN is not there.
    """
    folder, keys = folder or paths.figures(), list(CLUSTERS.keys)
    table = saved_table(CLUSTERS, folder)
    saved = {each.identifier: each.provenance["parameters"] for each in entries(folder)}
    subsets = table["subset"].nunique() - 1  # and their total
    frames = saved[CLUSTERS.file]["frames"] * subsets
    total = table.loc[table["subset"] == "Total", [*keys, "fp"]]
    printed = claims.published("table_5.8")[[*keys, "FP"]].astype(float)
    rows = total.merge(printed, on=keys)
    case = [f"minPts {a:g}, epsilon_mm {b:g}" for a, b in rows[keys].to_numpy()]
    first = pd.read_csv(paths.reference() / "first_twin_tables.csv", dtype={"table": str})
    before = first[first["quantity"] == FALSE].set_index("case")["first_twin"]
    rows = rows.assign(
        published=rows["FP"] / PUBLISHED_FRAMES, first_twin=before.reindex(case).to_numpy()
    )
    rows = rows.assign(second_look=rows["fp"] / frames)
    rows["over_print"] = rows["second_look"] / rows["published"]
    return rows.drop(columns=["fp", "FP"]).sort_values(keys, ignore_index=True)


def by_table(numbers: pd.DataFrame) -> pd.DataFrame:
    """Return how far both twins are from print, by table and quantity.

    Returns
    -------
    DataFrame
        ``table``, ``quantity``, ``numbers``, ``first_twin_apart`` and ``second_look_apart``
        (medians of the absolute difference from print), ``second_look_nearer`` (how often).
    """
    apart = numbers.assign(
        first_twin_apart=(numbers["first_twin"] - numbers["published"]).abs(),
        second_look_apart=(numbers["second_look"] - numbers["published"]).abs(),
        second_look_nearer=numbers["nearer"] == TWINS[1],
    )
    groups = apart.groupby(["table", "quantity"], sort=False)
    rows = groups[["first_twin_apart", "second_look_apart"]].median()
    rows.insert(0, "numbers", groups.size())
    return rows.assign(second_look_nearer=groups["second_look_nearer"].sum()).reset_index()


def draw(numbers: pd.DataFrame) -> Figure:
    """Draw ours against print, a panel for each table: first twin open, second look filled."""
    picture, grid = canvas(2, 3, width_mm=170, height_mm=110)
    for axes, (name, rows) in zip(grid.flat, numbers.groupby("table", sort=False), strict=False):
        low = min(0.0, rows[["first_twin", "second_look"]].min().min()) - 0.03  # R2 may be below 0
        axes.plot([0, 1], [0, 1], color="black", lw=0.6, ls="-")
        looks = {"mfc": "none", "ms": 4, "mew": 0.7, "marker": "o", "ls": "none"}
        axes.plot(rows["published"], rows["first_twin"], color="black", label=TWINS[0], **looks)
        looks |= {"mfc": COLOURS[1], "mec": COLOURS[1], "marker": "s", "ms": 3}
        axes.plot(rows["published"], rows["second_look"], label=TWINS[1], **looks)
        shown = ", ".join(NAMES.get(each, each) for each in rows["quantity"].unique())
        axes.set(title=f"Table {name}\n{shown}", xlim=(-0.03, 1.03), ylim=(low, 1.03))
        axes.set(xlabel="published (1)", ylabel="simulated (1)")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    picture.legend(handles, labels, loc="outside upper center", ncols=2)
    return picture


def describe(summary: pd.DataFrame, clusters: pd.DataFrame) -> str:
    """Return in sentences how the second look did: `by_table` and `false_clusters`."""
    total = summary.groupby("table", sort=False)[["numbers", "second_look_nearer"]].sum()
    parts = [
        f"{int(row['second_look_nearer'])} of {int(row['numbers'])} (Table {name})"
        for name, row in total.iterrows()
    ]
    farther = summary[summary["second_look_apart"] > summary["first_twin_apart"]]
    names = [
        f"{NAMES.get(row['quantity'], row['quantity'])} of Table {row['table']} "
        f"({row['first_twin_apart']:.3f}, now {row['second_look_apart']:.3f})"
        for _, row in farther.iterrows()
    ]
    by_eps = clusters.groupby("epsilon_mm")["over_print"].median()
    ratios = ", ".join(f"{ratio:.1f} at {eps:g} mm" for eps, ratio in by_eps.items())
    return (
        f"Nearer to print than the first twin: {', '.join(parts)}. Farther in the median: "
        f"{', '.join(names) or 'nothing'}. False clusters of DBSCAN over print, median by epsilon: "
        f"{ratios}."
    )
