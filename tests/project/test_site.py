import nbformat
import pytest
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook

from kilnflight.checks import InputError
from kilnflight.project import claims, figures, paths, site
from kilnflight.project.figures import Provenance
from kilnflight.project.site import documents


@pytest.fixture
def executed(tmp_path, monkeypatch):
    """An executed notebook, its text, its saved verdicts, and a table of claims."""
    reference, root = paths.reference(), tmp_path / "project"
    (root / "notebooks").mkdir(parents=True)
    monkeypatch.setattr(paths, "reference", lambda: reference)
    monkeypatch.setattr(paths, "root", lambda: root)
    # Without docs/ Sphinx need not read every room; tests/test_site_pages.py has them.
    monkeypatch.setattr(documents, "FOLDER", root / "docs")

    def make(text="# A title\n\nText with $x^2$.\n\n$$\nx = 1\n$$ (eq-1)", stem="07_test"):
        lines = "".join(f"# {line}\n" for line in text.splitlines())
        (root / "notebooks" / f"{stem}.py").write_text(f"# %% [markdown]\n{lines}")
        path = tmp_path / "build" / f"{stem}.ipynb"
        path.parent.mkdir(exist_ok=True)
        notebook = new_notebook(cells=[new_markdown_cell(text), new_code_cell("1")])
        notebook.metadata["language_info"] = {"name": "python", "pygments_lexer": "ipython3"}
        notebook.metadata["kernelspec"] = {"name": "python3", "display_name": "Python 3"}
        nbformat.write(notebook, path)
        origin = Provenance(stem, {"scale": "quick"})
        verdicts = [claims.judge("depth-3", 300.0)]
        figures.conclude("One result.", verdicts, origin)
        table = claims.collect([claims.verdict_table(verdicts, stem)])
        table.to_csv(paths.figures() / "claims.csv", index=False)
        return path

    return make


def build(executed_notebooks, folder):
    return site.build_site(executed_notebooks, folder / "build", folder / "site")


def test_a_site_has_an_index_with_results_and_sets_its_formulas(executed, tmp_path):
    index = build([executed()], tmp_path)
    text = index.read_text()
    assert "A title" in text
    assert "<b>1</b> reproduced" in text
    assert f"<b>{len(claims.load()) - 1}</b> not decidable" in text
    page = (tmp_path / "site" / "07_test.html").read_text()
    assert "One result." in page
    assert 'role="img" aria-label="x^2"' in page
    assert "<span>(1)</span>" in page  # the number of the formula


def test_a_notebook_without_verdicts_is_an_error_and_the_old_site_stays(executed, tmp_path):
    path = executed()
    build([path], tmp_path)
    (paths.figures() / "claims-07-test.png").unlink()
    with pytest.raises(InputError, match="07_test saved no claims-07-test"):
        build([path], tmp_path)
    assert (tmp_path / "site" / "index.html").is_file()


def test_what_sphinx_warns_about_is_an_error(executed, tmp_path):
    with pytest.raises(InputError, match=r"the site has a problem: .*07_test"):
        build([executed("# A title\n\n[nowhere](nothing.md)")], tmp_path)
    assert not (tmp_path / "site").exists()


def test_a_notebook_without_heading_is_an_error(executed, tmp_path):
    with pytest.raises(InputError, match="has no heading"):
        build([executed("Text only.")], tmp_path)


@pytest.fixture
def project(executed):
    executed(stem="01_test")
    executed(stem="02_test")
    return paths.root()


def test_the_readme_gets_the_results_and_only_between_its_marks(project):
    readme = project / "README.md"
    readme.write_text(f"before\n{site.MARK}\nold\n{site.END_MARK}\nafter\n")
    assert site.update_readme() is True
    text = readme.read_text()
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert text.count("One result.") == 1
    assert f"1 reproduced, 0 not reproduced, {len(claims.load()) - 1} not decidable" in text
    assert "old" not in text
    assert site.update_readme() is False


def test_the_overview_counts_verdicts(project):
    table = figures.overview()
    assert table["notebook"].tolist() == ["01_test", "02_test"]
    assert table["title"].tolist() == ["A title"] * 2
    assert table["reproduced"].tolist() == [1, 1]
    assert table["not reproduced"].tolist() == table["not decidable"].tolist() == [0, 0]


def test_a_readme_without_marks_is_an_error(project):
    (project / "README.md").write_text("nothing here")
    with pytest.raises(InputError, match=r"README\.md: the lines"):
        site.update_readme()


def test_imports_are_read_from_the_code_and_drawn_once(tmp_path, monkeypatch):
    package = tmp_path / "house"
    (package / "cellar").mkdir(parents=True)
    (package / "__init__.py").touch()
    (package / "roof.py").write_text(
        '"""Keep out rain.\n\nMore."""\nfrom house import hall, cellar'
    )
    (package / "hall.py").write_text("import os\nfrom house.cellar.wine import RED")
    (package / "cellar" / "__init__.py").write_text('"""Store wine."""')
    (package / "cellar" / "wine.py").write_text("from house.cellar import x\nRED = 1")
    monkeypatch.syspath_prepend(tmp_path)
    rooms = site.imports(package)
    imported = {room: set(rooms[room]) for room in rooms}
    assert imported == {"cellar": set(), "hall": {"cellar"}, "roof": {"hall", "cellar"}}
    purposes = dict(rooms.nodes(data="purpose"))
    assert purposes == {"roof": "Keep out rain.", "hall": "", "cellar": "Store wine."}
    (axes,) = site.draw_rooms(rooms).axes
    heights = {text.get_text(): text.get_position()[1] for text in axes.texts}
    assert heights["cellar"] < heights["hall"] < heights["roof"]
    (edges,) = axes.collections
    assert len(edges.get_segments()) == 2  # roof to cellar follows from the others
