"""Write the pages of the site and run Sphinx: ``python docs/generate.py BUILD SITE``.

    executed notebooks in BUILD, the folder of figures, docs/ -> BUILD/pages -> SITE

``python docs/generate.py --readme`` writes the results into README.md, and
figures/README.md.
"""

import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import nbformat
import pandas as pd
from jinja2 import Environment, FileSystemLoader
from nbformat.v4 import new_markdown_cell
from PIL import Image

from kilnflight.checks import InputError
from kilnflight.publication import claims, figures, verdicts
from kilnflight.store import index, paths
from kilnflight.store.cache import write_whole

DOCS = Path(__file__).parent
# By title: a pattern of work and place of its claims, numbers of the notebooks whose
# results are shown, and a table to read first.
CHAPTERS = {
    "Detection": ("thesis (3|5[.]1|6)", ("24",), "detection-scores"),
    "Tracking": ("thesis (4[.]2|5[.]2)", ("32",), "table-5-17-tracking"),
    "Regression": ("thesis 4[.]3", ("50",), "table-5-18-regression"),
    "Flight": ("thesis (5[.]3[.]1|A)", ("52", "53"), "dwell-recovery"),
    "Ignition": ("thesis 5[.]3[.]2", ("54",), "ignition-recovery"),
    "Belt": ("belt-", ("40",), "fig-belt20-9-arrival"),
    "Misprints": ("misprint", ("00",), "errata"),
}
# Ids of figures have these between kind and number.
STEMS = {"thesis": "", "belt-2020": "belt20-", "belt-2016": "belt16-"}
LONGEST = 150  # rows of a table that a page shows
SENTENCE_END = r"(?<!Fig)(?<!Figs)(?<!Eq)(?<!Eqs)(?<!ec)[.:;] "
FOUR_DIGITS = r"(?<=<td>)-?\d+\.\d{4,}(?=</td>)"


def latex(text: str) -> str:
    """Return a text with LaTeX's special characters escaped."""
    escaped = re.sub(r"([%&_#${}])", r"\\\1", text.replace("\\", r"\textbackslash "))
    return escaped.replace("~", r"\textasciitilde ").replace("^", r"\textasciicircum ")


TEMPLATES = Environment(
    loader=FileSystemLoader(DOCS / "_templates" / "pages"),
    trim_blocks=True,
    block_start_string="<%",
    block_end_string="%>",
    variable_start_string="<<",
    variable_end_string=">>",
)
TEMPLATES.filters["latex"] = latex


def render(template: str, **values: Any) -> str:
    """Return a template of docs/_templates/pages, filled in."""
    return TEMPLATES.get_template(template).render(values)


def saved() -> dict[str, dict[str, Any]]:
    """Return the saved figures and tables by id, as the templates show them."""
    folder = paths.figures()
    found = {}
    cff = (paths.root() / "CITATION.cff").read_text()
    url = re.search(r'^repository-code: *"?([^"\s]+)', cff, re.M)
    for name, entry in index.load()["figures"].items():
        origin = entry["provenance"]
        kinds = [
            kind
            for kind in ("png", "csv", "pdf")
            if (folder / f"{name}.{kind}").is_file()
        ]
        each = {**entry, "name": name, "kinds": kinds, "url": url and url[1]}
        first = re.split(SENTENCE_END, entry["caption"], maxsplit=1)[0]
        each["title"] = first.rstrip(".")
        each["scale"] = origin["parameters"].get("scale", "full")
        each["commit"] = origin["commit"][:12] + origin["commit"][40:]
        each["page"] = f"{origin['notebook']}.html#{name}"
        each["cited"] = {"BibTeX": render("bibtex", **each)}
        if entry["kind"] == "picture":
            each["cited"]["LaTeX"] = render("latex", **each)
            with Image.open(folder / f"{name}.png") as image:
                shown = figures.SCREEN_DPI / image.info["dpi"][0]
                each["width"] = round(shown * image.width)
                each["height"] = round(shown * image.height)
        found[name] = each
    return found


def table(name: str, folder: Path | None = None) -> str:
    """Return a saved table as HTML, numbers with four digits.

    Rows of claims.csv have anchors.
    """
    path = (folder or paths.figures()) / f"{name}.csv"
    rows = pd.read_csv(path, dtype=str, keep_default_na=False)
    text = rows.head(LONGEST).to_html(index=False, border=0)
    text = re.sub(FOUR_DIGITS, lambda found: f"{float(found[0]):.4g}", text)
    text = re.sub(r"<td>(\d\d_\w+)</td>", r'<td><a href="\1.html">\1</a></td>', text)
    if name == "claims":
        text = re.sub(r"<tr>(\s*<td>)([\w-]+)<", r'<tr id="\2">\1\2<', text)
    left = len(rows) - LONGEST
    if left > 0:
        text += f"<p>{left} more rows in the CSV.</p>"
    return text


def block(each: dict[str, Any]) -> str:
    """Return a figure or table with caption, files and citations as HTML."""
    return render("figure.html", table=table(each["name"]), **each)


def page(path: Path, known: dict[str, dict[str, Any]]) -> nbformat.NotebookNode:
    """Return an executed notebook with folded code and linked figures, each once."""
    notebook = nbformat.read(path, as_version=4)
    cells = []
    left = {
        name
        for name, each in known.items()
        if each["provenance"]["notebook"] == path.stem
    }
    for cell in notebook.cells:
        if cell.cell_type == "code":
            cell.metadata["tags"] = ["hide-input"]
            for output in cell.outputs:
                text = output.get("data", {}).get("text/html", "")
                found = re.match(r"<figure id='([a-z0-9-]+)'", text)
                if found and found[1] in left:
                    left.remove(found[1])
                    output["data"] = {"text/html": block(known[found[1]])}
            if cells and cells[-1].cell_type == "code" and not cells[-1].outputs:
                cell.source = f"{cells.pop().source}\n\n{cell.source}"  # one fold
        cells.append(cell)
    if left:
        rest = "".join(block(known[name]) for name in sorted(left))
        cells.append(new_markdown_cell(f"```{{raw}} html\n{rest}\n```"))
    notebook.cells = cells
    return notebook


def numbers(known: dict[str, dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the figures and tables of the works, each with those that show it."""
    rows = pd.read_csv(
        paths.reference() / "numbers.csv", dtype=str, keep_default_na=False
    )
    listed = rows.to_dict("records")
    for row in listed:
        row["label"] = f"{row['kind'].replace('Fig', 'Fig.')} {row['number']}"
        stem = f"{row['kind']}-{STEMS[row['work']]}{row['number']}-"
        stem = stem.lower().replace(".", "-")
        row["figures"] = [
            each for name, each in known.items() if f"{name}-".startswith(stem)
        ]
        pictures = [each for each in row["figures"] if each["kind"] == "picture"]
        row["thumbnail"] = next(iter(pictures), None)
    places = {
        (row["work"], f"drawn with {row['label']}"): row["figures"] for row in listed
    }
    for row in listed:
        row["figures"] = places.get((row["work"], row["absent"]), row["figures"])
    return listed


def chapters() -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Return verdict counts and one result of each chapter, and all counts."""
    judged = verdicts.collect().join(claims.load()[["work", "where"]], on="id")
    where = judged["work"] + " " + judged["where"]
    concluded = index.load()["notebooks"]
    rows = []
    for title, (start, chosen, shown) in CHAPTERS.items():
        results = [
            each["result"]
            for stem, each in concluded.items()
            if stem.startswith(chosen)
        ]
        part = judged[where.str.match(start)]
        row = {
            "title": title,
            "claims": len(part),
            "result": " ".join(results),
            "shown": shown,
        }
        rows.append(row | counts(part))
    return rows, {"claims": len(judged), **counts(judged)}


def counts(judged: pd.DataFrame) -> dict[str, int]:
    """Return the number of claims with each verdict, in the order of `VERDICTS`."""
    found = judged["verdict"].value_counts()
    return {verdict: int(found.get(verdict, 0)) for verdict in claims.VERDICTS}


def write_pages(executed: Path, pages: Path, small: Path) -> list[str]:
    """Write the sources of the site and the thumbnails; return the reduced scales."""
    known = saved()
    concluded = index.load()["notebooks"]
    (pages / "documents").mkdir(parents=True)
    small.mkdir()
    notebooks = [
        path for path in sorted(executed.glob("*.ipynb")) if path.stem in concluded
    ]
    for path in notebooks:
        nbformat.write(page(path, known), pages / path.name)
    stems = [path.stem for path in notebooks]
    (pages / "contents.inc").write_text(render("contents.inc", stems=stems))
    for path in DOCS.glob("*.md"):
        top = path.stem in ("index", "api")
        shutil.copy(path, pages if top else pages / "documents")
    measured = paths.root() / "figures"  # make bench writes there, at one scale
    for name in ("benchmarks", "cost-by-step", "growth"):
        text = "<p>Not measured here.</p>"
        if (measured / f"{name}.csv").is_file():
            text = table(name, measured)
        (pages / "documents" / f"{name}.inc").write_text(text)
    listed = numbers(known)
    (pages / "numbers.md").write_text(render("numbers.md", numbers=listed))
    (pages / "verdicts.inc").write_text(render("verdicts.inc", chapters=chapters()[0]))
    (pages / "thumbnails.inc").write_text(render("thumbnails.inc", numbers=listed))
    for name in {row["thumbnail"]["name"] for row in listed if row["thumbnail"]}:
        with Image.open(paths.figures() / f"{name}.png") as image:
            picture = image.convert("RGB")
            picture.thumbnail((240, 480))
            picture.save(small / f"{name}.webp", quality=60, method=6)
    return sorted({each["scale"] for each in known.values()} - {"full"})


def write_page(executed: Path, pages: Path, small: Path) -> list[str]:
    """Write the source of a site of one notebook, as `write_pages` does for all."""
    pages.mkdir()
    small.mkdir()
    (path,) = executed.glob("[0-9][0-9]_*.ipynb")
    nbformat.write(page(path, saved()), pages / "index.ipynb")
    return []


def build(executed: Path, site: Path) -> None:
    """Build the site under another name; it takes its place when it is whole."""
    pages, small, fresh = (executed / name for name in ("pages", "thumbnails", "fresh"))
    for folder in (pages, small, fresh):
        shutil.rmtree(folder, ignore_errors=True)
    if (executed / "00_claims.ipynb").is_file():
        scales = write_pages(executed, pages, small)
    else:
        scales = write_page(executed, pages, small)
    banner = ""
    if scales:
        banner = (
            f"A reduced run (scale {' and '.join(scales)}): little input, other "
            "numbers. Cite from make full only."
        )
    run_sphinx(pages, fresh, executed, banner)
    shutil.copytree(small, fresh / "figures" / "thumbnails")
    for path in paths.figures().iterdir():
        if path.suffix in (".png", ".pdf", ".csv"):
            shutil.copy(path, fresh / "figures")
    shutil.rmtree(site, ignore_errors=True)
    shutil.move(fresh, site)


def run_sphinx(pages: Path, fresh: Path, executed: Path, banner: str) -> None:
    """Run Sphinx; its output goes to site.log, its first warning is raised."""
    options = ["-q", "-W", "--keep-going", "--no-color", "-j", "auto"]
    options += ["-D", f"html_theme_options.announcement={banner}", "-c", str(DOCS)]
    options += ["-d", str(executed / "doctrees")]
    command = [sys.executable, "-m", "sphinx", *options, pages, fresh]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    (executed / "site.log").write_text(done.stdout + done.stderr)
    if done.returncode:
        lines = done.stderr.splitlines()
        warned = (line for line in lines if re.search("warning|error", line, re.I))
        first = next(warned, "Sphinx failed")
        raise InputError(f"{first} (all: {executed}/site.log)")


def readme() -> tuple[str, str]:
    """Return README.md with the current results, and figures/README.md."""
    listed, total = chapters()
    results = render("results.md", chapters=listed, total=total)
    first, *_, last = results.splitlines()
    text = (paths.root() / "README.md").read_text()
    found = re.fullmatch(f"(.*){first}.*{last}(.*)", text, re.S)
    if found is None:
        raise InputError(f"README.md: restore its lines {first!r} and {last!r}.")
    concluded = index.load()["notebooks"]
    gallery = render("gallery.md", figures=saved(), notebooks=concluded)
    return found[1] + results + found[2], gallery


if __name__ == "__main__":
    try:
        if sys.argv[1:] == ["--readme"]:
            for folder, text in zip(
                (paths.root(), paths.figures()), readme(), strict=True
            ):
                write_whole(folder / "README.md", text.encode())
        else:
            build(Path(sys.argv[1]), Path(sys.argv[2]))
            print(f"site: read {sys.argv[2]}/index.html")
    except InputError as error:
        sys.exit(f"site: {error}")
