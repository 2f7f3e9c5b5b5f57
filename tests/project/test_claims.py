import numpy as np
import pandas as pd
import pytest

from kilnflight.checks import InputError
from kilnflight.project import claims as reference


def test_tables_keep_what_was_printed():
    printed = reference.published("table_5.5", as_printed=True)
    assert printed.loc[0, "precision"].startswith("0.")
    assert reference.published("table_5.5")["TP"].dtype.kind == "i"


def test_an_unknown_table_is_told_with_those_there_are():
    with pytest.raises(InputError, match=r"'table_9' *; there are .*table_5\.5"):
        reference.published("table_9")


def test_every_claim_has_an_id_of_its_own_and_says_what_is_expected():
    claims = reference.claims()
    assert claims.index.is_unique
    assert (claims["expect"].str.len() > 0).all()
    bounds = claims[["low", "high"]]
    assert (bounds["low"].fillna(-np.inf) < bounds["high"].fillna(np.inf)).all()


@pytest.mark.parametrize(
    ("value", "verdict"),
    [
        (200.0, "reproduced"),
        ([200.0, 450.0], "reproduced"),
        ([300.0, 450.1], "not reproduced"),
        (-300.0, "not reproduced"),
    ],
)
def test_bounds_are_included_and_every_value_counts(value, verdict):
    assert reference.judge("depth-3", value).verdict == verdict


def test_labels_of_a_series_are_told():
    measured = pd.Series([294.81, 362.0], index=["6 m", "7 m"])
    assert reference.judge("depth-3", measured).measured == "6 m 294.8, 7 m 362"


def test_conditions_must_all_hold_and_are_written_out():
    verdict = reference.judge("depth-4", {"9 m": True, "10 m": False}, note="why")
    assert verdict.verdict == "not reproduced"
    assert verdict.measured == "9 m: yes; 10 m: NO"
    assert verdict.reason == "why"


@pytest.mark.parametrize(
    ("claim", "measured"),
    [
        ("nothing-1", 1.0),
        ("depth-3", {"a": True}),
        ("depth-4", 3.0),
        ("depth-4", {}),
        ("depth-3", np.nan),
        ("depth-3", []),
    ],
)
def test_a_measurement_that_does_not_fit_the_claim_is_refused(claim, measured):
    with pytest.raises(InputError, match=claim):
        reference.judge(claim, measured)


def test_strict_limits_exclude_their_end():
    assert reference.judge("wall-5", 0.08).verdict == "not reproduced"  # "< 0.08"
    assert reference.judge("wall-5", 0.0799).verdict == "reproduced"
    assert reference.judge("bg-3", 0.01).verdict == "reproduced"  # "<= 0.01"


def test_an_error_that_must_be_small_cannot_be_negative():
    assert reference.judge("depth-2", -900.0).verdict == "not reproduced"


def test_the_criterion_stands_beside_the_verdict():
    assert reference.judge("belt20-9", 0.0).criterion == "relative change: small [-0.05, 0.2]"
    assert "spread(3 m)" in reference.undecidable("depth-1", "why").criterion


@pytest.mark.parametrize("odd", [float("nan"), "NO", 1])
def test_a_condition_is_true_or_false(odd):
    with pytest.raises(InputError, match="neither True nor False"):
        reference.judge("depth-4", {"a": True, "b": odd})


def test_a_table_outside_the_published_ones_is_not_one():
    with pytest.raises(InputError, match="no published table"):
        reference.published("../claims")


def test_undecidable_needs_a_reason():
    with pytest.raises(InputError, match="say why"):
        reference.undecidable("depth-1", " ")
    assert reference.undecidable("depth-1", "no recording").verdict == "not decidable"


def test_collecting_gives_every_claim_once_in_their_order():
    one = reference.verdict_table([reference.judge("depth-3", 300.0)], "02_x")
    two = reference.verdict_table([reference.judge("depth-2", 10.0)], "03_y")
    table = reference.collect([one, two])
    assert table["id"].tolist() == reference.claims().index.tolist()
    assert reference.count(table)["reproduced"] == 2
    waiting = table[table["notebook"] == ""]
    assert (waiting["verdict"] == "not decidable").all()
    assert waiting["reason"].str.contains("no notebook tests it yet").all()
    assert not table.isna().any(axis=None)


def test_a_claim_is_judged_once():
    verdict = reference.judge("depth-3", 300.0)
    with pytest.raises(InputError, match="depth-3 is judged twice"):
        reference.verdict_table([verdict, verdict], "02_x")
    tables = [reference.verdict_table([verdict], name) for name in ("02_x", "03_y")]
    with pytest.raises(InputError, match="02_x and 03_y"):
        reference.collect(tables)


def test_collecting_nothing_leaves_all_claims_waiting():
    table = reference.collect([])
    assert reference.count(table) == {
        "reproduced": 0,
        "not reproduced": 0,
        "not decidable": len(reference.claims()),
    }
    assert isinstance(table, pd.DataFrame)


def test_a_fitted_claim_is_no_result_and_a_miss_stays_one():
    hit = reference.fitted(reference.judge("otsu-1", [0.95, 0.99], note="two"), "it was fitted")
    assert (hit.verdict, hit.reason) == (reference.NOT_DECIDABLE, "two; agrees, but it was fitted")
    miss = reference.judge("otsu-1", [0.1])
    assert reference.fitted(miss, "it was fitted") is miss
