"""The page that `kilnflight run` ends with: one HTML file that needs no network."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Callable
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from kilnflight import __version__
from kilnflight.flight import remaining
from kilnflight.outcome import Outcome, summary
from kilnflight.project import style
from kilnflight.project.cache import clear_parts, locked, parquet, save
from kilnflight.recording.frames import PictureRecording
from kilnflight.scores.flights import ignition_histogram
from kilnflight.tracklets import tracked

DPI = 150
BIN_S = 0.1  # sec. 5.3.2
STYLE = """
body { font: 16px/1.5 sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; }
table { border-collapse: collapse; }
th, td { text-align: left; padding: 0.15rem 1rem 0.15rem 0; border-bottom: 1px solid #ccc; }
figure { margin: 2rem 0; } img { max-width: 100%; } figcaption { font-size: 0.9rem; }
"""


def page(found: Outcome, recording: PictureRecording) -> str:
    """Return the report of a recording as one self-contained HTML page."""
    name = html.escape(found.name)
    notes = "".join(f"<li>{html.escape(note)}</li>" for note in found.notes)
    rows = "".join(
        f"<tr><th>{html.escape(what)}</th><td>{html.escape(value)}</td></tr>"
        for what, value in summary(found).to_numpy().tolist()
    )
    figures = "".join(_figure(draw(found, recording), caption) for draw, caption in _wanted(found))
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f"<title>{name}</title><style>{STYLE}</style></head><body><h1>{name}</h1>"
        + (f"<h2>To know</h2><ul>{notes}</ul>" if notes else "")
        + f"<h2>Summary</h2><table>{rows}</table>"
        + "<p>In brackets: 95 % intervals over particles; none of fewer than six.</p>"
        + f"<h2>Figures</h2>{figures}<p>kilnflight {__version__}</p></body></html>\n"
    )


def publish(found: Outcome, recording: PictureRecording, folder: Path) -> Path:
    """Write the tables, the summary and the report; return the report.

    Each file is there whole or not at all; what ``parts`` holds lets a run go on.

    Raises
    ------
    InputError
        If a file cannot be written, as on a full disk.
    """
    folder.mkdir(parents=True, exist_ok=True)
    names = ("detections", "tracks", "trajectories", "flights", "slices")
    contents = {f"{name}.parquet": parquet(getattr(found, name)) for name in names}
    contents["summary.csv"] = summary(found).to_csv(index=False).encode()
    contents["report.html"] = page(found, recording).encode()
    with locked(folder):
        for name, content in contents.items():
            clear_parts(folder / name)
            save(folder / name, content)
    return folder / "report.html"


Drawing = Callable[[Outcome, PictureRecording], Figure]


def _wanted(found: Outcome) -> list[tuple[Drawing, str]]:
    """Return what can be drawn, each with its caption."""
    drawn: list[tuple[Drawing, str]] = [
        (tracks_figure, "Tracks after post-processing over the first frame (dark parts lifted).")
    ]
    counted = found.counted
    if len(counted):
        drawn.append((dwell_figure, "Dwell times of flights from the lance, by their ending."))
    if len(found.slices):
        caption = "Velocity towards the camera in each metre from the lance: median, and the "
        caption += "middle half of the flights; below, the share of flights that get as far."
        drawn.append((velocity_figure, caption))
    if len(counted):
        seen = int(counted["ignition_s"].notna().sum())
        caption = f"Ignition after leaving the lance, in bins of {BIN_S:g} s: shares of all "
        caption += f"{len(counted)} flights; in {seen} of them ignition was seen."
        drawn.append((ignition_figure, caption))
    return drawn


def _figure(picture: Figure, caption: str) -> str:
    buffer = io.BytesIO()
    with style.style():
        picture.savefig(buffer, format="png", dpi=DPI, metadata={"Software": None})
    plt.close(picture)
    data = base64.b64encode(buffer.getvalue()).decode()
    said = html.escape(caption)
    return (
        f'<figure><img alt="{said}" src="data:image/png;base64,{data}"/>'
        f"<figcaption>{said}</figcaption></figure>"
    )


def tracks_figure(found: Outcome, recording: PictureRecording) -> Figure:
    """Draw all tracks over the first frame."""
    picture, axes = style.canvas(width_mm=style.PAGE_MM, height_mm=130)
    style.frame(axes[0, 0], recording.gray(0))
    style.tracks(axes[0, 0], tracked(found.tracks))
    return picture


def dwell_figure(found: Outcome, _: PictureRecording) -> Figure:
    """Draw the dwell times, stacked by ending."""
    counted = found.counted
    edges = np.arange(0.0, counted["dwell_s"].max() + 2 * BIN_S / 2, BIN_S / 2)
    picture, axes = style.canvas(width_mm=style.PAGE_MM * 2 / 3)
    low = np.zeros(len(edges) - 1)
    for k, (ending, some) in enumerate(counted.groupby("ending")):
        number = np.histogram(some["dwell_s"], edges)[0]
        look = {"color": style.COLOURS[k + 1], "hatch": style.HATCHES[k]}
        axes[0, 0].bar(edges[:-1], number, BIN_S / 2, low, align="edge", label=str(ending), **look)
        low += number
    axes[0, 0].set(xlabel="dwell time (s)", ylabel="flights")
    axes[0, 0].legend()
    return picture


def velocity_figure(found: Outcome, _: PictureRecording) -> Figure:
    """Draw median and middle half of the velocities, and the remaining share."""
    picture, axes = style.canvas(2, width_mm=style.PAGE_MM * 2 / 3, height_mm=90, sharex=True)
    groups = found.slices.groupby("slice_m")["velocity_m_s"]
    middle, place = groups.median(), np.array(list(groups.groups), dtype=float)
    reach = np.abs(np.stack([groups.quantile(0.25) - middle, groups.quantile(0.75) - middle]))
    axes[0, 0].errorbar(place, middle, yerr=reach, fmt="o-", color="black", capsize=2)
    share = remaining(found.slices, len(found.counted))
    axes[1, 0].bar(share["slice_m"], 100 * share["share"], 0.6, color="0.7", edgecolor="black")
    axes[0, 0].set(ylabel="velocity (m/s)")
    axes[1, 0].set(ylabel="flights (%)", xlabel="distance from the lance, end of slice (m)")
    return picture


def ignition_figure(found: Outcome, _: PictureRecording) -> Figure:
    """Draw when flights ignite, as shares of all of them."""
    bins = ignition_histogram(found.counted["ignition_s"].to_numpy(np.float64), BIN_S)
    picture, axes = style.canvas(width_mm=style.PAGE_MM * 2 / 3)
    look = {"align": "edge", "color": "0.7", "edgecolor": "black"}
    axes[0, 0].bar(bins["from_s"], bins["percent"], BIN_S, **look)
    label = "ignition after leaving the lance (s); the last bin holds all later"
    axes[0, 0].set(xlabel=label, ylabel="flights (%)")
    return picture
