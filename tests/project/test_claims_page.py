"""The page of claims."""

import pytest

from kilnflight.project import claims, claims_page


@pytest.fixture
def table():
    verdicts = [
        claims.judge("depth-3", 300.0),
        claims.judge("wall-5", 0.2, truth=0.3),
        claims.judge("otsu-1", 0.5, because="chain"),
        claims.judge("cluster-10", {"1 < 2 & so on": False}, because="misprint"),
    ]
    return claims.collect([claims.verdict_table(verdicts, "24_x")])


def test_every_claim_has_a_chapter_and_keeps_its_place_within_it(table):
    named = claims_page.with_chapters(table)
    assert sorted(named["id"]) == sorted(table["id"])
    chapters = named["chapter"].unique().tolist()
    assert chapters == [*claims_page.CHAPTERS.values(), *claims_page.PAPERS.values()]
    bat = named.loc[named["id"].str.startswith("bg-"), "id"].tolist()
    assert bat == [f"bg-{k}" for k in range(1, 7)]


def test_counts_are_those_of_the_claims(table):
    counts = claims_page.counts_by_cause(table).set_index("chapter")
    assert counts.loc["all", "claims"] == len(table) == 79
    assert counts.loc["all", "not reproduced: twin"] == 1
    assert counts.loc["Thesis, section 5.1: detection", "not reproduced: misprint"] == 1
    assert counts.loc["all"].drop("claims").sum() == 79
    assert counts.columns[0] == "reproduced"


def test_what_fails_on_the_truth_says_so_and_links_to_its_notebook(table):
    page = claims_page.page_table(table[table["notebook"] != ""])
    assert page.count("fails on the twin's own truth</em>") == 1
    assert "<a href='24_x.html'>wall-5</a>" in page
    assert "1 &lt; 2 &amp; so on: NO" in page
    assert page.count("<tr>") == 5


def test_a_missing_cause_is_seen():
    assert claims_page.outcome("not reproduced", "") == "not reproduced: cause missing"
    assert claims_page.outcome("reproduced", "") == "reproduced"
