import re

import nbformat
import pytest

from kilnflight.project import notebooks

SOURCE = """# %% [markdown]
# # A notebook
#
# Text.

# %% tags=["parameters"]
scale = "standard"
seed = 1
width = 2.0
flag = False

# %%
result = f"{scale} {seed} {width}"
result

# %%
LAST
"""


@pytest.fixture
def notebook(tmp_path):
    def write(last="1 + 1", stem="07_test"):
        path = tmp_path / f"{stem}.py"
        path.write_text(SOURCE.replace("LAST", last))
        return path

    return write


def outputs(path):
    cells = nbformat.read(path, as_version=4).cells
    return [
        output["data"]["text/plain"]
        for cell in cells
        for output in cell.get("outputs", [])
        if "data" in output
    ]


def test_parameters_reach_the_notebook(notebook, tmp_path):
    path = notebook()
    code = notebooks.main(
        [str(path), "--build", str(tmp_path / "b"), "-p", "scale=quick", "-p", "07.width=3"]
    )
    assert code == 0
    assert outputs(tmp_path / "b" / "07_test.ipynb") == ["'quick 1 3'", "2"]
    assert [p.name for p in (tmp_path / "b").iterdir()] == ["07_test.ipynb"]


@pytest.mark.parametrize(("given", "jobs"), [("scale=quick", 1), ("scale=quick,jobs=3", 3)])
def test_a_smoke_run_starts_no_processes_unless_told(notebook, tmp_path, given, jobs):
    path = notebook("jobs")
    path.write_text(path.read_text().replace("seed = 1", "seed = 1\njobs = 4"))
    build, options = tmp_path / "b", [part for one in given.split(",") for part in ("-p", one)]
    assert notebooks.main([str(path), "--build", str(build), *options]) == 0
    assert outputs(build / "07_test.ipynb")[-1] == str(jobs)


def test_a_parameter_that_another_notebook_does_not_know_stops_this_one(notebook, tmp_path, capsys):
    path, other = notebook(), notebook(stem="08_other")
    other.write_text(other.read_text().replace("width = 2.0", "height = 2.0"))
    assert notebooks.main([str(path), "--build", str(tmp_path / "b"), "-p", "width=3"]) == 1
    assert "08_other: unknown parameter 'width'" in capsys.readouterr().err
    assert not (tmp_path / "b").exists()


def test_a_failing_cell_is_told_and_the_rest_is_kept_for_inspection(notebook, tmp_path, capsys):
    build = tmp_path / "b"
    build.mkdir()
    path = notebook('raise ValueError("no such particle")')
    assert notebooks.main([str(path), "--build", str(build)]) == 1
    error = capsys.readouterr().err.strip()
    assert error.startswith(
        '07_test: cell 4 (raise ValueError("no such particle")) failed: ValueError'
    )
    assert "07_test.failed.ipynb" in error
    assert [p.name for p in build.iterdir()] == ["07_test.failed.ipynb"]
    assert outputs(build / "07_test.failed.ipynb") == ["'standard 1 2.0'"]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("nothing=3", r"unknown parameter 'nothing'; it knows scale, seed, width, flag"),
        ("seed=many", r"parameter seed is 'many', expected int"),
        ("scale=huge", r"scale 'huge' is not one of quick, standard, full"),
        ("x7.seed=3", "write name=value"),
    ],
)
def test_a_wrong_parameter_is_one_line_and_nothing_runs(notebook, tmp_path, capsys, given, message):
    path = notebook()
    assert notebooks.main([str(path), "--build", str(tmp_path / "b"), "-p", given]) == 1
    error = capsys.readouterr().err.strip()
    assert re.search(message, error)
    assert len(error.splitlines()) == 1
    assert not (tmp_path / "b").exists()
