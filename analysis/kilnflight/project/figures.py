"""The one way to save a figure or table: picture, data, caption, provenance.

`save` writes ``<id>.png``, ``<id>.pdf`` and ``<id>.csv`` and keeps ``README.md``, the
gallery with captions and citations. A smoke run (scale quick), which nobody cites from,
writes no PDF and a PNG of half the resolution. Caption and provenance live inside the PNG (and
PDF), so that a picture that leaves the folder still says where it came from; the
gallery is made from the PNGs alone. The same input gives the same bytes.
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
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from PIL import Image

from kilnflight import __version__
from kilnflight.checks import InputError
from kilnflight.project import claims, paths
from kilnflight.project.cache import locked, write_whole
from kilnflight.project.style import style, table_picture

PNG_DPI = 300
DRAFT_DPI = 150  # of a smoke run
TABLE_DPI = 150  # a table that is drawn as a picture: text only
SCREEN_DPI = 180  # a column of 88 mm becomes 624 px wide on a page
YEAR = 2026  # of the release, as in CITATION.cff

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


def trace(
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
            cwd=paths.root(),
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


@dataclass(frozen=True)
class Saved:
    """A saved figure or table; the last value of a cell shows it with its caption."""

    identifier: str
    caption: str
    body: str  # HTML
    path: Path  # the PNG

    def _repr_html_(self) -> str:
        """Return the figure with its caption, self-contained."""
        caption = f"<code>{self.identifier}</code> {html.escape(self.caption)}"
        return f"<figure>{self.body}<figcaption>{caption}</figcaption></figure>"


def _image(png: bytes, caption: str, dpi: int) -> str:
    with Image.open(io.BytesIO(png)) as image:
        width = round(image.width * SCREEN_DPI / dpi)
    data = base64.b64encode(png).decode()
    return f'<img alt="{html.escape(caption)}" width="{width}" src="data:image/png;base64,{data}"/>'


def save(
    identifier: str,
    table: pd.DataFrame,
    *,
    caption: str,
    provenance: Provenance,
    picture: Figure | None = None,
    folder: Path | None = None,
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
        What is seen, in whole sentences; the first one is the title.
    provenance
        From `kilnflight.project.provenance.trace`.
    picture
        The figure; without it the table itself is drawn.
    folder
        Where to, the project's figures/ by default.

    Returns
    -------
    Saved
        Shows itself in a notebook.

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
    folder = folder or paths.figures()
    folder.mkdir(parents=True, exist_ok=True)
    drawn = picture if picture is not None else table_picture(table)
    draft = provenance.parameters.get("scale") == "quick"
    dpi = TABLE_DPI if picture is None else DRAFT_DPI if draft else PNG_DPI
    contents = {
        f"{identifier}.csv": _csv(table),
        f"{identifier}.png": _png(drawn, identifier, caption, provenance, dpi),
    }
    if not draft:
        contents[f"{identifier}.pdf"] = _pdf(drawn, identifier, caption, provenance)
    plt.close(drawn)
    with locked(folder):
        for name, content in contents.items():
            write_whole(folder / name, content)
        write_whole(folder / "README.md", gallery(folder).encode())
    if os.environ.get(paths.SAVED_LIST):
        with Path(os.environ[paths.SAVED_LIST]).open("a") as listed:
            listed.writelines(f"{(folder / name).resolve()}\n" for name in contents)
    if picture is None:
        body = table.to_html(index=False, na_rep="", float_format="{:.5g}".format, border=0)
    else:
        body = _image(contents[f"{identifier}.png"], caption, dpi)
    return Saved(identifier, caption, body, folder / f"{identifier}.png")


def conclude(
    result: str,
    verdicts: Iterable[claims.Verdict],
    provenance: Provenance,
    folder: Path | None = None,
) -> Saved:
    """Save a notebook's verdicts under ``claims-<notebook>``; every notebook's last call.

    ``result`` is the one line that the index of the site shows for the notebook.
    """
    table = claims.verdict_table(verdicts, provenance.notebook)
    identifier = "claims-" + provenance.notebook.replace("_", "-")
    return save(identifier, table, caption=result, provenance=provenance, folder=folder)


def _csv(table: pd.DataFrame) -> bytes:
    return table.to_csv(index=False, lineterminator="\n", float_format="%.6g").encode()


def _record(provenance: Provenance) -> str:
    return json.dumps(asdict(provenance), sort_keys=True, default=str)


def _png(picture: Figure, identifier: str, caption: str, provenance: Provenance, dpi: int) -> bytes:
    metadata = {
        "Title": identifier,
        "Description": caption,
        "Software": f"kilnflight {provenance.version}",
        "Provenance": _record(provenance),
    }
    buffer = io.BytesIO()
    with style():
        picture.savefig(buffer, format="png", dpi=dpi, metadata=metadata)
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


@dataclass(frozen=True)
class Entry:
    """A saved figure, as its PNG tells it."""

    identifier: str
    caption: str
    provenance: dict[str, Any]


def entries(folder: Path | None = None) -> list[Entry]:
    """Return the saved figures of a folder, by id."""
    found = []
    for path in sorted((folder or paths.figures()).glob("*.png")):
        with Image.open(path) as image:
            text = image.info  # what stands before the pixels, which are not decoded
        if "Provenance" in text:
            record = json.loads(text["Provenance"])
            found.append(Entry(path.stem, text["Description"], record))
    return found


def concluded(folder: Path | None = None) -> dict[str, Path]:
    """Return where each notebook's verdicts are, by its stem (`figures.conclude`).

    What a notebook left that is no longer there does not count.
    """
    folder = folder or paths.figures()
    stems = sorted(path.stem for path in (paths.root() / "notebooks").glob("*.py"))
    tables = {stem: folder / f"claims-{stem.replace('_', '-')}.csv" for stem in stems}
    return {stem: path for stem, path in tables.items() if path.is_file()}


def gallery(folder: Path) -> str:
    """Return the text of figures/README.md: every figure with caption and citation."""
    found = entries(folder)
    scales = sorted({str(entry.provenance["parameters"].get("scale")) for entry in found})
    parts = [
        "# Figures and tables\n",
        f"Made at scale {' and '.join(scales)} (what the repository holds comes from `make full`); "
        "do not edit, and do not edit this page. Each figure has a PNG and a CSV here (the PDF is "
        "made by `make`, not tracked). Caption and provenance are also inside the PNG and the "
        "PDF.\n",
    ]
    parts += [_gallery_entry(entry) for entry in found]
    return "\n".join(parts)


def _gallery_entry(entry: Entry) -> str:
    made = entry.provenance
    commit = str(made["commit"])
    commit = f", commit {commit[:12]}{commit[40:]}" if commit else ""
    values = ", ".join(f"{name} = {value}" for name, value in made["parameters"].items())
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
  year   = {{{YEAR}}}
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
    abbreviations = "(?<!Fig)(?<!Figs)(?<!Eq)(?<!Eqs)(?<![Ss]ec)"
    return re.split(rf"{abbreviations}[.:;] ", caption, maxsplit=1)[0].rstrip(".")


def _latex(text: str) -> str:
    plain = text.replace("\\", r"\textbackslash ")
    escaped = re.sub(r"([%&_#${}])", r"\\\1", plain)
    return escaped.replace("~", r"\textasciitilde ").replace("^", r"\textasciicircum ")
