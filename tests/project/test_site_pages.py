"""Pages of the site: links in prose, blocks of figures, numbers of the works, notebooks."""

import re

import nbformat
import pandas as pd
import pytest
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook, new_output

from kilnflight.project import figures, paths
from kilnflight.project.figures import Provenance
from kilnflight.project.site import blocks as blocks_of
from kilnflight.project.site import long_tables, notebook, numbers
from kilnflight.project.site.blocks import Blocks
from kilnflight.project.site.links import Links
from kilnflight.project.style import canvas

LINKS = Links({"13": "13_light", "24": "24_all"}, {("Fig", "5.19"): "thesis-fig-5-19"})


@pytest.mark.parametrize(
    ("text", "linked"),
    [
        ("see notebook 13.", 'see <a href="13_light.html">notebook 13</a>.'),
        (
            "notebooks 13 and 24",
            'notebooks <a href="13_light.html">13</a> and <a href="24_all.html">24</a>',
        ),
        ("notebook 99", "notebook 99"),
        ("Fig. 5.19", '<a href="works/thesis-fig-5-19.html">Fig. 5.19</a>'),
        ("Figs 5.18 and 5.19", 'Figs 5.18 and <a href="works/thesis-fig-5-19.html">5.19</a>'),
        ("Fig. 5.1 and section 5.19", "Fig. 5.1 and section 5.19"),
    ],
)  # fmt: skip
def test_what_prose_refers_to_is_linked(text, linked):
    assert LINKS(text) == linked
    assert "../works" in LINKS("Fig. 5.19", "../")


@pytest.fixture
def blocks():
    """A drawn figure, a short table and a long one with totals."""
    origin = Provenance("52_dwell_time", {"scale": "full"}, commit="0" * 40)
    picture, ((axes,),) = canvas(width_mm=80, height_mm=40)
    axes.plot([0, 1], [0, 1])
    tables = {
        "fig-5-19-dwell-time": pd.DataFrame({"measured_s": [0.123456]}),
        "table-5-17-tracking": pd.DataFrame({"tracker": ["GNN"], "f1": [0.5]}),
        "table-5-8-dbscan": pd.DataFrame({"subset": ["V1"] * 30 + ["all"], "tp": range(31)}),
    }
    for name, table in tables.items():
        drawn = picture if name.startswith("fig") else None
        caption = "Dwell times, after Fig. 5.19. And more."
        figures.save(name, table, picture=drawn, caption=caption, provenance=origin)
    entries = {entry.identifier: entry for entry in figures.entries()}
    return Blocks(paths.figures(), LINKS, entries=entries)


def test_a_picture_is_linked_with_its_files_and_citations(blocks):
    text = blocks("fig-5-19-dwell-time")
    assert 'src="figures/fig-5-19-dwell-time.png" alt="Dwell times, after Fig. 5.19"' in text
    assert "base64" not in text
    for kind in ("png", "pdf", "csv"):
        assert f'href="figures/fig-5-19-dwell-time.{kind}" download' in text
    assert "@misc{kilnflight-fig-5-19-dwell-time" in text
    assert "includegraphics" in text
    assert 'href="works/thesis-fig-5-19.html"' in text


def test_a_reduced_figure_is_not_cited(blocks):
    origin = Provenance("52_dwell_time", {"scale": "standard"}, commit="0" * 40)
    table = pd.DataFrame({"f1": [0.5]})
    figures.save("table-5-17-tracking", table, caption="F1.", provenance=origin)
    entries = {entry.identifier: entry for entry in figures.entries()}
    text = Blocks(paths.figures(), LINKS, entries=entries)("table-5-17-tracking")
    assert "scale standard, do not cite" in text
    assert "@misc" not in text


def test_misprints_stand_on_the_page_of_their_table_with_the_digits_that_differ(blocks):
    origin = Provenance("01_published_tables", {"scale": "full"})
    row = ["Table 5.17, GNN: f1", "0.5020", "0.50208", "no: last digits only"]
    wrong = pd.DataFrame([row], columns=["where", "printed", "recomputed", "consequence"])
    figures.save("errata", wrong, caption="Misprints.", provenance=origin)
    assert "<td>0.5020</td>" in blocks.table("errata")
    assert "<td>0.50208</td>" in blocks.table("errata")
    table = numbers.load(["table-5-17-tracking"]).set_index("name", drop=False)
    none = pd.DataFrame(columns=["id", "verdict", "seed", "where", "published"], dtype=str)
    page = numbers.page(table.loc["thesis-table-5-17"].to_dict(), blocks, none)
    assert "printed 0.5020, recomputed 0.50208" in page
    assert "01_published_tables.html#errata" in page
    other = numbers.page(table.loc["thesis-table-5-1"].to_dict(), blocks, none)
    assert "misprint" not in other


def test_a_table_has_words_and_three_digits_and_a_long_one_its_totals(blocks):
    assert "<th>F1</th>" in blocks("table-5-17-tracking")
    text = blocks("table-5-8-dbscan")
    assert text.count("<td>all</td>") == 1
    assert "<td>V1</td>" not in text
    assert 'href="tables/table-5-8-dbscan.html">All 31 rows' in text


def test_long_tables_have_a_page_with_all_rows(blocks, tmp_path):
    assert long_tables.write(tmp_path / "tables", blocks) == ["table-5-8-dbscan"]
    text = (tmp_path / "tables" / "table-5-8-dbscan.md").read_text()
    assert text.count("<td>V1</td>") == 30


def test_every_number_has_its_own_figures_or_says_why_not():
    saved = ["fig-5-1-annotated", "fig-5-19-a", "fig-5-21-b", "fig-belt20-9-arrival", "table-5-1-x"]
    table = numbers.load(saved).set_index("name")
    assert not table.index.duplicated().any()
    assert table["ids"]["thesis-fig-5-1"] == ["fig-5-1-annotated"]
    assert table["ids"]["thesis-table-5-1"] == ["table-5-1-x"]
    assert table["ids"]["thesis-fig-5-22"] == ["fig-5-21-b"]  # drawn with it
    assert table["ids"]["belt-2020-fig-9"] == ["fig-belt20-9-arrival"]
    assert table["ids"]["thesis-fig-1-1"] == []


def test_what_is_drawn_with_another_names_one_that_exists():
    table = numbers.load()
    known = set(zip(table["kind"], table["number"], strict=True))
    for absent in table["absent"]:
        found = numbers.DRAWN_WITH.search(absent)
        assert found is None or ("Fig", found[1]) in known, absent


def test_a_notebook_page_has_result_and_badges_first_and_its_code_folded(blocks, tmp_path):
    shown = new_output(
        "display_data", {"text/html": "<figure id='fig-5-19-dwell-time'>old</figure>"}
    )
    html = pd.DataFrame({"x": [0.123456]}).to_html()
    given = "seed = 0  # a comment\nframes = 0  # 0: 1 or 10 by scale"
    table = new_output("execute_result", {"text/html": html}, execution_count=1)
    cells = [
        new_markdown_cell("# How long\n\n**Published** notebook 13."),
        new_code_cell(
            given,
            metadata={"tags": ["parameters"]},
        ),
        new_code_cell("seed = 5", metadata={"tags": ["injected-parameters"]}),
        new_code_cell("figures.save()", outputs=[shown]),
        new_code_cell("table", outputs=[table]),
    ]
    made = new_notebook(cells=cells, metadata={"papermill": {"parameters": {"seed": 5}}})
    path = tmp_path / "52_dwell_time.ipynb"
    nbformat.write(made, path)
    verdicts = pd.DataFrame(
        {"id": ["dwell-1"], "verdict": ["reproduced"], "published": ['Medians "lie" there']}
    )
    page = notebook.page(path, blocks, "All is well.", verdicts)
    first, parameters, code, drawn = page.cells
    assert first.source.index("dwell-1: reproduced") < first.source.index("Published")
    assert "All is well." in first.source
    assert '<a href="13_light.html">notebook 13</a>' in first.source
    assert "Parameters: seed = 5, frames by scale" in parameters.source
    assert "<td>0.123</td>" in drawn.outputs[0]["data"]["text/html"]
    assert code.metadata["tags"] == ["hide-input"]
    assert "figures/fig-5-19-dwell-time.png" in code.outputs[0]["data"]["text/html"]


def test_ids_of_the_notebooks_are_numbers_of_the_works_or_plain_words():
    table = numbers.load()
    stems = numbers.own_ids(table)
    for path in sorted((paths.root() / "notebooks").glob("*.py")):
        for name in re.findall(r'figures\.save\(\s*f?"([^"{]+)', path.read_text()):
            numbered = re.match(r"(fig|table)-", name)
            known = any(
                f"{name}-".startswith(f"{stem}-") or stem.startswith(name) for stem in stems
            )
            assert known or not numbered, f"{path.name}: {name} has no number of the works"


def test_what_is_published_stands_beside_ours():
    columns = ["tp", "precision", "f1_in_pixels", "f1", "f1_published", "precision_published"]
    text = blocks_of.html_table(pd.DataFrame([["1"] * 6], columns=columns))
    heads = re.findall(r"<th>([^<]+)</th>", text)
    assert heads == ["TP", "precision", "precision published", "F1 in pixels", "F1", "F1 published"]
