import hashlib
import json
import re
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
SMOKE = replace(MADE, parameters={"scale": "quick"})
TABLE = pd.DataFrame({"x_mm": [1.0, 2.5], "note": ["a", "b_c"]})


def drawn():
    picture, ((axes,),) = style.canvas()
    axes.plot([0, 1], [0, 1], label="line")
    axes.set(xlabel="x (mm)", ylabel="y (mm)")
    axes.legend()
    return picture


def save(identifier="fig-1", **more):
    given = {"caption": "A line. With a second sentence.", "provenance": MADE, **more}
    return figures.save(identifier, given.pop("table", TABLE), **given)


def test_a_film_is_shown_with_its_caption_and_listed_for_make(tmp_path, monkeypatch):
    monkeypatch.setenv(paths.SAVED_LIST, str(tmp_path / "saved"))
    path = paths.figures() / "film.gif"
    shown = figures.film(path, "A film & more.")
    assert 'src="figures/film.gif"' in shown._repr_html_()
    assert "<figcaption>A film &amp; more.</figcaption>" in shown.page
    assert (tmp_path / "saved").read_text() == f"{path.resolve()}\n"


def test_a_figure_is_png_pdf_csv_and_an_entry_in_the_gallery():
    save(picture=drawn())
    names = {path.name for path in paths.figures().iterdir()}
    assert names == {"fig-1.png", "fig-1.pdf", "fig-1.csv", "README.md"}
    assert (paths.figures() / "fig-1.csv").read_text() == "x_mm,note\n1,a\n2.5,b_c\n"


def test_six_digits_are_written_beside_words_too():
    save(table=pd.DataFrame({"value": [1 / 3, "words", 7]}))
    assert (paths.figures() / "fig-1.csv").read_text() == "value\n0.333333\nwords\n7\n"


@pytest.mark.parametrize("scale", ["quick", "standard"])
def test_a_reduced_run_saves_half_the_pixels_and_no_pdf(scale):
    reduced = replace(MADE, parameters={"scale": scale})
    full, quick = save(picture=drawn()), save("fig-2", picture=drawn(), provenance=reduced)
    names = {path.name for path in paths.figures().glob("fig-2.*")}
    assert names == {"fig-2.png", "fig-2.csv"}
    with Image.open(full.path) as large, Image.open(quick.path) as small:
        assert large.width == pytest.approx(2 * small.width, abs=1)
    width = re.compile(r'width="(\d+)"')  # on the page they are as wide
    shown = [int(width.search(one.page).group(1)) for one in (full, quick)]
    assert shown[0] == pytest.approx(shown[1], abs=1)


def test_the_picture_of_a_table_has_fewer_rows_in_a_reduced_run_and_its_csv_all():
    table = pd.DataFrame({"value": range(40)})
    full, quick = save(table=table), save("fig-2", table=table, provenance=SMOKE)
    with Image.open(full.path) as large, Image.open(quick.path) as small:
        assert large.height > 2 * small.height
    assert len(pd.read_csv(quick.path.with_suffix(".csv"))) == 40
    assert quick.page.count("<tr") == full.page.count("<tr")


def test_a_changed_figure_is_read_again():
    save(caption="Before.", picture=drawn())
    assert [entry.caption for entry in figures.entries()] == ["Before."]
    save(caption="After.", picture=drawn())
    assert [entry.caption for entry in figures.entries()] == ["After."]


@pytest.mark.parametrize("picture", [drawn, lambda: None], ids=["figure", "table"])
def test_the_same_input_gives_the_same_bytes(picture):
    save(picture=picture())
    first = {path.name: path.read_bytes() for path in paths.figures().iterdir()}
    plt.rcParams["font.size"] = 20  # a user's own settings must not matter
    plt.rcParams["font.size"] = 10
    save(picture=picture())
    assert first == {path.name: path.read_bytes() for path in paths.figures().iterdir()}


def test_caption_and_provenance_are_inside_the_png():
    with Image.open(save(picture=drawn()).path) as image:
        text = image.text
    assert text["Title"] == "fig-1"
    assert text["Description"] == "A line. With a second sentence."
    record = json.loads(text["Provenance"])
    assert record == {
        "notebook": "02_x",
        "parameters": {"scale": "full"},
        "seed": 7,
        "inputs": {"a.csv": "0f"},
        "version": "0.1.0",
        "commit": "abc",
        "mark": "simulated",
    }


def test_caption_and_provenance_are_inside_the_pdf():
    save(picture=drawn())
    content = (paths.figures() / "fig-1.pdf").read_bytes()
    assert b"A line. With a second sentence." in content
    assert b"02_x" in content
    assert b"CreationDate" not in content


def test_a_saved_figure_shows_itself_with_its_caption():
    page = save(picture=drawn(), caption="x < 1 & more")._repr_html_()
    assert "data:image/png;base64," in page
    assert "x &lt; 1 &amp; more" in page
    assert "<table" in save("table-1")._repr_html_()


def test_an_impossible_number_is_refused_unless_the_caption_says_why():
    table = pd.DataFrame({"fraction": ["a", "b"], "measured_m_s": [1_063_640.0, 5.0]})
    message = r"figure fig-1: column measured_m_s: 1 of 2 outside -30 to 32 \(m/s.* worst 1.06"
    with pytest.raises(InputError, match=message):
        save(table=table)
    assert not list(paths.figures().glob("fig-1*"))
    save(table=table, caption="Velocities. Impossible values stand here to show what is refused.")
    assert (paths.figures() / "fig-1.csv").is_file()


def test_saved_tables_are_looked_through_for_what_cannot_be():
    save("fig-1")
    save("fig-2", caption="Impossible values stand here.", table=pd.DataFrame({"dwell_s": [-1.0]}))
    assert figures.absurdities() == []
    (paths.figures() / "by-hand.csv").write_text("dwell_s,f1\n0.3,0.5\n0.4,1.5\n")
    (found,) = figures.absurdities()
    assert found.startswith("by-hand.csv: column f1: 1 of 2 outside 0 to 1")


def test_open_figures_are_closed():
    before = plt.get_fignums()
    save(picture=drawn())
    save("table-1")
    assert plt.get_fignums() == before


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"identifier": "Fig 1"}, "lower-case words"),
        ({"identifier": "../fig"}, "lower-case words"),
        ({"caption": " "}, "no caption"),
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
    assert list(paths.figures().iterdir()) == []


def test_conclusions_are_saved_under_the_notebook():
    verdict = claims.judge("depth-3", 300.0)
    figures.conclude("One line.", [verdict], MADE)
    table = pd.read_csv(paths.figures() / "claims-02-x.csv")
    assert table.loc[0, ["id", "verdict", "notebook"]].tolist() == ["depth-3", "reproduced", "02_x"]


def test_a_notebook_without_claims_concludes_too():
    figures.conclude("Nothing to test.", [], MADE)
    assert len(pd.read_csv(paths.figures() / "claims-02-x.csv")) == 0


def test_a_png_is_small_even_of_noise_and_stays_as_wide_on_the_page():
    picture, ((axes,),) = style.canvas()
    axes.imshow(np.random.default_rng(0).random((700, 1000)), cmap="gray", aspect="auto")
    small, noisy = save(picture=style.canvas()[0]), save("fig-2", picture=picture)
    assert noisy.path.stat().st_size <= figures.LARGEST_PNG
    widths = [int(re.search(r'width="(\d+)"', one.page)[1]) for one in (small, noisy)]
    assert widths[0] == pytest.approx(widths[1], abs=2)


def save_one(identifier, caption, scale="full", **more):
    made = Provenance("02_x", {"scale": scale}, commit="a" * 40, **more)
    figures.save(identifier, pd.DataFrame({"a": [1]}), caption=caption, provenance=made)


@pytest.fixture
def page():
    save_one("fig-b", "Second figure. It has 50 % & more_less.")
    save_one("fig-a", "First figure: with a colon. And more.")
    return (paths.figures() / "README.md").read_text()


def test_every_figure_has_its_entry_in_order(page):
    assert re.findall(r"^## (.+)$", page, re.MULTILINE) == ["Results by notebook", "fig-a", "fig-b"]
    assert "![fig-a](fig-a.png)" in page
    assert "Second figure. It has 50 % & more_less." in page
    assert "notebooks/02_x.py" in page
    assert "(scale = full)" in page


def test_citations_are_ready_to_paste(page):
    assert "@misc{kilnflight-fig-a," in page
    assert "title  = {First figure}," in page
    assert r"\includegraphics[width=\columnwidth]{fig-b.pdf}" in page
    assert r"It has 50 \% \& more\_less." in page
    assert page.count("{") == page.count("}")


def test_a_figure_of_a_reduced_run_has_no_citation():
    save_one("fig-a", "First figure.", scale="quick")
    page = (paths.figures() / "README.md").read_text()
    assert "do not cite" in page
    assert "bibtex" not in page
    assert "latex" not in page


def test_pictures_of_others_do_not_count():
    save_one("fig-a", "First figure.")
    Image.new("RGB", (2, 2)).save(paths.figures() / "foreign.png")
    assert [entry.identifier for entry in figures.entries()] == ["fig-a"]


def test_only_notebooks_that_exist_have_concluded(monkeypatch, tmp_path):
    (tmp_path / "notebooks").mkdir()
    (tmp_path / "notebooks" / "02_x.py").write_text("# # Title\n")
    monkeypatch.setattr(paths, "root", lambda: tmp_path)
    for stem in ("02_x", "99_gone"):
        figures.conclude("A result.", [], Provenance(stem, {"scale": "quick"}))
    assert list(figures.concluded()) == ["02_x"]


@pytest.mark.parametrize(
    ("caption", "title"),
    [
        ("Depth, after Fig. 2.15. Boxes: more.", "Depth, after Fig. 2.15"),
        ("One sentence", "One sentence"),
        ("After Fig. 9 of the 2020 paper: box plots.", "After Fig. 9 of the 2020 paper"),
    ],
)
def test_the_title_is_the_first_sentence(caption, title):
    assert figures.title_of(caption) == title


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


def test_few_colours_keep_greys_grey_and_colours_near():
    ramp = np.linspace(0, 255, 300).astype(np.uint8)
    grey = np.repeat(ramp[None, :, None], 3, axis=2)
    blend = np.stack([ramp, 255 - ramp, np.full(300, 90, np.uint8)], axis=1)[None]
    pixels = np.concatenate([grey, blend])
    few = figures._few_colours(Image.fromarray(pixels), 64, 192)
    shown = np.asarray(few.convert("RGB")).astype(int)
    assert np.ptp(shown[0], axis=1).max() == 0
    assert np.abs(shown[0] - grey[0]).max() <= 3
    assert np.abs(shown[1] - blend[0]).max() <= 12


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


def test_a_long_table_is_drawn_with_its_totals_first():
    table = pd.DataFrame({"subset": [*("V1" for _ in range(60)), "Total"], "tp": range(61)})
    texts = [text.get_text() for text in style.table_picture(table).axes[0].texts]
    assert texts[2:4] == ["Total", "60"]
    assert texts[-2].startswith("... 16 more rows")


def test_a_reading_of_all_tracks_is_no_total():
    table = pd.DataFrame({"reading": ["all", "from the lance"], "fraction": ["shred", "all"]})
    assert style.totals(table).tolist() == [False, True]


def test_the_address_of_the_repository_is_in_every_citation_once_it_is_set(tmp_path, monkeypatch):
    save(picture=drawn())
    (entry,) = figures.entries()
    assert "url " not in figures.citations(entry)["BibTeX"]
    monkeypatch.setattr(paths, "root", lambda: tmp_path)
    (tmp_path / "CITATION.cff").write_text('repository-code: "https://example.org/kilnflight"\n')
    assert "url    = {https://example.org/kilnflight}," in figures.citations(entry)["BibTeX"]


def test_no_sentence_holds_a_nan():
    assert figures.NO_NUMBER.sub("too few", "alpha nan (0.67), +nan, nan % of nanometres") == (
        "alpha too few (0.67), too few, too few of nanometres"
    )
    save(picture=drawn(), caption="Half of nan %.")
    assert figures.entries()[0].caption == "Half of too few."
