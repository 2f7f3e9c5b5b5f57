"""Pictures of a run: detections, tracks, lengths and speeds, mean square displacement."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import fields, replace
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from kilnflight import chain
from kilnflight.film.preparation import choose, spread
from kilnflight.film.report import Tables
from kilnflight.film.settings import Options
from kilnflight.film.spreading import diffusion, followed, speeds, square_displacements
from kilnflight.publication import style
from kilnflight.recording.files import open_any
from kilnflight.recording.frames import Recording
from kilnflight.tables import TO_TRACK, order_tracks, with_pixels

PREVIEW_FRAMES = 3
PREVIEW_STEPS = (0.5, 1.0, 2.0)  # frames, and multiples of the threshold


def png(figure: Figure) -> bytes:
    """Return a figure as PNG, the same bytes for the same figure."""
    buffer = io.BytesIO()
    with style.style():
        figure.savefig(buffer, format="png", dpi=150, metadata={"Software": None})
    return buffer.getvalue()


def pictures(
    recording: Recording, tables: Tables, frames: Any
) -> Iterator[tuple[str, Figure]]:
    """Yield the names and figures of a run; the last one only if there are lags to fit.

    Of the tables, detections and tracks are drawn; ``frames`` (n,) are the numbers of
    the frames that were searched.
    """
    counts = tables["detections"]["frame"].value_counts().reindex(frames, fill_value=0)
    linked = followed(tables["tracks"])
    bars = {"color": "0.7", "edgecolor": "black"}
    figure, ((axes,),) = style.canvas(width_mm=120)
    axes.plot(frames, counts, lw=0.8)
    axes.set(xlabel="frame", ylabel="detections", ylim=(0, None))
    yield "detections", figure
    yield "tracks", plot_tracks(recording, tables["tracks"])
    figure, ((left, right),) = style.canvas(columns=2, width_mm=style.PAGE_MM)
    left.hist(linked["particle"].value_counts(), bins=30, **bars)
    left.set(xlabel="length of a track (detections)", ylabel="tracks")
    right.hist(speeds(linked), bins=40, **bars)
    right.set(xlabel="speed (px/frame)", ylabel="steps")
    yield "lengths-and-speeds", figure
    spreading = square_displacements(linked)
    if len(spreading) > 2:
        figure, ((axes,),) = style.canvas(width_mm=120)
        diffusing, error = diffusion(spreading)
        lag = spreading["lag"].to_numpy()
        mean = spreading["square_px2"].to_numpy()
        axes.plot(lag, mean, "o", ms=3, label="tracks, drift taken off")
        fitted = f"4 · {diffusing:.3g} px²/frame · lag {4 * error:+.3g} px²"
        axes.plot(lag, 4 * (diffusing * lag + error), label=fitted)
        axes.set(xlabel="lag (frames)", ylabel="mean square displacement (px²)")
        axes.legend()
        yield "mean-square-displacement", figure


def plot_tracks(source: Any, tracks: pd.DataFrame) -> Figure:
    """Return a figure of tracks over the first frame of their recording.

    ``source`` is a recording or anything that `kilnflight.open` takes; ``tracks`` has
    frame, particle and row, col or y, x in pixels.
    """
    figure, ((axes,),) = style.canvas(width_mm=style.PAGE_MM, height_mm=130)
    style.draw_frame(axes, gray := open_any(source).gray(0), 1 + gray.shape[1] // 800)
    table = with_pixels(tracks)
    rows = order_tracks(table, where := "plot_tracks: tracks")[0]
    places = TO_TRACK.check(table.assign(z=1.0), where).assign(
        particle=table["particle"]
    )
    style.draw_tracks(axes, places.iloc[rows])
    return figure


def preview(source: Any, **options: Any) -> Figure:
    """Return a figure of three frames with the detections of three thresholds.

    They are half, once and twice the threshold that a run takes; arguments as for
    `kilnflight.detect`.
    """
    first = (recording := open_any(source)).frame(0).index
    run, given, rows = choose(recording, Options(**options))
    frames = [run.start + k for k in spread(run.stop - run.start, PREVIEW_FRAMES)]
    seen = list(chain.views(run.source.recording(), frames, run.background))
    height = (
        8.0
        + style.PAGE_MM / 3 * recording.attributes.rows / recording.attributes.columns
    )
    shape = {"width_mm": style.PAGE_MM, "height_mm": 5.0 + height * len(frames)}
    figure, grid = style.canvas(len(frames), len(PREVIEW_STEPS), **shape)
    warnings = [text for what, text in rows if what == "warning"]
    figure.suptitle("\n".join(warnings), fontsize=6, color=style.COLOURS[1])
    single: Any = run.detector.detector
    for k, step in enumerate(PREVIEW_STEPS):
        threshold = step * (given.threshold or 0.0)
        finder = replace(single, **{fields(single)[0].name: threshold})
        detector: Any = replace(run.detector, detector=finder)
        for axes, (t, view) in zip(grid[:, k], seen, strict=True):
            found = detector(view, run.source.recording().attributes.roi)
            style.draw_frame(axes, recording.gray(t), 1)
            style.draw_circles(axes, found.iloc[:, 1:4].to_numpy(), style.COLOURS[1])
            title = (
                f"frame {view.number - first}, threshold {threshold:.3g}: {len(found)}"
            )
            axes.set_title(title, fontsize=6)
            axes.label_outer()
    return figure
