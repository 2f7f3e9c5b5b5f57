import json
import re
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


def test_a_figure_is_png_pdf_csv_and_an_entry_in_the_gallery():
    save(picture=drawn())
    names = {path.name for path in paths.figures().iterdir()}
    assert names == {"fig-1.png", "fig-1.pdf", "fig-1.csv", "README.md"}
    assert (paths.figures() / "fig-1.csv").read_text() == "x_mm,note\n1,a\n2.5,b_c\n"


def test_a_smoke_run_saves_half_the_pixels_and_no_pdf():
    full, quick = save(picture=drawn()), save("fig-2", picture=drawn(), provenance=SMOKE)
    names = {path.name for path in paths.figures().glob("fig-2.*")}
    assert names == {"fig-2.png", "fig-2.csv"}
    with Image.open(full.path) as large, Image.open(quick.path) as small:
        assert large.width == pytest.approx(2 * small.width, abs=1)
    width = re.compile(r'width="(\d+)"')  # on the page they are as wide
    shown = [int(width.search(one.page).group(1)) for one in (full, quick)]
    assert shown[0] == pytest.approx(shown[1], abs=1)


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
    picture, ((axes,),) = style.canvas(width_mm=180, height_mm=120)
    axes.imshow(np.random.default_rng(0).random((700, 1000)), cmap="gray")
    small, noisy = save(picture=style.canvas(width_mm=180)[0]), save("fig-2", picture=picture)
    assert noisy.path.stat().st_size <= figures.LARGEST_PNG
    widths = [int(re.search(r'width="(\d+)"', one.page)[1]) for one in (small, noisy)]
    assert widths[0] == pytest.approx(widths[1], abs=2)


def test_what_only_a_check_needs_is_no_figure():
    figures.save_check("numbers", TABLE, caption="Only looked at.", provenance=MADE)
    assert (paths.checks() / "numbers.csv").is_file()
    assert figures.entries() == []
