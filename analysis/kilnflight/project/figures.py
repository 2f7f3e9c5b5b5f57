"""Figures and tables saved with their provenance, and the gallery of all.

Each is saved as picture, data, caption and provenance.

`save` writes ``<id>.png``, ``<id>.pdf`` and ``<id>.csv`` and renews ``README.md``, the
gallery with captions and citations. A smoke run (scale quick) writes no PDF and a PNG of
half the resolution. Caption and provenance are stored inside the PNG and the PDF, so
that a picture that leaves the folder still says where it came from; the gallery is made
from the PNGs alone. The same input gives the same bytes.
"""

from __future__ import annotations

import base64
import hashlib
import html
import io
import json
import os
import re
import subprocess
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from functools import cache
from itertools import islice
from pathlib import Path
from string import Template
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from kilnflight import __version__
from kilnflight.checks import InputError
from kilnflight.project import claims, paths
from kilnflight.project.cache import locked, write_whole
from kilnflight.project.style import LONGEST_PICTURE, mark, style, table_picture
from kilnflight.tables import impossible

PNG_DPI = 300
DRAFT_DPI = 150  # of a reduced run, whose figures are not to be cited
DRAFT_ROWS = 12  # of a table's picture in a reduced run; the page has all rows
TABLE_DPI = 150  # of a table that is drawn as a picture: text only
SCREEN_DPI = 180  # a column of 88 mm becomes 624 px wide on a page
LARGEST_PNG = 300_000  # bytes
# Share of the resolution, greys and other colours: tried in turn until a PNG is small enough
REDUCTIONS = ((1.0, 64, 192), (0.8, 64, 192), (0.64, 64, 64), (0.5, 32, 32), (0.4, 16, 0))
TABLE_REDUCTIONS = ((1.0, 16, 0), (0.8, 16, 0))  # text
NO_NUMBER = re.compile(r"[+-]?\bnan\b( ?%)?")  # of a reduced run; a sentence says "too few"
YEAR = 2026  # of the release
IMPOSSIBLE = "Impossible values"  # begins the sentence of a caption that says why they stand
ENTRY = Template(Path(__file__).with_name("gallery_entry.md").read_text("utf-8"))
# What a result depends on: the commit that last touched any of these made the figure.
SOURCES = ("analysis", "notebooks", "data/reference", "pyproject.toml", "requirements.lock")


@dataclass(frozen=True)
class Provenance:
    """Where a figure comes from."""

    notebook: str
    parameters: Mapping[str, object] = field(default_factory=dict)
    seed: int | None = None
    inputs: Mapping[str, str] = field(default_factory=dict)  # name -> SHA-256
    version: str = __version__
    commit: str = ""
    mark: str = "simulated"  # stands inside each picture


def trace(
    notebook: str,
    parameters: Mapping[str, object],
    *,
    seed: int | None = None,
    inputs: Iterable[Path] = (),
    mark: str = "simulated",
) -> Provenance:
    """Return the provenance of what a notebook makes.

    Parameters
    ----------
    notebook
        Stem of the notebook, for example ``"02_depth_calibration"``.
    parameters
        The values of its parameters cell.
    seed
        Seed of every random draw, if there is any.
    inputs
        Files that were read; their SHA-256 is stored.
    mark
        What the data of its pictures are, in a word that stands inside each of them.
    """
    checksums = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in inputs}
    return Provenance(notebook, dict(parameters), seed, checksums, __version__, _commit(), mark)


def _commit() -> str:
    """Return the commit that last touched `SOURCES`.

    "+changes" is added if they differ from it.
    """

    def git(*command: str) -> str:
        options: dict[str, Any] = {"cwd": paths.root(), "capture_output": True, "text": True}
        done = subprocess.run(["git", *command, "--", *SOURCES], check=False, **options)
        return str(done.stdout).strip() if done.returncode == 0 else ""

    try:
        commit = git("log", "-1", "--format=%H")
        return commit + ("+changes" if commit and git("status", "--porcelain") else "")
    except FileNotFoundError:  # no git on this machine: the version must do
        return ""


@dataclass(frozen=True)
class Saved:
    """A saved figure or table; as the last value of a cell it shows itself."""

    page: str  # the figure with its caption, self-contained HTML
    path: Path  # the PNG

    def _repr_html_(self) -> str:
        return self.page


def save(
    identifier: str,
    table: pd.DataFrame,
    *,
    caption: str,
    provenance: Provenance,
    picture: Figure | None = None,
) -> Saved:
    """Save a figure or table under its fixed id; the only way out of a notebook.

    Parameters
    ----------
    identifier
        The id everywhere, for example ``"fig-5-19-dwell-time"``.
    table
        The data behind the picture, units in the column names; an empty cell means
        "does not apply", infinities are refused.
    caption
        What the figure shows, in whole sentences; the first one is the title. A table that has
        to hold numbers outside their physical bound (`kilnflight.tables.BOUNDS`) says why in a
        sentence that begins with "Impossible values".
    provenance
        From `trace`.
    picture
        The figure; without it the table itself is drawn.

    Raises
    ------
    InputError
        If the id is not lower-case words joined by hyphens, the caption is empty, or
        the table has no columns, holds an infinity or an impossible number. Nothing is written
        then.
    """
    if not re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", identifier):
        raise InputError(f"figure id {identifier!r}: use lower-case words joined by hyphens.")
    if not caption.strip():
        raise InputError(f"figure {identifier}: it has no caption; write what it shows.")
    if not len(table.columns) or np.isinf(table.select_dtypes("number").to_numpy(float)).any():
        raise InputError(f"figure {identifier}: its table has no columns or holds an infinity.")
    if IMPOSSIBLE not in caption and (absurd := impossible(table, identifier)):
        raise InputError(
            f"figure {identifier}: {'; '.join(absurd)}. Refuse what cannot be where it is made, "
            f"or say in the caption why it stands: '{IMPOSSIBLE} ...'."
        )
    caption = NO_NUMBER.sub("too few", caption)
    folder = paths.figures()
    folder.mkdir(parents=True, exist_ok=True)
    draft = not _whole(provenance.parameters)
    if picture is None:
        drawn = table_picture(table, DRAFT_ROWS if draft else LONGEST_PICTURE)
    else:
        drawn = mark(picture, provenance.mark)
    dpi = TABLE_DPI if picture is None else DRAFT_DPI if draft else PNG_DPI
    texts = {
        "Title": identifier,
        "Description": caption,
        "Software": f"kilnflight {provenance.version}",
        "Provenance": json.dumps(asdict(provenance), sort_keys=True, default=str),
        "Kind": "table" if picture is None else "picture",
    }
    reductions = TABLE_REDUCTIONS if picture is None else REDUCTIONS
    png = _png(drawn, texts, dpi, reductions, smallest=not draft)
    short = table.map(lambda value: float(f"{value:.6g}") if isinstance(value, float) else value)
    text = short.to_csv(index=False, lineterminator="\n", float_format="%.6g")
    contents = {f"{identifier}.csv": text.encode(), f"{identifier}.png": png}
    if not draft:
        contents[f"{identifier}.pdf"] = _pdf(drawn, texts)
    plt.close(drawn)
    with locked(folder):
        for name, content in contents.items():
            write_whole(folder / name, content)
        write_whole(folder / "README.md", gallery(folder).encode())
    _list_saved(folder / name for name in contents)
    return Saved(
        _page(identifier, caption, table if picture is None else png), folder / f"{identifier}.png"
    )


def _list_saved(files: Iterable[Path]) -> None:
    """Tell make what was saved."""
    if os.environ.get(paths.SAVED_LIST):
        with Path(os.environ[paths.SAVED_LIST]).open("a") as listed:
            listed.writelines(f"{path.resolve()}\n" for path in files)


def film(path: Path, caption: str) -> Saved:
    """Return a film that lies in the folder of figures, to show it on its notebook's page.

    As the PDFs it is made by make and not tracked; the gallery of figures leaves it out.
    """
    _list_saved([path])
    words = html.escape(caption, quote=True)
    image = f'<img alt="{words}" src="figures/{path.name}" loading="lazy"/>'
    return Saved(f"<figure class='saved'>{image}<figcaption>{words}</figcaption></figure>", path)


def conclude(result: str, verdicts: Iterable[claims.Verdict], provenance: Provenance) -> Saved:
    """Save a notebook's verdicts under ``claims-<notebook>``.

    This is every notebook's last call.

    ``result`` is the one line that the index of the site shows for the notebook.
    """
    table = claims.verdict_table(verdicts, provenance.notebook)
    return save(verdicts_of(provenance.notebook), table, caption=result, provenance=provenance)


def _png(
    picture: Figure,
    texts: Mapping[str, str],
    dpi: int,
    reductions: Iterable[tuple[float, int, int]],
    smallest: bool = True,
) -> bytes:
    """Return a PNG, with fewer dots and colours until it is no larger than `LARGEST_PNG`.

    ``smallest``: as small as can be, which takes several times as long.
    """
    info, png = PngInfo(), io.BytesIO()
    for name, text in texts.items():
        info.add_text(name, text)
    for share, greys, colours in reductions:
        drawn, png = io.BytesIO(), io.BytesIO()
        with style():
            picture.savefig(drawn, format="png", dpi=share * dpi)
        few = _few_colours(Image.open(drawn), greys, colours)
        few.save(png, "PNG", optimize=smallest, dpi=(share * dpi, share * dpi), pnginfo=info)
        if png.tell() <= LARGEST_PNG:
            break
    return png.getvalue()


def _few_colours(image: Image.Image, greys: int, colours: int) -> Image.Image:
    """Return an image with a palette of even greys and of colours.

    The greys are even so that grey stays grey.
    """
    pixels = np.asarray(image.convert("RGB"))
    palette = np.linspace(0, 255, greys).round().astype(int).repeat(3).tolist()
    index = np.rint(pixels.mean(axis=2) * ((greys - 1) / 255)).astype(np.uint8)
    coloured = np.ptp(pixels, axis=2) > 255 / greys
    if colours and coloured.any():
        row = Image.fromarray(pixels[coloured][None])
        nearest = row.quantize(colours, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
        index[coloured] = greys + np.asarray(nearest)[0]
        palette += nearest.getpalette() or []
    few = Image.fromarray(index)
    few.putpalette(palette[: 3 * (greys + colours)])
    return few


def _pdf(picture: Figure, texts: Mapping[str, str]) -> bytes:
    metadata = {
        "Title": texts["Title"],
        "Subject": texts["Description"],
        "Keywords": texts["Provenance"],
        "Creator": texts["Software"],
        "CreationDate": None,
    }
    buffer = io.BytesIO()
    with style():
        picture.savefig(buffer, format="pdf", metadata=metadata)
    return buffer.getvalue()


def _page(identifier: str, caption: str, content: pd.DataFrame | bytes) -> str:
    """Return a table or a PNG with its caption as HTML."""
    words = html.escape(caption)
    if isinstance(content, pd.DataFrame):
        body = content.to_html(index=False, na_rep="", float_format="{:.5g}".format, border=0)
    else:
        image = Image.open(io.BytesIO(content))
        width = round(image.width * SCREEN_DPI / image.info["dpi"][0])
        data = base64.b64encode(content).decode()
        body = f'<img alt="{words}" width="{width}" src="data:image/png;base64,{data}"/>'
    caption = f"<code>{identifier}</code> {words}"
    return f"<figure id='{identifier}'>{body}<figcaption>{caption}</figcaption></figure>"


@dataclass(frozen=True, eq=False)
class Entry:
    """A saved figure, as read from its PNG; another reading of it is another entry."""

    identifier: str
    caption: str
    provenance: dict[str, Any]


def entries(folder: Path | None = None) -> list[Entry]:
    """Return the saved figures of a folder, by id."""
    files = sorted((folder or paths.figures()).glob("*.png"))
    saved = [_entry(path, path.stat().st_mtime_ns) for path in files]
    return [entry for entry in saved if entry is not None]


@cache
def _entry(path: Path, changed_ns: int) -> Entry | None:
    """Return what a PNG says of itself, read again when it was changed; None if it is not ours."""
    with Image.open(path) as image:
        texts = image.info  # stands before the pixels, which are not decoded
    if "Provenance" not in texts:
        return None
    return Entry(path.stem, texts["Description"], json.loads(texts["Provenance"]))


def absurdities(folder: Path | None = None) -> list[str]:
    """Return what is impossible in the saved tables of a folder (`kilnflight.tables.BOUNDS`).

    Tables whose caption says why it stands there are left out.
    """
    folder = folder or paths.figures()
    excused = {entry.identifier for entry in entries(folder) if IMPOSSIBLE in entry.caption}
    tables = [path for path in sorted(folder.glob("*.csv")) if path.stem not in excused]
    return [
        f"{path.name}: {sentence}"
        for path in tables
        for sentence in impossible(pd.read_csv(path), path.stem)
    ]


def concluded(folder: Path | None = None) -> dict[str, Path]:
    """Return the file of each notebook's verdicts, by the notebook's stem.

    Only notebooks that exist count.
    """
    folder = folder or paths.figures()
    stems = sorted(path.stem for path in (paths.root() / "notebooks").glob("*.py"))
    tables = {stem: folder / f"{verdicts_of(stem)}.csv" for stem in stems}
    return {stem: path for stem, path in tables.items() if path.is_file()}


def verdicts_of(notebook: str) -> str:
    """Return the id of a notebook's verdicts, by its stem."""
    return f"claims-{notebook.replace('_', '-')}"


def title(notebook: str) -> str:
    """Return the first heading of a notebook, by its stem.

    Raises
    ------
    InputError
        If the notebook has none.
    """
    path = paths.root() / "notebooks" / f"{notebook}.py"
    heading = re.search(r"^# # (.+)$", path.read_text(), re.MULTILINE)
    if heading is None:
        raise InputError(f"{path} has no heading; start it with '# %% [markdown]' and '# # Title'.")
    return heading[1]


def overview(folder: Path | None = None) -> pd.DataFrame:
    """Return one row per notebook that has concluded.

    A row is title, result and verdict counts.
    """
    results = {entry.identifier: entry.caption for entry in entries(folder)}
    rows = [
        {"notebook": stem, "title": title(stem), "result": results[path.stem]}
        | _counts(path, path.stat().st_mtime_ns)
        for stem, path in concluded(folder).items()
        if path.stem in results
    ]
    return pd.DataFrame(rows, columns=["notebook", "title", "result", *claims.VERDICTS])


@cache
def _counts(path: Path, changed_ns: int) -> dict[str, int]:
    """Return how many verdicts of each kind a file holds, read again when it was changed."""
    return claims.count(pd.read_csv(path))


def gallery(folder: Path) -> str:
    """Return the text of figures/README.md.

    It holds the results, and every figure with its citation.
    """
    saved = entries(folder)
    scales = sorted({str(entry.provenance["parameters"].get("scale")) for entry in saved})
    heading = (
        f"# Figures and tables\n\nMade at scale {' and '.join(scales)} (what the repository holds "
        "comes from `make full`); do not edit, and do not edit this page. Each figure has a PNG "
        "and a CSV here (the PDF is made by `make full`, not tracked). Caption and provenance are "
        "also inside the PNG and the PDF.\n\n## Results by notebook\n"
    )
    table = markdown(overview(folder).drop(columns="notebook"))
    cited = [entry for entry in saved if not is_empty(folder, entry.identifier)]
    return "\n".join([heading, table, *map(_gallery_entry, cited)])


def is_empty(folder: Path, identifier: str) -> bool:
    """Return whether a saved table has no rows, as that of a notebook that tests no claim."""
    with (folder / f"{identifier}.csv").open() as file:
        return len(list(islice(file, 2))) < 2


def markdown(table: pd.DataFrame) -> str:
    """Return a table as Markdown, numbers to the right."""
    rule = ["---:" if kind.kind in "if" else "---" for kind in table.dtypes]
    rows = [table.columns, rule, *table.astype(str).to_numpy()]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows) + "\n"


def may_be_cited(entry: Entry) -> bool:
    """Return whether a figure is not of a reduced run; what has no scale is whole."""
    return _whole(entry.provenance["parameters"])


def _whole(parameters: Mapping[str, object]) -> bool:
    """Return whether parameters are not those of a reduced run."""
    return parameters.get("scale", "full") == "full"


@cache
def _gallery_entry(entry: Entry) -> str:
    """Return the entry of a figure; one of a reduced run has no citation to paste."""
    whole = _with_citations(entry)
    if may_be_cited(entry):
        return whole
    return whole.partition("<details>")[0] + "*Of a reduced run: do not cite.*\n"


def _with_citations(entry: Entry) -> str:
    origin = entry.provenance
    commit = str(origin["commit"])
    return ENTRY.substitute(
        identifier=entry.identifier,
        caption=entry.caption,
        notebook=origin["notebook"],
        version=origin["version"],
        commit=f", commit {commit[:12]}{commit[40:]}" if commit else "",
        parameters=", ".join(f"{name} = {value}" for name, value in origin["parameters"].items()),
        latex_title=_latex(title_of(entry.caption)),
        latex_caption=_latex(entry.caption),
        year=YEAR,
        address=_address(),
    )


def _address() -> str:
    """Return where the repository is published, as a line of BibTeX; empty: nowhere yet.

    It is set in one place, ``repository-code`` of CITATION.cff.
    """
    path = paths.root() / "CITATION.cff"
    found = (
        re.search(r"^repository-code: *\"?([^\"\s]+)", path.read_text(), re.M)
        if path.is_file()
        else None
    )
    return f"  url    = {{{found[1]}}},\n" if found else ""


def citations(entry: Entry) -> dict[str, str]:
    """Return the citation of a figure to paste, as BibTeX and as LaTeX."""
    blocks = dict(re.findall(r"```(bibtex|latex)\n(.*?)\n```", _with_citations(entry), re.DOTALL))
    return {"BibTeX": blocks["bibtex"], "LaTeX": blocks["latex"]}


def title_of(caption: str) -> str:
    """Return the first sentence of a caption."""
    abbreviations = "(?<!Fig)(?<!Figs)(?<!Eq)(?<!Eqs)(?<![Ss]ec)"
    return re.split(rf"{abbreviations}[.:;] ", caption, maxsplit=1)[0].rstrip(".")


def _latex(text: str) -> str:
    plain = text.replace("\\", r"\textbackslash ")
    escaped = re.sub(r"([%&_#${}])", r"\\\1", plain)
    return escaped.replace("~", r"\textasciitilde ").replace("^", r"\textasciicircum ")
