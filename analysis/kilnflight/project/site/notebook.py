"""Executed notebooks as pages: the result first, code folded, figures linked with downloads."""

from __future__ import annotations

import json
import re
from collections.abc import Hashable, Mapping
from html import escape
from pathlib import Path
from typing import Any

import nbformat
import pandas as pd
from nbformat.v4 import new_markdown_cell

from kilnflight.project import claims, paths
from kilnflight.project.site.blocks import Blocks, three_digits

FIGURE = re.compile(r"<figure id=['\"]([a-z0-9-]+)['\"]")
CELL = re.compile("<td>([^<]*)</td>")
MISPRINTS = "01_published_tables"  # the last printed digits are what it is about
SUMMARY = "00_claims"  # the notebook that collects the verdicts of all others
PLOTLY = "application/vnd.plotly.v1+json"  # a view that turns


def page(path: Path, blocks: Blocks, result: str, verdicts: pd.DataFrame) -> nbformat.NotebookNode:
    """Return the page of an executed notebook.

    Parameters
    ----------
    path
        The executed notebook.
    blocks
        Of the saved figures.
    result
        Its one-line result.
    verdicts
        Its claims: ``id``, ``verdict``, ``published``.
    """
    notebook = nbformat.read(path, as_version=4)
    cells = []
    for cell in notebook.cells:
        tags = cell.metadata.get("tags", [])
        if "injected-parameters" in tags:
            continue
        if "parameters" in tags:
            cells.append(new_markdown_cell(_parameters(notebook, cell.source)))
        elif cell.cell_type == "markdown":
            cells.append(new_markdown_cell(_linked(cell.source, blocks)))
        else:
            _append(cells, _folded(cell, blocks, short=path.stem != MISPRINTS))
    title, _, rest = cells[0].source.partition("\n")
    badges = _all_verdicts() if path.stem == SUMMARY else _badges(verdicts)
    top = f"{title}\n\n{badges}\n\n**Result.** {blocks.links(escape(result))}\n"
    cells[0] = new_markdown_cell(f"{top}{rest}")
    for number, cell in enumerate(cells):  # ids depend on the place alone
        cell["id"] = f"cell-{number}"
    notebook.cells = cells
    return notebook


def _append(cells: list[nbformat.NotebookNode], cell: nbformat.NotebookNode) -> None:
    """Add a code cell; to a code cell before it that shows nothing, its lines are added."""
    if cells and cells[-1].cell_type == "code" and not cells[-1].outputs:
        cell.source = f"{cells.pop().source}\n\n{cell.source}"
    cells.append(cell)


def _linked(source: str, blocks: Blocks) -> str:
    """Return prose with links; a heading has none, as the table of contents links it whole."""
    parts = re.split(r"(?m)^(#.*)$", source)
    return "".join(part if part.startswith("#") else blocks.links(part) for part in parts)


def _parameters(notebook: nbformat.NotebookNode, source: str) -> str:
    """Return the parameters of a run in one line."""
    given = notebook.metadata.get("papermill", {}).get("parameters", {})
    lines = re.findall(r"^(\w+) = ([^#\n]+?)\s*(#.*)?$", source, re.MULTILINE)
    values = {name: value for name, value, _ in lines}
    values |= {name: repr(value) for name, value in given.items()}
    by_scale = {name for name, _, told in lines if re.search(r"\b0: .*by scale", told)}
    shown = ", ".join(
        f"{name} by scale" if name in by_scale and value == "0" else f"{name} = {value}"
        for name, value in values.items()
    )
    return f'<p class="parameters">Parameters: {escape(shown, quote=False)}</p>'


def _three_digits(found: re.Match[str]) -> str:
    return f"<td>{three_digits(found[1])}</td>"


def _folded(cell: nbformat.NotebookNode, blocks: Blocks, short: bool) -> nbformat.NotebookNode:
    """Return a code cell that is folded, with linked figures instead of embedded ones.

    ``short``: whether numbers of its tables get three digits.
    """
    cell.metadata["tags"] = sorted({*cell.metadata.get("tags", []), "hide-input"})
    for output in cell.outputs:
        data: Mapping[str, Any] = output.get("data", {})
        text = data.get("text/html", "")
        found = FIGURE.search(text)
        if found and found[1] in blocks.entries:
            output["data"] = {"text/html": blocks(found[1])}
        elif PLOTLY in data:
            output["data"] = {"text/html": _turning(data[PLOTLY], blocks.above)}
        elif 'class="dataframe"' in text and short:
            output["data"] = {**data, "text/html": CELL.sub(_three_digits, text)}
    return cell


def _turning(view: object, above: str) -> str:
    """Return a button that shows a view in space; its script is loaded then, and not before."""
    data = json.dumps(view, separators=(",", ":")).replace("</", "<\\/")
    return (
        f'<div class="turning"><button type="button" data-script="{above}_static/plotly.min.js">'
        "Show in 3D (loads 5 MB)</button>"
        f'<script type="application/json">{data}</script></div>'
    )


def _badges(verdicts: pd.DataFrame) -> str:
    """Return a badge for each claim, which leads to its row on the page of claims."""
    if not len(verdicts):
        return '<p class="badges"><span class="badge">no claim is tested here</span></p>'
    badges = [
        f'<a class="badge {row["verdict"].replace(" ", "-")}" title="{escape(row["published"], quote=True)}" '
        f'href="00_claims.html#{row["id"]}">{row["id"]}: {row["verdict"]}{_full(row)}</a>'
        for row in verdicts.to_dict("records")
    ]
    return f'<p class="badges">{" ".join(badges)}</p>'


def _full(row: Mapping[Hashable, str]) -> str:
    """Return the verdict at full scale, on the page of a reduced run where it differs."""
    return f" (full scale: {row['full']})" if row.get("full") else ""


def _all_verdicts() -> str:
    """Return how the page of claims begins: what filters it, and its files."""
    table = pd.read_csv(paths.figures() / "claims.csv", keep_default_na=False)
    return (
        f"{verdict_bar(table)}<p class='downloads' id='claims'><a id='all' href='#all'>all {len(table)}</a> "
        '<a href="figures/claims.csv" download>CSV</a> '
        '<a href="tables/claims.html">as a table, to sort and filter</a></p>'
    )


def verdict_bar(verdicts: pd.DataFrame) -> str:
    """Return the counts of verdicts as a bar; each part shows its claims only."""
    parts = [
        f'<a class="{name}" id="{name}" style="flex-grow: {number}" href="{SUMMARY}.html#{name}">'
        f"<b>{number}</b> {verdict}</a>"
        for verdict, number in claims.count(verdicts).items()
        if number and (name := verdict.replace(" ", "-"))
    ]
    return f'<div class="bar">{"".join(parts)}</div>'
