"""The page of claims: by chapter, verdict and cause, each beside what decided it.

Rows are those of figures/claims.csv (`kilnflight.project.claims.collect`).
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping
from html import escape

import pandas as pd

from kilnflight.project import claims

# Chapters by how "seed where" of claims.csv begins.
CHAPTERS = {
    "thesis 2": "Thesis, chapter 2: depth camera",
    "thesis 3": "Thesis, chapter 3: particles on the wall",
    "thesis 4": "Thesis, chapter 4: tracklets and regression",
    "thesis 5.1": "Thesis, section 5.1: detection",
    "thesis 5.2": "Thesis, section 5.2: tracking and regression",
    "thesis 5.3": "Thesis, section 5.3: flight and combustion",
    "thesis A": "Thesis, appendix A: flight",
    "belt-2020": "Belt paper of 2020",
    "belt-2016": "Belt paper of 2016",
}
ORDERS = {
    "chapter": list(CHAPTERS.values()),
    "verdict": list(claims.VERDICTS),
    "because": ["", *claims.CAUSES],
}
LONGEST = 120  # characters of a measured value that are shown unasked


def by_chapter(table: pd.DataFrame) -> pd.DataFrame:
    """Return verdicts by chapter, verdict and cause, with ``chapter``, ``seed``, ``where``."""
    places = claims.load().loc[table["id"], ["seed", "where"]].set_index(table.index)
    named = table.join(places)
    keys = named["seed"] + " " + named["where"]
    starts = [next(start for start in CHAPTERS if key.startswith(start)) for key in keys]
    named["chapter"] = pd.Series(starts, table.index).map(CHAPTERS)
    for name, order in ORDERS.items():
        named[name] = pd.Categorical(named[name], order)
    ranked = named.sort_values(list(ORDERS), ignore_index=True)
    return ranked.astype(dict.fromkeys(ORDERS, str))


def counts_by_cause(table: pd.DataFrame) -> pd.DataFrame:
    """Return how many claims of each chapter have which verdict, and because of what."""
    named, rows = by_chapter(table), []
    for chapter, part in [*named.groupby("chapter", sort=False), ("all", named)]:
        row: dict[str, object] = {"chapter": chapter, "claims": len(part)}
        for verdict in claims.VERDICTS:
            causes = part.loc[part["verdict"] == verdict, "because"]
            told = [
                f"{cause} {number}" for cause in claims.CAUSES if (number := sum(causes == cause))
            ]
            row[verdict] = f"{len(causes)}: {', '.join(told)}" if told else str(len(causes))
        rows.append(row)
    return pd.DataFrame(rows)


def fails_on_truth(table: pd.DataFrame) -> pd.Series:
    """Return which claims fail on the twin's own truth, so that no measuring can save them."""
    told = f"{claims.WORDS[claims.NOT_REPRODUCED]} {claims.ON_TRUTH}"
    return table["reason"].str.startswith(told) & (table["verdict"] == claims.NOT_REPRODUCED)


def figure_of(seed: str, where: str, saved: Mapping[str, str]) -> tuple[str, str]:
    """Return name and id of the figure or table that a claim is about; empty: not drawn here.

    ``saved`` holds each figure's notebook by its id.
    """
    found = re.search(r"(Fig|Table) ([A-Z]?[\d.]+)", where)
    if found is None:
        return "", ""
    paper = {"belt-2020": "belt20-", "belt-2016": "belt16-"}.get(seed, "")
    stem = f"{found[1]}-{paper}{found[2]}".lower().replace(".", "-")
    return found[0], next((name for name in saved if f"{name}-".startswith(f"{stem}-")), "")


def page_table(table: pd.DataFrame, saved: Mapping[str, str]) -> str:
    """Return claims of `by_chapter` as HTML, linked to notebooks and figures (``saved``)."""
    names = ("claim", "published", "ours", "verdict")
    lines = ["".join(["<table class='claims'><tr>", *(f"<th>{name}</th>" for name in names)])]
    for (_, given), on_truth in zip(table.iterrows(), fails_on_truth(table), strict=True):
        row = given.map(lambda value: escape(str(value)))
        link = f"<a href='{row['notebook']}.html'>{row['id']}</a>" if row["notebook"] else row["id"]
        name, figure = figure_of(row["seed"], row["where"], saved)
        if figure:
            link += f"<br> <a href='{saved[figure]}.html#{figure}'>{name}</a>"
        short = textwrap.shorten(given["measured"], LONGEST, placeholder=" ...") or "not measured"
        why = "<br>".join(filter(None, dict.fromkeys(row[["measured", "criterion", "reason"]])))
        ours = f"<details><summary>{escape(short)}</summary>{why}</details>"
        verdict = f"<b>{row['verdict']}</b>"
        if row["verdict"] != claims.REPRODUCED:
            verdict += f"<br>{row['because']}"
        verdict += "<br><em>fails on the twin's own truth</em>" if on_truth else ""
        cells = (link, f"{row['published']} ({row['where']})", ours, verdict)
        kind = row["verdict"].replace(" ", "-")
        lines.append(
            f"<tr id='{row['id']}' class='{kind}'>" + "".join(f"<td>{cell}</td>" for cell in cells)
        )
    return "\n".join([*lines, "</table>"])
