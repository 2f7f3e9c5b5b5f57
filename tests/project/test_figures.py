import json
import subprocess
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from matplotlib import pyplot as plt
from PIL import Image

from kilnflight.checks import InputError
from kilnflight.project import claims, figures, paths, style
from kilnflight.project.figures import Provenance

MADE = Provenance("02_x", {"scale": "full"}, 7, {"a.csv": "0f"}, "0.1.0", "abc")
TABLE = pd.DataFrame({"x_mm": [1.0, 2.5], "note": ["a", "b_c"]})
RECORD = {
    "notebook": "02_x",
    "parameters": {"scale": "full"},
    "seed": 7,
    "inputs": {"a.csv": "0f"},
    "version": "0.1.0",
    "commit": "abc",
    "mark": "simulated",
}


def drawn():
    picture, ((axes,),) = style.canvas()
    axes.plot([0, 1], [0, 1], label="line")
    axes.set(xlabel="x (mm)", ylabel="y (mm)")
    axes.legend()
    return picture


def save(identifier="fig-1", **more):
    given = {"caption": "A line. With a second sentence.", "provenance": MADE, **more}
    return figures.save(identifier, given.pop("table", TABLE), **given)


def files():
    return {path.name: path.read_bytes() for path in paths.figures().iterdir()}


def test_a_picture_is_png_pdf_and_csv_and_a_table_a_csv():
    save(picture=drawn())
    save("table-1")
    assert set(files()) == {"fig-1.png", "fig-1.pdf", "fig-1.csv", "table-1.csv", "index.json"}
    assert (paths.figures() / "fig-1.csv").read_text() == "x_mm,note\n1,a\n2.5,b_c\n"
    index = figures.index()["figures"]
    assert [index[name]["kind"] for name in ("fig-1", "table-1")] == ["picture", "table"]
    assert index["fig-1"]["caption"] == "A line. With a second sentence."
    assert index["fig-1"]["provenance"] == RECORD


def test_the_same_input_gives_the_same_bytes():
    save(picture=drawn())
    first = files()
    plt.rcParams["font.size"] = 20  # a user's own settings must not matter
    plt.rcParams["font.size"] = 10
    save(picture=drawn())
    assert first == files()


def test_caption_and_provenance_are_inside_png_and_pdf():
    save(picture=drawn())
    with Image.open(paths.figures() / "fig-1.png") as image:
        assert image.text["Description"] == "A line. With a second sentence."
        assert json.loads(image.text["Provenance"]) == RECORD
    content = (paths.figures() / "fig-1.pdf").read_bytes()
    assert b"A line. With a second sentence." in content
    assert b"02_x" in content
    assert b"CreationDate" not in content


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"identifier": "Fig 1"}, "lower-case-words"),
        ({"identifier": "../fig"}, "lower-case-words"),
        ({"caption": " "}, "a caption"),
        ({"table": pd.DataFrame()}, "no columns"),
        ({"table": pd.DataFrame({"a": [np.inf]})}, "infinity"),
    ],
)
def test_what_cannot_be_saved_is_told_and_nothing_is_written(wrong, message):
    with pytest.raises(InputError, match=message):
        save(**wrong)
    assert not paths.figures().exists()


def test_result_and_verdicts_of_a_notebook_that_exists_are_kept():
    verdict = claims.check("bg-1", True, 300.0)
    made = replace(MADE, notebook="00_claims")
    figures.conclude("One line.", [verdict], made)
    figures.conclude("Nothing to test.", [], MADE)  # no such notebook
    kept = figures.index()["notebooks"]
    assert list(kept) == ["00_claims"]
    assert kept["00_claims"]["result"] == "One line."
    (row,) = kept["00_claims"]["verdicts"]
    assert (row["id"], row["verdict"], row["measured"]) == ("bg-1", "reproduced", "300")
    with pytest.raises(InputError, match="judged twice"):
        figures.conclude("One line.", [verdict, verdict], made)


@pytest.fixture
def project(tmp_path, monkeypatch):
    """A project of its own with one commit."""
    monkeypatch.setenv("KILNFLIGHT_ROOT", str(tmp_path))
    for name in ("data/reference/claims.csv", "analysis/a.py", "notebooks/n.py"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("x = 1\n")
    (tmp_path / "pyproject.toml").write_text("")
    (tmp_path / "requirements.lock").write_text("")

    def git(*arguments):
        identity = ["-c", "user.name=n", "-c", "user.email=e"]
        command = ["git", *identity, *arguments]
        return subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, text=True)

    git("init", "-q")
    git("add", "-A")
    git("commit", "-qm", "one")
    return tmp_path, git


def test_the_commit_is_the_last_one_that_touched_what_counts(project):
    folder, git = project
    first = git("rev-parse", "HEAD").stdout.strip()
    (folder / "README.md").write_text("figures and pages do not count")
    git("add", "-A")
    git("commit", "-qm", "two")
    assert figures.trace("n", {}).commit == first
    (folder / "analysis/a.py").write_text("x = 2\n")
    assert figures.trace("n", {}).commit == first + "+changes"
    git("commit", "-qam", "three")
    assert figures.trace("n", {}).commit == git("rev-parse", "HEAD").stdout.strip()
