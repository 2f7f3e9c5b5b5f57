"""The page of claims: by chapter and by cause, each with what decided it.

Rows are those of figures/claims.csv (`kilnflight.project.claims.collect`).
"""

from __future__ import annotations

from html import escape

import pandas as pd

from kilnflight.project import claims

# Chapters of the thesis by the start of ``where`` in claims.csv; the first that fits counts.
CHAPTERS = {
    "2": "Thesis, chapter 2: depth camera",
    "3": "Thesis, chapter 3: particles on the wall",
    "4": "Thesis, chapter 4: tracklets and regression",
    "5.1": "Thesis, section 5.1: detection",
    "5.2": "Thesis, section 5.2: tracking and regression",
    "5.3": "Thesis, section 5.3: flight and combustion",
    "A": "Thesis, appendix A: flight",
}
PAPERS = {"belt-2020": "Belt paper of 2020", "belt-2016": "Belt paper of 2016"}


def chapter(where: str, seed: str) -> str:
    """Return the heading under which a claim stands.

    ``where`` and ``seed`` are those of data/reference/claims.csv.
    """
    if seed in PAPERS:
        return PAPERS[seed]
    return next(name for start, name in CHAPTERS.items() if where.startswith(start))


def with_chapters(table: pd.DataFrame) -> pd.DataFrame:
    """Return the verdicts with a column ``chapter`` in front, in the order of chapters."""
    known = claims.load()
    rows = known.loc[table["id"], ["where", "seed"]].astype(str).itertuples(index=False)
    named = table.assign(chapter=[chapter(where, seed) for where, seed in rows])
    order = [*CHAPTERS.values(), *PAPERS.values()]
    named["chapter"] = pd.Categorical(named["chapter"], order, ordered=True)
    ranked = named.sort_values("chapter", kind="stable", ignore_index=True)
    return ranked.astype({"chapter": str})[["chapter", *table.columns]]


def outcome(verdict: str, because: str) -> str:
    """Return a verdict with its cause, for example "not reproduced: twin"."""
    return verdict if verdict == claims.REPRODUCED else f"{verdict}: {because or 'cause missing'}"


def counts_by_cause(table: pd.DataFrame) -> pd.DataFrame:
    """Return how many claims of each chapter have which verdict and cause, with totals."""
    named = with_chapters(table)
    outcomes = pd.Series(
        [outcome(*pair) for pair in zip(named["verdict"], named["because"], strict=True)],
        name="outcome",
    )
    counts = pd.crosstab(named["chapter"], outcomes).loc[named["chapter"].unique()]
    order = [outcome(verdict, cause) for verdict in claims.VERDICTS for cause in claims.CAUSES]
    columns = sorted(counts.columns, key=lambda name: order.index(name) if name in order else 99)
    totals = counts.sum().rename("all")
    whole = pd.concat([counts[columns], totals[columns].to_frame().T])
    return whole.assign(claims=whole.sum(axis=1)).rename_axis("chapter").reset_index()


def fails_on_truth(table: pd.DataFrame) -> pd.Series:
    """Return which claims fail on the twin's own truth, so that no measuring can save them."""
    told = claims.ON_TRUTH[claims.NOT_REPRODUCED]
    return table["reason"].str.startswith(told) & (table["verdict"] == claims.NOT_REPRODUCED)


def page_table(table: pd.DataFrame) -> str:
    """Return claims as an HTML table; each links to the page of its notebook."""
    lines = ["<table class='claims'><thead><tr>"]
    lines += [f"<th>{name}</th>" for name in ("claim", "published", "verdict", "what decides")]
    lines.append("</tr></thead><tbody>")
    for row, on_truth in zip(table.itertuples(), fails_on_truth(table), strict=True):
        verdict = escape(outcome(str(row.verdict), str(row.because)))
        if on_truth:
            verdict += "<br><em>fails on the twin's own truth</em>"
        name, notebook = escape(str(row.id)), escape(str(row.notebook))
        link = f"<a href='{notebook}.html'>{name}</a>" if notebook else name
        why = "<br>".join(escape(str(text)) for text in (row.measured, row.reason) if text)
        decides = f"{escape(str(row.criterion))}<details><summary>measured</summary>{why}</details>"
        cells = (link, escape(str(row.published)), verdict, decides)
        lines.append("<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>")
    return "\n".join([*lines, "</tbody></table>"])
