"""The page of claims."""

import pytest

from kilnflight.project import claims, claims_page

SAVED = {"fig-2-15-plate-depth": "02_x", "table-5-5-otsu": "21_x", "fig-belt20-9-arrival": "40_x"}


@pytest.fixture
def table():
    verdicts = [
        claims.judge("depth-3", 300.0),
        claims.judge("wall-5", 0.2, truth=0.3),
        claims.judge("otsu-1", 0.5, because="chain"),
        claims.judge("cluster-10", {"1 < 2 & so on": False}, because="misprint"),
    ]
    return claims.collect([claims.verdict_table(verdicts, "24_x")])


def test_claims_stand_by_chapter_then_verdict_then_cause(table):
    named = claims_page.by_chapter(table)
    assert sorted(named["id"]) == sorted(table["id"])
    assert named["chapter"].unique().tolist() == list(claims_page.CHAPTERS.values())
    detection = named[named["chapter"].str.contains("5.1")]
    assert detection["id"].tolist()[:3] == ["wall-5", "otsu-1", "cluster-10"]
    assert detection["verdict"].tolist()[3] == "not decidable"


def test_counts_are_those_of_the_claims(table):
    counts = claims_page.counts_by_cause(table).set_index("chapter")
    assert counts.loc["all", "claims"] == len(table) == 96
    assert counts.loc["all", "reproduced"] == "1"
    assert counts.loc["all", "not reproduced"] == "3: twin 1, chain 1, misprint 1"
    assert counts.loc["Belt paper of 2016", "not decidable"] == "10: method 10"
    assert counts["claims"].iloc[:-1].sum() == len(table)


@pytest.mark.parametrize(
    ("seed", "where", "link"),
    [
        ("thesis", "2.1.5 Fig 2.15", ("Fig 2.15", "fig-2-15-plate-depth")),
        ("thesis", "5.1.3 Table 5.5", ("Table 5.5", "table-5-5-otsu")),
        ("thesis", "2.1.5 Fig 2.1", ("Fig 2.1", "")),
        ("belt-2020", "5.2 Fig 9", ("Fig 9", "fig-belt20-9-arrival")),
        ("belt-2016", "IV.C Fig 9a", ("Fig 9", "")),
        ("thesis", "5.2.3", ("", "")),
    ],
)
def test_a_claim_leads_to_the_figure_that_it_is_about(seed, where, link):
    assert claims_page.figure_of(seed, where, SAVED) == link


def test_what_fails_on_the_truth_says_so_and_links_to_notebook_and_figure(table):
    shown = claims_page.by_chapter(table[table["notebook"] != ""])
    page = claims_page.page_table(shown, SAVED)
    assert page.count("fails on the twin's own truth</em>") == 1
    assert "<a href='24_x.html'>wall-5</a>" in page
    assert "<a href='21_x.html#table-5-5-otsu'>Table 5.5</a>" in page
    assert "1 &lt; 2 &amp; so on: NO" in page
    assert page.count("<tr") == 5
