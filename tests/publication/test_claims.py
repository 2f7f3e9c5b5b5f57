import re

import pandas as pd
import pytest

from kilnflight.publication import claims, figures, verdicts
from kilnflight.store import paths

MADE = figures.trace("00_claims", {})


def test_a_claim_has_one_of_three_verdicts_and_a_cause_only_where_it_fails(monkeypatch):
    table = claims.load()
    table.loc["bg-1", "cause"] = "twin"
    monkeypatch.setattr(claims, "load", lambda: table)
    found = [
        claims.check("bg-1", holds, 0.123456, "why") for holds in (True, False, None)
    ]
    assert [each.verdict for each in found] == list(claims.VERDICTS)
    assert [each.because for each in found] == ["", "twin", ""]
    assert {(each.measured, each.reason) for each in found} == {("0.1235", "why")}
    assert found[0].published == table.loc["bg-1", "sentence"]


def test_answers_have_three_values():
    assert claims.all_of(True, True) is True
    assert claims.all_of(True, None) is None
    assert claims.all_of(None, False) is False
    found = [claims.beyond(*interval) for interval in ((1, 2), (-1, 2), (-2, -1))]
    assert found == [True, None, False]
    for draws, answer in (
        (range(1, 9), True),
        (range(-4, 4), None),
        ([-1], False),
        ([], None),
    ):
        assert claims.above(pd.Series(draws, dtype=float)) is answer


def test_every_claim_is_collected_once_in_order_and_open_where_no_notebook_tests_it():
    figures.conclude(
        "One.", [claims.check("bg-2", True), claims.check("bg-1", False)], MADE
    )
    table = verdicts.collect()
    assert table["id"].tolist() == claims.load().index.tolist()
    counted = table["verdict"].value_counts()[list(claims.VERDICTS)]
    assert counted.tolist() == [1, 1, len(table) - 2]
    assert table.set_index("id").loc["bg-2", "notebook"] == "00_claims"
    assert not table.isna().any(axis=None)


# data/reference against the publications themselves (skipped where they are not)


@pytest.mark.parametrize(
    "table", ["5.5", "5.6", "5.8", "5.9", "5.10", "5.11", "5.13", "5.14"]
)
def test_every_printed_cell_stands_in_the_thesis(seeds, table):
    text = next(seeds.glob("000_*.txt")).read_text()
    heading = text.rindex(f"**Table {table}.:**")
    near = text[max(0, heading - 6000) : heading + 6000]
    printed = claims.published(f"table_{table}", as_printed=True)
    cells = printed[["TP", "FP", "FN", "precision", "recall", "f1"]].to_numpy().ravel()
    assert {*cells} - {""} <= set(re.findall(r"\d+(?:\.\d+)?", near))


def test_our_copy_of_the_published_tables_is_theirs(seeds):
    for path in sorted((seeds.parent / "reference" / "published").glob("*.csv")):
        ours = pd.read_csv(paths.reference() / "published" / path.name, dtype=str)
        theirs = pd.read_csv(path, dtype=str)
        pd.testing.assert_frame_equal(
            ours[theirs.columns], theirs
        )  # flight.csv: one column more
