import re

import pandas as pd
import pytest

from kilnflight.project import figures, paths
from kilnflight.project.figures import Provenance


def save(identifier, caption, **more):
    made = Provenance("02_x", {"scale": "quick"}, commit="a" * 40, **more)
    figures.save(identifier, pd.DataFrame({"a": [1]}), caption=caption, provenance=made)


@pytest.fixture
def page():
    save("fig-b", "Second figure. It has 50 % & more_less.")
    save("fig-a", "First figure: with a colon. And more.")
    return (paths.figures() / "README.md").read_text()


def test_every_figure_has_its_entry_in_order(page):
    assert re.findall(r"^## (.+)$", page, re.MULTILINE) == ["Results by notebook", "fig-a", "fig-b"]
    assert "![fig-a](fig-a.png)" in page
    assert "Second figure. It has 50 % & more_less." in page
    assert "notebooks/02_x.py" in page
    assert "(scale = quick)" in page


def test_citations_are_ready_to_paste(page):
    assert "@misc{kilnflight-fig-a," in page
    assert "title  = {First figure}," in page
    assert r"\includegraphics[width=\columnwidth]{fig-b.pdf}" in page
    assert r"It has 50 \% \& more\_less." in page
    assert page.count("{") == page.count("}")


def test_pictures_of_others_do_not_count():
    save("fig-a", "First figure.")
    from PIL import Image

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
    assert figures._title(caption) == title
