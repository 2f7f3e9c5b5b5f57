"""Write the pages of the site and run Sphinx: ``python docs/generate.py BUILD SITE``.

    results of record in figures/, sources of notebooks -> SITE, a page a notebook
    executed notebooks in BUILD, their figures          -> SITE/run, a page a notebook
    docs/                                               -> all other pages

Without results of record the executed notebooks take their place. A film of one's own
is a site of one page.

``python docs/generate.py --readme`` writes the results into README.md, into
figures/README.md and into a page for each notebook beside it; ``--cite ID`` prints how
to cite a figure.
"""

import ast
import difflib
import os
import re
import runpy
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import jupytext
import nbformat
import pandas as pd
from jinja2 import Environment, FileSystemLoader
from nbformat.v4 import new_markdown_cell, new_output
from PIL import Image

from kilnflight.checks import InputError
from kilnflight.publication import choices, claims, figures, verdicts
from kilnflight.store import index, paths
from kilnflight.store.cache import write_whole

DOCS = Path(__file__).parent
EXECUTE = runpy.run_path(str(DOCS.parent / "tools" / "execute.py"))
# By title: a pattern of work and place of its claims, numbers of the notebooks whose
# results are shown, and a table to read first.
CHAPTERS = {
    "Depth calibration": ("thesis 2[.]1", ("02",), "eq-2-4-limits"),
    "Backgrounds and detection": (
        "thesis (3|5[.]1|6)",
        ("20", "24"),
        "detection-scores",
    ),
    "Tracking": ("thesis (4[.]2|5[.]2)", ("32",), "table-5-17-tracking"),
    "Regression and flights": (
        "thesis (4[.]3|5[.]3[.]1|A)",
        ("52", "53", "50"),
        "dwell-recovery",
    ),
    "Ignition": ("thesis 5[.]3[.]2", ("54",), "ignition-recovery"),
    "Belt": ("belt-", ("40",), "fig-belt20-9-arrival"),
    "Misprints": ("misprint", ("00",), "errata"),
}
CAUSES = {"twin": "simulation", "data": "other data", "implementation": "ours differs"}
SCREEN_DPI = 180  # a column of 88 mm becomes 624 px wide on a page
COLUMN_MM = 90.0  # a wider picture spans two columns
# Ids of figures have these between kind and number.
STEMS = {"thesis": "", "belt-2020": "belt20-", "belt-2016": "belt16-"}
Figures = dict[str, dict[str, Any]]  # entries of the index by id
LONGEST = 150  # rows of a table that a page shows
SENTENCE_END = r"(?<!Fig)(?<!Figs)(?<!Eq)(?<!Eqs)(?<!ec)[.] "
ABOUT_DATA = r"[.;] (The |In the |in the )?CSV\b.*"  # last in a caption
PAGE_PX = 736.0  # width of a table on a desk
COUNTS = ("tp", "fp", "fn", "seconds_per_image")  # shown last
ON_PAGE = {  # columns of tables that have too many
    "absolute-difference": [
        *("method", "subset", "f1", "f1_published", "f1_absolute"),
        *("recall", "recall_absolute", "precision", "precision_absolute"),
    ],
    "belt-filters": [
        *("filter", "approach", "quantity", "median", "iqr", "absolute_q95"),
        *("belt16-5", "belt16-7", "belt16-10"),
    ],
    "belt-real-models": [
        *("data_set", "filter", "quantity", "model", "n", "left_out"),
        *("median", "iqr", "mae"),
    ],
    "choices": [
        *("id", "not_printed", "chosen", "others", "decided_by", "verdicts_that_turn"),
    ],
    "claims": ["id", "verdict", "because", "published", "bound", "measured", "reason"],
    "flight-recovery": [
        *("fraction", "pressure_bar", "quantity", "printed", "true", "measured"),
        *("low", "high", "recovered"),
    ],
    "fig-belt16-6-deviations": [
        *("material", "data", "approach", "quantity", "n"),
        *("median", "median_low", "median_high", "iqr", "iqr_low", "iqr_high"),
        "absolute_q95",
    ],
    "fig-belt20-9-arrival": [
        *("data_set", "model", "n", "median_ms", "q25_ms", "q75_ms", "iqr_ms"),
        *("mae_ms", "beyond_belt_percent"),
    ],
    "table-5-4-background": [
        *("model", "subset", "reading", "f1", "f1_published", "precision", "recall"),
        *("recall_non_burning", "threshold"),
    ],
}


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


def works() -> dict[str, str]:
    """Return the BibTeX entries of the thesis and the papers by key."""
    text = (DOCS / "_templates" / "works.bib").read_text()
    entries = text.strip().split("\n\n")
    return {re.findall(r"{(\w+),", entry)[0]: entry for entry in entries}


def work_of(name: str, notebook: str) -> str | None:
    """Return the work to which a figure belongs; None for the user's own film."""
    if "belt16" in name:
        return "pfaff2016"
    if notebook.startswith("60"):
        return None
    return "pfaff2020" if notebook.startswith("4") else "zhang2023"


def render(template: str, **values: Any) -> str:
    """Return a template of docs/_templates/pages, filled in."""
    return TEMPLATES.get_template(template).render(values)


@contextmanager
def figures_in(folder: Path) -> Iterator[None]:
    """Take figures, results and verdicts from a folder."""
    before = os.environ.get("KILNFLIGHT_FIGURES", "")
    os.environ["KILNFLIGHT_FIGURES"] = str(folder)
    try:
        yield
    finally:
        os.environ["KILNFLIGHT_FIGURES"] = before


def saved(files: str = "figures", record: Figures | None = None) -> Figures:
    """Return the saved figures and tables by id, as the templates show them.

    ``files`` is their place in the site, seen from a page; ``record`` are the results
    of record.
    """
    folder = paths.figures()
    found = {}
    cff = (paths.root() / "CITATION.cff").read_text()
    url = re.search(r'^repository-code: *"?([^"\s]+)', cff, re.M)
    for name, entry in index.load()["figures"].items():
        origin = entry["provenance"]
        kinds = [
            kind
            for kind in ("png", "csv", "pdf", "mp4")
            if (folder / f"{name}.{kind}").is_file()
        ]
        each = {**entry, "name": name, "kinds": kinds, "url": url and url[1]}
        each |= {"files": files, "record": (record or {}).get(name)}
        first = re.split(SENTENCE_END, entry["caption"], maxsplit=1)[0]
        each["title"] = first.rstrip(".")
        each["scale"] = origin["parameters"].get("scale", "full")
        each["commit"] = origin["commit"][:12] + origin["commit"][40:]
        each["page"] = f"{origin['notebook']}.html#{name}"
        each["work"] = work_of(name, origin["notebook"])
        each["simulated"] = origin["mark"] == "simulated"
        each["cited"] = {"BibTeX": render("bibtex", works=works(), **each)}
        if entry["kind"] == "picture":
            with Image.open(folder / f"{name}.png") as image:
                inches = image.width / image.info["dpi"][0]
                each["width"] = round(SCREEN_DPI * inches)
                each["height"] = round(each["width"] * image.height / image.width)
            each["wide"] = 25.4 * inches > COLUMN_MM
            each["printed"] = re.sub(ABOUT_DATA, ".", entry["caption"])
            each["cited"]["LaTeX"] = render("latex", **each)
        found[name] = each
    return found


def table(name: str, folder: Path | None = None) -> str:
    """Return a saved table as HTML, printed beside ours, no wider than a page.

    Rows of claims.csv have anchors. What is left out stands in the CSV.
    """
    path = (folder or paths.figures()) / f"{name}.csv"
    rows = pd.read_csv(path, dtype=str, keep_default_na=False)
    if name == "claims":
        rows = rows.join(claims.load()["bound"].fillna(""), on="id")
    if name == "errata":  # what touches a conclusion first
        touching = rows["consequence"].str.match("yes|in part")
        rows = pd.concat([rows[touching], rows[~touching]])
    shown = paired(rows[ON_PAGE.get(name, list(rows))].head(LONGEST))
    left_out = [column for column in rows if column not in ON_PAGE.get(name, rows)]
    while sum(map(widest, shown, shown.T.to_numpy())) > PAGE_PX:
        left_out.append(shown.columns[-1])
        shown = shown.iloc[:, :-1]
    shown.columns = shown.columns.str.replace("_", " ").str.replace("tproc", "t-proc")
    text = shown.to_html(index=False, border=0)
    text = re.sub(r"<td>(\d\d_\w+)</td>", r'<td><a href="\1.html">\1</a></td>', text)
    if name == "claims":
        text = re.sub(r"<tr>(\s*<td>)([\w-]+)<", r'<tr id="\2">\1\2<', text)
    more = []
    if len(rows) > LONGEST:
        more.append(f"{len(rows) - LONGEST} more rows")
    if left_out:
        more.append(", ".join(left_out).replace("_", " "))
    if more:
        text += f"<p>In the CSV alone: {'; '.join(more)}.</p>"
    return text


def digits(cell: str, number: int) -> str:
    """Return a number with so many digits, whole ones and other text as they are."""
    if not re.fullmatch(r"-?\d+\.\d+(e-?\d+)?", cell):
        return cell
    value = float(cell)
    return f"{value:.{number}g}" if abs(value) < 10**number else f"{value:.0f}"


def paired(rows: pd.DataFrame) -> pd.DataFrame:
    """Return a table with each printed value beside ours, and ours with its interval.

    First come the columns that name a row, then those with a printed value, then
    others; counts come last.
    """
    values = rows.map(digits, number=4)
    quoted = [name for name in rows if "published" in name or "printed" in name]
    values[quoted] = rows[quoted]  # as they stand in print
    bounds = {name: (f"{name}_low", f"{name}_high") for name in rows}
    alone = next((name for name in ("error", "difference") if name in rows), None)
    if alone:
        bounds[alone] = ("low", "high")
    for name, (low, high) in bounds.items():
        if low in rows and high in rows:
            ends = rows[[low, high]].map(digits, number=3)
            interval = " [" + ends[low] + ", " + ends[high] + "]"
            known = (rows[low] != "") & (rows[high] != "")
            values[name] += interval.where(known, "")
            values = values.drop(columns=[low, high])
    printed = [name for name in values if f"{name}_published" in rows]
    counts = [name for name in values if name in COUNTS]
    first = min((values.columns.get_loc(name) for name in printed + counts), default=0)
    if not printed:  # then counts are what is counted
        counts = []
        first = 0
    keys = list(values)[:first]
    columns = {name: values[name] for name in keys}
    for name in printed:
        columns[f"{name} printed"] = values[f"{name}_published"]
        columns[f"{name} ours"] = values[name]
    used = {*keys, *printed, *counts, *(f"{name}_published" for name in printed)}
    columns |= {name: values[name] for name in values if name not in used}
    return pd.DataFrame(columns | {name: values[name] for name in counts})


def widest(name: str, cells: Sequence[str]) -> float:
    """Return the width of a column in px; cells and titles break at spaces."""
    texts = {name.replace("_", " "), *cells}
    words = [word for text in texts for word in re.split(r"\s+|(?<=\w-)", text)]
    return 10.0 + 7.1 * max(map(len, words), default=0)


def block(each: dict[str, Any]) -> str:
    """Return a figure or table with caption, files and citations as HTML."""
    return render("figure.html", table=table(each["name"]), **each)


def of_notebook(stem: str, known: Figures) -> set[str]:
    """Return the ids of the figures and tables of a notebook."""
    return {
        name for name, each in known.items() if each["provenance"]["notebook"] == stem
    }


def recorded(source: Path, known: Figures, ran: bool) -> nbformat.NotebookNode:
    """Return a notebook with its results of record in the place of outputs.

    ``ran`` says whether this run executed it, too.
    """
    notebook = jupytext.read(source)
    notebook.metadata = {"language_info": {"name": "python"}}
    stem = source.stem
    own = of_notebook(stem, known)
    commits = {known[name]["commit"][:12] for name in own}
    title, rest = notebook.cells[0].source.split("\n", 1)
    about = render("recorded.md", commits=sorted(commits), stem=ran and stem)
    notebook.cells[0].source = f"{title}\n\n{about}\n{rest}"
    for cell in notebook.cells:
        if cell.cell_type != "code":
            page = r'<a href="documents/\1.html">\1</a>'
            cell.source = re.sub(r"\bdocs/(\w+)\.md\b", page, cell.source)
            continue
        named = re.findall(r'"([a-z0-9-]+)"', cell.source)
        shown = [f"<figure id='{name}'>" for name in named if name in own]
        if "figures.conclude(" in cell.source:
            shown.append(figures.concluded(index.load()["notebooks"][stem]))
        if ran and not shown and displays(cell.source):
            shown.append(render("elsewhere.html", stem=stem))
        cell.outputs = [
            new_output("display_data", {"text/html": each}) for each in shown
        ]
    return folded(notebook, own, known)


def displays(code: str) -> bool:
    """Return whether a cell shows a value that it does not save."""
    *_, last = ast.parse(code).body or [None]
    if not isinstance(last, ast.Expr) or isinstance(last.value, ast.Constant):
        return False
    return not re.search(
        r"(save|conclude|append|insert|Markdown|make_whole)\(", ast.unparse(last)
    )


def linked(text: str, folder: str = "") -> str:
    """Return Markdown in which a notebook is a link to its page in a folder."""
    stems = {stem[:2]: stem for stem in index.load()["notebooks"]}

    def link(found: re.Match[str]) -> str:
        stem = stems.get(found[2])
        if stem is None:
            return found[0]
        return f'{found[1]}<a href="{folder}{stem}.html">{found[2]}</a>'

    return re.sub(r"(\bnotebooks? )(\d\d)\b", link, text)


def executed(
    path: Path, known: Figures, scale: str, has_record: bool
) -> nbformat.NotebookNode:
    """Return a notebook as this run executed it, which leads to results of record."""
    notebook = nbformat.read(path, as_version=4)
    title, rest = notebook.cells[0].source.split("\n", 1)
    if scale != "full":
        for words in ("One number", "What disagrees"):
            rest = rest.replace(f"**{words}.**", f"**{words}, at full scale.**")
    about = render("run.md", stem=has_record and path.stem, scale=scale)
    notebook.cells[0].source = f"{title} (this run)\n\n{about}\n{rest}"
    for cell in notebook.cells:
        if cell.cell_type == "markdown":  # equations of the page of record have these
            cell.source = re.sub(r"\beq-(?=\d)", "run-eq-", cell.source)
    notebook.metadata["nosearch"] = True  # a number leads to its result of record
    if has_record:
        notebook.metadata["orphan"] = True  # in no list of pages
    return folded(notebook, of_notebook(path.stem, known), known)


def folded(
    notebook: nbformat.NotebookNode, own: set[str], known: Figures
) -> nbformat.NotebookNode:
    """Return a notebook with folded code and linked figures, each once."""
    cells = []
    left = set(own)
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            cell.source = linked(cell.source)
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


def numbers(known: Figures) -> list[dict[str, Any]]:
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


def chapters() -> tuple[list[dict[str, Any]], dict[str, dict[str, Any]]]:
    """Return verdicts and a result of each chapter, and verdicts of kiln and belt."""
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
    kiln = judged["work"] == "thesis"
    return rows, {"kiln": counts(judged[kiln]), "belt": counts(judged[~kiln])}


def recovered() -> dict[str, int]:
    """Return how many numbers of flight and ignition are recovered: yes, no, open."""
    path = paths.figures() / "flight-recovery.csv"
    if not path.is_file():
        return {}
    found = pd.read_csv(path)["recovered"].value_counts()
    return {name: int(found.get(name, 0)) for name in ("yes", "no", "open")}


def counts(judged: pd.DataFrame) -> dict[str, Any]:
    """Return the numbers of claims, of each verdict, and of causes of failures."""
    verdict = judged["verdict"]
    found = {each: int((verdict == each).sum()) for each in claims.VERDICTS}
    failed = judged.loc[verdict == claims.NOT_REPRODUCED, "because"]
    causes = {CAUSES.get(name, name): n for name, n in failed.value_counts().items()}
    undecided = (judged["because"] == "choice") & (verdict == claims.OPEN)
    more = {"causes": causes, "undecided": int(undecided.sum())}
    return {"claims": len(judged), **found, **more}


def write_pages(run: Path, pages: Path, small: Path) -> str:
    """Write the sources of the site and the thumbnails; return its banner.

    ``run`` is the folder of executed notebooks.
    """
    (pages / "documents").mkdir(parents=True)
    small.mkdir()
    here = paths.figures()
    record = paths.root() / "figures"
    concluded = index.load()["notebooks"]
    notebooks = {
        path.stem: path
        for path in sorted(run.glob("*.ipynb"))
        if path.stem in concluded
    }
    banner = ""
    if not (record / "index.json").is_file():
        known = saved()
        record = here
        for stem, path in notebooks.items():
            notebook = nbformat.read(path, as_version=4)
            own = of_notebook(stem, known)
            nbformat.write(folded(notebook, own, known), pages / path.name)
        stems = [*notebooks]
        scales = sorted({each["scale"] for each in known.values()} - {"full"})
        if scales:
            banner = (
                f"No results of record are here (figures/). This is a run at scale "
                f"{' and '.join(scales)}: little input, other numbers. Do not cite it."
            )
    else:
        stems = write_both(notebooks, pages, here, record)
    with figures_in(record):
        write_front(pages, small, stems)
    return banner


def write_both(
    notebooks: dict[str, Path], pages: Path, here: Path, record: Path
) -> list[str]:
    """Write a page of record and one of this run for each notebook; return all pages.

    ``here`` are the figures of this run.
    """
    (pages / "run").mkdir()
    with figures_in(record):
        known = saved()
        stems = [*index.load()["notebooks"]]
        for stem in stems:
            source = paths.root() / "notebooks" / f"{stem}.py"
            notebook = recorded(source, known, stem in notebooks)
            nbformat.write(notebook, pages / f"{stem}.ipynb")
    of_run = saved("../figures" if here == record else "figures", known)
    usual = next((each["scale"] for each in of_run.values()), "full")
    for stem, path in notebooks.items():
        own = of_notebook(stem, of_run)
        scale = next((of_run[name]["scale"] for name in own), usual)
        notebook = executed(path, of_run, scale, stem in stems)
        nbformat.write(notebook, pages / "run" / path.name)
    return sorted({*stems, *(f"run/{stem}" for stem in notebooks if stem not in stems)})


def write_front(pages: Path, small: Path, stems: list[str]) -> None:
    """Write all pages but those of notebooks, and the thumbnails."""
    known = saved()
    (pages / "contents.inc").write_text(render("contents.inc", stems=stems))
    (pages / "index.md").write_text(linked(render("index.md")))
    for path in DOCS.glob("*.md"):
        top = path.stem == "api"
        folder = pages if top else pages / "documents"
        text = linked(path.read_text(), "" if top else "../")
        (folder / path.name).write_text(text)
    measured = paths.root() / "figures"  # make bench writes there, at one scale
    for name in ("benchmarks", "cost-by-step", "growth", "scale-out", "full-run"):
        text = "<p>Not measured here.</p>"
        if (measured / f"{name}.csv").is_file():
            text = table(name, measured).replace('href="', 'href="../')
        (pages / "documents" / f"{name}.inc").write_text(text)
    parameters = {
        path.stem: ", ".join(EXECUTE["known_parameters"](path))
        for path in sorted((paths.root() / "notebooks").glob("*.py"))
    }
    text = render("parameters.inc", parameters=parameters)
    (pages / "documents" / "parameters.inc").write_text(text)
    listed = numbers(known)
    tables = (row["label"] for row in listed if row["kind"] == "Table")
    place = next(tables).lower().replace(" ", "-").replace(".", "-")
    gallery = pages.parents[1] / "gallery" / "gallery.csv"
    films = []
    if gallery.is_file():
        films = pd.read_csv(gallery, dtype=str, keep_default_na=False)
        films = films.map(digits, number=3).to_dict("records")
    (pages / "documents" / "gallery.inc").write_text(render("gallery.inc", films=films))
    text = render("numbers.md", numbers=listed, first_table=place)
    (pages / "numbers.md").write_text(text)
    movie = next((each for each in known.values() if "mp4" in each["kinds"]), None)
    seeds = table("headline-seeds") if "headline-seeds" in known else ""
    shown = known.get("headlines")
    front = render("front.inc", movie=movie, headlines=shown, seeds=seeds)
    (pages / "front.inc").write_text(front)
    listed_chapters, total = chapters()
    for row in listed_chapters:
        row["page"] = known[row["shown"]]["page"] if row["shown"] in known else ""
    (pages / "verdicts.inc").write_text(
        render("verdicts.inc", chapters=listed_chapters, total=total, flown=recovered())
    )
    (pages / "thumbnails.inc").write_text(render("thumbnails.inc", numbers=listed))
    for name in {row["thumbnail"]["name"] for row in listed if row["thumbnail"]}:
        with Image.open(paths.figures() / f"{name}.png") as image:
            picture = image.convert("RGB")
            picture.thumbnail((240, 480))
            picture.save(small / f"{name}.webp", quality=60, method=6)
    if movie:
        film = cv2.VideoCapture(str(paths.figures() / f"{movie['name']}.mp4"))
        film.set(cv2.CAP_PROP_POS_FRAMES, film.get(cv2.CAP_PROP_FRAME_COUNT) // 2)
        cv2.imwrite(str(small / f"{movie['name']}-movie.webp"), film.read()[1])


def write_page(run: Path, pages: Path, small: Path) -> str:
    """Write the source of a site of one notebook, as `write_pages` does for all."""
    pages.mkdir()
    small.mkdir()
    (path,) = run.glob("[0-9][0-9]_*.ipynb")
    known = saved()
    notebook = nbformat.read(path, as_version=4)
    own = of_notebook(path.stem, known)
    nbformat.write(folded(notebook, own, known), pages / "index.ipynb")
    return ""


def build(run: Path, site: Path) -> None:
    """Build the site under another name; it takes its place when it is whole."""
    pages, small, fresh = (run / name for name in ("pages", "thumbnails", "fresh"))
    for folder in (pages, small, fresh):
        shutil.rmtree(folder, ignore_errors=True)
    if (run / "00_claims.ipynb").is_file():
        banner = write_pages(run, pages, small)
    else:
        banner = write_page(run, pages, small)
    run_sphinx(pages, fresh, run, banner)
    shutil.copytree(small, fresh / "figures" / "thumbnails")
    here = paths.figures()
    record = paths.root() / "figures"
    for path in run.parent.glob("gallery/*.png"):
        (fresh / "figures").mkdir(exist_ok=True)
        shutil.copy(path, fresh / "figures" / f"gallery-{path.name}")
    if (pages / "run").is_dir():
        copy_figures(record, fresh / "figures")
        if here != record:
            copy_figures(here, fresh / "run" / "figures")
    else:
        copy_figures(here, fresh / "figures")
    shutil.rmtree(site, ignore_errors=True)
    shutil.move(fresh, site)


def copy_figures(source: Path, target: Path) -> None:
    """Copy pictures and tables."""
    target.mkdir(exist_ok=True)
    for path in source.iterdir():
        if path.suffix in (".png", ".pdf", ".csv", ".mp4"):
            shutil.copy(path, target)


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


def readme() -> dict[Path, str]:
    """Return README.md with the current results, and the pages of figures/."""
    listed, total = chapters()
    known = saved()
    for row in listed:
        notebook = known[row["shown"]]["provenance"]["notebook"]
        row["page"] = f"{notebook}.md#{row['shown']}"
    flown = recovered()
    results = render("results.md", chapters=listed, total=total, flown=flown)
    first, *_, last = results.splitlines()
    path = paths.root() / "README.md"
    found = re.fullmatch(f"(.*){first}.*{last}(.*)", path.read_text(), re.S)
    if found is None:
        raise InputError(f"README.md: restore its lines {first!r} and {last!r}.")
    concluded = index.load()["notebooks"]
    pages = {path: found[1] + results + found[2]}
    pages[paths.figures() / "README.md"] = render(
        "gallery.md", figures=known, notebooks=concluded
    )
    asked = choices.load()
    asked = asked[asked["decided_by"].isin(choices.UNDECIDED)].reset_index()
    rows = asked.to_dict("records")
    for row in rows:
        row["not_printed"] = row["not_printed"].rstrip(".")
        row["chosen"] = row["chosen"].rstrip(".")
    pages[paths.root() / "docs" / "letter.md"] = render("letter.md", asked=rows)
    pages[paths.root() / "codecheck.yml"] = render("codecheck.yml", figures=known)
    for stem, entry in concluded.items():
        own = [known[name] for name in sorted(of_notebook(stem, known))]
        text = render("notebook.md", stem=stem, result=entry["result"], figures=own)
        pages[paths.figures() / f"{stem}.md"] = text
    return pages


def cite(wanted: str) -> str:
    """Return caption and citations of a figure or table by its id, or its beginning.

    Raises
    ------
    InputError
        If none or several fit; it names those that are near.
    """
    with figures_in(paths.root() / "figures"):
        known = saved()
    fitting = [name for name in known if name.startswith(f"{wanted}-")]
    fitting = fitting or [name for name in known if name.startswith(wanted)]
    if wanted in known:
        fitting = [wanted]
    if len(fitting) != 1:
        near = fitting or difflib.get_close_matches(wanted, known, n=5, cutoff=0.4)
        told = ", ".join(near) or "figures/README.md lists all"
        raise InputError(f"no figure or table {wanted!r} alone; near: {told}.")
    each = known[fitting[0]]
    return "\n\n".join([fitting[0], each["caption"], *each["cited"].values()])


def main(arguments: list[str]) -> None:
    """Write README.md and the pages of figures/, print a citation, or build a site."""
    if arguments == ["--readme"]:
        pages = readme()
        for path in paths.figures().glob("[0-9][0-9]_*.md"):
            if path not in pages:
                path.unlink()
        for path, text in pages.items():
            write_whole(path, text.encode())
    elif arguments[0] == "--cite":
        print(cite(arguments[1]))
    else:
        build(Path(arguments[0]), Path(arguments[1]))
        print(f"site: read {arguments[1]}/index.html")


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except InputError as error:
        sys.exit(f"{sys.argv[1].lstrip('-')}: {error}")
