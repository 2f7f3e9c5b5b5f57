"""data/reference against the publications themselves (skipped where they are not)."""

import re

import pytest

from kilnflight.project import claims, paths


def _text(seeds, number):
    return next(seeds.glob(f"{number}_*.txt")).read_text()


@pytest.mark.parametrize("table", ["5.5", "5.6", "5.8", "5.9", "5.10", "5.11", "5.13", "5.14"])
def test_every_printed_cell_stands_in_the_thesis(seeds, table):
    text = _text(seeds, "000")
    heading = text.rindex(f"**Table {table}.:**")
    near = text[max(0, heading - 6000) : heading + 6000]
    numbers = set(re.findall(r"\d+(?:\.\d+)?", near))
    printed = claims.published(f"table_{table}", as_printed=True)
    for column in ("TP", "FP", "FN", "precision", "recall", "f1"):
        missing = {cell for cell in printed[column] if cell and cell not in numbers}
        assert not missing, f"Table {table}, {column}: {missing}"


def test_equation_2_4_stands_in_the_thesis(seeds):
    text = _text(seeds, "000")
    equation = claims.published("depth_calibration", as_printed=True)
    for cell in equation.loc[equation["kind"] == "equation", "a1"]:
        assert cell in text


def test_our_copy_of_the_facts_is_theirs(seeds):
    theirs = seeds.parent / "reference"
    for path in sorted((theirs / "published").glob("*.csv")):
        assert (paths.reference() / "published" / path.name).read_text() == path.read_text()
    import pandas as pd

    table = pd.read_csv(theirs / "claims.csv", index_col="id")
    ours = claims.load()
    pd.testing.assert_frame_equal(ours[table.columns], table)
