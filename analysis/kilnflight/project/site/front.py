"""The front page: question, verdicts, findings, the chain with its losses, all figures by number.

Every number is read from figures/; none is typed.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import pandas as pd
from PIL import Image

from kilnflight.project import claims, claims_page, paths
from kilnflight.project.figures import Entry
from kilnflight.project.site.blocks import three_digits
from kilnflight.project.site.notebook import verdict_bar

QUESTION = "Can the published flight and combustion numbers of refuse-derived fuel be reproduced?"
ABSTRACT = (  # of the report, too
    "A thesis and two papers publish how particles are seen, followed and measured in a rotary "
    "kiln and on a sorting belt. The thesis's recordings are not public: a physical twin with "
    "known truth stands in; the belt's tracks and recordings are the authors' own. So methods and "
    "their errors can be judged, and the kiln's own numbers only as far as the twin is the kiln."
)
USE = """\
<pre class="use">make          # notebooks with less input, and this site
make full     # everything, at the scale of the publications
# the same chain on a film of your own; chips.toml says where it lies
kilnflight import chips.toml --to chips.zarr
kilnflight run chips.zarr --to chips</pre>
<p><a href="documents/made.html">How to reproduce it</a>,
<a href="documents/own_recording.html">a recording of your own</a>,
<a href="documents/limits.html">what the twin can and cannot tell</a>,
<a href="01_published_tables.html">errata of the printed tables</a>. Under every figure and table
stand its data and a citation to copy.</p>"""
THUMB_PX = 200  # width of a thumbnail
FRAME = "tracked-frame"  # on the first screen
# Pages of the chapters that `claims_page.CHAPTERS` names, by how their claims begin.
PAGES = {
    "thesis 2": "02_depth_calibration", "thesis 3": "25_wall", "thesis 4": "31_tracklets",
    "thesis 5.1": "24_all_methods", "thesis 5.2": "32_tracking", "thesis 5.3": "52_dwell_time",
    "thesis A": "55_simulated_flights", "belt-2020": "40_belt_arrival",
    "belt-2016": "42_predictive_tracking",
}  # fmt: skip
STEPS = {
    "recording": "10_ground_truth", "background": "20_backgrounds", "detection": "24_all_methods",
    "tracking": "32_tracking", "tracklets": "31_tracklets", "regression": "50_regression",
    "flight": "52_dwell_time",
}  # fmt: skip


@dataclass(frozen=True)
class Front:
    """The front page of the figures in a folder; ``verdicts`` are all claims."""

    folder: Path
    verdicts: pd.DataFrame
    numbers: pd.DataFrame  # `kilnflight.project.site.numbers.load`
    entries: Sequence[Entry] = ()  # of the figures

    def __call__(self, thumbnails: Path) -> str:
        """Return the page as Markdown, and write its small pictures into a folder."""
        parts = [
            self.first_screen(thumbnails),
            "## What was found",
            self.findings(thumbnails),
            "## Verdicts by chapter",
            self.chapters(),
            "## The way of a particle",
            self.way(),
            "## Figures and tables by number",
            self.wall(thumbnails),
            "## Use it",
            USE,
        ]
        return f"# {QUESTION}\n\n" + "\n\n".join(map(_raw, parts))

    def table(self, name: str) -> pd.DataFrame:
        """Return a saved table; empty if this run has none."""
        path = self.folder / f"{name}.csv"
        return pd.read_csv(path) if path.is_file() else pd.DataFrame()

    def first_screen(self, thumbnails: Path) -> str:
        """Return three sentences, the bar of verdicts, and one picture."""
        frame = self._thumbnail(FRAME, thumbnails, 3 * THUMB_PX)
        picture = (
            f'<figure class="first"><a href="32_tracking.html#{FRAME}"><img src="{frame}" alt='
            '"A simulated frame of the kiln with detections and tracks"/></a><figcaption>Simulated: '
            "a frame of the twin, what is detected in it, and the tracks up to it.</figcaption>"
            "</figure>"
            if frame
            else ""
        )
        return (
            f'<div class="screen"><div><p>{ABSTRACT}</p>'
            f"{verdict_bar(self.verdicts)}</div>{picture}</div>"
        )

    def findings(self, thumbnails: Path) -> str:
        """Return the headline findings as cards."""
        cards = [
            self._card(*each, thumbnails)
            for each in (
                ("24_all_methods", "detection-scores", "Detection", self._detection()),
                ("32_tracking", "tracking-scores", "Tracking", self._tracking()),
                ("52_dwell_time", "fig-5-19-dwell-time", "Dwell time", self._dwell()),
                ("40_belt_arrival", "fig-belt20-9-arrival", "Sorting belt", self._belt()),
            )
            if each[3]
        ]
        return f'<div class="cards">{"".join(cards)}</div>'

    def _card(self, page: str, name: str, title: str, text: str, thumbnails: Path) -> str:
        image = self._thumbnail(name, thumbnails, int(1.5 * THUMB_PX))
        shown = f'<img src="{image}" alt="" loading="lazy"/>' if image else ""
        return f'<a class="card" href="{page}.html">{shown}<b>{title}</b><span>{text}</span></a>'

    def _detection(self) -> str:
        table = self.table("table-5-11-detection")
        if table.empty:
            return ""
        f1 = table[table["reading"] == "absolute"].set_index("method")["f1"].astype(float)
        alone, both = f1["2D-SIFT"], f1["Combi SIFT+DBSCAN"]
        printed = claims.published("table_5.11").set_index("method")["f1"].astype(float)
        told = f" (published {printed.max():.3f}, the best)" if len(printed) else ""
        return f"SIFT with DBSCAN has F1 {both:.3f}{told}; SIFT alone {alone:.3f} on the twin."

    def _tracking(self) -> str:
        table = self.table("tracking-scores")
        if table.empty:
            return ""
        rows = table[(table["measure"] == "alpha") & (table["tracker"] == "GNN")]
        mean = rows.groupby("postprocessing")[["recomputed", "published"]].mean(numeric_only=True)
        if set(mean.index) != {"with", "without"} or mean.isna().to_numpy().any():
            return ""
        before, after = mean.loc["without"], mean.loc["with"]
        return (
            f"Post-processing raises GNN's alpha from {before['recomputed']:.2f} to "
            f"{after['recomputed']:.2f} (published {before['published']:.2f} to "
            f"{after['published']:.2f}), means of the fractions."
        )

    def _dwell(self) -> str:
        table = self.table("dwell-medians")
        if table.empty:
            return ""
        known = table.dropna(subset=["with_lost_low", "with_lost_high", "true_s"])
        if known.empty:
            return ""
        low, true, high = (
            known[name].astype(float) for name in ("with_lost_low", "true_s", "with_lost_high")
        )
        return (
            "The measured 95 % interval holds the true median dwell time in "
            f"{((low <= true) & (true <= high)).sum()} of {len(known)} campaigns that have both. "
            "Lost flights count as censored."
        )

    def _belt(self) -> str:
        table = self.table("belt-arrival")
        part = table[table["source"] == "authors-dem"] if len(table) else table
        if part.empty:
            return ""
        mae = part.pivot(index="data_set", columns="model", values="mae_ms").astype(float)
        ratio = mae["IV"] / mae["IA"]
        return (
            "On the authors' own tracks the model of identical acceleration predicts the arrival "
            f"{ratio.min():.0f} to {ratio.max():.0f} times better than that of identical velocity."
        )

    def chapters(self) -> str:
        """Return each chapter's verdicts as dots, beside one of its numbers."""
        named = claims_page.by_chapter(self.verdicts)
        keys = pd.read_csv(paths.reference() / "key_numbers.csv", dtype=str, keep_default_na=False)
        names = ("chapter", "claims", "a number of it", "published", "ours", "true, in the twin")
        lines = ["<tr>" + "".join(f"<th>{name}</th>" for name in names) + "</tr>"]
        for key in keys.to_dict("records"):
            part = named[named["chapter"] == claims_page.CHAPTERS[key["chapter"]]]
            page = f'<a href="{PAGES[key["chapter"]]}.html">{part["chapter"].iloc[0]}</a>'
            ours, true = self.measured(key)
            quantity, *texts = map(escape, (key["quantity"], key["published"], ours, true))
            number = f'<a href="{self.page_of(key["table"])}">{quantity}</a>'
            cells = (page, "".join(map(_dot, part.to_dict("records"))), number, *texts)
            lines.append("<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>")
        return f'<div class="wide" tabindex="0"><table class="chapters">{"".join(lines)}</table></div>'

    def page_of(self, name: str) -> str:
        """Return the place of a saved table on its notebook's page; without it, all numbers."""
        notebooks = {each.identifier: each.provenance["notebook"] for each in self.entries}
        return f"{notebooks[name]}.html#{name}" if name in notebooks else "numbers.html"

    def measured(self, key: Mapping[Hashable, str]) -> tuple[str, str]:
        """Return a number with its interval, and its true value; empty if this run has none."""
        table = self.table(key["table"])
        rows = table.query(key["rows"]) if len(table) else table
        if rows.empty:
            return "", ""
        row = {name: "" if pd.isna(value) else str(value) for name, value in rows.iloc[0].items()}
        ours = three_digits(row[key["value"]])
        if key["low"] and row[key["low"]]:
            ours += f" [{three_digits(row[key['low']])}, {three_digits(row[key['high']])}]"
        return ours, three_digits(row[key["true"]]) if key["true"] else ""

    def way(self) -> str:
        """Return the steps of the chain with what each loses, as boxes that lead to pages."""
        losses = self._losses()
        boxes = [
            f'<a class="step" href="{page}.html"><b>{name}</b><span>{losses.get(name, "")}</span></a>'
            for name, page in STEPS.items()
        ]
        return f'<div class="way">{"".join(boxes)}</div>'

    def _losses(self) -> dict[str, str]:
        """Return what each step finds or loses; a step whose table this run lacks has no words."""
        words = {}
        steps = self.table("accuracy-steps")
        if len(steps):
            columns = ["measurable_particles", "detected_particles"]
            sums = steps.groupby("replaced_step")[columns].sum()
            found = 100 * sums["detected_particles"] / sums["measurable_particles"]
            words["recording"] = f"{sums.loc['whole chain'].iloc[0]} particles can be measured"
            words["detection"] = f"{found['true links']:.0f} % of them are found often enough"
            words["tracking"] = f"{found['whole chain']:.0f} % of them have a track"
        backgrounds = self.table("table-5-4-background")
        if len(backgrounds):
            first = backgrounds[backgrounds["reading"] == "absolute"]
            f1 = first.assign(f1=first["f1"].astype(float)).groupby("model")["f1"].mean()
            words["background"] = f"F1 {f1.min():.2f} to {f1.max():.2f}, by model"
        pieces = self.table("tracklet-steps")
        if len(pieces):
            tracks = pieces.groupby("step", sort=False)["tracks"].sum()
            words["tracklets"] = f"{tracks.iloc[0]} pieces become {tracks.iloc[-1]} tracks"
        fits = self.table("table-5-18-regression")
        if len(fits):
            r2 = fits.loc[fits["axis"] == "z", "r2"].astype(float)
            words["regression"] = f"R2 of the depth {r2.min():.2f} to {r2.max():.2f}, by fraction"
        flights = self.table("dwell-flights")
        if len(flights):
            refused = [name for name in flights if str(name).startswith("refused")]
            gone, lost = int(flights[refused].to_numpy().sum()), int(flights["lost"].sum())
            total = int(flights["from_lance"].sum())
            words["flight"] = f"of {total} from the lance {gone} are refused, {lost} lost"
        return words

    def wall(self, thumbnails: Path) -> str:
        """Return a thumbnail for each figure and table of the works, with a filter."""
        tiles = []
        for row in self.numbers.to_dict("records"):
            dot = "." if row["kind"] == "Fig" else ""
            image = self._thumbnail(row["ids"][0], thumbnails, THUMB_PX) if row["ids"] else ""
            shown = f'<img src="{image}" alt="" loading="lazy"/>' if image else "<i></i>"
            work = "" if row["work"] == "thesis" else f", {row['work'].replace('-', ' paper of ')}"
            words = f"{row['kind']}{dot} {row['number']}{work}"
            tiles.append(
                f'<a class="tile" href="works/{row["name"]}.html">{shown}<b>{words}</b>'
                f"<span>{escape(row['topic'])}{' (not drawn here)' if not row['ids'] else ''}"
                "</span></a>"
            )
        return (
            '<input class="tiles" type="search" placeholder="filter, for example dwell or 5.1" '
            f'aria-label="filter figures and tables"/><div class="wall">{"".join(tiles)}</div>'
        )

    def _thumbnail(self, name: str, folder: Path, width: int) -> str:
        """Write a small picture of a figure and return its address; empty if there is none."""
        source = self.folder / f"{name}.png"
        if not source.is_file():
            return ""
        folder.mkdir(parents=True, exist_ok=True)
        target = folder / f"{name}-{width}.webp"
        if not target.is_file():
            with Image.open(source) as image:
                small = image.convert("RGB")
                small.thumbnail((width, 2 * width))
                small.save(target, "WEBP", quality=60, method=6)
        return f"_static/{folder.name}/{target.name}"


def _dot(row: Mapping[Hashable, str]) -> str:
    """Return the verdict on a claim as a mark that leads to the claim."""
    told = escape(f"{row['id']}: {row['verdict']}", quote=True)
    return (
        f'<a class="dot {row["verdict"].replace(" ", "-")}" href="00_claims.html#{row["id"]}" '
        f'title="{told}"><span>{row["id"]}</span></a>'
    )


def _raw(part: str) -> str:
    return part if part.startswith("#") else f"```{{raw}} html\n{part}\n```"
