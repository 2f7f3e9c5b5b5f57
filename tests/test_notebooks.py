"""The notebooks: rules of the house, and a smoke run of the whole chain up to the pages."""

import ast
import json
import re
import subprocess
from pathlib import Path

import jupytext
import pandas as pd
import pytest

from kilnflight.experiments import errata
from kilnflight.project import claims, figures, notebooks

PROJECT = Path(__file__).resolve().parents[1]

SOURCES = sorted((PROJECT / "notebooks").glob("*.py"))
FOUND = "tp fp fn precision recall f1"
TABLES = {
    "table-5-4-background": f"model subset {FOUND}",
    "table-5-5-otsu": f"subset {FOUND} seconds_per_image",
    "table-5-6-sift": f"threshold subset {FOUND} seconds_per_image",
    "table-5-8-dbscan": f"minPts epsilon_mm subset {FOUND} seconds_per_image",
    "table-5-9-mo": f"R subset {FOUND} seconds_per_image",
    "table-5-10-qcc": f"K alpha subset {FOUND} seconds_per_image",
    "table-5-11-detection": f"method {FOUND}",
    "table-5-17-tracking": "fraction tracker postprocessing alpha beta jsc jsc_theta",
    "table-5-13-classification": f"threshold threshold_mm subset {FOUND}",
    "table-5-14-classification": f"threshold threshold_mm subset {FOUND}",
    "belt-arrival": "source data_set model n median_ms q25_ms q75_ms mae_ms",
    "belt-lateral": "source data_set model n median_mm q25_mm q75_mm mae_mm",
    "belt-arrival-rate": "sampling_hz source data_set model n iqr_ms mae_ms",
    "errata": "where printed recomputed consequence",
    "claims": "id verdict measured published notebook reason criterion",
}


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.stem)
def test_a_notebook_keeps_the_rules(path):
    notebook = jupytext.read(path)
    assert figures.title(path.stem)
    assert {"scale", "seed"} <= set(notebooks.known_parameters(notebooks.read_source(path)))
    code = [cell.source for cell in notebook.cells if cell.cell_type == "code"]
    assert max(len(cell.splitlines()) for cell in code) <= 25
    for cell in code:
        for node in ast.walk(ast.parse(cell)):
            if isinstance(node, ast.FunctionDef):
                assert node.end_lineno - node.lineno < 5
    assert "figures.conclude(" in code[-1]
    assert not any(cell.get("outputs") for cell in notebook.cells)
    text = "\n".join(cell.source for cell in notebook.cells if cell.cell_type == "markdown")
    assert "**Published" in text or "**The work.**" in text


def test_nothing_executed_is_tracked():
    listed = subprocess.run(
        ["git", "ls-files", "*.ipynb"], cwd=PROJECT, capture_output=True, text=True, check=False
    )
    assert listed.stdout == ""


def test_the_tables_have_the_agreed_columns(smoke):
    for name, columns in TABLES.items():
        table = pd.read_csv(smoke / "figures" / f"{name}.csv")
        wanted = columns.split()
        assert list(table.columns)[: len(wanted)] == wanted, name
        assert len(table), name


def test_no_saved_table_holds_an_impossible_number(smoke):
    assert figures.absurdities(smoke / "figures") == []


def test_every_model_has_a_row_for_every_data_set(smoke):
    for name, models in (("arrival", 6), ("lateral", 7)):
        table = pd.read_csv(smoke / "figures" / f"belt-{name}.csv")
        assert set(table["source"]) == {"own-simulation"}
        assert (table.groupby("data_set")["model"].nunique() == models).all()
        assert table.notna().all(axis=None)
        unit = {"arrival": "ms", "lateral": "mm"}[name]
        assert (table[f"q25_{unit}"] <= table[f"median_{unit}"]).all()
        assert (table[f"median_{unit}"] <= table[f"q75_{unit}"]).all()


def test_every_claim_has_a_verdict_and_without_data_a_reason(smoke):
    table = pd.read_csv(smoke / "figures" / "claims.csv", index_col="id", keep_default_na=False)
    assert table.index.tolist() == claims.load().index.tolist()
    assert set(table["verdict"]) <= set(claims.VERDICTS)
    assert (table.loc[table["verdict"] == claims.NOT_DECIDABLE, "reason"] != "").all()
    assert table.loc["cluster-10", "verdict"] == claims.NOT_REPRODUCED


def test_what_is_not_reproduced_says_because_of_what(smoke):
    table = pd.read_csv(smoke / "figures" / "claims.csv", keep_default_na=False)
    assert claims.without_cause(table) == []


def test_the_first_line_says_that_it_is_our_simulation(smoke):
    for stem in ("40_belt_arrival", "41_belt_lateral"):
        cells = json.loads((smoke / "build" / f"{stem}.ipynb").read_text())["cells"]
        text = "".join(cells[1]["outputs"][0]["data"]["text/markdown"])
        assert text.startswith("**Own simulation**")


def test_no_cell_printed_a_warning(smoke):
    for path in sorted((smoke / "build").glob("[0-9]*.ipynb")):
        for cell in json.loads(path.read_text())["cells"]:
            for output in cell.get("outputs", []):
                assert output.get("name") != "stderr", (path.stem, output["text"])


def test_no_cell_shows_the_inside_of_matplotlib(smoke):
    for path in sorted((smoke / "build").glob("[0-9]*.ipynb")):
        for cell in json.loads(path.read_text())["cells"]:
            for output in cell.get("outputs", []):
                text = "".join(output.get("data", {}).get("text/plain", ""))
                assert "matplotlib" not in text, path.stem
                assert not text.startswith(("[", "(", "Text(")), (path.stem, text)


def test_the_index_lists_every_notebook_and_a_page_begins_with_its_result(smoke):
    page = (smoke / "site" / "index.html").read_text()
    for path in SOURCES:
        assert f'href="{path.stem}.html"' in page
    assert re.search(r"<b>\d+</b> not decidable", page)
    errors = (smoke / "site" / "01_published_tables.html").read_text()
    assert f"{len(errata.recompute())} printed values recomputed" in errors
