"""Render executed notebooks as a site that builds and reads without a network.

Sphinx with myst-nb and the furo theme; MathJax lies beside the pages. The index lists
the notebooks with title, one-line result and verdict counts, which it takes from what
the notebooks saved (`kilnflight.project.figures.conclude`). One page shows the rooms of
the package and their imports, read from the code.
"""

from __future__ import annotations

import argparse
import ast
import importlib.util
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import grimp
import networkx as nx
import pandas as pd
from matplotlib.figure import Figure

from kilnflight import __version__
from kilnflight.checks import InputError
from kilnflight.project import claims, claims_page, figures, paths
from kilnflight.project.cache import write_whole
from kilnflight.project.style import PAGE_MM, canvas, style

# One self-contained script: MathJax with SVG output needs no font files, which a browser
# would refuse to load from a page opened as a file.
MATHJAX = "tex-svg-full.js"
STYLE_SHEET = Path(__file__).with_name("site.css")
MARK = "<!-- results: made by `make full`, do not edit -->"
END_MARK = "<!-- end of results -->"
# Results that README.md shows, by number of the notebook: topic and table.
SHOWN = {
    "01": ("Printed numbers", "figures/errata.csv"),
    "24": ("Detection", "figures/table-5-11-detection.csv"),
}

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
    "html_css_files": [STYLE_SHEET.name],
    "html_copy_source": False,
    "html_show_sourcelink": False,
    "html_show_sphinx": False,
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
    shutil.copyfile(_mathjax(), sources / "_static" / MATHJAX)
    shutil.copy(STYLE_SHEET, sources / "_static")
    for path in notebooks:
        shutil.copy(path, sources)
    (sources / "index.md").write_text(_index(sorted(path.stem for path in notebooks)))
    rooms = imports(Path(__file__).parents[1])
    (sources / "rooms.md").write_text(_rooms_page(rooms))
    draw_rooms(rooms).savefig(sources / "rooms.svg", metadata={"Date": None})
    _sphinx(sources, fresh, build / "doctrees")
    shutil.rmtree(site, ignore_errors=True)
    shutil.move(fresh, site)
    return site / "index.html"


def _mathjax() -> Path:
    """Return the MathJax script that the package sphinx-mathjax-offline ships."""
    package = importlib.util.find_spec("sphinx-mathjax-offline")
    if package is None or package.origin is None:
        raise InputError("sphinx-mathjax-offline is not installed; run make setup.")
    return Path(package.origin).parent / "static" / "mathjax" / MATHJAX


def _index(stems: Sequence[str]) -> str:
    """Return the text of the first page: claims, and every notebook with its result."""
    table = figures.overview().set_index("notebook", drop=False)
    for stem in set(stems) - set(table.index):
        raise InputError(
            f"{stem} saved no {figures.verdicts_of(stem)}; its last cell must call "
            "figures.conclude."
        )
    table = table.loc[list(stems)]
    table["title"] = "[" + table["title"] + "](" + table["notebook"] + ".ipynb)"
    lines = [
        "# kilnflight\n",
        "How to see particles fly: each result of a thesis and two papers beside ours.\n",
        f"{_claims_sentence()} How the package is built: [its rooms](rooms.md).\n",
        "## Claims by chapter and cause\n",
        "<a href='00_claims.html'>Every claim beside its verdict</a>\n",
        figures.markdown(claims_page.counts_by_cause(_claims_table())),
        "## Results by notebook\n",
        figures.markdown(table.drop(columns="notebook")),
        "```{toctree}\n:hidden:\n",
        *stems,
        "rooms\n```\n",
    ]
    return "\n".join(lines)


def _claims_table() -> pd.DataFrame:
    return pd.read_csv(paths.figures() / "claims.csv", keep_default_na=False)


def _claims_sentence() -> str:
    totals = claims.count(_claims_table())
    counts = ", ".join(f"{number} {verdict}" for verdict, number in totals.items())
    return f"Of {sum(totals.values())} published claims: {counts}."


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


def imports(package: Path) -> nx.DiGraph:
    """Return the rooms of a package and their imports.

    Rooms are modules or folders at its top.

    Each room has a ``purpose``, the first line of its docstring.
    """
    modules, rooms = grimp.build_graph(package.name, cache_dir=None), nx.DiGraph()
    for module in sorted(modules.find_children(package.name)):
        file = package / f"{module.rpartition('.')[2]}.py"
        if not file.is_file():
            modules.squash_module(module)
            file = file.with_suffix("") / "__init__.py"
        purpose = (ast.get_docstring(ast.parse(file.read_text())) or "").partition("\n")[0]
        rooms.add_node(module.rpartition(".")[2], purpose=purpose)
    for room in rooms:
        imported = modules.find_modules_directly_imported_by(f"{package.name}.{room}")
        others = {name.rpartition(".")[2] for name in imported} & set(rooms) - {room}
        rooms.add_edges_from((room, other) for other in sorted(others))
    return rooms


def draw_rooms(rooms: nx.DiGraph) -> Figure:
    """Draw rooms in layers, each above what it imports; implied imports are left out."""
    layers = dict(enumerate(nx.topological_generations(rooms.reverse())))
    places = nx.multipartite_layout(rooms, subset_key=layers, align="horizontal")
    figure, ((axes,),) = canvas(width_mm=PAGE_MM, height_mm=15.0 * len(layers))
    box = {"boxstyle": "round", "facecolor": "white", "edgecolor": "0.4", "lw": 0.6}
    with style():
        drawn = nx.transitive_reduction(rooms)
        nx.draw_networkx_edges(drawn, places, ax=axes, arrows=False, edge_color="0.6", width=0.6)
        nx.draw_networkx_labels(rooms, places, ax=axes, font_size=7.5, bbox=box)
    axes.axis("off")
    return figure


def _rooms_page(rooms: nx.DiGraph) -> str:
    rows = [(room, rooms.nodes[room]["purpose"], ", ".join(sorted(rooms[room]))) for room in rooms]
    return (
        "# The rooms of the package\n\n![Rooms and their imports](rooms.svg)\n\n"
        "A room imports from layers below only. Imports that follow from others are not drawn.\n\n"
        + figures.markdown(pd.DataFrame(rows, columns=["room", "what it is for", "imports"]))
    )


def results_block() -> str:
    """Return the lines of README.md with results, from figures/."""
    results = figures.overview().set_index("notebook")["result"]
    lines = [MARK, f"- {_claims_sentence()} [Every verdict](figures/claims.csv)."]
    for stem, result in results.items():
        if str(stem)[:2] in SHOWN:
            topic, table = SHOWN[str(stem)[:2]]
            lines.append(f"- {topic}: {result} [Table]({table}).")
    return "\n".join([*lines, END_MARK])


def update_readme() -> bool:
    """Write the current results into README.md; return whether that changed it."""
    path = paths.root() / "README.md"
    text = path.read_text()
    if MARK not in text or END_MARK not in text:
        raise InputError(
            f"README.md: the lines {MARK!r} and {END_MARK!r} are missing; restore them."
        )
    before, _, rest = text.partition(MARK)
    updated = before + results_block() + rest.partition(END_MARK)[2]
    if updated != text:
        write_whole(path, updated.encode())
    return updated != text


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


if __name__ == "__main__":
    raise SystemExit(main())
