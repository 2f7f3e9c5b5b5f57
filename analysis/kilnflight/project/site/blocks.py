"""What stands on a page for a saved figure or table: content, caption, downloads, citation.

Figures are linked, not embedded: the site has one copy of each file, in ``figures/``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from html import escape
from pathlib import Path

import pandas as pd
from PIL import Image

from kilnflight.project import figures
from kilnflight.project.figures import SCREEN_DPI, Entry
from kilnflight.project.site.links import Links
from kilnflight.project.style import totals

LONGEST_TABLE = 25  # rows that a page shows; the rest has a page of its own
AS_SAVED = ("errata", "published-recomputed")  # the last printed digits are what they are about
UNITS = {
    "m_s": "m/s", "mm": "mm", "px": "px", "ms": "ms", "s": "s", "m": "m", "bar": "bar",
    "percent": "%", "degrees": "degrees", "gray": "grey value",
}  # fmt: skip


@dataclass(frozen=True)
class Blocks:
    """Blocks of the figures of a folder, for pages that lie ``above`` the site's root."""

    folder: Path
    links: Links
    above: str = ""  # "../" for a page one folder down
    entries: Mapping[str, Entry] = field(default_factory=dict)

    def __call__(self, identifier: str) -> str:
        """Return the HTML of one figure or table."""
        entry = self.entries[identifier]
        if identifier.startswith("claims-") and figures.is_empty(self.folder, identifier):
            return f'<p id="{identifier}">No claim of the works is tested here.</p>'
        drawn = is_drawn(self.folder, identifier)
        body = self.picture(entry) if drawn else self.table(identifier)
        caption = self.links(escape(entry.caption), self.above)
        return (
            f'<figure id="{identifier}" class="saved">{body}'
            f"<figcaption>{caption}</figcaption>{self.downloads(entry)}</figure>"
        )

    def picture(self, entry: Entry) -> str:
        """Return the picture, in its size on a screen."""
        path = self.folder / f"{entry.identifier}.png"
        with Image.open(path) as image:
            dpi = image.info["dpi"][0]
            width, height = (round(size * SCREEN_DPI / dpi) for size in image.size)
        words = escape(figures.title_of(entry.caption), quote=True)
        return (
            f'<img src="{self.above}figures/{path.name}" alt="{words}" loading="lazy" '
            f'width="{width}" height="{height}"/>'
        )

    def table(self, identifier: str) -> str:
        """Return the table: whole if it is short, else its totals or first rows."""
        table = pd.read_csv(self.folder / f"{identifier}.csv", keep_default_na=False, dtype=str)
        if len(table) <= LONGEST_TABLE:
            return html_table(table, identifier)
        words = totals(table)
        shown = table[words] if 0 < words.sum() <= LONGEST_TABLE else table.head(LONGEST_TABLE)
        kind = "totals" if 0 < words.sum() <= LONGEST_TABLE else "first rows"
        return (
            f'{html_table(shown, identifier)}<p class="more">Shown: the {kind}. '
            f'<a href="{self.above}tables/{identifier}.html">All {len(table)} rows</a>, to sort '
            "and filter.</p>"
        )

    def downloads(self, entry: Entry) -> str:
        """Return links to the files, and the citation to copy."""
        name = entry.identifier
        kinds = [kind for kind in ("png", "pdf", "csv") if self._has(name, kind)]
        files = [
            f'<a href="{self.above}figures/{name}.{kind}" download>{kind.upper()}</a>'
            for kind in kinds
        ]
        notebook = entry.provenance["notebook"]
        if notebook[:2].isdigit():  # benchmarks have no page
            page = f"{self.above}{notebook}.html#{name}"
            files.append(f'<a href="{page}">notebook {notebook[:2]}</a>')
        files.append(f'<a href="#{name}">link</a>')
        return f'<div class="downloads">{" ".join(files)}{self.citations(entry)}</div>'

    @staticmethod
    def citations(entry: Entry) -> str:
        """Return the citations to copy; figures/ holds no figure of a reduced run to cite."""
        if not figures.may_be_cited(entry):
            scale = entry.provenance["parameters"]["scale"]
            return f" <span>scale {scale}, do not cite</span>"
        return "".join(
            f"<details><summary>{label}</summary><pre>{escape(text)}</pre></details>"
            for label, text in figures.citations(entry).items()
        )

    def _has(self, name: str, kind: str) -> bool:
        return (self.folder / f"{name}.{kind}").is_file()


def is_drawn(folder: Path, identifier: str) -> bool:
    """Return whether a figure is a picture; a table drawn as text is shown as a table."""
    with Image.open(folder / f"{identifier}.png") as image:
        kind = image.info.get("Kind")
        return bool(kind == "picture" if kind else image.info["dpi"][0] > 1.05 * figures.TABLE_DPI)


def html_table(table: pd.DataFrame, identifier: str = "") -> str:
    """Return a table of texts as HTML: words as headers, numbers with three digits.

    What is published stands beside ours. Tables of `AS_SAVED` keep their digits.
    """
    order = [str(name) for name in table]
    for name in [name for name in order if name.endswith("_published")]:
        if (ours := name.removesuffix("_published")) in order:
            order.remove(name)
            order.insert(order.index(ours) + 1, name)
    cells = table[order].rename(columns=header)
    cells = cells if identifier in AS_SAVED else cells.map(three_digits)
    return f'<div class="wide" tabindex="0">{cells.to_html(index=False, border=0, na_rep="")}</div>'


def header(column: str) -> str:
    """Return a column's name in words, its unit in brackets.

    Examples
    --------
    >>> header("measured_m_s"), header("pressure_bar"), header("f1_published")
    ('measured (m/s)', 'pressure (bar)', 'F1 published')
    """
    unit = next((unit for unit in UNITS if column.endswith(f"_{unit}")), "")
    words = column.removesuffix(f"_{unit}").replace("_", " ")
    words = re.sub(r"\b(f1|jsc|tp|fp|fn|rmse|mape|r2)\b", lambda found: found[0].upper(), words)
    return f"{words} ({UNITS[unit]})" if unit else words


def three_digits(text: str) -> str:
    """Return a number with three digits, whole numbers and words as they are.

    Examples
    --------
    >>> [three_digits(each) for each in ("0.123456", "1234", "8.2e-05", "wood chip", "-0.5")]
    ['0.123', '1234', '8.2e-05', 'wood chip', '-0.5']
    """
    if not re.fullmatch(r"-?\d*\.\d+(e[-+]?\d+)?", text):
        return text
    number = float(text)
    return f"{number:.3g}" if abs(number) < 1000 else f"{number:.0f}"
