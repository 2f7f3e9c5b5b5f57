import re

import nbformat
import pytest
from tools import execute as executor

from kilnflight.publication import notebooks

SOURCE = """# %% [markdown]
# # A notebook
#
# Text.

# %% tags=["parameters"]
scale = "standard"
seed = 1
width = 2.0
jobs = 4

# %%
f"{scale} {seed} {width} {jobs}"

# %%
LAST
"""


def execute(folder, given="scale=standard", last="1 + 1"):
    """Execute the notebook in a folder; return the exit code and its files by name."""
    path, build = folder / "07_test.py", folder / "build"
    path.write_text(SOURCE.replace("LAST", last))
    options = [part for one in given.split(" ") for part in ("-p", one)]
    code = executor.main([str(path), "--build", str(build), *options])
    return code, {file.name: outputs(file) for file in build.glob("*")}


def outputs(path):
    cells = nbformat.read(path, as_version=4).cells
    found = [
        output
        for cell in cells
        for output in cell.get("outputs", [])
        if "data" in output
    ]
    return [output["data"]["text/plain"] for output in found]


@pytest.mark.parametrize(
    ("given", "shown"),
    [
        ("scale=quick 07.width=3 jobs=3", "'quick 1 3 3'"),
        ("scale=quick", "'quick 1 2.0 1'"),
    ],
)
def test_parameters_reach_the_notebook_and_a_smoke_run_starts_no_processes(
    tmp_path, given, shown
):
    code, made = execute(tmp_path, given)
    assert code == 0
    assert made == {"07_test.ipynb": [shown, "2"]}


def test_a_failing_cell_is_told_and_the_rest_is_kept_for_inspection(tmp_path, capsys):
    code, made = execute(tmp_path, last='raise ValueError("no such particle")')
    assert code == 1
    assert made == {"07_test.failed.ipynb": ["'standard 1 2.0 4'"]}
    error = capsys.readouterr().err
    assert error.startswith("07_test: cell 5 (raise ValueError")
    assert "07_test.failed.ipynb" in error


@pytest.mark.parametrize("path", ["2024", "1e5", "film.tif", "[a]", "'film.tif'"])
def test_a_path_that_looks_like_a_number_stays_a_path(path):
    known = {"recording": "", "seed": 0}
    items = [f"60.recording={path}", "seed=3"]
    given = executor.parse_parameters(items, "60_film", ["60_film"], known)
    executor.check_parameters("60_film", known, given)
    assert given == {"recording": path.strip("'"), "seed": 3}


@pytest.mark.parametrize(
    ("given", "name"),
    [
        ("nothing=3", "'nothing'"),
        ("seed=many", "seed"),
        ("scale=huge", "scale"),
        ("x7.seed=3", "x7.seed"),
        ("width=3", "08_other.*'width'"),  # of another notebook
    ],
)
def test_a_wrong_parameter_is_one_line_and_nothing_runs(tmp_path, capsys, given, name):
    (tmp_path / "08_other.py").write_text(SOURCE.replace("width = 2.0", ""))
    assert execute(tmp_path, given) == (1, {})
    error = capsys.readouterr().err.strip()
    assert re.search(name, error)
    assert len(error.splitlines()) == 1


LENDER = """# %%
import math

width = 2.0
rows = []
width_of = math.sqrt(seed)


# %%
def area(height):
    return math.floor(width * height) + more


1 / 0
"""


def test_functions_are_borrowed_without_running_a_notebook(tmp_path, monkeypatch):
    (tmp_path / "notebooks").mkdir()
    (tmp_path / "notebooks" / "07_lender.py").write_text(LENDER)
    monkeypatch.setattr(notebooks, "root", lambda: tmp_path)
    lender = notebooks.borrow("07_lender", more=1)
    assert lender.area(3.0) == 7
    assert lender.rows == []
    assert not hasattr(lender, "width_of")
    assert notebooks.borrow("07_lender", more=1, width=4.0).area(3.0) == 13
    lender.more = 10
    assert lender.area(3.0) == 16
