import re
import subprocess

import pandas as pd
import pytest

from kilnflight.checks import InputError
from kilnflight.publication import choices, claims, figures, notebooks, verdicts
from kilnflight.store import paths

MADE = figures.trace("00_claims", {})
chapter = notebooks.borrow("01_choices")
collect = chapter.collect


@pytest.fixture
def decided(monkeypatch):
    """Two choices: one that the text decides, and one that nothing does."""
    row = {
        "where": "4",
        "not_printed": "r",
        "chosen": "1",
        "others": "2",
        "evidence": "T",
    }
    rows = [
        {"id": "A1", **row, "decided_by": "text", "claims_touched": "bg-1"},
        {"id": "A2", **row, "decided_by": "assumption", "claims_touched": "bg-2"},
    ]
    table = pd.DataFrame(rows).set_index("id")
    monkeypatch.setattr(choices, "load", table.copy)


def test_a_verdict_turns_where_the_two_values_judge_differently():
    ours = [
        claims.check("bg-1", True),
        claims.check("bg-2", False),
        claims.check("bg-5", None),
    ]
    other = [
        claims.check("bg-1", False),
        claims.check("bg-2", False),
        claims.check("bg-5", True),
    ]
    assert choices.turned(ours, other) == {
        "bg-1": "reproduced -> not reproduced",
        "bg-5": "open -> reproduced",
    }
    assert choices.turned(ours, ours) == choices.turned(ours, []) == {}


@pytest.mark.usefixtures("decided")
def test_a_verdict_that_turns_with_what_nothing_decides_is_open():
    checks = [claims.check("bg-1", True), claims.check("bg-2", False)]
    compared = [
        choices.compare(
            "A1", "F1", chosen=0.912345, other=float("nan"), turns={"bg-1": "open"}
        ),
        choices.compare("A2", "F1", chosen=0.9, other="none", turns={"bg-2": "open"}),
    ]
    figures.conclude("One.", checks, MADE, choices=compared)
    judged = verdicts.collect().set_index("id")
    assert judged.loc["bg-1", ["verdict", "because"]].tolist() == ["reproduced", ""]
    assert judged.loc["bg-2", ["verdict", "because"]].tolist() == ["open", "choice"]
    table = collect().set_index("id")
    assert table.loc["A1", ["result_chosen", "result_other"]].tolist() == [
        "0.9123",
        "-",
    ]
    assert table.loc["A2", "verdicts_that_turn"] == "bg-2"
    assert table.loc["A2", "notebook"] == "00_claims"


@pytest.mark.usefixtures("decided")
def test_a_choice_of_one_notebook_opens_the_verdict_of_another():
    compared = [choices.compare("A2", "F1", chosen=1, other=2, turns={"bg-2": "open"})]
    origin = figures.trace("20_backgrounds", {})
    figures.conclude("One.", [claims.check("bg-2", True)], origin)
    figures.conclude("Two.", [], MADE, choices=compared)
    assert verdicts.collect().set_index("id").loc["bg-2", "because"] == "choice"


@pytest.mark.usefixtures("decided")
def test_the_authors_data_decide_before_the_simulation():
    compared = [choices.compare("A2", "F1", chosen=1, other=2, turns={"bg-2": "open"})]
    simulated = [claims.check("bg-2", False), claims.check("bg-1", False)]
    figures.conclude("One.", simulated, MADE, choices=compared)
    assert verdicts.collect().set_index("id").loc["bg-2", "because"] == "choice"
    theirs = figures.trace("20_backgrounds", {})
    judged = [claims.check("bg-2", True), claims.check("sift-2", False)]
    figures.conclude("Two.", judged, theirs, data="authors")
    table = verdicts.collect().set_index("id")
    names = ["verdict", "because", "data"]
    assert table.loc["bg-2", names].tolist() == ["reproduced", "", "authors"]
    # The simulation cannot be why a claim fails on the authors' frames.
    assert table.loc["sift-2", names].tolist() == ["not reproduced", "", "authors"]
    assert table.loc["bg-1", "data"] == "simulated"
    assert table.loc["bg-5", "data"] == ""


def test_a_choice_without_a_result_is_empty_and_an_unknown_one_is_an_error():
    assert set(collect()["result_chosen"]) == {""}
    with pytest.raises(InputError, match="no choice 'X9'"):
        choices.compare("X9", "F1", chosen=1, other=2)
    with pytest.raises(InputError, match="61 characters"):
        choices.compare("D1", "F1", chosen="x" * 61, other=2)


# data/reference/choices.csv


def test_every_choice_says_what_decides_it_and_which_claims_it_touches():
    table, known = choices.load(), claims.load()
    assert table.index.is_unique
    assert set(table["decided_by"]) <= set(chapter.DECIDED_BY)
    filled = table[["where", "not_printed", "chosen", "others", "evidence"]]
    assert (filled != "").all(axis=None)
    touched = {claim for names in table["claims_touched"] for claim in names.split()}
    assert touched - set(known.index) == set()


def test_a_text_that_decides_is_named_by_its_line_or_quoted():
    table = choices.load()
    texts = table.loc[table["decided_by"] == "text", "evidence"]
    named = texts.str.contains(r"T:\d+|Fig\.|Eq\.|section|\"", regex=True)
    assert named.all(), texts[~named].to_dict()


def test_a_number_that_identified_a_choice_tests_no_claim():
    """Such a number is an input. It is named like table_5.6/Total/f1 in both files."""
    key = r"[\w.]+/[\w .+-]+/\w+"
    table = choices.load()
    evidence = table.loc[table["decided_by"] == "identified", "evidence"]
    named = {number for text in evidence for number in re.findall(key, text)}
    tested = claims.load()["tests"].fillna("")
    assert len(named) >= 3
    for number in named:
        testing = tested[[number in each.split("; ") for each in tested]]
        assert testing.empty, (
            f"{number} is an input, but tests {', '.join(testing.index)}"
        )


def test_the_hash_of_each_frozen_input_is_that_of_its_commit():
    freezes = pd.read_csv(paths.reference() / "freezes.csv", dtype=str)
    assert freezes["step"].is_monotonic_increasing
    known = git("cat-file", "--batch-check", text="\n".join(freezes["commit"]))
    if "missing" in known:
        pytest.skip("this clone is shallow: it lacks the commits of the freezes")
    for _, row in freezes.iterrows():
        assert git("rev-parse", f"{row['commit']}:{row['input']}").startswith(
            row["hash"]
        )


def git(*command, text=None):
    folder = paths.root()
    done = subprocess.run(
        ["git", *command],
        cwd=folder,
        input=text,
        capture_output=True,
        text=True,
        check=False,
    )
    return done.stdout if done.returncode == 0 else "missing"


@pytest.mark.usefixtures("decided")
@pytest.mark.parametrize(
    ("stem", "shown"), [("40_belt_arrival", "1"), ("12_labelled_frames", "")]
)
def test_choices_on_the_belt_are_listed_and_those_of_notebook_12_are_not(stem, shown):
    compared = [choices.compare("A1", "F1", chosen=1, other=2, turns={})]
    origin = figures.trace(stem, {})
    figures.conclude("One.", [], origin, choices=compared, data="authors")
    assert collect().set_index("id").loc["A1", "result_chosen"] == shown
