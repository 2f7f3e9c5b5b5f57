"""The report in PDF: what the site says, on pages that one prints and cites.

figures/, CITATION.cff -> paragraphs, tables and pictures -> reportlab -> report.pdf

Every number comes from figures/*.csv and from the captions inside the PNGs. The same input gives
the same bytes.
"""

from __future__ import annotations

import argparse
import sys
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import pandas as pd
import yaml
from reportlab.platypus import Flowable, KeepTogether, PageBreak, Paragraph

from kilnflight import __version__
from kilnflight.checks import InputError
from kilnflight.project import claims, claims_page, figures, paths
from kilnflight.project.cache import write_whole
from kilnflight.project.site import numbers
from kilnflight.project.site.front import ABSTRACT, QUESTION
from kilnflight.project.site.pdf import (
    BODY,
    CODE,
    TITLE,
    Heading,
    begun,
    pages,
    picture,
    register_fonts,
    table,
)

# The figures one would cite, in the order of the thesis: id, and why.
CHOSEN = {
    "fig-2-16-calibration": "Every depth, velocity and trajectory passes through this calibration.",
    "fig-3-11-distances": "It decides which particles fly and which lie on the wall.",
    "fig-5-4-background": "Which background model is best depends on how differences are read.",
    "fig-5-5-recall": "It shows which class of particle the detection loses, and by which reading.",
    "ablation-means": "It says which step of the chain costs the tracking most.",
    "fig-5-16-trajectories": "It is what all numbers about flight are measured on.",
    "fig-5-19-dwell-time": "Dwell time is the main number of the thesis, here beside its truth.",
    "fig-5-20-remaining": "It tells how far particles get, which the design of a burner needs.",
    "fig-5-21-velocity": "Velocity by metre is the second main number, for four fractions.",
    "fig-5-25-ignition": "It is the only published measure of combustion, beside the truth.",
    "accuracy-steps": "It splits the error of each number into the steps that cause it.",
    "fig-belt20-9-arrival": "It is the main result of the belt paper of 2020.",
}


@dataclass(frozen=True)
class Sources:
    """What the report is made of, as read from a folder of figures."""

    collected: pd.DataFrame  # claims with verdicts
    errata: pd.DataFrame
    entries: dict[str, figures.Entry]
    folder: Path

    @property
    def scales(self) -> set[str]:
        """At which scales the figures were made."""
        shown = (self.entries[name] for name in CHOSEN)
        return {str(entry.provenance["parameters"].get("scale")) for entry in shown}


def read(folder: Path) -> Sources:
    """Read what the report needs.

    Raises
    ------
    InputError
        If anything is missing; it names all that is.
    """
    saved = {entry.identifier: entry for entry in figures.entries(folder)}
    tables = {name: folder / f"{name}.csv" for name in ("claims", "errata")}
    missing = [path.name for path in tables.values() if not path.is_file()]
    missing += [f"{name}.png" for name in CHOSEN if name not in saved]
    if missing:
        raise InputError(
            f"{folder} has no {', '.join(missing)}, which the report shows; run make full."
        )
    collected, errata = (
        pd.read_csv(path, dtype=str, keep_default_na=False) for path in tables.values()
    )
    return Sources(collected, errata, saved, folder)


def story(sources: Sources) -> list[Flowable]:
    """Return the report as reportlab's flowables, in reading order."""
    register_fonts()
    parts = (_front, _verdicts, _chosen, _errata, _cite)
    return [flowable for part in parts for flowable in part(sources)]


def _front(sources: Sources) -> Iterable[Flowable]:
    """Return title, abstract and the verdicts counted by chapter and cause."""
    count = claims.count(sources.collected)
    told = ", ".join(f"{number} {verdict}" for verdict, number in count.items())
    yield Paragraph(QUESTION, TITLE)
    yield Paragraph(f"kilnflight {__version__}, report of the reproduction", BODY)
    if sources.scales != {"full"}:
        scale = " and ".join(sorted(sources.scales))
        yield Paragraph(f"<b>Made at scale {scale}, a reduced run: do not cite.</b>", BODY)
    yield Heading("Abstract")
    yield Paragraph(ABSTRACT, BODY)
    yield Heading("Verdicts by chapter and cause")
    yield Paragraph(f"Of {sum(count.values())} published claims: {told}.", BODY)
    counted = claims_page.counts_by_cause(sources.collected)
    yield table(counted.columns, counted.astype(str).to_numpy(), (58, 14, 22, 40, 31))
    yield Paragraph("What the causes mean:", BODY)
    for cause, meaning in claims.CAUSES.items():
        yield Paragraph(f"<b>{cause}</b>: {escape(meaning)}.", BODY)


def _verdicts(sources: Sources) -> Iterable[Flowable]:
    """Return every claim with its verdict, by chapter."""
    named = claims_page.by_chapter(sources.collected)
    yield PageBreak()
    yield Heading("Every claim")
    for chapter, part in named.groupby("chapter", sort=False):
        yield from begun(Heading(str(chapter), 1))
        yield table(("claim", "published", "here", "verdict"), _rows(part), (22, 60, 55, 28))


def _rows(part: pd.DataFrame) -> Iterable[tuple[str, ...]]:
    for row in part.to_dict("records"):
        why = "" if row["verdict"] == claims.REPRODUCED else f": {row['because']}"
        here = textwrap.shorten(row["measured"], claims_page.LONGEST, placeholder=" ...")
        yield row["id"], f"{row['published']} ({row['where']})", here, f"{row['verdict']}{why}"


def _chosen(sources: Sources) -> Iterable[Flowable]:
    """Return the figures one would cite, each with number, caption, reason and data."""
    yield PageBreak()
    yield Heading("Twelve figures to cite")
    note = "All are simulated: they show the twin or simulated belts, never the kiln itself."
    yield Paragraph(note, BODY)
    places = numbers.load(sources.entries)
    for name, reason in CHOSEN.items():
        shown = places[[name in ids for ids in places["ids"]]]
        entry = sources.entries[name]
        origin = f"{name}.csv, notebook {entry.provenance['notebook']}"
        if entry.provenance["commit"]:
            origin += f", commit {entry.provenance['commit'][:12]}"
        yield KeepTogether(
            [
                Heading(figures.title_of(entry.caption), 1),
                picture(sources.folder / f"{name}.png"),
                Paragraph(f"<b>{_where(shown)}; simulated.</b> {escape(entry.caption)}", BODY),
                Paragraph(f"<i>Why cite it:</i> {escape(reason)}", BODY),
                Paragraph(escape(origin), CODE),
            ]
        )


def _where(shown: pd.DataFrame) -> str:
    """Return what a figure is called in the works, for example "Fig. 5.19, thesis"."""
    if not len(shown):
        return "No number in the works"
    titles = [numbers.title(row).split(", ", 1) for row in shown.to_dict("records")]
    return escape(", ".join([*(name for name, _ in titles), titles[0][1]]))


def _errata(sources: Sources) -> Iterable[Flowable]:
    """Return the misprints, those that a conclusion depends on first."""
    wrong = sources.errata
    depends = wrong["consequence"].str.match("yes|in part")
    yield PageBreak()
    yield Heading("Errata of the works")
    parts = {"A conclusion depends on them": wrong[depends], "No conclusion does": wrong[~depends]}
    for title, part in parts.items():
        yield from begun(Heading(f"{title}: {len(part)}", 1))
        yield table(part.columns, part.to_numpy(), (50, 32, 35, 48))


def _cite(sources: Sources) -> Iterable[Flowable]:
    """Return how to cite the package, its figures and the works."""
    given = yaml.safe_load((paths.root() / "CITATION.cff").read_text("utf-8"))
    yield from begun(Heading("How to cite"))
    yield Paragraph("The package, and the work that a result belongs to:", BODY)
    for work in [given, *given["references"]]:
        yield Paragraph(escape(_reference(work)), BODY)
    yield Paragraph(
        "A figure is cited by its id, which stands under it above; its BibTeX and LaTeX are in "
        "figures/README.md. For example:",
        BODY,
    )
    example = figures.citations(sources.entries["fig-5-19-dwell-time"])["BibTeX"]
    yield Paragraph(escape(example).replace(" ", "&nbsp;").replace("\n", "<br/>"), CODE)


def _reference(work: dict[str, Any]) -> str:
    """Return one entry of CITATION.cff as a line."""
    names = [
        " ".join(filter(None, [person.get("given-names"), person.get("family-names")]))
        or str(person.get("name"))
        for person in work["authors"]
    ]
    version = f"Version {work['version']}" if "version" in work else ""
    place = work.get("institution", {}).get("name") or work.get("collection-title", version)
    year = str(work.get("year", figures.YEAR))
    doi = f"doi:{work['doi']}" if "doi" in work else ""
    return ". ".join(filter(None, [", ".join(names), work["title"], place, year, doi])) + "."


def render(sources: Sources) -> bytes:
    """Return the report as a PDF."""
    below = f"kilnflight {__version__}: a twin, not the kiln"
    return pages(story(sources), QUESTION, "The kilnflight founders", below)


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the report of what figures/ holds."""
    parser = argparse.ArgumentParser(
        prog="python -m kilnflight.project.site.report", description=main.__doc__
    )
    parser.add_argument("--to", type=Path, default=Path("build/report.pdf"))
    options = parser.parse_args(arguments)
    try:
        content = render(read(paths.figures()))
    except InputError as error:
        print(f"report: {error}", file=sys.stderr)
        return 1
    options.to.parent.mkdir(parents=True, exist_ok=True)
    write_whole(options.to, content)
    print(f"report: read {options.to}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
