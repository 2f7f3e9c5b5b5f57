import nbformat
import pandas as pd
import pytest
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook

from kilnflight.checks import InputError
from kilnflight.project import claims, figures, paths, site
from kilnflight.project.figures import Provenance


@pytest.fixture
def executed(tmp_path):
    """An executed notebook, its saved verdicts, and a table of claims."""

    def make(text="# A title\n\nText with $x^2$.", stem="07_test"):
        path = tmp_path / "build" / f"{stem}.ipynb"
        path.parent.mkdir(exist_ok=True)
        notebook = new_notebook(cells=[new_markdown_cell(text), new_code_cell("1")])
        notebook.metadata["language_info"] = {"name": "python", "pygments_lexer": "ipython3"}
        notebook.metadata["kernelspec"] = {"name": "python3", "display_name": "Python 3"}
        nbformat.write(notebook, path)
        made = Provenance(stem, {"scale": "quick"})
        verdicts = [claims.judge("depth-3", 300.0)]
        figures.conclude("One result.", verdicts, made)
        table = claims.collect([claims.verdict_table(verdicts, stem)])
        figures.save("claims", table, caption="All.", provenance=made)
        return path

    return make


def build(executed_notebooks, folder):
    return site.build_site(executed_notebooks, folder / "build", folder / "site")


def test_a_site_has_an_index_with_results_and_its_own_mathjax(executed, tmp_path):
    index = build([executed()], tmp_path)
    text = index.read_text()
    assert "A title" in text
    assert "One result." in text
    assert "1 reproduced, 0 not reproduced, 78 not decidable" in text
    page = (tmp_path / "site" / "07_test.html").read_text()
    assert f'src="_static/{site.MATHJAX}' in page
    assert (tmp_path / "site" / "_static" / site.MATHJAX).stat().st_size > 1e6


def test_a_notebook_without_verdicts_is_an_error_and_the_old_site_stays(executed, tmp_path):
    build([executed()], tmp_path)
    path = executed()
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
def project(executed, tmp_path, monkeypatch):
    executed()
    (tmp_path / "notebooks").mkdir()
    (tmp_path / "notebooks" / "07_test.py").write_text("# %% [markdown]\n# # A title\n")
    monkeypatch.setattr(paths, "root", lambda: tmp_path)
    return tmp_path


def test_the_readme_gets_the_results_and_only_between_its_marks(project):
    readme = project / "README.md"
    readme.write_text(f"before\n{site.MARK}\nold\n{site.END_MARK}\nafter\n")
    assert site.update_readme() is True
    text = readme.read_text()
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert "| A title | One result. | 1 | 0 | 0 |" in text
    assert "old" not in text
    assert site.update_readme() is False


def test_a_readme_without_marks_is_an_error(project):
    (project / "README.md").write_text("nothing here")
    with pytest.raises(InputError, match=r"README\.md: the lines"):
        site.update_readme()


def test_the_overview_counts_verdicts(project):
    table = site.overview({"07_test": "A title"})
    assert isinstance(table, pd.DataFrame)
    assert table.loc[0, "reproduced"] == 1
