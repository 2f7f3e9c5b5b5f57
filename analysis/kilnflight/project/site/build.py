"""Render executed notebooks as a site that builds and reads without a network.

Sphinx with myst-nb and the furo theme, whose left bar carries groups; formulas are drawings.
The index lists the notebooks with title, one-line result and verdict counts, which it takes from
what the notebooks saved (`kilnflight.project.figures.conclude`). One page shows the rooms of
the package and their imports, read from the code.
"""

from __future__ import annotations

import argparse
import importlib.util
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import nbformat

from kilnflight import __version__
from kilnflight.checks import InputError
from kilnflight.project import figures, paths
from kilnflight.project.site import documents, long_tables, notebook, numbers, reduced
from kilnflight.project.site.blocks import Blocks
from kilnflight.project.site.front import Front
from kilnflight.project.site.readme import claims_table, update_readme
from kilnflight.project.site.rooms import draw_rooms, imports, rooms_page

STYLE_SHEET = Path(__file__).with_name("site.css")
SCRIPT = Path(__file__).with_name("site.js")

PRINTED = "Claims and printed numbers"
# Groups of the left bar, in the order of the thesis: how the names of their notebooks begin.
GROUPS = {
    PRINTED: "00|01",
    "Depth": "02|03",
    "Detection": "2",
    "Tracking": "3",
    "Flight and combustion": "5",
    "Belt sorting": "4",
    "The twin": "1",
}

CONFIGURATION: dict[str, object] = {
    "project": "kilnflight",
    "author": "The kilnflight founders",
    "copyright": "The kilnflight founders",
    "release": __version__,
    "html_title": f"kilnflight {__version__}",
    "extensions": [
        "myst_nb",
        "sphinx_copybutton",
        "sphinx_design",
        "sphinx.ext.autodoc",
        "sphinx.ext.napoleon",
        documents.__name__,
        f"{__package__}.mathematics",
    ],
    "autodoc_typehints": "none",
    "autodoc_member_order": "bysource",
    "add_module_names": False,
    "toc_object_entries": False,
    "default_role": "py:obj",
    "napoleon_use_ivar": True,
    "copybutton_selector": "div.highlight pre, .downloads pre",
    "html_theme": "furo",
    "nb_execution_mode": "off",
    "nb_merge_streams": True,
    "nb_code_prompt_show": "Code",
    "nb_code_prompt_hide": "Code",
    "myst_enable_extensions": ["dollarmath", "amsmath", "colon_fence"],
    "myst_dmath_double_inline": True,
    "html_math_renderer": "drawn",
    "exclude_patterns": ["jupyter_execute"],
    "html_static_path": ["_static"],
    "html_css_files": [STYLE_SHEET.name],
    "html_js_files": [SCRIPT.name],
    "html_copy_source": False,
    "html_show_sourcelink": False,
    "html_show_sphinx": False,
    "html_show_search_summary": False,  # it would fetch pages, which files may not
}


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
    for path in (STYLE_SHEET, SCRIPT, _plotly()):
        shutil.copy(path, sources / "_static")
    _write_pages(notebooks, sources)
    rooms = imports(Path(__file__).parents[2])
    (sources / "rooms.md").write_text(rooms_page(rooms))
    draw_rooms(rooms).savefig(sources / "rooms.svg", metadata={"Date": None})
    _sphinx(sources, fresh, build / "doctrees")
    (fresh / "figures").mkdir()
    for path in paths.figures().iterdir():
        if path.suffix in (".png", ".pdf", ".csv", ".gif"):
            shutil.copy(path, fresh / "figures")
    shutil.rmtree(site, ignore_errors=True)
    shutil.move(fresh, site)
    return site / "index.html"


def _write_pages(notebooks: Sequence[Path], sources: Path) -> None:
    """Write the pages of notebooks, of the works' figures and tables, and of long tables."""
    stems = sorted(path.stem for path in notebooks)
    _check_concluded(stems)
    saved = {entry.identifier: entry for entry in figures.entries()}
    table = numbers.load(saved)
    blocks = Blocks(paths.figures(), numbers.links(table, stems), entries=saved)
    collected, results = claims_table(), figures.overview().set_index("notebook")["result"]
    beside = reduced.beside_full(collected)
    for path in notebooks:
        own = beside[beside["notebook"] == path.stem]
        page = notebook.page(path, blocks, str(results.get(path.stem, "")), own)
        nbformat.write(page, sources / path.name)
    below = replace(blocks, above="../")
    numbers.write(sources / "works", table, below, collected)
    (sources / "numbers.md").write_text(numbers.index(table))
    long_tables.write(sources / "tables", below)
    documents.write(sources / "documents", collected, blocks.links)
    documents.write_api(sources / "api")
    front = Front(paths.figures(), collected, table, list(saved.values()))
    first = front(sources / "_static" / "thumbs")
    (sources / "index.md").write_text(f"{first}\n\n{_contents(stems)}")


def _plotly() -> Path:
    """Return the script that the package plotly ships; pages with a view in space load it on a click."""
    return _package("plotly") / "package_data" / "plotly.min.js"


def _package(name: str) -> Path:
    """Return the folder of an installed package."""
    package = importlib.util.find_spec(name)
    if package is None or package.origin is None:
        raise InputError(f"{name} is not installed; run make setup.")
    return Path(package.origin).parent


def _check_concluded(stems: Sequence[str]) -> None:
    """Refuse notebooks that saved no verdicts."""
    for stem in set(stems) - set(figures.overview()["notebook"]):
        raise InputError(
            f"{stem} saved no {figures.verdicts_of(stem)}; its last cell must call "
            "figures.conclude."
        )


def _contents(stems: Sequence[str]) -> str:
    """Return the left bar: every page in its group."""
    groups = {name: [stem for stem in stems if re.match(start, stem)] for name, start in GROUPS.items()}
    known = {stem for group in groups.values() for stem in group}
    groups["Further notebooks"] = [stem for stem in stems if stem not in known]
    groups[PRINTED].append("numbers")
    groups |= documents.groups()
    return "\n".join(
        "\n".join(["```{toctree}", ":hidden:", f":caption: {name}\n", *pages, "```\n"])
        for name, pages in groups.items()
        if pages
    )


def _sphinx(sources: Path, target: Path, doctrees: Path) -> None:
    """Run Sphinx; any warning is an error."""
    configuration = CONFIGURATION | {"html_theme_options": {"announcement": reduced.banner()}}
    settings = "".join(f"{name} = {value!r}\n" for name, value in configuration.items())
    (sources / "conf.py").write_text(settings)
    shutil.rmtree(doctrees, ignore_errors=True)
    options = ["-b", "html", "-q", "--no-color", "-W", "--keep-going", "-j", "auto", "-d", str(doctrees)]
    command = [sys.executable, "-m", "sphinx", *options, str(sources), str(target)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        log = sources.parent / "site.log"
        log.write_text(done.stdout + done.stderr)
        lines = [line for line in done.stderr.splitlines() if "WARNING" in line or "rror" in line]
        first = lines[0] if lines else "see the log"
        raise InputError(f"the site has a problem: {first} (all of them: {log})")


def main(arguments: Sequence[str] | None = None) -> int:
    """Render executed notebooks into a site, or update the README's results."""
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
