"""The published tables, recomputed: every number that another number determines.

A printed value agrees when it differs from the recomputed one by no more than half a
unit of its last printed digit. Tables are kept as printed in data/reference/published;
sentences that a table can confirm or refute are in data/reference/statements.csv.
"""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from pandas import DataFrame, Series

from kilnflight.publication import claims
from kilnflight.scores import rates
from kilnflight.simulated.kiln.scenes import RECORDED, SUBSETS
from kilnflight.store import paths

COUNTS = ["TP", "FP", "FN"]
RATE_TABLES = ("5.5", "5.6", "5.8", "5.9", "5.10", "5.11", "5.13", "5.14")
QCC_CONSEQUENCE = "yes: see 'best F1 of QCC' and 'lead in F1 of QCC over DBSCAN'"
MO_CONSEQUENCE = "no: Table 5.9 has 0.5970, which the printed F1 fits"
RATE_CONSEQUENCES = {
    "Table 5.10, K=30, alpha=0.1": QCC_CONSEQUENCE,
    "Table 5.11, 3D-QCC Clustering": QCC_CONSEQUENCE,
    "Table 5.11, 3D-MO-based Clustering": MO_CONSEQUENCE,
}


class Check(NamedTuple):
    """One printed number beside its recomputed value; a row of `recompute`."""

    where: str  # table and row, or section
    quantity: str
    printed: str
    recomputed: float | str  # a text for sentences about words
    agrees: bool
    # whether a conclusion of the thesis depends on it; empty if it agrees
    consequence: str = ""


def agrees(printed: str, recomputed: float) -> bool:
    """Return whether a printed number equals the recomputed one, rounded as printed.

    ``"<8"`` and ``">0"`` are bounds, a final % is ignored. A tie may be rounded either
    way.

    Examples
    --------
    >>> agrees("0.8436", 0.84356), agrees("0.6210", 0.5808), agrees("<8", 7.6)
    (True, False, True)
    """
    if printed.startswith("<"):
        return recomputed < float(printed[1:])
    if printed.startswith(">"):
        return recomputed > float(printed[1:])
    digits = printed.rstrip("%")
    decimals = len(digits.partition(".")[2])
    return abs(float(digits) - recomputed) <= 0.5 * 10**-decimals * (1 + 1e-9)


def _check(where: str, quantity: str, printed: str, recomputed: float) -> Check:
    """Compare a printed number with its recomputed value."""
    right = agrees(printed, recomputed)
    return Check(where, quantity, printed, recomputed, agrees=right)


def _row_name(row: Series) -> str:
    """Return the unique name of a table's row, such as "K=30, alpha=0.1" or "V1"."""
    texts = row.filter(["subset", "test_set", "method"])
    numbers = row.filter(["minPts", "epsilon_mm", "R", "K", "alpha"])
    return ", ".join([*texts, *(f"{name}={value}" for name, value in numbers.items())])


def printed_rates(table: str) -> DataFrame:
    """Load one of `RATE_TABLES` as printed strings, indexed by `_row_name`.

    One row is corrected. The last row of Table 5.6 is printed one column too far left:
    its 3687, 354, 700 are TP, FP, FN, and the 271 under FN repeats the value of V5.
    """
    printed = claims.published(f"table_{table}", as_printed=True)
    if table == "5.6":
        total = printed["test_set"] == "Total"
        shifted = printed.loc[total, ["dog_local_max", "TP", "FP"]]
        printed.loc[total, COUNTS] = shifted.to_numpy()
    return printed.set_axis(printed.apply(_row_name, axis=1))


def recomputed_rates(table: str) -> DataFrame:
    """Compute precision, recall and F1 of one of `RATE_TABLES` from its counts.

    One row per printed row, indexed by `_row_name`.
    """
    counts = printed_rates(table)[COUNTS].astype(float)
    return rates(*counts.to_numpy().T).set_axis(counts.index)


def check_rates() -> Iterator[Check]:
    """Check precision, recall and F1 of `RATE_TABLES` against TP, FP and FN.

    Yields
    ------
    Check
        One per printed rate.
    """
    for table in RATE_TABLES:
        printed = printed_rates(table)
        exact = recomputed_rates(table)
        for name in exact.index:
            where = f"Table {table}, {name}"
            for rate in ("precision", "recall", "f1"):
                check = _check(where, rate, printed[rate][name], exact[rate][name])
                if check.agrees:
                    yield check
                elif abs(float(check.printed) - exact[rate][name]) < 0.001:
                    yield check._replace(consequence="no: last digits only")
                else:
                    yield check._replace(consequence=RATE_CONSEQUENCES[where])


def check_sums() -> Iterator[Check]:
    """Check the sums over subsets and classes in Tables 5.2 to 5.14, and shares.

    The row "Total" of four tables must be the sum of the other rows.
    """
    for table in ("5.5", "5.6", "5.13", "5.14"):
        printed = printed_rates(table)[COUNTS]
        sums = printed.drop("Total").astype(float).sum()
        for count, total in sums.items():
            shown = printed[count]["Total"]
            yield _check(f"Table {table}, Total", str(count), shown, total)
    everything, inside = (
        claims.published(f"table_{table}", as_printed=True).set_index("class")
        for table in ("5.2", "5.3")
    )
    yield from _check_class_sums(everything, "Table 5.2")
    yield from _check_class_sums(inside, "Table 5.3")
    # Both percentages are shares of the particles of Table 5.2. Table 5.3 has the same
    # classes in the same order, but other words for them.
    share = "percentage_with_3d_info"
    rows = zip(everything.iterrows(), inside.iterrows(), strict=True)
    for (name, row), (named, kept) in rows:
        percent = float(row["amount"]) / 100
        where = f"Table 5.3, {named}"
        exact = float(row["with_3d_info"]) / percent
        yield _check(f"Table 5.2, {name}", share, row[share], exact)
        exact = float(kept["amount"]) / percent
        yield _check(where, "percentage of Table 5.2", kept["percentage"], exact)
        for subset in SUBSETS:  # the region of interest cannot hold more than the image
            most = float(row[subset])
            right = float(kept[subset]) <= most
            quantity = f"{subset} not above Table 5.2"
            yield Check(where, quantity, kept[subset], most, agrees=right)


def _check_class_sums(table: DataFrame, where: str) -> Iterator[Check]:
    """Check the sums in Table 5.2 or 5.3 (``where``), over classes and over subsets.

    The rows of ``table`` must be: burning in air, non-burning in air, burning on the
    wall, in air (the first two), amount (the first three). Cells are printed strings.
    """
    counts = table[[*SUBSETS, "amount"]].astype(float)
    for column, values in counts.items():
        for row, summed in ((3, 2), (4, 3)):
            place = f"{where}, {table.index[row]}"
            total = values[:summed].sum()
            yield _check(place, str(column), table[column].iloc[row], total)
    sums = counts[[*SUBSETS]].sum(axis=1)
    for name in table.index:
        yield _check(f"{where}, {name}", "amount", table["amount"][name], sums[name])


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
        for name in found.index:
            expected = float(inside[name if name in inside else "amount"])
            where = f"Table {table}, {name}"
            yield _check(where, quantity, str(found[name]), expected)


def check_durations() -> Iterator[Check]:
    """Check the durations (s) of App. A.1 against frames and `FRAME_RATES`."""
    flight = claims.published("flight").query("quantity == 'sequence_length'")
    printed = flight["value_as_printed"].str.extract(r"\(([\d.]+) s\)", expand=False)
    for _, row in flight.assign(printed=printed).dropna(subset="printed").iterrows():
        rate = RECORDED[row["fraction"]]["rate_hz"]
        where = f"App. A.1, {row['fraction']} at {row['pressure_bar']} bar"
        check = _check(where, "duration_s", row["printed"], row["value_low"] / rate)
        yield check._replace(consequence="no")


def check_statements(values: Mapping[str, float]) -> Iterator[Check]:
    """Check the sentences of statements.csv against recomputed values by id.

    Sentences about words have no recomputed number. They carry their correction
    instead, and count as wrong.
    """
    table = pd.read_csv(
        paths.reference() / "statements.csv", dtype=str, keep_default_na=False
    )
    row: Any
    for row in table.itertuples():
        value = values.get(row.id, row.should_be)
        yield Check(
            where=row.where,
            quantity=row.quantity,
            printed=row.printed,
            recomputed=value,
            agrees=row.expected != "" and agrees(row.expected, value),
            consequence=row.consequence,
        )


def recompute(statements: Mapping[str, float]) -> DataFrame:
    """Recompute every number that others determine, one row each.

    Parameters
    ----------
    statements
        Value of the tables for each sentence of statements.csv, by id.

    Returns
    -------
    DataFrame
        The fields of `Check`, and ``kind``: a printed "number", or a "sentence", which
        includes signs, bounds and captions.
    """
    checks = [
        *check_rates(),
        *check_sums(),
        *check_totals(),
        *check_durations(),
        *check_statements(statements),
    ]
    table = DataFrame(checks, columns=Check._fields)
    is_number = table["printed"].str.fullmatch(r"\d+(\.\d+)?%?")
    return table.assign(kind=np.where(is_number, "number", "sentence"))
