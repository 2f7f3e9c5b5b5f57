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

from kilnflight.camera import EQUATION_2_4, PLATE_DISTANCES_MM, invert_depth
from kilnflight.publication import claims
from kilnflight.scores import rates
from kilnflight.store import paths

AMBIENT_BAR = 1.01325
COUNTS = ["TP", "FP", "FN"]
RATE_TABLES = ("5.5", "5.6", "5.8", "5.9", "5.10", "5.11", "5.13", "5.14")
SUBSETS = ["V1", "V2", "V3", "V4", "V5"]
# Frames per second of the recordings (thesis 2.1.4; PE granules 5.2.3).
FRAME_RATES = {
    "wood chip": 330.0,
    "confetti": 330.0,
    "paper shred": 330.0,
    "PE granule": 153.85,
}


QCC_CONSEQUENCE = "yes: see 'best F1 of QCC' and 'lead in F1 of QCC over DBSCAN'"
RATE_CONSEQUENCES = {
    "Table 5.10, K=30, alpha=0.1": QCC_CONSEQUENCE,
    "Table 5.11, 3D-QCC Clustering": QCC_CONSEQUENCE,
    "Table 5.11, 3D-MO-based Clustering": "no: Table 5.9 has 0.5970, which the printed F1 fits",
}


class Check(NamedTuple):
    """One printed number beside its recomputed value; a row of `recompute`."""

    where: str  # table and row, or section
    quantity: str
    printed: str
    recomputed: float | str  # a text for sentences about words
    agrees: bool
    consequence: str = (
        ""  # whether a conclusion of the thesis depends on it, if it disagrees
    )


def agrees(printed: str, recomputed: float) -> bool:
    """Return whether a printed number equals the recomputed one, rounded as printed.

    ``"<8"`` and ``">0"`` are bounds, a final % is ignored. A tie may be rounded either
    way.

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
    """Return the check of a printed number against its recomputed value."""
    return Check(
        where, quantity, printed, recomputed, agrees(printed, recomputed), consequence
    )


def _row_name(row: pd.Series) -> str:
    """Return the unique name of a table's row, such as "K=30, alpha=0.1" or "V1"."""
    texts = row[row.index.isin(["subset", "test_set", "method"])].tolist()
    numbers = row[row.index.isin(["minPts", "epsilon_mm", "R", "K", "alpha"])]
    return ", ".join([*texts, *(f"{name}={value}" for name, value in numbers.items())])


def printed_rates(table: str) -> pd.DataFrame:
    """Load one of `RATE_TABLES` as printed strings, indexed by `_row_name`.

    One row is corrected. The last row of Table 5.6 is printed one column too far left:
    its 3687, 354, 700 are TP, FP, FN, and the 271 under FN repeats the value of V5.
    """
    printed = claims.published(f"table_{table}", as_printed=True)
    if table == "5.6":
        total = printed["test_set"] == "Total"
        printed.loc[total, COUNTS] = printed.loc[
            total, ["dog_local_max", "TP", "FP"]
        ].to_numpy()
    return printed.set_axis(printed.apply(_row_name, axis=1))


def recomputed_rates(table: str) -> pd.DataFrame:
    """Return precision, recall and F1 of one of `RATE_TABLES` from its counts.

    One row per printed row, indexed by `_row_name`.
    """
    counts = printed_rates(table)[COUNTS].astype(float)
    return rates(*counts.to_numpy().T).set_axis(counts.index)


def check_rates() -> Iterator[Check]:
    """Check precision, recall and F1 of `RATE_TABLES` against TP, FP and FN.

    Yields one `Check` per printed rate. `RATE_CONSEQUENCES` tells which wrong ones
    matter.
    """
    for table in RATE_TABLES:
        exact = recomputed_rates(table)
        for (name, values), (_, row) in zip(
            exact.iterrows(), printed_rates(table).iterrows(), strict=True
        ):
            where = f"Table {table}, {name}"
            for rate, value in zip(exact.columns, values.tolist(), strict=True):
                small = abs(float(row[rate]) - value) < 0.001
                consequence = (
                    "no: last digits only"
                    if small
                    else RATE_CONSEQUENCES.get(where, "")
                )
                check = _check(where, rate, row[rate], value, consequence)
                yield check._replace(consequence="") if check.agrees else check


def check_sums() -> Iterator[Check]:
    """Check the sums over subsets and classes in Tables 5.2 to 5.14, and shares.

    The row "Total" of four tables must be the sum of the other rows.
    """
    for table in ("5.5", "5.6", "5.13", "5.14"):
        printed = printed_rates(table)[COUNTS].T
        sums = printed.drop(columns="Total").astype(float).sum(axis=1)
        for count in COUNTS:
            yield _check(
                f"Table {table}, Total", count, printed["Total"][count], sums[count]
            )
    classes = {
        where: claims.published(
            where.lower().replace(" ", "_"), as_printed=True
        ).set_index("class")
        for where in ("Table 5.2", "Table 5.3")
    }
    for where, counted in classes.items():
        yield from _check_class_sums(counted, where)
    yield from _check_shares(*classes.values())


def _check_class_sums(table: pd.DataFrame, where: str) -> Iterator[Check]:
    """Check the sums in Table 5.2 or 5.3 (``where``), over classes and over subsets.

    The rows of ``table`` must be: burning in air, non-burning in air, burning on the
    wall, in air (the first two), amount (the first three). Cells are printed strings.
    """
    counts = table[[*SUBSETS, "amount"]].astype(float)
    for column in counts.columns:
        for row in (
            3,
            4,
        ):  # in air is the sum of rows 0 and 1, amount that of rows 0 to 2
            place = f"{where}, {table.index[row]}"
            total = counts[column].iloc[: row - 1].sum()
            yield _check(place, column, table[column].iloc[row], total)
    for name, *printed in table[["amount", *SUBSETS]].itertuples(name=None):
        yield _check(
            f"{where}, {name}", "amount", printed[0], sum(map(float, printed[1:]))
        )


def _check_shares(everything: pd.DataFrame, inside: pd.DataFrame) -> Iterator[Check]:
    """Check the percentages in Tables 5.2 (depth) and 5.3 (region of interest).

    Both are shares of the particles of Table 5.2. ``everything`` is Table 5.2,
    ``inside`` Table 5.3, with the same classes in the same order; cells are printed
    strings.
    """
    share = "percentage_with_3d_info"
    for (name, row), (_, kept) in zip(
        everything.iterrows(), inside.iterrows(), strict=True
    ):
        amount = float(row["amount"])
        where = f"Table 5.3, {kept.name}"
        exact = 100 * float(row["with_3d_info"]) / amount
        yield _check(f"Table 5.2, {name}", share, row[share], exact)
        exact = 100 * float(kept["amount"]) / amount
        yield _check(where, "percentage of Table 5.2", kept["percentage"], exact)
        for subset in SUBSETS:  # the region of interest cannot hold more than the image
            most = float(row[subset])
            quantity = f"{subset} not above Table 5.2"
            yield Check(
                where, quantity, kept[subset], most, float(kept[subset]) <= most
            )


def check_totals() -> Iterator[Check]:
    """Check that TP + FN of every detector is the particles of Table 5.3.

    Table 5.13 is not restricted to the region of interest, so its own TP + FN is the
    reference for Table 5.14. Table 5.13 must therefore precede Table 5.14 in
    `RATE_TABLES`.
    """
    inside = claims.published("table_5.3").set_index("class").T["Total"]
    quantity = "TP + FN"
    for table in RATE_TABLES:
        found = printed_rates(table)[["TP", "FN"]].astype(int).sum(axis=1)
        if table == "5.13":
            inside = found
            quantity = "TP + FN as in Table 5.13"
            continue
        for name, printed in found.items():
            expected = float(inside[str(name) if name in inside else "amount"])
            yield _check(f"Table {table}, {name}", quantity, str(printed), expected)


def check_durations() -> Iterator[Check]:
    """Check the durations (s) of App. A.1 against frames and `FRAME_RATES`."""
    flight = claims.published("flight")
    for _, row in flight[flight["quantity"] == "sequence_length"].iterrows():
        printed = re.search(r"\(([\d.]+) s\)", str(row["value_as_printed"]))
        if printed:
            seconds = row["value_low"] / FRAME_RATES[row["fraction"]]
            where = f"App. A.1, {row['fraction']} at {row['pressure_bar']} bar"
            yield _check(where, "duration_s", printed.group(1), seconds, "no")


def recomputed_statements() -> dict[str, float]:
    """Return the value of the tables for each sentence of statements.csv, by id.

    Units are those of the sentence: F1, points of F1, seconds, mm, m or percent.
    """
    exact = {table: recomputed_rates(table) for table in RATE_TABLES}
    f1 = {table: part["f1"] for table, part in exact.items()}
    best = {table: f1[table].max() for table in ("5.8", "5.9", "5.10")}
    both = f1["5.11"]
    qcc = f1["5.10"]
    combined = both[both.index.str.startswith("Combi")]
    gain = 100 * (
        combined.to_numpy() - both["2D-" + combined.index.str[6:10]].to_numpy()
    )
    by_alpha = [qcc[f"K={k}, alpha=0.1"] - qcc[f"K={k}, alpha=0.2"] for k in (20, 30)]
    sift_s = claims.published("table_5.7").set_index("dog_local_max")[
        "computation_time_s"
    ]
    dbscan_s = claims.published("table_5.8").set_index(["minPts", "epsilon_mm"])[
        "time_per_image_s"
    ]
    qcc_s = claims.published("table_5.10").set_index(["K", "alpha"])["time_per_image_s"]
    truth, detected = (
        printed_rates(table)[COUNTS].astype(float).T["Total"]
        for table in ("5.13", "5.14")
    )
    bias = np.abs(
        invert_depth(PLATE_DISTANCES_MM) - PLATE_DISTANCES_MM
    )  # of 1, 2, ... 11 m
    tracking = claims.published("table_5.17")
    without = tracking[tracking["post_processing"] == "without"]
    raw = without["value"][without["measure"].isin(["alpha", "beta"])].astype(float)
    theta = tracking[tracking["measure"] == "JSC_theta"]
    theta = theta.pivot(
        index=["fraction", "algorithm"], columns="post_processing", values="value"
    )
    return {
        "qcc-best": best["5.10"],
        "three-d-best": best["5.10"] - best["5.8"],
        "three-d-gap": max(best.values()) - min(best.values()),
        "combined-gain-low": float(gain.min()),
        "combined-gain-high": float(gain.max()),
        "combined-gain-mean": float(gain.mean()),
        "qcc-alpha": by_alpha[1] - by_alpha[0],
        "dog-threshold": both["2D-SIFT"] - 0.8592,  # of the median filter in Fig. 5.4
        "dbscan-time": dbscan_s[10, 50] - dbscan_s[6, 50],
        "dbscan-precise": exact["5.8"]["precision"].max(),
        "sift-otsu-v5": f1["5.6"]["V5"] - f1["5.5"]["V5"],
        "otsu-v5": f1["5.5"]["V5"],
        "qcc-time": qcc_s[20, 0.1] - qcc_s[20, 0.2],
        "sift-time": sift_s[900] - sift_s[1000],
        "depth-centimetres": float(bias[2:5].max()),
        "depth-middle": float(bias[5:8].mean()) / 1000,
        "depth-far": float(bias[8:].max() - bias[7]),
        "tracking-raw": 100.0 * float(raw.between(0.2, 0.3).mean()),
        "tracking-gain": 100.0 * float((theta["with"] - theta["without"]).max()),
        "false-positives-wall": detected["FP"] - truth["FP"],
        "air-misclassified": 100 * truth["FN"] / (truth["TP"] + truth["FN"]),
        "wood-5-bar": 100.0 - 6.0,  # the 6 % that sec. 5.3.1 itself reports as landed
        "lance-bore": lance_bores_apart(),
        "depth-jump-3000": float(EQUATION_2_4.jumps()[0]),
        "depth-jump-5000": float(EQUATION_2_4.jumps()[1]),
        "depth-falls": float(np.ptp(EQUATION_2_4.falling(1300.0, 11000.0))),
    }


def lance_bores_apart() -> float:
    """Return the gap in mm between two bores of the lance, 0 if they overlap.

    Air flow and outlet velocity are printed at 0.5 and at 5 bar. Each pair gives the
    bore; as the velocity is rounded to 1 m/s, it gives a range. The flow is taken at
    the pressure of the feed, which the text does not say, and expands to ambient
    pressure.
    """
    bar, flow_m3_h, velocity_m_s = np.array([[0.5, 5.0], [70.5, 76.6], [4.0, 16.0]])
    outlet_m3_s = flow_m3_h * (bar / AMBIENT_BAR + 1) / 3600
    rounded_m_s = velocity_m_s + np.array([[0.5], [-0.5]])
    low, high = 2000 * np.sqrt(outlet_m3_s / rounded_m_s / np.pi)
    return max(float(low.max() - high.min()), 0.0)


def check_statements() -> Iterator[Check]:
    """Check the sentences of statements.csv against `recomputed_statements`.

    Sentences about words have no recomputed number. They carry their correction
    instead, and count as wrong.
    """
    table = pd.read_csv(
        paths.reference() / "statements.csv", dtype=str, keep_default_na=False
    )
    values = recomputed_statements()
    for _, row in table.iterrows():
        value = values.get(row["id"], row["should_be"])
        right = bool(row["expected"]) and agrees(row["expected"], value)
        where, quantity, printed = row[["where", "quantity", "printed"]]
        yield Check(where, quantity, printed, value, right, row["consequence"])


def recompute() -> pd.DataFrame:
    """Return every check, one row each.

    Returns
    -------
    DataFrame
        The fields of `Check`, and ``kind``: a printed "number", or a "sentence", which
        includes signs, bounds and captions.
    """
    steps = (check_rates, check_sums, check_totals, check_durations, check_statements)
    table = pd.DataFrame(
        [check for step in steps for check in step()], columns=Check._fields
    )
    is_number = table["printed"].str.fullmatch(r"\d+(\.\d+)?%?")
    return table.assign(kind=np.where(is_number, "number", "sentence"))
