"""Figures and tables, saved with caption and provenance; results of notebooks.

`save` writes ``<id>.csv`` and, of a picture, ``<id>.png`` (full scale: also a small
``<id>.pdf``). Captions, provenance and verdicts of a folder stand in its
``index.json``; caption and provenance also inside the PNG and the PDF. The same input
gives the same bytes.
"""

import base64
import hashlib
import html
import io
import json
import re
import subprocess
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from IPython.display import HTML
from matplotlib.figure import Figure
from pandas import DataFrame
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from kilnflight import __version__
from kilnflight.checks import InputError
from kilnflight.publication import choices as unprinted
from kilnflight.publication import claims
from kilnflight.publication.style import LOOKS, mark, style
from kilnflight.store import index, paths

PNG_DPI = 300
DRAFT_DPI = 150  # a reduced run's figures are not to be cited
LARGEST = 300_000  # bytes of a picture
# Shares of the resolution and numbers of colours, tried until a PNG is small enough.
REDUCTIONS = ((1.0, 256), (0.8, 128), (0.64, 64), (0.5, 64), (0.4, 32))
# What a result depends on: the commit that last touched any of these made the figure.
SOURCES = (
    "analysis",
    "identify",
    "notebooks",
    "data/reference",
    "pyproject.toml",
    "requirements.lock",
)


@dataclass(frozen=True)
class Provenance:
    """Where a figure comes from; stored in index.json and in the picture.

    Parameters
    ----------
    notebook
        Stem of the notebook.
    parameters
        Values of its parameters cell.
    seed
        Seed of every random draw, if there is any.
    inputs
        SHA-256 of each file that was read, by name.
    commit
        Last commit on `SOURCES`; empty without git.
    mark
        Kind of data; it stands inside each picture.
    version
        Version of kilnflight.
    """

    notebook: str
    parameters: Mapping[str, object]
    seed: int | None
    inputs: Mapping[str, str]
    commit: str
    mark: str
    version: str = __version__


def trace(
    notebook: str,
    parameters: Mapping[str, object],
    *,
    seed: int | None = None,
    inputs: Iterable[Path] = (),
    mark: str = "simulated",
) -> Provenance:
    """Return the provenance of a notebook's figures and tables.

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
        One word for the kind of data, such as "simulated", written inside each picture.

    Raises
    ------
    InputError
        If a reduced run would write over the results of record.
    """
    scale = parameters.get("scale", "full")
    if scale != "full" and paths.figures() == paths.root() / "figures":
        raise InputError(
            f"scale {scale}: figures/ holds results of make full; set KILNFLIGHT_"
            f"FIGURES=build/{scale}/figures."
        )
    checksums = {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in inputs
    }
    return Provenance(
        notebook=notebook,
        parameters=dict(parameters),
        seed=seed,
        inputs=checksums,
        commit=_commit(),
        mark=mark,
    )


def _commit() -> str:
    """Return the last commit on `SOURCES`, with "+changes" if they differ from it.

    Other files do not change a result, so their commits do not count.
    """
    try:
        commit = _git("log", "-1", "--format=%H")
        changes = _git("status", "--porcelain")
    except FileNotFoundError:  # no git on this machine: the version must do
        return ""
    if commit and changes:
        commit += "+changes"
    return commit


def _git(*command: str) -> str:
    done = subprocess.run(
        ["git", *command, "--", *SOURCES],
        cwd=paths.root(),
        capture_output=True,
        text=True,
        check=False,
    )
    return done.stdout.strip()


def save(
    identifier: str,
    table: DataFrame,
    *,
    caption: str,
    provenance: Provenance,
    picture: Figure | None = None,
) -> HTML:
    """Save a figure or table under its fixed id, and return it as shown on the page.

    Every result of a notebook is saved by this function, so that it has caption and
    provenance.

    Parameters
    ----------
    identifier
        The id everywhere, for example ``"fig-5-19-dwell-time"``.
    table
        The data behind the picture, units in the column names; an empty cell means
        "does not apply", infinities are refused.
    caption
        What is shown, in whole sentences; the first one is the title.
    provenance
        From `trace`.
    picture
        Figure that shows the table; it is closed afterwards. None: only the table is
        saved.

    Raises
    ------
    InputError
        If the id or the table is not as described, the caption is empty, or a file
        cannot be written.
    """
    if not re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", identifier) or not caption.strip():
        raise InputError(
            f"figure {identifier!r}: write lower-case-words as its id, and a caption."
        )
    numbers = table.select_dtypes("number").to_numpy(float)
    if not len(table.columns) or np.isinf(numbers).any():
        raise InputError(
            f"figure {identifier}: its table has no columns or holds an infinity."
        )
    short = table.map(
        lambda value: float(f"{value:.6g}") if isinstance(value, float) else value
    )
    text = short.to_csv(index=False, lineterminator="\n", float_format="%.6g")
    contents = {f"{identifier}.csv": text.encode()}
    words = html.escape(caption)
    entry = {"caption": caption, "provenance": asdict(provenance), "kind": "table"}
    if picture is None:
        body = table.to_html(
            index=False, na_rep="", float_format="{:.5g}".format, border=0
        )
    else:
        entry["kind"] = "picture"
        mark(picture, provenance.mark)
        contents |= _drawn(picture, identifier, caption, provenance)
        coded = base64.b64encode(contents[f"{identifier}.png"]).decode()
        body = f'<img alt="{words}" src="data:image/png;base64,{coded}"/>'
    index.write(contents, "figures", identifier, entry)
    below = f"<figcaption><code>{identifier}</code> {words}</figcaption>"
    return HTML(f"<figure id='{identifier}'>{body}{below}</figure>")


def conclude(
    result: str,
    verdicts: Iterable[claims.Verdict],
    provenance: Provenance,
    choices: Iterable[unprinted.Comparison] = (),
    data: str = "simulated",
) -> HTML:
    """Save a notebook's result, verdicts and choices; the last call of a notebook.

    Parameters
    ----------
    result
        What was found, in one or two sentences; "nan" becomes "(too few)".
    verdicts
        From `kilnflight.publication.claims.check`, each claim once.
    provenance
        From `trace`.
    choices
        From `kilnflight.publication.choices.compare`: results with both values of what
        no work prints. A verdict that turns with a choice that nothing decides is open.
    data
        What the verdicts rest on: "simulated", or "authors" for their own data.
    """
    compared = [asdict(each) | {"data": data} for each in choices]
    judged = [asdict(verdict) | {"data": data} for verdict in verdicts]
    for row in judged:
        if data == "authors" and row["because"] == "twin":
            row["because"] = ""  # the simulation is not the cause there
    rows = unprinted.opened(judged, compared)
    result = re.sub(r"[+-]?\bnan\b", "(too few)", result)  # a reduced run
    entry = {"result": result, "verdicts": rows, "choices": compared}
    index.write({}, "notebooks", provenance.notebook, entry)
    return HTML(concluded(entry))


def concluded(entry: Mapping[str, Any]) -> str:
    """Return a notebook's entry of the index as HTML: result, verdicts, choices."""
    body = f"<p>{html.escape(entry['result'])}</p>"
    if entry["verdicts"]:
        table = DataFrame(entry["verdicts"]).join(claims.load()["bound"], on="id")
        body += _shown(table, "verdicts")
    else:
        body += "No claim is tested here."
    if entry["choices"]:
        table = DataFrame(entry["choices"])
        table["turns"] = table["turns"].map(" ".join)
        body += (
            "<p>What no work prints (notebook 01), with ours and the other value:</p>"
        )
        body += _shown(table, "choices")
    return f"<div class='concluded'>{body}</div>"


def _shown(table: DataFrame, kind: str) -> str:
    """Return the columns of a table that are shown as HTML; looks.toml names them."""
    names = LOOKS[kind]
    return table[[*names]].rename(columns=names).to_html(index=False, border=0)


def _drawn(
    picture: Figure, identifier: str, caption: str, provenance: Provenance
) -> dict[str, bytes]:
    """Draw a picture as PNG and, at full scale, PDF; return them by file name."""
    record = json.dumps(asdict(provenance), sort_keys=True, default=str)
    software = f"kilnflight {provenance.version}"
    draft = provenance.parameters.get("scale", "full") != "full"
    about = {"Title": identifier, "Description": caption, "Software": software}
    files = {}
    with style():
        files[f"{identifier}.png"] = _png(
            picture, about | {"Provenance": record}, draft
        )
        if not draft:
            pdf = io.BytesIO()
            metadata = {
                "Title": identifier,
                "Subject": caption,
                "Keywords": record,
                "Creator": software,
                "CreationDate": None,  # the same input gives the same bytes
            }
            picture.savefig(pdf, format="pdf", metadata=metadata)
            if pdf.tell() <= LARGEST:
                files[f"{identifier}.pdf"] = pdf.getvalue()
    plt.close(picture)
    return files


def _png(picture: Figure, texts: Mapping[str, str], draft: bool) -> bytes:
    """Draw a PNG; resolution and colours fall until it has `LARGEST` bytes."""
    info = PngInfo()
    for name, text in texts.items():
        info.add_text(name, text)
    for share, colours in REDUCTIONS:
        dpi = share * (DRAFT_DPI if draft else PNG_DPI)
        drawn = io.BytesIO()
        picture.savefig(drawn, format="png", dpi=dpi)
        image = Image.open(drawn).convert("RGB")
        few = image.quantize(colours, dither=Image.Dither.NONE)
        png = io.BytesIO()
        few.save(png, "PNG", optimize=not draft, dpi=(dpi, dpi), pnginfo=info)
        if png.tell() <= LARGEST:
            break
    return png.getvalue()
