"""Limits of the numbers in saved tables, by the names of their columns."""

import re
from pathlib import Path

import numpy as np
import pandas as pd

BOUNDS = pd.read_csv(Path(__file__).parents[2] / "data" / "reference" / "bounds.csv")
VALUES = list(
    BOUNDS[BOUNDS["kind"] == "value"].itertuples(index=False)
)  # the first match holds
DIFFERENCE, SPREAD, SUFFIX = BOUNDS.loc[BOUNDS["kind"] != "value", "pattern"]


def impossible(table: pd.DataFrame, identifier: str = "") -> list[str]:
    """Return a sentence for every column of a table that holds an impossible number."""
    sentences = []
    for column in table.select_dtypes("number"):
        name = f"{identifier}/{column}".lower()
        plain = re.sub(SUFFIX, "", name)
        bound = next((row for row in VALUES if re.search(row.pattern, plain)), None)
        if bound is None:
            continue
        least, greatest = bound.least, bound.greatest
        difference, width = re.search(DIFFERENCE, name), greatest - least
        if difference or re.search(SPREAD, name):
            least, greatest = -width if difference else 0.0, width
        values = table[column].to_numpy(np.float64)
        outside = values[(values < least) | (values > greatest)]
        if len(outside):
            sentences.append(
                f"column {column}: {len(outside)} of {len(values)} outside {least:g} "
                f"to {greatest:g} ({bound.source}), worst {max(outside, key=abs):g}"
            )
    return sentences
