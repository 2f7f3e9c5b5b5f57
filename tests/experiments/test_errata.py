import pandas as pd
import pytest

from kilnflight.experiments import errata
from kilnflight.publication import claims, notebooks
from kilnflight.store import paths


def statements():
    """The sentences of statements.csv that have a recomputed number."""
    table = pd.read_csv(paths.reference() / "statements.csv", keep_default_na=False)
    return table[table["expected"] != ""]


@pytest.fixture(scope="module")
def checks():
    return errata.recompute(dict.fromkeys(statements()["id"], 0.0))


@pytest.mark.parametrize(
    ("printed", "value", "right"),
    [
        ("0.50", 0.495, True),  # a tie may be rounded either way
        ("0.50", 0.5051, False),
        ("94%", 94.4, True),
        ("<8", 8.0, False),
        (">0", 0.1, True),
    ],
)
def test_agreement_is_half_a_unit_of_the_last_digit(printed, value, right):
    assert errata.agrees(printed, value) is right


def test_a_rate_recomputed_by_hand(checks):
    """Table 5.10, K = 30, alpha = 0.1: the F1 that decides which 3D method is best."""
    row = claims.published("table_5.10").set_index(["K", "alpha"]).loc[(30, 0.1)]
    by_hand = 2 * row["TP"] / (2 * row["TP"] + row["FP"] + row["FN"])
    check = checks.set_index(["where", "quantity"]).loc[
        ("Table 5.10, K=30, alpha=0.1", "f1")
    ]
    assert check["recomputed"] == pytest.approx(by_hand)
    assert (check["printed"], check["agrees"]) == ("0.6210", False)


def test_every_cell_of_every_rate_table_is_checked(checks):
    for table in errata.RATE_TABLES:
        rows = len(claims.published(f"table_{table}"))
        of_table = checks[checks["where"].str.startswith(f"Table {table},")]
        assert (
            of_table["quantity"].isin(["precision", "recall", "f1"]).sum() == 3 * rows
        )


def test_every_wrong_number_says_whether_a_conclusion_depends_on_it(checks):
    wrong = checks[~checks["agrees"] & (checks["kind"] == "number")]
    wrong = wrong[~wrong["quantity"].isin(statements()["quantity"])]
    assert len(wrong) == 14
    assert (wrong["consequence"] == "no: last digits only").sum() == 9
    assert wrong["consequence"].str.match(r"(no|yes|in part|not known)\b").all()
    assert statements()["consequence"].str.match(r"(no|yes|in part)\b").all()


def test_a_sentence_is_checked_against_its_value():
    table = statements().set_index("id")
    values = dict.fromkeys(table.index, 0.62)
    found = pd.DataFrame(errata.check_statements(values)).set_index("quantity")
    assert found.loc[table.loc["qcc-best", "quantity"], "agrees"]
    assert not found.loc[table.loc["three-d-gap", "quantity"], "agrees"]
    words = found[found["recomputed"] != 0.62]
    assert len(words)
    assert not words["agrees"].any()


def test_one_lance_fits_both_printed_flows_at_the_pressure_of_the_feed():
    """By hand, for flows at the outlet: 79 mm (4.5 m/s: 74.4) and 41 mm (15.5 m/s:
    41.8).
    """
    chapter = notebooks.borrow("00_claims")
    assert chapter.lance_bores_apart() == 0.0
    chapter.AMBIENT_BAR = 1e12  # no expansion
    assert chapter.lance_bores_apart() == pytest.approx(32.6, abs=0.1)
