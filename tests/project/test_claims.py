import re

import numpy as np
import pandas as pd
import pytest

from kilnflight.checks import InputError
from kilnflight.project import claims, paths


def test_tables_keep_what_was_printed():
    printed = claims.published("table_5.5", as_printed=True)
    assert printed.loc[0, "precision"].startswith("0.")
    assert claims.published("table_5.5")["TP"].dtype.kind == "i"


def test_an_unknown_table_is_told_with_those_there_are():
    with pytest.raises(InputError, match=r"'table_9' *; there are .*table_5\.5"):
        claims.published("table_9")


def test_every_claim_has_an_id_of_its_own_and_says_what_is_expected():
    table = claims.load()
    assert table.index.is_unique
    assert (table["expect"].str.len() > 0).all()
    bounds = table[["low", "high"]]
    assert (bounds["low"].fillna(-np.inf) < bounds["high"].fillna(np.inf)).all()


@pytest.mark.parametrize(
    ("value", "verdict"),
    [
        (250.0, "reproduced"),
        ([250.0, 375.0], "reproduced"),
        ([300.0, 375.1], "not decidable"),
        ([300.0, 600.1], "not reproduced"),
        (-300.0, "not reproduced"),
    ],
)
def test_bounds_are_included_and_every_value_counts(value, verdict):
    """About 300 mm is 200 to 450 mm: 250 to 375 mm or 100 to 600 mm would decide alike."""
    assert claims.judge("depth-3", value).verdict == verdict


def test_labels_of_a_series_are_told():
    measured = pd.Series([294.81, 362.0], index=["6 m", "7 m"])
    assert claims.judge("depth-3", measured).measured == "6 m 294.8, 7 m 362"


def test_conditions_must_all_hold_and_are_written_out():
    verdict = claims.judge("depth-4", {"9 m": True, "10 m": False}, note="why")
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
        claims.judge(claim, measured)


def test_strict_limits_exclude_their_end():
    assert claims.judge("wall-5", 0.08).verdict == "not reproduced"  # "< 0.08"
    assert claims.judge("wall-5", 0.0799).verdict == "reproduced"
    assert claims.judge("bg-4", 0.01).verdict == "reproduced"  # "<= 0.01"


def test_a_strict_limit_is_strict_at_its_own_end_only():
    assert claims.judge("wall-5", 0.0).verdict == "reproduced"  # 0 % is "less than 8 %"
    assert claims.judge("wall-5", 0.08).verdict == "not reproduced"
    assert claims.judge("cluster-8", [0.0, 0.49]).verdict == "reproduced"
    assert claims.judge("otsu-1", 0.9).verdict == "not reproduced"  # "> 0.9"


def test_a_verdict_names_its_cause_unless_the_claim_is_reproduced():
    failed = claims.judge("wall-5", 0.2, because="chain")
    assert (failed.verdict, failed.because) == ("not reproduced", "chain")
    assert claims.judge("wall-5", 0.01, because="chain").because == ""
    assert claims.undecidable("depth-1", "an input", because="twin").because == "twin"


@pytest.mark.parametrize(
    ("truth", "because", "told"),
    [(0.1, "twin", "fails on the twin's own truth (0.1)"), (0.01, "chain", "holds on")],
)
def test_the_truth_tells_whether_the_twin_or_the_chain_is_the_cause(truth, because, told):
    verdict = claims.judge("wall-5", 0.2, note="our test", truth=truth, because="chain")
    assert verdict.because == because
    assert told in verdict.reason
    assert verdict.reason.endswith("our test")


def test_a_cause_that_is_named_holds_where_the_truth_agrees():
    assert claims.judge("wall-5", 0.2, truth=0.0, because="method").because == "method"
    assert claims.judge("wall-5", 0.2, truth=0.0).because == "chain"


@pytest.mark.parametrize("give", [claims.judge, claims.undecidable])
def test_an_unknown_cause_is_refused(give):
    with pytest.raises(InputError, match=r"depth-1.*'weather'.*misprint"):
        give("depth-1", "no reason", because="weather")


def test_a_condition_that_hangs_on_a_bound_of_ours_is_open():
    verdict = claims.judge("depth-4", {"9 m": True, "10 m": None})
    assert (verdict.verdict, verdict.because) == ("not decidable", "criterion")
    assert verdict.measured == "9 m: yes; 10 m: open"
    assert claims.judge("depth-4", {"9 m": False, "10 m": None}).verdict == "not reproduced"


def test_a_bound_of_ours_decides_where_half_and_twice_as_far_agree(monkeypatch):
    table = claims.load()
    table.loc["cluster-2", ["bound", "low", "about"]] = ["ours", 3.0, 1.0]
    monkeypatch.setattr(claims, "load", lambda: table)
    verdicts = {value: claims.judge("cluster-2", value) for value in (5.1, 4.9, 1.9)}
    told = [each.verdict for each in verdicts.values()]
    assert told == ["reproduced", "not decidable", "not reproduced"]
    assert verdicts[4.9].because == "criterion"
    assert verdicts[4.9].criterion.endswith("(a bound of ours)")


def test_every_bound_is_printed_or_ours_and_ours_are_measured_from_what_the_words_name():
    table = claims.load()
    assert set(table["bound"]) <= {"print", "ours"}
    ours = table["bound"] == "ours"
    assert table.loc[~ours, "about"].isna().all()
    assert table.loc[table["about"].notna(), ["low", "high"]].notna().any(axis=1).all()


def test_what_is_not_reproduced_and_names_no_cause_is_found():
    verdicts = [
        claims.judge("wall-5", 0.2),
        claims.judge("otsu-1", 0.95),
        claims.judge("depth-3", 900.0, because="misprint"),
    ]
    table = claims.collect([claims.verdict_table(verdicts, "02_x")])
    assert claims.without_cause(table) == ["wall-5"]


def test_an_error_that_must_be_small_cannot_be_negative():
    assert claims.judge("depth-2", -900.0).verdict == "not reproduced"


def test_the_criterion_stands_beside_the_verdict():
    assert claims.judge("bg-3", 0.0).criterion.startswith("F1 difference: <= 0.01 [0, 0.01]")
    assert "spread(3 m)" in claims.undecidable("depth-1", "why").criterion


@pytest.mark.parametrize("odd", [float("nan"), "NO", 1])
def test_a_condition_is_true_or_false(odd):
    with pytest.raises(InputError, match="neither True nor False"):
        claims.judge("depth-4", {"a": True, "b": odd})


def test_a_table_outside_the_published_ones_is_not_one():
    with pytest.raises(InputError, match="no published table"):
        claims.published("../claims")


def test_undecidable_needs_a_reason():
    with pytest.raises(InputError, match="say why"):
        claims.undecidable("depth-1", " ")
    assert claims.undecidable("depth-1", "no recording").verdict == "not decidable"


def test_collecting_gives_every_claim_once_in_their_order():
    one = claims.verdict_table([claims.judge("depth-3", 300.0)], "02_x")
    two = claims.verdict_table([claims.judge("depth-2", 10.0)], "03_y")
    table = claims.collect([one, two])
    assert table["id"].tolist() == claims.load().index.tolist()
    assert claims.count(table)["reproduced"] == 2
    waiting = table[table["notebook"] == ""]
    assert (waiting["verdict"] == "not decidable").all()
    assert waiting["reason"].str.contains("no notebook tests it yet").all()
    assert not table.isna().any(axis=None)


def test_a_claim_is_judged_once():
    verdict = claims.judge("depth-3", 300.0)
    with pytest.raises(InputError, match="depth-3 is judged twice"):
        claims.verdict_table([verdict, verdict], "02_x")
    tables = [claims.verdict_table([verdict], name) for name in ("02_x", "03_y")]
    with pytest.raises(InputError, match="02_x and 03_y"):
        claims.collect(tables)


def test_collecting_nothing_leaves_all_claims_waiting():
    table = claims.collect([])
    assert claims.count(table) == {
        "reproduced": 0,
        "not reproduced": 0,
        "not decidable": len(claims.load()),
    }
    assert isinstance(table, pd.DataFrame)


def test_a_fitted_claim_is_no_result_and_a_miss_stays_one():
    hit = claims.fitted(claims.judge("otsu-1", [0.95, 0.99], note="two"), "it was fitted")
    assert (hit.verdict, hit.reason) == (claims.NOT_DECIDABLE, "two; agrees, but it was fitted")
    miss = claims.judge("otsu-1", [0.1])
    assert claims.fitted(miss, "it was fitted") is miss


@pytest.mark.parametrize(
    ("value", "answer"), [(0.51, True), (0.46, None), (0.59, None), (0.61, False)]
)
def test_about_is_a_bound_of_ours(value, answer):
    assert claims.about(value, 0.5, 0.05) is answer


def test_what_failed_says_what_shows_its_cause():
    miss = claims.judge("otsu-1", [0.1], note="a frame", because="twin")
    assert claims.with_cause(miss).reason == f"a frame; {claims.JUDGED}"
    assert claims.with_cause(miss, "a fit ends there").reason == "a frame; a fit ends there"
    hit = claims.judge("otsu-1", [0.95], because="twin")
    assert claims.with_cause(hit) is hit


def test_what_is_not_decidable_does_not_count_as_reproduced():
    hit, miss = claims.judge("otsu-1", [0.95]), claims.judge("otsu-1", [0.1])
    verdicts = [hit, miss, hit, claims.fitted(hit, "it was fitted")]
    assert claims.count_reproduced(verdicts) == 2
    assert claims.count_reproduced([]) == 0


def test_the_first_twins_verdicts_stand_beside_those_of_now():
    first = claims.first_twin()
    assert set(first["verdict"]) <= set(claims.VERDICTS)
    expected = [name for name in claims.load().index if not name.startswith("belt")]
    assert first.index.tolist() == expected
    table = claims.collect(
        [claims.verdict_table([claims.judge("wall-5", 0.2, because="twin")], "25")]
    )
    rows = claims.beside_first_twin(table).set_index("id")
    assert rows.index.tolist() == expected
    row = rows.loc["wall-5"]
    assert (row["first_twin"], row["second_look"]) == (claims.REPRODUCED, claims.NOT_REPRODUCED)
    assert row["label"] == "second look"
    assert (rows.loc["cluster-10", "first_twin"], row["second_look_measured"]) == (
        claims.NOT_REPRODUCED,
        "0.2",
    )
    same = rows["first_twin"] == rows["second_look"]
    assert (rows.loc[same, "label"] == "").all()


# data/reference against the publications themselves (skipped where they are not)


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
    """What a claim is tested by is ours to sharpen; the sentence and its place are not."""
    theirs = seeds.parent / "reference"
    for path in sorted((theirs / "published").glob("*.csv")):
        assert (paths.reference() / "published" / path.name).read_text() == path.read_text()
    table = pd.read_csv(theirs / "claims.csv", index_col="id")
    given = ["seed", "where", "subject", "claim", "testable_with"]
    pd.testing.assert_frame_equal(claims.load().loc[table.index, given], table[given])
