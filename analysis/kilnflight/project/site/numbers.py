"""A page for every figure and table of the three works, by its number.

data/reference/numbers.csv, figures/ -> works/<work>-<kind>-<number>.md
"""

from __future__ import annotations

import re
from collections.abc import Hashable, Iterable, Mapping
from html import escape
from pathlib import Path

import pandas as pd

from kilnflight.project import claims, paths
from kilnflight.project.site.blocks import Blocks
from kilnflight.project.site.links import Links

WORKS = {"thesis": "Thesis", "belt-2020": "Belt paper of 2020", "belt-2016": "Belt paper of 2016"}
STEMS = {"thesis": "", "belt-2020": "belt20-", "belt-2016": "belt16-"}  # of the figures' ids
DRAWN_WITH = re.compile(r"drawn with (?:Fig|Table)\. (\S+)")


def load(saved: Iterable[str] = ()) -> pd.DataFrame:
    """Return the figures and tables of the works.

    Parameters
    ----------
    saved
        Ids of the figures that are saved here.

    Returns
    -------
    DataFrame
        ``work``, ``kind``, ``number``, ``topic``, ``absent`` (why it is not drawn here), ``name``
        of its page, and ``ids``: the saved figures that show it, a list.
    """
    table = pd.read_csv(paths.reference() / "numbers.csv", dtype=str, keep_default_na=False)
    table["name"] = table["work"] + "-" + table["kind"].str.lower() + "-" + _stems(table)
    own = own_ids(table)
    saved = sorted(saved)
    ids = [[name for name in saved if f"{name}-".startswith(f"{stem}-")] for stem in own]
    by_place = dict(zip(zip(table["work"], table["kind"], table["number"], strict=True), ids, strict=True))
    table["ids"] = [
        by_place.get((work, kind, found[1]), own) if (found := DRAWN_WITH.search(absent)) else own
        for work, kind, absent, own in zip(table["work"], table["kind"], table["absent"], ids, strict=True)
    ]
    return table


def own_ids(table: pd.DataFrame) -> pd.Series:
    """Return how the ids of a work's figures and tables begin, for example "fig-5-19"."""
    return table["kind"].str.lower() + "-" + table["work"].map(STEMS) + _stems(table)


def _stems(table: pd.DataFrame) -> pd.Series:
    return table["number"].str.lower().str.replace(".", "-")


def links(table: pd.DataFrame, notebooks: Iterable[str]) -> Links:
    """Return the links to notebooks, and to the thesis's figures and tables."""
    thesis = table[table["work"] == "thesis"]
    names = dict(zip(zip(thesis["kind"], thesis["number"], strict=True), thesis["name"], strict=True))
    return Links({stem[:2]: stem for stem in notebooks}, names)


def title(row: Mapping[Hashable, str]) -> str:
    """Return the name of a figure or table, for example "Fig. 5.19 of the thesis"."""
    dot = "." if row["kind"] == "Fig" else ""
    work = WORKS[row["work"]]
    return f"{row['kind']}{dot} {row['number']}, {work[0].lower() + work[1:]}"


def page(row: Mapping[Hashable, object], blocks: Blocks, verdicts: pd.DataFrame) -> str:
    """Return the page of one figure or table as Markdown.

    Parameters
    ----------
    row
        Of `load`.
    blocks
        Of the saved figures, for pages one folder down.
    verdicts
        Claims with ``id``, ``verdict``, ``where``, ``seed`` and ``published``.
    """
    kind, number = str(row["kind"]), str(row["number"])
    dot = "." if kind == "Fig" else ""
    name = f"{kind}{dot} {number}"  # what the search finds first
    indexed = f"```{{index}} ! {name}\n```\n"
    lines = ["---\norphan: true\n---\n", indexed, f"# {name}: {row['topic']}\n", f"{WORKS[str(row['work'])]}.\n"]
    about = verdicts[
        (verdicts["seed"] == row["work"])
        & verdicts["where"].str.contains(rf"\b{kind}\.? {re.escape(number)}(?!\d)", regex=True)
    ]
    for claim in about.to_dict("records"):
        lines.append(
            f"- **{claim['verdict']}**: {claim['published']} "
            f"(<a href='../00_claims.html#{claim['id']}'>{claim['id']}</a>)"
        )
    lines += _misprints(str(row["work"]), rf"\b{kind}\.? {re.escape(number)}(?!\d)", blocks)
    if row["absent"]:
        lines.append(f"\nNot drawn here on its own: {row['absent']}.\n")
    ids = row["ids"]
    assert isinstance(ids, list)
    lines += [f"\n```{{raw}} html\n{blocks(name)}\n```\n" for name in ids]
    return "\n".join(lines) + "\n"


def _misprints(work: str, place: str, blocks: Blocks) -> list[str]:
    """Return what the errata say of a place of the thesis, as lines of a list."""
    path = blocks.folder / "errata.csv"
    if work != "thesis" or not path.is_file():
        return []
    wrong = pd.read_csv(path, dtype=str, keep_default_na=False)
    here = wrong[wrong["where"].str.contains(place) & ~wrong["where"].str.startswith("Belt")]
    link = "<a href='../01_published_tables.html#errata'>errata</a>"
    return [
        f"- **misprint** ({link}): {escape(row['where'])}: printed {escape(row['printed'])}, "
        f"recomputed {escape(row['recomputed'])}"
        for row in here.to_dict("records")
    ]


def index(table: pd.DataFrame) -> str:
    """Return the page that lists the figures and tables of the works."""
    lines = ["# Figures and tables by number\n"]
    for work, part in table.groupby("work", sort=False):
        lines.append(f"## {WORKS[str(work)]}\n")
        for row in part.to_dict("records"):
            dot = "." if row["kind"] == "Fig" else ""
            absent = f" ({row['absent']})" if row["absent"] else ""
            name = f"{row['kind']}{dot} {row['number']}"
            lines.append(f"- [{name}](works/{row['name']}.md): {row['topic']}{absent}")
        lines.append("")
    return "\n".join(lines) + "\n"


def write(folder: Path, table: pd.DataFrame, blocks: Blocks, collected: pd.DataFrame) -> list[str]:
    """Write the pages of all figures and tables; return their names."""
    places = claims.load()[["seed", "where"]]
    verdicts = collected.join(places, on="id")
    folder.mkdir(parents=True, exist_ok=True)
    for row in table.to_dict("records"):
        (folder / f"{row['name']}.md").write_text(page(row, blocks, verdicts))
    return table["name"].tolist()
