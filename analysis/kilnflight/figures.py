"""Style, and the one way to save a figure or table: picture, data, caption, provenance.

`save` writes ``<id>.png``, ``<id>.pdf`` and ``<id>.csv`` and keeps ``README.md``, the
gallery with captions and citations. Caption and provenance live inside the PNG (and
PDF), so that a picture that leaves the folder still says where it came from; the
gallery is made from the PNGs alone. The same input gives the same bytes.
"""

from __future__ import annotations

import fcntl
import hashlib
import io
import json
import os
import re
import subprocess
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from kilnflight import __version__, places, reference
from kilnflight.checks import InputError

COLUMN_MM = 88.0  # one text column of a two-column journal
PAGE_MM = 180.0  # both columns
PNG_DPI = 300
LONGEST_PICTURE = 40  # rows of a table that are drawn; the CSV has all

# Okabe and Ito's colour-blind safe colours, ordered so that neighbours also differ in
# lightness; with line style and marker they stay apart in grey.
COLOURS = ("#000000", "#D55E00", "#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9")
LINES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (8, 2)), (0, (1, 1)))
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
HATCHES = ("", "////", "....", "\\\\\\\\", "xx", "--", "oo")

STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 7.5,
    "axes.titlesize": 8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "axes.prop_cycle": cycler(color=COLOURS, linestyle=LINES),
    "lines.linewidth": 1.2,
    "lines.markersize": 3.5,
    "legend.frameon": False,
    "legend.fontsize": 7,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "figure.constrained_layout.use": True,
    "figure.dpi": 150,
    "pdf.fonttype": 42,
    "svg.hashsalt": "kilnflight",
    "text.usetex": False,
    "text.parse_math": False,
}

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


def provenance(
    notebook: str,
    parameters: Mapping[str, object],
    *,
    seed: int | None = None,
    inputs: Iterable[Path] = (),
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
        Files that were read; their SHA-256 is kept.
    """
    checksums = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in inputs}
    return Provenance(notebook, dict(parameters), seed, checksums, __version__, _commit())


def _commit() -> str:
    """Return the commit that last touched `SOURCES`, "+changes" if they differ from it."""

    def git(*arguments: str) -> str:
        answer = subprocess.run(
            ["git", *arguments, "--", *SOURCES],
            cwd=places.root(),
            capture_output=True,
            text=True,
            check=False,
        )
        return answer.stdout.strip() if answer.returncode == 0 else ""

    try:
        commit = git("log", "-1", "--format=%H")
        return commit + ("+changes" if commit and git("status", "--porcelain") else "")
    except FileNotFoundError:  # no git on this machine: the version must do
        return ""


@contextmanager
def style() -> Iterator[None]:
    """Draw in the project's style inside a ``with`` block."""
    with matplotlib.rc_context(STYLE):
        yield


def use_style() -> None:
    """Draw in the project's style from here on (first cell of a notebook)."""
    matplotlib.rcParams.update(STYLE)


def canvas(
    rows: int = 1,
    columns: int = 1,
    *,
    width_mm: float = COLUMN_MM,
    height_mm: float = 60.0,
    **arguments: Any,
) -> tuple[Figure, np.ndarray]:
    """Return a figure and its axes as a 2D array, in print size.

    Parameters
    ----------
    rows, columns
        Grid of axes.
    width_mm, height_mm
        Size on paper; `COLUMN_MM` and `PAGE_MM` are the usual widths.
    **arguments
        Handed to `matplotlib.pyplot.subplots` (``sharex``, ``sharey`` ...).
    """
    with style():
        size = (width_mm / 25.4, height_mm / 25.4)
        return plt.subplots(rows, columns, figsize=size, squeeze=False, **arguments)


def table_picture(table: pd.DataFrame) -> Figure:
    """Return a table as a figure: a rule above and below the heading, text wrapped."""
    shown = table.head(LONGEST_PICTURE)
    cells = [list(map(str, table.columns))]
    cells += [[_cell(value) for value in row] for row in shown.itertuples(index=False)]
    if len(table) > len(shown):
        note = f"... {len(table) - len(shown)} more rows in the CSV"
        cells.append([note if i == 0 else "" for i in range(table.shape[1])])
    cells = [[textwrap.fill(text, 34) for text in row] for row in cells]
    widths = [max(_width(row[i]) for row in cells) + 2 for i in range(table.shape[1])]
    heights = [max(text.count("\n") + 1 for text in row) + 0.35 for row in cells]
    with style():
        figure = plt.figure(
            figsize=(sum(widths) * 0.062 + 0.2, sum(heights) * 0.125 + 0.2), layout="none"
        )
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        _write_cells(axes, cells, widths, heights)
    return figure


def _write_cells(
    axes: Axes, cells: list[list[str]], widths: list[int], heights: list[float]
) -> None:
    lefts = np.concatenate([[0], np.cumsum(widths)])
    tops = np.concatenate([[0], np.cumsum(heights)])
    for row, top in zip(cells, tops, strict=False):
        for text, left in zip(row, lefts, strict=False):
            axes.text(left + 0.5, top + 0.2, text, va="top", ha="left", fontsize=7)
    for y in (0, tops[1], tops[-1]):
        axes.axhline(y, color="black", linewidth=0.8, linestyle="-")
    axes.set(xlim=(-0.5, lefts[-1]), ylim=(tops[-1] + 0.4, -0.4))
    axes.axis("off")


def _width(text: str) -> int:
    return max(map(len, text.split("\n")))


def _cell(value: object) -> str:
    if isinstance(value, float):
        return "" if np.isnan(value) else f"{value:.5g}"
    return str(value)


def save(
    identifier: str,
    table: pd.DataFrame,
    *,
    caption: str,
    provenance: Provenance,
    picture: Figure | None = None,
    folder: Path | None = None,
) -> Path:
    """Save a figure or table under its fixed id; the only way out of a notebook.

    Parameters
    ----------
    identifier
        The id everywhere, for example ``"fig-5-19-dwell-time"``.
    table
        The data behind the picture, units in the column names; an empty cell means
        "does not apply", infinities are refused.
    caption
        What is seen, in whole sentences; the first one is the title.
    provenance
        From `provenance`.
    picture
        The figure; without it the table itself is drawn.
    folder
        Where to, the project's figures/ by default.

    Returns
    -------
    Path
        The PNG.

    Raises
    ------
    InputError
        If the id is not lower-case words joined by hyphens, the caption is empty, or
        the table has no columns or holds an infinity. Nothing is written then.
    """
    if not re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", identifier):
        raise InputError(f"figure id {identifier!r}: use lower-case words joined by hyphens.")
    if not caption.strip():
        raise InputError(f"figure {identifier}: a figure without caption cannot be cited.")
    if not len(table.columns) or np.isinf(table.select_dtypes("number").to_numpy(float)).any():
        raise InputError(f"figure {identifier}: its table has no columns or holds an infinity.")
    folder = folder or places.figures()
    folder.mkdir(parents=True, exist_ok=True)
    picture = picture if picture is not None else table_picture(table)
    contents = {
        f"{identifier}.csv": _csv(table),
        f"{identifier}.pdf": _pdf(picture, identifier, caption, provenance),
        f"{identifier}.png": _png(picture, identifier, caption, provenance),
    }
    plt.close(picture)
    with _locked(folder):
        for name, content in contents.items():
            write_whole(folder / name, content)
        write_whole(folder / "README.md", gallery(folder).encode())
    return folder / f"{identifier}.png"


def conclude(
    result: str,
    verdicts: Iterable[reference.Verdict],
    provenance: Provenance,
    folder: Path | None = None,
) -> pd.DataFrame:
    """Save a notebook's verdicts under ``claims-<notebook>``; every notebook's last call.

    ``result`` is the one line that the index of the site shows for the notebook.
    """
    table = reference.verdict_table(verdicts, provenance.notebook)
    identifier = "claims-" + provenance.notebook.replace("_", "-")
    save(identifier, table, caption=result, provenance=provenance, folder=folder)
    return table


def _csv(table: pd.DataFrame) -> bytes:
    return table.to_csv(index=False, lineterminator="\n", float_format="%.6g").encode()


def _record(provenance: Provenance) -> str:
    return json.dumps(asdict(provenance), sort_keys=True, default=str)


def _png(picture: Figure, identifier: str, caption: str, provenance: Provenance) -> bytes:
    metadata = {
        "Title": identifier,
        "Description": caption,
        "Software": f"kilnflight {provenance.version}",
        "Provenance": _record(provenance),
    }
    buffer = io.BytesIO()
    with style():
        picture.savefig(buffer, format="png", dpi=PNG_DPI, metadata=metadata)
    return buffer.getvalue()


def _pdf(picture: Figure, identifier: str, caption: str, provenance: Provenance) -> bytes:
    metadata = {
        "Title": identifier,
        "Subject": caption,
        "Keywords": _record(provenance),
        "Creator": f"kilnflight {provenance.version}",
        "CreationDate": None,
    }
    buffer = io.BytesIO()
    with style():
        picture.savefig(buffer, format="pdf", metadata=metadata)
    return buffer.getvalue()


def write_whole(path: Path, content: bytes) -> None:
    """Write a file under a temporary name and rename it: it is there whole or not at all."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        temporary.write_bytes(content)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Let one process at a time write (make -j runs notebooks side by side)."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


@dataclass(frozen=True)
class Entry:
    """A saved figure, as its PNG tells it."""

    identifier: str
    caption: str
    provenance: dict[str, object]


def entries(folder: Path | None = None) -> list[Entry]:
    """Return the saved figures of a folder, by id."""
    found = []
    for path in sorted((folder or places.figures()).glob("*.png")):
        with Image.open(path) as image:
            text = image.text  # type: ignore[attr-defined]
        if "Provenance" in text:
            record = json.loads(text["Provenance"])
            found.append(Entry(path.stem, text["Description"], record))
    return found


def gallery(folder: Path) -> str:
    """Return the text of figures/README.md: every figure with caption and citation."""
    parts = [
        "# Figures and tables\n",
        "Made by `make full`; do not edit, and do not edit this page. Each figure has a PNG and "
        "a CSV here (the PDF is made by `make`, not tracked). Caption and provenance are also "
        "inside the PNG and the PDF.\n",
    ]
    parts += [_gallery_entry(entry) for entry in entries(folder)]
    return "\n".join(parts)


def _gallery_entry(entry: Entry) -> str:
    made = entry.provenance
    commit = str(made["commit"])
    commit = f", commit {commit[:12]}{commit[40:]}" if commit else ""
    parameters = made["parameters"]
    assert isinstance(parameters, dict)
    values = ", ".join(f"{name} = {value}" for name, value in parameters.items())
    return f"""## {entry.identifier}

![{entry.identifier}]({entry.identifier}.png)

{entry.caption}

Data: [{entry.identifier}.csv]({entry.identifier}.csv). Made by notebooks/{made["notebook"]}.py,
kilnflight {made["version"]}{commit} ({values}).

<details><summary>Cite</summary>

```bibtex
@misc{{kilnflight-{entry.identifier},
  author = {{{{The kilnflight founders}}}},
  title  = {{{_latex(_title(entry.caption))}}},
  note   = {{kilnflight {made["version"]}, figure {entry.identifier}{commit}}},
  year   = {{2026}}
}}
```

```latex
\\begin{{figure}}
  \\centering
  \\includegraphics[width=\\columnwidth]{{{entry.identifier}.pdf}}
  \\caption{{{_latex(entry.caption)}~\\cite{{kilnflight-{entry.identifier}}}}}
  \\label{{fig:{entry.identifier}}}
\\end{{figure}}
```

</details>
"""


def _title(caption: str) -> str:
    return re.split(r"(?<=[a-z)])[.:;] ", caption, maxsplit=1)[0].rstrip(".")


def _latex(text: str) -> str:
    return re.sub(r"([%&_#${}])", r"\\\1", text.replace("\\", r"\textbackslash "))
