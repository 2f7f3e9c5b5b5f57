import json
import subprocess
from dataclasses import asdict, replace

import numpy as np
import pandas as pd
import pytest
from matplotlib import pyplot as plt
from PIL import Image

from kilnflight.checks import InputError
from kilnflight.publication import claims, figures, style, verdicts
from kilnflight.publication.figures import Provenance
from kilnflight.store import index, paths

MADE = Provenance(
    "02_x", {"scale": "full"}, 7, {"a.csv": "0f"}, "abc", "simulated", version="0.1.0"
)
TABLE = pd.DataFrame({"x_mm": [1.0, 2.5], "note": ["a", "b_c"]})
CAPTION = "A line. With a second sentence."


def drawn():
    picture, ((axes,),) = style.canvas()
    axes.plot([0, 1], [0, 1], label="line")
    axes.legend()
    return picture


def save(identifier="fig-1", table=TABLE, caption=CAPTION, picture=None):
    figures.save(identifier, table, caption=caption, provenance=MADE, picture=picture)


def files():
    return {path.name: path.read_bytes() for path in paths.figures().iterdir()}


def test_a_picture_is_png_pdf_and_csv_and_a_table_a_csv():
    save(picture=drawn())
    save("table-1")
    assert set(files()) == {
        "fig-1.png",
        "fig-1.pdf",
        "fig-1.csv",
        "table-1.csv",
        "index.json",
    }
    assert (paths.figures() / "fig-1.csv").read_text() == "x_mm,note\n1,a\n2.5,b_c\n"
    known = index.load()["figures"]
    assert [known[name]["kind"] for name in ("fig-1", "table-1")] == [
        "picture",
        "table",
    ]
    assert known["fig-1"]["caption"] == CAPTION
    assert known["fig-1"]["provenance"] == asdict(MADE)
    with Image.open(paths.figures() / "fig-1.png") as image:
        assert image.text["Description"] == CAPTION
        assert json.loads(image.text["Provenance"]) == asdict(MADE)
    content = (paths.figures() / "fig-1.pdf").read_bytes()
    assert CAPTION.encode() in content
    assert b"02_x" in content


def test_a_picture_that_grew_too_large_has_no_older_pdf():
    save(picture=drawn())
    dots, ((axes,),) = style.canvas()
    axes.plot(*np.random.default_rng(0).random((2, 60_000)), ".")
    save(picture=dots)
    assert set(files()) == {"fig-1.png", "fig-1.csv", "index.json"}


def test_the_same_input_gives_the_same_bytes():
    save(picture=drawn())
    first = files()
    picture = drawn()
    with plt.rc_context({"font.size": 20}):  # a user's own settings must not matter
        save(picture=picture)
    assert first == files()


@pytest.mark.parametrize(
    ("wrong", "name"),
    [
        ({"identifier": "../fig"}, "id"),
        ({"caption": " "}, "caption"),
        ({"table": pd.DataFrame()}, "table"),
        ({"table": pd.DataFrame({"a": [np.inf]})}, "table"),
    ],
)
def test_what_cannot_be_saved_is_told_and_nothing_is_written(wrong, name):
    with pytest.raises(InputError, match=name):
        save(**wrong)
    assert not paths.figures().exists()


def test_result_and_verdicts_of_a_notebook_that_exists_are_kept():
    verdict = claims.check("bg-1", True, 300.0)
    made = replace(MADE, notebook="00_claims")
    figures.conclude("One line.", [verdict], made)
    figures.conclude("Nothing to test.", [], MADE)  # no such notebook
    judged = asdict(verdict) | {"data": "simulated"}
    kept = {"result": "One line.", "verdicts": [judged], "choices": []}
    assert index.load()["notebooks"] == {"00_claims": kept}
    figures.conclude("One line.", [verdict, verdict], made)
    with pytest.raises(InputError, match="00_claims and 00_claims"):
        verdicts.collect()


def test_the_commit_is_the_last_one_that_touched_what_counts(tmp_path, monkeypatch):
    monkeypatch.setenv("KILNFLIGHT_ROOT", str(tmp_path))

    def git(*arguments):
        command = ["git", "-c", "user.name=n", "-c", "user.email=e", *arguments]
        done = subprocess.run(
            command, cwd=tmp_path, check=True, capture_output=True, text=True
        )
        return done.stdout.strip()

    def commit(name):
        (tmp_path / name).write_text("x = 1\n")
        git("add", "-A")
        git("commit", "-qm", name)
        return git("rev-parse", "HEAD")

    git("init", "-q")
    for folder in ("data/reference", "analysis"):
        (tmp_path / folder).mkdir(parents=True)
    commit("data/reference/claims.csv")
    first = commit("analysis/a.py")
    commit("README.md")
    assert figures.trace("n", {}).commit == first
    (tmp_path / "analysis/a.py").write_text("x = 2\n")
    assert figures.trace("n", {}).commit == first + "+changes"
    assert commit("analysis/b.py") == figures.trace("n", {}).commit


def test_a_reduced_run_never_writes_over_results_of_record(monkeypatch):
    monkeypatch.delenv("KILNFLIGHT_FIGURES")
    with pytest.raises(InputError, match="KILNFLIGHT_FIGURES"):
        figures.trace("02_x", {"scale": "quick"})
    assert figures.trace("02_x", {"scale": "full"}).parameters == {"scale": "full"}


def test_a_large_picture_has_no_pdf(monkeypatch):
    monkeypatch.setattr(figures, "LARGEST", 1)
    save(picture=drawn())
    assert set(files()) == {"fig-1.png", "fig-1.csv", "index.json"}
