"""Executed notebooks become a site that builds and reads without a network.

Sphinx with myst-nb and the furo theme; MathJax lies beside the pages. The index lists
the notebooks with title, one-line result and verdict counts, which it takes from what
the notebooks saved (`kilnflight.project.figures.conclude`).
"""

from __future__ import annotations

import argparse
import importlib.util
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import nbformat
import pandas as pd

from kilnflight import __version__
from kilnflight.checks import InputError
from kilnflight.project import claims, figures, paths
from kilnflight.project.cache import write_whole

# One self-contained script: MathJax with SVG output needs no font files, which a browser
# would refuse to load from a page opened as a file.
MATHJAX = "tex-svg-full.js"
# pandas tables come without any style of their own
TABLES_CSS = """
.cell_output table.dataframe { border-collapse: collapse; font-size: 0.8em; }
.cell_output table.dataframe th, .cell_output table.dataframe td {
  border: none; border-bottom: 1px solid var(--color-background-border);
  padding: 0.2em 0.6em; text-align: left; vertical-align: top;
}
.cell_output { overflow-x: auto; }
.cell_output figure { margin: 0.5em 0; }
figcaption { font-size: 0.9em; margin-top: 0.3em; }
"""
MARK = "<!-- results: made by `make full`, do not edit -->"
END_MARK = "<!-- end of results -->"

CONFIGURATION: dict[str, object] = {
    "project": "kilnflight",
    "author": "The kilnflight founders",
    "copyright": "The kilnflight founders",
    "release": __version__,
    "html_title": f"kilnflight {__version__}",
    "extensions": ["myst_nb", "sphinx.ext.mathjax"],
    "html_theme": "furo",
    "nb_execution_mode": "off",
    "nb_merge_streams": True,
    "myst_enable_extensions": ["dollarmath", "amsmath"],
    "myst_dmath_double_inline": True,
    "mathjax_path": MATHJAX,
    "exclude_patterns": ["jupyter_execute"],
    "html_static_path": ["_static"],
    "html_css_files": ["tables.css"],
    "html_copy_source": False,
    "html_show_sourcelink": False,
    "html_show_sphinx": False,
}


def mathjax() -> Path:
    """Return the MathJax script that the package sphinx-mathjax-offline ships."""
    package = importlib.util.find_spec("sphinx-mathjax-offline")
    if package is None or package.origin is None:
        raise InputError("sphinx-mathjax-offline is not installed; run make setup.")
    return Path(package.origin).parent / "static" / "mathjax" / MATHJAX


def title(notebook: nbformat.NotebookNode) -> str:
    """Return the first heading of a notebook."""
    for cell in notebook.cells:
        found = re.search(r"^# (.+)$", cell.source, re.MULTILINE)
        if cell.cell_type == "markdown" and found:
            return found.group(1)
    raise InputError("a notebook has no heading; start it with '# %% [markdown]' and '# # Title'.")


def overview(titles: dict[str, str], folder: Path | None = None) -> pd.DataFrame:
    """Return one row per notebook: what it found and its verdict counts.

    Parameters
    ----------
    titles
        Title by stem, in the order to show.
    folder
        Where the figures are.
    """
    folder = folder or paths.figures()
    saved = {entry.identifier: entry for entry in figures.entries(folder)}
    rows = []
    for stem, heading in titles.items():
        identifier = "claims-" + stem.replace("_", "-")
        if identifier not in saved:
            raise InputError(
                f"{stem} saved no {identifier}; its last cell must call figures.conclude."
            )
        table = pd.read_csv(folder / f"{identifier}.csv")
        result = saved[identifier].caption
        rows.append({"notebook": stem, "title": heading, "result": result, **claims.count(table)})
    return pd.DataFrame(rows, columns=["notebook", "title", "result", *claims.VERDICTS])


def index_text(table: pd.DataFrame, totals: dict[str, int]) -> str:
    """Return the text of the site's first page."""
    named = zip(table["title"], table["notebook"], strict=True)
    lines = [
        "# kilnflight",
        "",
        "How to see particles fly: a thesis and two papers, each result beside the published one.",
        "",
        _sentence(totals),
        "",
        *_markdown(table, [f"[{title}]({stem}.ipynb)" for title, stem in named]),
    ]
    stems = "\n".join(table["notebook"])
    return "\n".join(lines) + f"\n\n```{{toctree}}\n:hidden:\n\n{stems}\n```\n"


def _markdown(table: pd.DataFrame, names: Sequence[str]) -> list[str]:
    """Return the lines of a Markdown table of the overview, notebooks called by ``names``."""
    lines = [
        "| notebook | result | " + " | ".join(claims.VERDICTS) + " |",
        "|---|---|" + "---:|" * len(claims.VERDICTS),
    ]
    for name, (_, row) in zip(names, table.iterrows(), strict=True):
        counts = " | ".join(str(row[verdict]) for verdict in claims.VERDICTS)
        lines.append(f"| {name} | {row['result']} | {counts} |")
    return lines


def _sentence(totals: dict[str, int]) -> str:
    counts = ", ".join(f"{number} {verdict}" for verdict, number in totals.items())
    return f"Of {sum(totals.values())} published claims: {counts}."


def build_site(notebooks: Sequence[Path], build: Path, site: Path) -> Path:
    """Render executed notebooks and return the first page.

    The site is built under another name and takes its place when it is whole.

    Raises
    ------
    InputError
        If a notebook has no heading or no verdicts, or Sphinx reports a problem.
    """
    sources, fresh = build / "pages", build / "site"
    for folder in (sources, fresh):
        shutil.rmtree(folder, ignore_errors=True)
    (sources / "_static").mkdir(parents=True)
    shutil.copyfile(mathjax(), sources / "_static" / MATHJAX)
    (sources / "_static" / "tables.css").write_text(TABLES_CSS)
    titles = {}
    for path in sorted(notebooks):
        notebook = nbformat.read(path, as_version=4)
        titles[path.stem] = title(notebook)
        shutil.copyfile(path, sources / path.name)
    judged = paths.figures() / "claims.csv"
    totals = claims.count(pd.read_csv(judged)) if judged.is_file() else {}
    (sources / "index.md").write_text(index_text(overview(titles), totals))
    _sphinx(sources, fresh, build / "doctrees")
    shutil.rmtree(site, ignore_errors=True)
    shutil.move(fresh, site)
    return site / "index.html"


def _sphinx(sources: Path, target: Path, doctrees: Path) -> None:
    """Run Sphinx; any warning is an error."""
    settings = "".join(f"{name} = {value!r}\n" for name, value in CONFIGURATION.items())
    (sources / "conf.py").write_text(settings)
    shutil.rmtree(doctrees, ignore_errors=True)
    options = ["-b", "html", "-q", "--no-color", "-W", "--keep-going", "-d", str(doctrees)]
    command = [sys.executable, "-m", "sphinx", *options, str(sources), str(target)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        log = sources.parent / "site.log"
        log.write_text(done.stdout + done.stderr)
        lines = [line for line in done.stderr.splitlines() if "WARNING" in line or "rror" in line]
        first = lines[0] if lines else "see the log"
        raise InputError(f"the site has a problem: {first} (all of them: {log})")


def results_block() -> str:
    """Return the README's table of results, from figures/claims.csv and the notebooks."""
    titles = {}
    for path in sorted((paths.root() / "notebooks").glob("*.py")):
        found = re.search(r"^# # (.+)$", path.read_text(), re.MULTILINE)
        titles[path.stem] = found.group(1) if found else path.stem
    table = overview(titles)
    totals = claims.count(pd.read_csv(paths.figures() / "claims.csv"))
    lines = [
        MARK,
        _sentence(totals),
        "",
        *_markdown(table, list(table["title"])),
        *_trust(),
    ]
    return "\n".join([*lines, END_MARK])


def _trust() -> list[str]:
    """Return the main table of the notebook on trust, if it has run."""
    path = paths.figures() / "trust.csv"
    if not path.is_file():
        return []
    table = pd.read_csv(path, keep_default_na=False, dtype=str)
    rule = ["---" if k < 2 else "---:" for k in range(table.shape[1])]
    rows = [table.columns.tolist(), rule, *table.to_numpy().tolist()]
    return [
        "",
        "**How far to trust what is measured** on the twin, where the truth is known (notebook 56; "
        "median of measured minus true with its 95 % interval +- half the range that holds 68 % of "
        "it; cell's dwell: the median of all measured flights, and of all true ones; nobody's: "
        "flights that follow no particle):",
        "",
        *(f"| {' | '.join(row)} |" for row in rows),
    ]


def update_readme() -> bool:
    """Put the current results into README.md; say whether that changed it."""
    path = paths.root() / "README.md"
    text = path.read_text()
    if MARK not in text or END_MARK not in text:
        raise InputError(
            f"README.md: the lines {MARK!r} and {END_MARK!r} are missing; restore them."
        )
    before, _, rest = text.partition(MARK)
    after = rest.partition(END_MARK)[2]
    updated = before + results_block() + after
    if updated != text:
        write_whole(path, updated.encode())
    return updated != text


def main(arguments: Sequence[str] | None = None) -> int:
    """Render executed notebooks into a site, or bring the README's results up to date."""
    parser = argparse.ArgumentParser(
        prog="python -m kilnflight.project.site", description=main.__doc__
    )
    parser.add_argument("notebooks", type=Path, nargs="*")
    parser.add_argument("--build", type=Path, default=Path("build"))
    parser.add_argument("--site", type=Path, default=Path("site"))
    parser.add_argument("--readme", action="store_true", help="update README.md and stop")
    options = parser.parse_args(arguments)
    try:
        if options.readme:
            print("README.md: results " + ("updated" if update_readme() else "are up to date"))
        else:
            print(f"site: rendering {len(options.notebooks)} notebooks", flush=True)
            print(f"site: read {build_site(options.notebooks, options.build, options.site)}")
    except InputError as error:
        print(f"site: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
