"""What stands in figures/ and README.md is of one cast (make check; not part of make
test).
"""

import re
import runpy
from pathlib import Path

import pandas as pd
import pytest
from tests.definitions.bounds import impossible

from kilnflight.checks import InputError
from kilnflight.publication import claims, figures, verdicts
from kilnflight.store import index

PROJECT = Path(__file__).resolve().parents[1]
NOTEBOOKS = sorted((PROJECT / "notebooks").glob("*.py"))

# What names a place, a kind or a setting is no result.
NAMED = re.compile(
    r"(?:Figs?\.|Eqs?\.|Tables?|sections?|chapter|notebooks?)\s[\dA-D][\d.]*"
    r"(?:\([a-z]\))?(?:(?:,| and| to)\s[\dA-D][\d.]*(?! ?(?:%|mm|m/s|s\b)))*"
    r"|\b[A-Z]\d+\b|\b\d-frame|\b[23]D|\b(?:19|20)\d\d\b|`[^`]*`|\$\$.*?\$\$"
)
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?!\w|\.\d)")
FEW = 12  # smaller whole numbers count things
SHORT = 120  # rows of a table in which a number does not stand by chance
LARGEST_MOVIE = 1_000_000  # bytes
CAUSES = ("work", "implementation", "choice", "twin", "data", "misprint")

pytestmark = pytest.mark.published


@pytest.fixture
def published(monkeypatch):
    """The tracked figures."""
    monkeypatch.setenv("KILNFLIGHT_FIGURES", str(PROJECT / "figures"))
    return PROJECT / "figures"


@pytest.fixture
def entries(published):
    return index.load()["figures"]


def test_every_figure_comes_from_make_full_and_a_clean_tree(entries):
    assert entries, "figures/ is empty; run make full"
    for name, entry in entries.items():
        hint = f"{name}: run make full (or git checkout figures README.md)"
        assert entry["provenance"]["parameters"]["scale"] == "full", hint
        assert "+changes" not in entry["provenance"]["commit"], hint


def test_the_folder_holds_what_its_index_lists(published, entries):
    pictures = {name for name, entry in entries.items() if entry["kind"] == "picture"}
    assert {path.stem for path in published.glob("*.csv")} == set(entries)
    assert {path.stem for path in published.glob("*.png")} == pictures
    assert {path.stem for path in published.glob("*.pdf")} <= pictures
    drawn = [*published.glob("*.png"), *published.glob("*.pdf")]
    assert max(path.stat().st_size for path in drawn) <= figures.LARGEST
    movies = [path.stat().st_size for path in published.glob("*.mp4")]
    assert max(movies, default=0) <= LARGEST_MOVIE


def test_captions_are_short(entries):
    assert {
        name: len(each["caption"])
        for name, each in entries.items()
        if len(each["caption"]) > 350
    } == {}


def test_every_picture_says_inside_what_its_data_are(entries):
    pictures = [entry for entry in entries.values() if entry["kind"] == "picture"]
    marks = {entry["provenance"]["mark"] for entry in pictures}
    assert marks <= {"simulated", "example", "recorded", ""}


def test_no_table_holds_an_impossible_number(published):
    found = {
        path.name: impossible(pd.read_csv(path), path.stem)
        for path in published.glob("*.csv")
    }
    assert {name: wrong for name, wrong in found.items() if wrong} == {}


def test_every_saved_table_of_the_thesis_has_published_values_beside_ours(published):
    # Table 5.4 lists what is used, as printed; Table 5.7 names the print in its own
    # words.
    printed = {
        "table-5-4-parameters": "window",
        "table-5-7-sift-time": "computation_time_s",
    }
    for path in sorted(published.glob("table-[0-9]-*.csv")):
        columns = list(pd.read_csv(path))
        if path.stem == "table-5-2-ground-truth":  # rows
            assert "published" in set(pd.read_csv(path)["source"])
        elif path.stem in printed:
            assert printed[path.stem] in columns
        else:
            assert any("published" in name or name == "printed" for name in columns), (
                path.name
            )


def test_the_claims_are_those_of_the_notebooks(published):
    shown = pd.read_csv(published / "claims.csv", keep_default_na=False)
    pd.testing.assert_frame_equal(shown, verdicts.collect(), check_dtype=False)
    cut = shown["measured"].str.endswith("...")
    assert shown.loc[cut, "id"].tolist() == []
    failed = shown[shown["verdict"] == claims.NOT_REPRODUCED]
    assert set(failed["because"]) <= set(CAUSES), (
        "fill cause in data/reference/claims.csv"
    )


def test_the_first_page_counts_the_verdicts_and_the_misprints(published):
    text = (PROJECT / "notebooks" / "00_claims.py").read_text().replace("\n# ", " ")
    verdict = pd.read_csv(published / "claims.csv")["verdict"].value_counts()
    counted = re.search(
        r"Of (\d+) claims (\d+) are reproduced, (\d+) are not and (\d+) are open", text
    )
    found = [verdict.sum(), *verdict[list(claims.VERDICTS)]]
    assert list(map(int, counted.groups())) == found
    checks = pd.read_csv(published / "published-recomputed.csv")
    numbers = checks[checks["kind"] == "number"]
    told = re.search(r"Of (\d+) printed numbers that others determine (\d+) are", text)
    assert list(map(int, told.groups())) == [len(numbers), (~numbers["agrees"]).sum()]


def test_every_verdict_that_turned_is_one_that_its_choice_names(published):
    table = pd.read_csv(published / "choices.csv", dtype=str, keep_default_na=False)
    for row in table.itertuples():
        unnamed = set(row.verdicts_that_turn.split()) - set(row.claims_touched.split())
        assert unnamed == set(), f"{row.id}: add them to claims_touched in choices.csv"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_the_one_number_of_a_notebook_stands_in_its_tables(path, published, entries):
    found = re.search(
        r"^# \*\*One number\.\*\* (.*?)\n(?:#\n|\n)", path.read_text(), re.M | re.S
    )
    line = found[1].replace("\n# ", " ")
    if "no number" in line:
        return
    given = re.search(r" printed, (-?\d+(?:\.(\d+))?)( %)?[^,]* here\.", line)
    assert given, line
    value, half = float(given[1]), 0.5 * 10.0 ** -len(given[2] or "") + 1e-9
    own = [
        name
        for name, each in entries.items()
        if each["provenance"]["notebook"] == path.stem
    ]
    cells = " ".join((published / f"{name}.csv").read_text() for name in own)
    numbers = [float(each) for each in re.findall(r"-?\d+(?:\.\d+)?(?:e-?\d+)?", cells)]
    scales = (1.0, 100.0) if given[3] else (1.0,)
    assert any(
        abs(scale * each - value) <= half for each in numbers for scale in scales
    ), line


def numbers_in(text):
    return {float(each) for each in re.findall(r"-?\d+(?:\.\d+)?(?:e-?\d+)?", text)}


@pytest.fixture(scope="module")
def printed():
    """Every number of data/reference: what works print, and inputs."""
    texts = (
        path.read_text() for path in (PROJECT / "data" / "reference").rglob("*.csv")
    )
    return numbers_in(" ".join(texts))


@pytest.mark.parametrize("path", NOTEBOOKS[1:], ids=lambda path: path.stem)
def test_numbers_of_openings_and_reasons_stand_in_tables(
    path, published, entries, printed
):
    opening = re.match(r"# %% \[markdown\]\n(.*?)\n\n# %%", path.read_text(), re.S)[1]
    concluded = index.load()["notebooks"][path.stem]
    judged = concluded["verdicts"]
    texts = [opening.replace("\n# ", " "), *(each["reason"] for each in judged)]
    tables = [
        (published / f"{name}.csv").read_text()
        for name, each in entries.items()
        if each["provenance"]["notebook"] == path.stem
    ]
    tables += [each["measured"] for each in judged]
    tables += [f"{each['chosen']} {each['other']}" for each in concluded["choices"]]
    known = set(printed)
    for table in tables:
        if table.count("\n") <= SHORT:
            known |= numbers_in(table)
    missing = []
    for found in NUMBER.findall(" ".join(NAMED.sub(" ", text) for text in texts)):
        value = float(found)
        half = 0.5 * 10.0 ** -len(found.partition(".")[2]) + 1e-9
        counts = "." not in found and abs(value) <= FEW
        scales = (1.0, 100.0, 0.001)  # per cent, and m of mm
        if not counts and not any(
            abs(scale * abs(each) - abs(value)) <= half
            for each in known
            for scale in scales
        ):
            missing.append(found)
    assert missing == []


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_no_title_holds_a_measured_number(path):
    """A reduced run has the same title, and other numbers."""
    title = re.match(r"# %% \[markdown\]\n# # (.*?)\n#\n", path.read_text(), re.S)[1]
    printed = re.sub(
        r"(Eq\.|chapter) \d[.]\d|at 3 m\b", "", title
    )  # they stand in the works
    assert not re.search(r"\d+ ?(%|ms|mm|m/s|s\b|of\b)|\d[.]\d", printed), title


def test_a_citation_names_work_and_package_and_near_ids(published):
    generate = runpy.run_path(str(PROJECT / "docs" / "generate.py"))
    told = generate["cite"]("fig-5-19")
    assert told.startswith("fig-5-19-dwell-time\n")
    for part in ("@misc{kilnflight-fig-5-19-dwell-time", "@phdthesis{zhang2023"):
        assert part in told
    assert "title  = {Simulated: " in told
    assert "\\includegraphics[width=\\textwidth]{fig-5-19-dwell-time}" in told
    assert "@inproceedings{pfaff2016" in generate["cite"]("fig-belt16-6")
    assert generate["cite"]("fig-5-1").startswith("fig-5-1-annotated-frame\n")
    for each in generate["saved"]().values():
        title = each["title"]
        assert title.count("(") == title.count(")"), title
        assert "Simulated: Simulated" not in each["cited"]["BibTeX"], title
        assert "CSV" not in each["cited"].get("LaTeX", ""), title
    with pytest.raises(InputError, match="detection-scores"):
        generate["cite"]("detecton-scores")


def test_readme_and_gallery_show_the_results(published):
    generate = runpy.run_path(str(PROJECT / "docs" / "generate.py"))
    pages = generate["readme"]()
    hint = "run python docs/generate.py --readme"
    assert {*pages} >= {PROJECT / "README.md", *published.glob("*.md")}, hint
    for path, text in pages.items():
        assert text == path.read_text(), hint


def test_links_of_the_pages_of_figures_lead_somewhere(published):
    links = 0
    for page in published.glob("*.md"):
        for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text()):
            path, _, place = target.partition("#")
            file = (page.parent / path).resolve() if path else page
            assert file.is_file(), (page.name, target)
            if place:
                assert f"## {place}\n" in file.read_text(), (page.name, target)
            links += 1
    assert links > 100


def test_the_belt_results_are_those_on_the_authors_data(published):
    table = pd.read_csv(published / "belt-arrival.csv")
    hint = (
        "run make full where the authors' data are (make data, or KILNFLIGHT_EXTERNAL)"
    )
    assert "authors-dem" in set(table["source"]), hint
