"""The notebooks: rules of the house, and a smoke run of the whole chain up to the
pages.
"""

import json
from pathlib import Path

import jupytext
import pandas as pd
import pytest
from tests.definitions.bounds import impossible
from tools import execute

from kilnflight.publication import claims

PROJECT = Path(__file__).resolve().parents[1]

SOURCES = sorted((PROJECT / "notebooks").glob("*.py"))
FOUND = "tp fp fn precision recall f1"
TABLES = {  # columns that outside checks read
    "table-5-4-background": f"model subset reading {FOUND}",
    "table-5-5-otsu": f"subset {FOUND}",
    "table-5-6-sift": f"threshold subset {FOUND}",
    "table-5-8-dbscan": f"minPts epsilon_mm subset {FOUND}",
    "table-5-9-mo": f"R subset {FOUND}",
    "table-5-10-qcc": f"K alpha subset {FOUND}",
    "table-5-11-detection": f"method {FOUND} f1_diameter_45_px",
    "table-5-13-classification": f"threshold_mm subset {FOUND}",
    "table-5-14-classification": f"threshold_mm subset {FOUND}",
    "table-5-17-tracking": "fraction tracker postprocessing alpha beta jsc jsc_theta",
    "belt-arrival": "source data_set model n median_ms q25_ms q75_ms mae_ms",
    "belt-lateral": "source data_set model n median_mm q25_mm q75_mm mae_mm",
    "errata": "where printed recomputed consequence",
    "claims": "id verdict because measured published notebook reason data",
    "choices": "id decided_by result_chosen result_other verdicts_that_turn",
}


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.stem)
def test_a_notebook_keeps_the_rules(path):
    notebook = jupytext.read(path)
    first = notebook.cells[0].source
    assert first.startswith("# ")
    for words in (
        "**The work.**",
        "**Here.**",
        "**One number.**",
        "**What disagrees.**",
    ):
        assert words in first
    assert {"scale", "seed"} <= set(execute.known_parameters(path))
    code = [cell.source for cell in notebook.cells if cell.cell_type == "code"]
    assert max(len(cell.splitlines()) for cell in code) <= 40
    assert "figures.conclude(" in code[-1]


def test_the_tables_have_the_agreed_columns(smoke):
    for name, columns in TABLES.items():
        table = pd.read_csv(smoke / "figures" / f"{name}.csv")
        assert set(columns.split()) <= set(table.columns), name
        assert len(table), name


def test_every_erratum_says_whether_a_conclusion_depends_on_it(smoke):
    wrong = pd.read_csv(smoke / "figures" / "errata.csv")
    assert len(wrong) == 45
    number = wrong["kind"] == "number"
    assert number.sum() == 19
    assert (wrong.loc[number, "consequence"] == "no: last digits only").sum() == 9
    assert wrong["consequence"].str.match(r"(no|yes|in part|not known)\b").all()
    assert not wrong["where"].duplicated().any()


def test_no_saved_table_holds_an_impossible_number(smoke):
    for path in (smoke / "figures").glob("*.csv"):
        assert impossible(pd.read_csv(path), path.stem) == [], path.name


def test_every_model_has_a_row_for_every_data_set(smoke):
    for name, models in (("arrival", 6), ("lateral", 7)):
        table = pd.read_csv(smoke / "figures" / f"belt-{name}.csv")
        assert set(table["source"]) == {"own-simulation"}
        assert (table.groupby("data_set")["model"].nunique() == models).all()
        assert table.notna().all(axis=None)


def test_most_claims_have_a_verdict(smoke):
    table = pd.read_csv(smoke / "figures" / "claims.csv", keep_default_na=False)
    assert table["id"].tolist() == claims.load().index.tolist()
    assert (table["notebook"] != "").mean() > 0.5


def test_no_cell_printed_a_warning_and_pages_say_that_the_belt_is_simulated(smoke):
    told = set()
    for path in (smoke / "build").glob("[0-9]*.ipynb"):
        cells = json.loads(path.read_text())["cells"]
        for output in (output for cell in cells for output in cell.get("outputs", [])):
            assert output.get("name") != "stderr", (path.stem, output["text"])
            text = "".join(output.get("data", {}).get("text/plain", ""))
            assert not text.startswith(("[", "(", "<matplotlib", "Text(")), (
                path.stem,
                text,
            )
            if "friction model" in json.dumps(output):
                told.add(path.stem[:2])
    assert {"40", "41", "42", "43", "45"} <= told


def test_the_site_has_every_notebook_and_says_that_the_run_is_reduced(smoke):
    front = (smoke / "site" / "index.html").read_text()
    for path in SOURCES:
        page = (smoke / "site" / "run" / f"{path.stem}.html").read_text()
        assert "at scale quick: little input" in page
        recorded = (smoke / "site" / f"{path.stem}.html").is_file()
        place = path.stem if recorded else f"run/{path.stem}"
        assert f'href="{place}.html"' in front
