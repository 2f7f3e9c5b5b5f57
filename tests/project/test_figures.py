import hashlib
import json
import subprocess
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from matplotlib import pyplot as plt
from PIL import Image

from kilnflight import __version__
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


def test_six_digits_are_written_beside_words_too():
    save(table=pd.DataFrame({"value": [1 / 3, "words", 7]}))
    assert (paths.figures() / "fig-1.csv").read_text() == "value\n0.333333\nwords\n7\n"


@pytest.mark.parametrize("scale", ["quick", "standard"])
def test_a_reduced_run_saves_half_the_pixels_and_no_pdf(scale):
    save(picture=drawn())
    save("fig-2", picture=drawn(), provenance=replace(MADE, parameters={"scale": scale}))
    assert {name for name in files() if "fig-2" in name} == {"fig-2.png", "fig-2.csv"}
    widths = []
    for name in ("fig-1.png", "fig-2.png"):
        with Image.open(paths.figures() / name) as image:
            widths.append(image.width)
    assert widths[0] == pytest.approx(2 * widths[1], abs=1)


def test_a_figure_that_is_saved_again_or_lost_is_known():
    save(caption="Before.")
    save(caption="After.")
    assert figures.index()["figures"]["fig-1"]["caption"] == "After."
    (paths.figures() / "fig-1.csv").unlink()
    assert figures.index()["figures"] == {}


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


def test_a_saved_figure_shows_itself_with_its_caption():
    page = save(picture=drawn(), caption="x < 1 & more")._repr_html_()
    assert "data:image/png;base64," in page
    assert "x &lt; 1 &amp; more" in page
    assert "<table" in save("table-1")._repr_html_()
    assert plt.get_fignums() == []


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


def test_a_picture_that_cannot_be_drawn_leaves_nothing(monkeypatch):
    picture = drawn()
    monkeypatch.setattr(picture, "savefig", lambda *_, **__: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        save(picture=picture)
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


def test_saved_files_are_listed_for_make(tmp_path, monkeypatch):
    monkeypatch.setenv(paths.SAVED_LIST, str(tmp_path / "saved"))
    save()
    assert (tmp_path / "saved").read_text() == f"{paths.figures() / 'fig-1.csv'}\n"


def test_a_png_is_small_even_of_noise():
    picture, ((axes,),) = style.canvas()
    axes.imshow(np.random.default_rng(0).random((700, 1000)), cmap="gray", aspect="auto")
    save(picture=picture)
    assert len(files()["fig-1.png"]) <= figures.LARGEST_PNG


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


def test_inputs_are_known_by_their_checksum(tmp_path):
    path = tmp_path / "in.csv"
    path.write_bytes(b"1,2\n")
    made = figures.trace("02_x", {"scale": "quick"}, seed=3, inputs=[path])
    assert made.inputs == {"in.csv": hashlib.sha256(b"1,2\n").hexdigest()}
    assert (made.notebook, made.seed, made.version) == ("02_x", 3, __version__)


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


def test_without_a_repository_or_git_there_is_no_commit(project, monkeypatch, tmp_path_factory):
    empty = tmp_path_factory.mktemp("no-git")
    (empty / "data/reference").mkdir(parents=True)
    (empty / "data/reference/claims.csv").write_text("")
    monkeypatch.setenv("KILNFLIGHT_ROOT", str(empty))
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(empty.parent))
    assert figures.trace("n", {}).commit == ""
    monkeypatch.setenv("PATH", str(empty))
    assert figures.trace("n", {}).commit == ""


def test_a_picture_says_what_its_data_are_and_leaves_them_room():

    for word in ("simulated", ""):
        picture, ((axes,),) = style.canvas(width_mm=80, height_mm=40)
        axes.set(xlabel="time (s)")
        style.mark(picture, word)
        picture.draw_without_rendering()
        box = axes.get_tightbbox().transformed(picture.transFigure.inverted())
        assert [text.get_text() for text in picture.texts] == [word]
        mark = picture.texts[0].get_window_extent().transformed(picture.transFigure.inverted())
        assert not word or box.y0 >= mark.y1 - 0.01
