"""The report in PDF: what stands in it, that it is whole, and that it is the same each time."""

import re
import shutil

import pandas as pd
import pytest
from reportlab.platypus import Image, Paragraph, Table

from kilnflight.checks import InputError
from kilnflight.project import claims, figures, paths
from kilnflight.project.site import front, pdf, report

pytestmark = pytest.mark.published


@pytest.fixture(scope="module")
def sources():
    return report.read(paths.root() / "figures")


def flattened(flowables):
    """The flowables of a story, those within others and within cells, too."""
    for flowable in flowables:
        yield flowable
        yield from flattened(getattr(flowable, "_content", []))
        for row in flowable._cellvalues if isinstance(flowable, Table) else []:
            yield from flattened(row)


@pytest.fixture(scope="module")
def story(sources):
    return list(flattened(report.story(sources)))


@pytest.fixture(scope="module")
def text(story):
    return "\n".join(part.getPlainText() for part in story if isinstance(part, Paragraph))


def test_the_abstract_is_that_of_the_front_page_and_verdicts_are_counted(sources, text):
    abstract = text.split("Abstract\n")[1].split("\n")[0]
    assert abstract == front.ABSTRACT
    assert len(re.findall(r"\.(?: |$)", abstract)) == 3
    told = re.search(r"Of (\d+) published claims: .*", text)
    count = claims.count(sources.collected)
    assert [int(number) for number in re.findall(r"\d+", told[0])] == [
        len(sources.collected),
        *count.values(),
    ]


def test_every_claim_and_every_misprint_stands_in_it(sources, text):
    lines = set(text.split("\n"))
    assert set(sources.collected["id"]) <= lines
    assert {" ".join(where.split()) for where in sources.errata["where"]} <= lines
    assert "A conclusion depends on them: 10" in lines


def test_twelve_figures_with_number_reason_and_the_word_simulated(sources, story, text):
    assert len(report.CHOSEN) == 12
    assert sum(isinstance(part, Image) for part in story) == 12
    assert text.count("simulated. ") >= 12
    assert "Fig. 5.19, thesis; simulated. Dwell times" in text
    assert "Fig. 5.21, Fig. 5.22, Fig. 5.23, Fig. 5.24, thesis; simulated." in text
    for name, reason in report.CHOSEN.items():
        assert f"Why cite it: {reason}" in text
        assert f"{name}.csv, notebook {sources.entries[name].provenance['notebook']}" in text


def test_it_says_how_to_cite_all_works(text):
    cited = text.split("How to cite\n")[1]
    for words in ("kilnflight: seeing particles fly", "Miao Zhang", "doi:10.1515/auto-2019-0134"):
        assert words in cited
    assert "@misc{kilnflight-fig-5-19-dwell-time," in cited


def test_the_pages_fit_their_headings_are_bookmarks_and_bytes_are_the_same(sources, story):
    content = report.render(sources)
    assert content == report.render(sources)
    assert content.startswith(b"%PDF-")
    assert 10 <= len(re.findall(rb"/Type /Page\b", content)) <= 25
    headings = [part for part in story if isinstance(part, pdf.Heading)]
    assert len(re.findall(rb"/Title ", content)) == len(headings) + 1  # and the document's
    assert len(content) < 5_000_000


def test_a_folder_without_all_of_it_gives_one_error_and_no_file(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("KILNFLIGHT_FIGURES", str(tmp_path))
    shutil.copy(paths.root() / "figures" / "claims.csv", tmp_path)
    target = tmp_path / "made" / "report.pdf"
    assert report.main(["--to", str(target)]) == 1
    said = capsys.readouterr().err
    assert said.startswith("report: ")
    assert "errata.csv, fig-2-16-calibration.png" in said
    assert "run make full" in said
    assert "claims.csv" not in said
    assert not target.parent.exists()
    with pytest.raises(InputError):
        report.read(tmp_path)


def test_a_reduced_run_is_named(sources, monkeypatch):
    entries = {
        name: figures.Entry(
            name, entry.caption, {**entry.provenance, "parameters": {"scale": "quick"}}
        )
        for name, entry in sources.entries.items()
    }
    reduced = report.Sources(sources.collected, sources.errata, entries, sources.folder)
    texts = [part.getPlainText() for part in report.story(reduced) if isinstance(part, Paragraph)]
    assert "Made at scale quick, a reduced run: do not cite." in texts


def test_a_claim_that_is_not_reproduced_says_why():
    row = {"id": "a-1", "where": "5.1", "published": "x", "measured": "1", "because": "twin"}
    part = pd.DataFrame([row | {"verdict": claims.NOT_REPRODUCED}])
    assert list(report._rows(part)) == [("a-1", "x (5.1)", "1", "not reproduced: twin")]
