"""Pictures of a run: detections, tracks, lengths, speeds, square displacements."""

import io
from collections.abc import Iterator
from dataclasses import fields, replace
from typing import Any

from matplotlib.figure import Figure
from pandas import DataFrame

from kilnflight import chain
from kilnflight.film.preparation import STEPS, choose
from kilnflight.film.prepared import spread
from kilnflight.film.report import Rows, Tables
from kilnflight.film.settings import Options
from kilnflight.film.spreading import (
    LEAST_PX2,
    fit_spreading,
    followed,
    speeds,
    square_displacements,
)
from kilnflight.publication import style
from kilnflight.recording.files import open_any
from kilnflight.recording.frames import Recording
from kilnflight.tables import SQUARES, in_tracks

PREVIEW_FRAMES = 3
PREVIEW_STEPS = (*STEPS, 8.0)  # multiples of the threshold
BARS = {"color": "0.7", "edgecolor": "black"}  # histograms


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

    Parameters
    ----------
    recording
        Recording whose first frame is shown.
    tables
        Detections and tracks are drawn.
    frames
        Numbers (n,) of the frames that were searched.
    """
    linked = followed(tables["tracks"])
    counts = tables["detections"]["frame"].value_counts()
    figure, ((axes,),) = style.canvas(width_mm=120)
    axes.plot(frames, counts.reindex(frames, fill_value=0), lw=0.8)
    axes.set(xlabel="frame", ylabel="detections", ylim=(0, None))
    yield "detections", figure
    yield "tracks", plot_tracks(recording, tables["tracks"])
    figure, ((left, right),) = style.canvas(columns=2, width_mm=style.PAGE_MM)
    left.hist(linked["particle"].value_counts(), bins=30, **BARS)
    left.set(xlabel="length of a track (detections)", ylabel="tracks")
    # steps that differ by rounding alone make no bins
    right.hist(speeds(linked).round(6), bins=40, **BARS)
    right.set(xlabel="speed (px/frame)", ylabel="steps")
    yield "lengths-and-speeds", figure
    spreading = square_displacements(linked)
    if len(spreading) > 2 and spreading["square_px2"].max() > LEAST_PX2:
        count = linked["particle"].nunique()
        yield "mean-square-displacement", _spreading(spreading, count)


def _spreading(displacements: DataFrame, tracks: int) -> Figure:
    """Return a figure of mean square displacements with their fit."""
    figure, ((axes,),) = style.canvas(width_mm=120)
    lag, square, error = displacements[SQUARES.names].to_numpy(float).T
    fit = fit_spreading(displacements)
    told = f"{tracks} track(s), exponent {fit.exponent:.2f}".replace("nan", "unknown")
    axes.errorbar(lag, square, error, fmt="o", ms=3, label=told)
    if abs(fit.exponent - 1) > 0.5:  # halfway to 2, that of flight
        axes.set_title("not diffusive: the exponent is not near 1")
    else:
        told = f"D = {fit.diffusion:.3g} ± {fit.diffusion_error:.2g} px²/frame"
        axes.plot(lag, 4 * (fit.diffusion * lag + fit.position_error_px2), label=told)
    axes.set(xlabel="lag (frames)", ylabel="mean square displacement (px²)")
    axes.legend(loc="upper left")
    return figure


def plot_tracks(source: Any, tracks: DataFrame) -> Figure:
    """Draw tracks over the first frame of their recording.

    Parameters
    ----------
    source
        A recording, or anything that `kilnflight.open` takes.
    tracks
        Columns frame, particle and row, col or y, x (px).

    Returns
    -------
    matplotlib.figure.Figure

    Examples
    --------
    >>> import kilnflight
    >>> film = kilnflight.sample_film()
    >>> figure = kilnflight.plot_tracks(film.frames, film.truth)
    >>> len(figure.axes[0].lines)
    133
    """
    gray = open_any(source).gray(0)
    figure, ((axes,),) = style.canvas(width_mm=style.PAGE_MM, height_mm=130)
    style.draw_frame(axes, gray, 1 + gray.shape[1] // 800)
    style.draw_tracks(axes, in_tracks(tracks, "plot_tracks: tracks"))
    return figure


def preview(source: Any, **options: Any) -> Figure:
    """Draw three frames with the detections of five thresholds.

    The thresholds are half, once, twice, four and eight times the one that a run takes.

    Parameters
    ----------
    source
        A recording, or anything that `kilnflight.open` takes.
    **options
        Those of `Options`, as for `kilnflight.detect`.

    Returns
    -------
    matplotlib.figure.Figure

    Examples
    --------
    >>> import kilnflight
    >>> figure = kilnflight.preview(kilnflight.sample_film().frames, threshold=500)
    >>> len(figure.axes)
    15
    """
    recording = open_any(source)
    first = recording.frame(0).index
    rows: Rows = []
    run = choose(recording, Options(**options), rows)
    seen = run.source.recording()
    frames = [run.frames[k] for k in spread(len(run.frames), PREVIEW_FRAMES)]
    views = list(chain.views(seen, frames, run.background))
    attributes = recording.attributes
    height_mm = 8.0 + style.PAGE_MM / 3 * attributes.rows / attributes.columns
    figure, grid = style.canvas(
        rows=len(PREVIEW_STEPS),
        columns=len(frames),
        width_mm=style.PAGE_MM,
        height_mm=5.0 + height_mm * len(PREVIEW_STEPS),
    )
    doubts = "\n".join(text for what, text in rows if what == "warning")
    figure.suptitle(doubts, fontsize=7, color=style.COLOURS[1], wrap=True)
    single: Any = run.detector.detector
    # The first parameter of DoG and Otsu is their threshold.
    name = fields(single)[0].name
    for k, step in enumerate(PREVIEW_STEPS):
        threshold = step * getattr(single, name)
        changed = replace(single, **{name: threshold})
        detector = replace(run.detector, detector=changed)
        for axes, (t, view) in zip(grid[k], views, strict=True):
            found = detector(view, seen.attributes.roi)
            style.draw_frame(axes, recording.gray(t), 1)
            style.draw_circles(axes, found.iloc[:, 1:4].to_numpy(), style.COLOURS[1])
            title = f"frame {view.number - first}, threshold {threshold:.3g}"
            axes.set_title(f"{title}: {len(found)}", fontsize=7)
            axes.label_outer()
    return figure
