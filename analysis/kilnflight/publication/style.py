"""The look of all figures: one style, print size, readable without colours."""

import re
import tomllib
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import Circle
from pandas import DataFrame

from kilnflight.arrays import Anything, Array

COLUMN_MM = 88.0  # one text column of a two-column journal
PAGE_MM = 180.0  # both columns
MARK_MM = 3.0  # height of the strip below a picture that holds the word of `mark`
MM_PER_INCH = 25.4

SHEET = Path(__file__).with_name("kilnflight.mplstyle")
STYLE: Any = matplotlib.rc_params_from_file(SHEET, use_default_template=False)
style = partial(matplotlib.rc_context, STYLE)  # draws in the style within a block
CYCLE = STYLE["axes.prop_cycle"].by_key()
COLOURS = CYCLE["color"]
LINES = CYCLE["linestyle"]

# looks.toml has what figures share, such as the look of what a work prints.
LOOKS = tomllib.loads(Path(__file__).with_name("looks.toml").read_text("utf-8"))
MARKERS = LOOKS["markers"]
HATCHES = LOOKS["hatches"]
PUBLISHED = LOOKS["published"]
PUBLISHED_BAR = LOOKS["published_bar"]
BOXES = LOOKS["boxes"]


def use_style() -> None:
    """Draw in the project's style from here on (first cell of a notebook)."""
    matplotlib.rcParams.update(STYLE)


def canvas(
    rows: int = 1,
    columns: int = 1,
    *,
    width_mm: float = COLUMN_MM,
    height_mm: float = 60.0,
    **arguments: Any,
) -> tuple[Figure, np.ndarray]:
    """Return a figure and its axes, an array (rows, columns), in print size.

    Parameters
    ----------
    rows, columns
        Grid of axes.
    width_mm, height_mm
        Size on paper; `COLUMN_MM` and `PAGE_MM` are the usual widths.
    **arguments
        Arguments of `matplotlib.pyplot.subplots` (``sharex``, ``sharey`` ...).
    """
    with style():
        size = (width_mm / MM_PER_INCH, height_mm / MM_PER_INCH)
        picture, grid = plt.subplots(
            rows,
            columns,
            figsize=size,
            squeeze=False,
            layout="constrained",
            **arguments,
        )
    plt.close(picture)  # a page shows it where it is saved, and only there
    return picture, grid


def mark(picture: Figure, word: str) -> Figure:
    """Write the kind of data below a picture at the right; return the picture.

    ``word`` is such as "simulated"; if empty, nothing is written. With a constrained
    layout, as `canvas` sets it, axes and legends stay above that strip of `MARK_MM`.
    """
    strip = MARK_MM / MM_PER_INCH / picture.get_figheight()
    engine = picture.get_layout_engine()
    if word and isinstance(engine, ConstrainedLayoutEngine):
        engine.set(rect=(0.0, strip, 1.0, 1.0 - strip))
        points = MARK_MM / MM_PER_INCH * 72
        for legend in picture.legends:
            if getattr(legend, "_outside_loc", None) == "lower":  # it keeps its place
                legend.borderaxespad += points / legend.prop.get_size_in_points()
    picture.text(0.99, 0.2 * strip, word, **LOOKS["kind"])
    return picture


def draw_frame(axes: Axes, gray: Anything, step: int = 2) -> None:
    """Draw the root of a camera frame's grey values, axes in px of the frame.

    The root makes dark parts visible.

    Parameters
    ----------
    axes
        Axes to draw on.
    gray
        (rows, cols) grey values, not negative.
    step
        Blocks of ``step`` x ``step`` px are averaged, since a page shows no more;
        incomplete blocks at the right and at the bottom are cut off.
    """
    rows, cols = (length - length % step for length in gray.shape)
    whole = gray[:rows, :cols].astype(float)
    blocks = whole.reshape(rows // step, step, cols // step, step)
    extent = (-0.5, cols - 0.5, rows - 0.5, -0.5)
    axes.imshow(np.sqrt(blocks.mean(axis=(1, 3))), cmap="gray", extent=extent)
    axes.set(xlabel="column (px)", ylabel="row (px)")


def draw_circles(axes: Axes, spots: Array, color: str) -> None:
    """Draw spots (n, 3) with row, col and radius in px as circles of that radius."""
    patches = [Circle((col, row), radius) for row, col, radius in spots]
    axes.add_collection(
        PatchCollection(patches, facecolor="none", edgecolor=color, lw=0.7)
    )


def draw_tracks(axes: Axes, table: DataFrame, colour: str = "") -> None:
    """Draw tracks as lines of one colour, or each in another one.

    ``table`` has ``particle``, ``frame``, ``row`` and ``col`` (px); NaN breaks a line.
    """
    tracks = table.sort_values(["particle", "frame"]).groupby("particle")
    visible = COLOURS[1:]  # black is not seen on a frame
    markers = MARKERS
    if len(tracks) >= 200:  # they would hide the frame
        markers = [""]
    for k, (_, track) in enumerate(tracks):
        axes.plot(
            track["col"],
            track["row"],
            ls="-",
            lw=0.6,
            ms=1.6,
            color=colour or visible[k % len(visible)],
            marker=markers[k % len(markers)],
        )


def draw_boxes(axes: Axes, summary: DataFrame) -> None:
    """Draw box plots from their quartiles and whiskers, without outliers.

    Above each whisker stands q75 - q25, since flat boxes look like lines.

    Parameters
    ----------
    axes
        Axes to draw on; box i is at x = i.
    summary
        One row per box, columns ``whisker_low``, ``q25``, ``median``, ``q75``,
        ``whisker_high``.
    """
    names = LOOKS["summary"]
    table = summary[[*names]].rename(columns=names)
    boxes: Any = table.to_dict("records")
    axes.bxp(
        boxes,
        positions=np.arange(len(boxes)),
        widths=0.55,
        showfliers=False,
        boxprops=LOOKS["thin_box"],
        **BOXES,
    )
    axes.margins(y=0.12)
    for i, box in enumerate(boxes):
        height = f"{box['q3'] - box['q1']:.2g}"
        axes.text(i, box["whishi"], height, **LOOKS["height"])


def words(name: str) -> str:
    """Return a code name as words for a picture.

    Examples
    --------
    >>> words("RunningGaussian"), words("dwell_s")
    ('running Gaussian', 'dwell (s)')
    """
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])|_", " ", re.sub(r"_s\b", " (s)", name))
    return spaced.lower().replace("gaussian", "Gaussian")
