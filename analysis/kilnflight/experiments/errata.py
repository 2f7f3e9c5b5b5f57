"""The published tables, recomputed: every number that another number determines.

A printed value agrees when it differs from the recomputed one by no more than half a
unit of its last printed digit. Tables are kept as printed in data/reference/published;
sentences that a table can confirm or refute are in data/reference/statements.csv.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pandas as pd

from kilnflight.camera import EQUATION_2_4, invert_depth
from kilnflight.checks import InputError
from kilnflight.project import claims, paths
from kilnflight.scores import rates
from kilnflight.twin.gas import AMBIENT_BAR

COUNTS = ["TP", "FP", "FN"]
RATE_TABLES = ("5.5", "5.6", "5.8", "5.9", "5.10", "5.11", "5.13", "5.14")
SUBSETS = ["V1", "V2", "V3", "V4", "V5"]
# Frames per second of the recordings (thesis 2.1.4; PE granules 5.2.3).
FRAME_RATES = {"wood chip": 330.0, "confetti": 330.0, "paper shred": 330.0, "PE granule": 153.85}


QCC_CONSEQUENCE = "yes: see 'best F1 of QCC' and 'lead in F1 of QCC over DBSCAN'"
RATE_CONSEQUENCES = {
    "Table 5.10, K=30, alpha=0.1": QCC_CONSEQUENCE,
    "Table 5.11, 3D-QCC Clustering": QCC_CONSEQUENCE,
    "Table 5.11, 3D-MO-based Clustering": "no: Table 5.9 has 0.5970, which the printed F1 fits",
}


class Check(NamedTuple):
    """One printed number beside what it should be."""

    where: str
    quantity: str
    printed: str
    recomputed: float | str
    agrees: bool
    consequence: str = ""


def agrees(printed: str, recomputed: float) -> bool:
    """Say whether a printed number is the recomputed one, rounded as printed.

    ``"<8"`` and ``">0"`` are bounds. A tie may be rounded either way.

    Examples
    --------
    >>> agrees("0.8436", 0.84356), agrees("0.6210", 0.5808), agrees("<8", 7.6)
    (True, False, True)
    """
    bound = re.match(r"[<>]", printed)
    if bound:
        limit = float(printed[1:])
        return recomputed < limit if bound.group() == "<" else recomputed > limit
    digits = printed.rstrip("%")
    decimals = len(digits.partition(".")[2])
    return abs(float(digits) - recomputed) <= 0.5 * 10**-decimals * (1 + 1e-9)


def _check(
    where: str, quantity: str, printed: str, recomputed: float, consequence: str = ""
) -> Check:
    return Check(where, quantity, printed, recomputed, agrees(printed, recomputed), consequence)


def _row_name(row: pd.Series) -> str:
    """Return what tells a row from the others: texts, names and values of numbers."""
    texts = row[row.index.isin(["subset", "test_set", "method"])].tolist()
    numbers = row[row.index.isin(["minPts", "epsilon_mm", "R", "K", "alpha"])]
    return ", ".join([*texts, *(f"{name}={value}" for name, value in numbers.items())])


def printed_rates(table: str) -> pd.DataFrame:
    """Load a table with TP, FP, FN, every cell as printed, the shifted row put right.

    The last row of Table 5.6 stands one column to the left: its 3687, 354, 700 are TP,
    FP, FN, and the 271 under FN repeats the value of V5.
    """
    printed = claims.published(f"table_{table}", as_printed=True)
    if table == "5.6":
        total = printed["test_set"] == "Total"
        printed.loc[total, COUNTS] = printed.loc[total, ["dog_local_max", "TP", "FP"]].to_numpy()
    return printed


def _recomputed_rates(table: str, *index: str) -> pd.DataFrame:
    """Return precision, recall and F1 from printed counts, by the columns ``index``."""
    printed = printed_rates(table)
    exact = rates(*(printed[count].astype(float) for count in COUNTS))
    return exact.set_index([printed[name] for name in index]) if index else exact


def check_rates() -> Iterator[Check]:
    """Check every precision, recall and F1 of Tables 5.5-5.14 against TP, FP, FN."""
    for table in RATE_TABLES:
        exact = _recomputed_rates(table)
        for (_, row), (_, values) in zip(
            printed_rates(table).iterrows(), exact.iterrows(), strict=True
        ):
            where = f"Table {table}, {_row_name(row)}"
            for rate, value in zip(exact.columns, values.tolist(), strict=True):
                small = abs(float(row[rate]) - value) < 0.001
                consequence = "no: last digits only" if small else RATE_CONSEQUENCES.get(where, "")
                check = _check(where, rate, row[rate], value, consequence)
                yield check._replace(consequence="") if check.agrees else check


def check_sums() -> Iterator[Check]:
    """Check sums over subsets and classes, shares, and Table 5.2 against Table 5.3."""
    for table in ("5.5", "5.6", "5.13", "5.14"):
        printed = printed_rates(table)
        printed = printed.set_index(printed.columns[0])[COUNTS].T
        sums = printed.drop(columns="Total").astype(float).sum(axis=1)
        for count in COUNTS:
            yield _check(f"Table {table}, Total", count, printed["Total"][count], sums[count])
    classes = {
        where: claims.published(where.lower().replace(" ", "_"), as_printed=True).set_index("class")
        for where in ("Table 5.2", "Table 5.3")
    }
    for where, counted in classes.items():
        yield from _check_class_sums(counted, where)
    yield from _check_shares(*classes.values())


def _check_class_sums(table: pd.DataFrame, where: str) -> Iterator[Check]:
    """Check the rows burning, unlit, on the wall, in air and all of these.

    In air: burning or unlit.
    """
    counts = table[[*SUBSETS, "amount"]].astype(float)
    for column in counts.columns:
        for row in (3, 4):  # the sum of the rows before, but for the wall's in air
            place, total = f"{where}, {table.index[row]}", counts[column].iloc[: row - 1].sum()
            yield _check(place, column, table[column].iloc[row], total)
    for name, *printed in table[["amount", *SUBSETS]].itertuples(name=None):
        yield _check(f"{where}, {name}", "amount", printed[0], sum(map(float, printed[1:])))


def _check_shares(everything: pd.DataFrame, inside: pd.DataFrame) -> Iterator[Check]:
    """Check the shares of particles with depth, or in the region of interest.

    Shares of all particles.
    """
    share = "percentage_with_3d_info"
    for (name, row), (_, kept) in zip(everything.iterrows(), inside.iterrows(), strict=True):
        amount, where = float(row["amount"]), f"Table 5.3, {kept.name}"
        exact = 100 * float(row["with_3d_info"]) / amount
        yield _check(f"Table 5.2, {name}", share, row[share], exact)
        exact = 100 * float(kept["amount"]) / amount
        yield _check(where, "percentage of Table 5.2", kept["percentage"], exact)
        for subset in SUBSETS:  # the region of interest cannot hold more than the image
            most, quantity = float(row[subset]), f"{subset} not above Table 5.2"
            yield Check(where, quantity, kept[subset], most, float(kept[subset]) <= most)


def check_totals() -> Iterator[Check]:
    """Check that every detector is counted against the particles of Table 5.3."""
    inside = claims.published("table_5.3").set_index("class").T["Total"]
    for table in ("5.5", "5.6", "5.8", "5.9", "5.10", "5.11"):
        for name, printed in _particles(table).items():
            expected = float(inside.get(name, inside["amount"]))
            yield _check(f"Table {table}, {name}", "TP + FN", str(printed), expected)
    truth, detected = _particles("5.13"), _particles("5.14")
    for subset, printed, expected in zip(truth.index, detected, truth, strict=True):
        where, quantity = f"Table 5.14, {subset}", "TP + FN as in Table 5.13"
        yield _check(where, quantity, str(printed), float(expected))


def _particles(table: str) -> pd.Series:
    """Return TP + FN of each row of a table, by `_row_name`."""
    printed = printed_rates(table)
    found = printed["TP"].astype(int) + printed["FN"].astype(int)
    return found.set_axis(printed.apply(_row_name, axis=1))


def check_durations() -> Iterator[Check]:
    """Check the durations of App. A.1 against frames and frame rate.

    330 per s; PE 153.85 per s.
    """
    flight = claims.published("flight")
    for _, row in flight[flight["quantity"] == "sequence_length"].iterrows():
        printed = re.search(r"\(([\d.]+) s\)", str(row["value_as_printed"]))
        if printed:
            seconds = row["value_low"] / FRAME_RATES[row["fraction"]]
            where = f"App. A.1, {row['fraction']} at {row['pressure_bar']} bar"
            yield _check(where, "duration_s", printed.group(1), seconds, "no")


def recomputed_statements() -> dict[str, float]:
    """Return what the tables say about each sentence of statements.csv, by its id."""
    return {**_detection_statements(), **_other_statements()}


def best_f1_of_3d_methods() -> pd.DataFrame:
    """Return the best F1 settings of DBSCAN, MO and QCC, as printed and recomputed.

    Returns
    -------
    DataFrame
        Columns ``method``, ``setting``, ``printed_f1``, ``recomputed_f1``; two rows for a method
        whose best setting changes.
    """
    rows = []
    for method, table, names in (
        ("DBSCAN", "5.8", ("minPts", "epsilon_mm")),
        ("MO", "5.9", ("R",)),
        ("QCC", "5.10", ("K", "alpha")),
    ):
        exact = _recomputed_rates(table, *names)["f1"]
        printed = printed_rates(table)["f1"].astype(float)
        for best in dict.fromkeys([int(printed.argmax()), int(exact.argmax())]):
            values = np.atleast_1d(exact.index[best])
            settings = ", ".join(f"{n} {v}" for n, v in zip(names, values, strict=True))
            rows.append((method, settings.replace("_mm", ""), printed.iloc[best], exact.iloc[best]))
    return pd.DataFrame(rows, columns=["method", "setting", "printed_f1", "recomputed_f1"])


def _detection_statements() -> dict[str, float]:
    f1 = _recomputed_rates("5.11", "method")["f1"]
    gain = [
        100 * (f1[name] - f1[f"2D-{name.split()[1].split('+')[0]}"])
        for name in f1.index
        if name.startswith("Combi")
    ]
    qcc = _recomputed_rates("5.10", "K", "alpha")["f1"]
    dbscan = _recomputed_rates("5.8", "minPts", "epsilon_mm")
    three_d = [dbscan["f1"].max(), _recomputed_rates("5.9", "R")["f1"].max(), qcc.max()]
    v5_otsu = _recomputed_rates("5.5", "subset")["f1"]["V5"]
    seconds = {
        table: claims.published(f"table_{table}").set_index(index)[column]
        for table, index, column in (
            ("5.7", "dog_local_max", "computation_time_s"),
            ("5.8", ["minPts", "epsilon_mm"], "time_per_image_s"),
            ("5.10", ["K", "alpha"], "time_per_image_s"),
        )
    }
    return {
        "qcc-best": qcc.max(),
        "three-d-best": qcc.max() - three_d[0],
        "three-d-gap": max(three_d) - min(three_d),
        "combined-gain-low": min(gain),
        "combined-gain-high": max(gain),
        "combined-gain-mean": float(np.mean(gain)),
        "qcc-alpha": (qcc["30", "0.1"] - qcc["30", "0.2"]) - (qcc["20", "0.1"] - qcc["20", "0.2"]),
        "dog-threshold": f1["2D-SIFT"] - 0.8592,  # of the median filter in Fig. 5.4
        "dbscan-time": seconds["5.8"][10, 50] - seconds["5.8"][6, 50],
        "dbscan-precise": dbscan["precision"].max(),
        "sift-otsu-v5": _recomputed_rates("5.6", "test_set")["f1"]["V5"] - v5_otsu,
        "otsu-v5": v5_otsu,
        "qcc-time": seconds["5.10"][20, 0.1] - seconds["5.10"][20, 0.2],
        "sift-time": seconds["5.7"][900] - seconds["5.7"][1000],
    }


def _other_statements() -> dict[str, float]:
    truth, detected = (
        printed_rates(table).set_index("subset")[COUNTS].astype(float).T["Total"]
        for table in ("5.13", "5.14")
    )
    falling = EQUATION_2_4.falling(1300.0, 11000.0)
    bias = np.abs(invert_depth([3000.0, 4000.0, 5000.0]) - [3000.0, 4000.0, 5000.0])
    tracking = claims.published("table_5.17")
    without = tracking[tracking["post_processing"] == "without"]
    raw = without["value"][without["measure"].isin(["alpha", "beta"])].astype(float)
    theta = tracking[tracking["measure"] == "JSC_theta"]
    theta = theta.pivot(index=["fraction", "algorithm"], columns="post_processing", values="value")
    return {
        "depth-centimetres": float(bias.max()),
        "tracking-raw": 100.0 * float(raw.between(0.2, 0.3).mean()),
        "tracking-gain": 100.0 * float((theta["with"] - theta["without"]).max()),
        "false-positives-wall": detected["FP"] - truth["FP"],
        "air-misclassified": 100 * truth["FN"] / (truth["TP"] + truth["FN"]),
        "wood-5-bar": 100.0 - 6.0,  # the 6 % that sec. 5.3.1 itself reports as landed
        "lance-bore": min(lance_bores_apart(at_feed) for at_feed in (True, False)),
        "depth-jump-3000": float(EQUATION_2_4.jumps()[0]),
        "depth-jump-5000": float(EQUATION_2_4.jumps()[1]),
        "depth-falls": float(np.ptp(falling)) if len(falling) else 0.0,
    }


def lance_bores_apart(at_feed: bool) -> float:
    """Return the gap in mm between the bores of the lance that section 2.1.1 prints, 0 if none.

    Air flow and outlet velocity are printed at 0.5 and at 5 bar, the velocities to 1 m/s; so each
    pair gives a range of bores.

    Parameters
    ----------
    at_feed
        Whether the flow is at the pressure of the feed, or at the outlet, which the text does not
        say. Then the air expands to ambient pressure.
    """
    ranges = []
    for bar, flow_m3_h, velocity_m_s in ((0.5, 70.5, 4.0), (5.0, 76.6, 16.0)):
        at_outlet = flow_m3_h * (bar / AMBIENT_BAR + 1 if at_feed else 1.0)
        ends = [at_outlet / 3600 / (velocity_m_s + rounding) for rounding in (0.5, -0.5)]
        ranges.append([2000 * float(np.sqrt(area / np.pi)) for area in ends])
    (low, high), (least, most) = ranges
    return max(low - most, least - high, 0.0)


def check_statements() -> Iterator[Check]:
    """Check the sentences of statements.csv.

    Those about words carry their correction.
    """
    table = pd.read_csv(paths.reference() / "statements.csv", dtype=str, keep_default_na=False)
    values = recomputed_statements()
    numbers = set(table.loc[table["expected"] != "", "id"])
    if numbers != set(values):
        raise InputError(
            f"statements.csv and errata.py disagree about {sorted(numbers ^ set(values))}: each "
            "sentence with an expected number needs its recomputation, and the other way round."
        )
    for _, row in table.iterrows():
        value = values.get(row["id"], row["should_be"])
        right = bool(row["expected"]) and agrees(row["expected"], value)
        where, quantity, printed = row[["where", "quantity", "printed"]]
        yield Check(where, quantity, printed, value, right, row["consequence"])


def recompute() -> pd.DataFrame:
    """Return every check, one row each: where, quantity, printed, recomputed, agrees."""
    steps = (check_rates, check_sums, check_totals, check_durations, check_statements)
    return pd.DataFrame([check for step in steps for check in step()], columns=Check._fields)


def errata(checks: pd.DataFrame | None = None) -> pd.DataFrame:
    """Return what disagrees: where, printed, recomputed, consequence.

    Where: with the quantity.
    """
    table = recompute() if checks is None else checks
    wrong = table[~table["agrees"]]
    return pd.DataFrame(
        {
            "where": wrong["where"] + ": " + wrong["quantity"],
            "printed": wrong["printed"],
            "recomputed": [v if isinstance(v, str) else f"{v:.5g}" for v in wrong["recomputed"]],
            "consequence": wrong["consequence"],
        }
    ).reset_index(drop=True)
