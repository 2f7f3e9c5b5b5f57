"""What a recording holds, in numbers a person can check at a glance."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
import pandas as pd
from tqdm import tqdm

from kilnflight.recording.frames import LABELS, Recording

SATURATED_SHARE = 0.001  # of all pixels at the highest possible value: worth a warning
PLAUSIBLE_DEPTH_MM = (100.0, 50_000.0)


class Report(NamedTuple):
    """What a recording holds; `text` says it in words."""

    name: str
    frames: int
    rows: int
    columns: int
    bit_depth: int  # the fewest bits that hold the highest gray value
    gray_range: tuple[int, int]
    points: tuple[int, float, int]  # per frame: minimum, median, maximum
    depth_share: float  # of all pixels
    depth_range_mm: tuple[float, float] | None
    labelled_frames: int
    label_pixels: Mapping[str, int]
    warnings: tuple[str, ...]

    def text(self) -> str:
        """Return the report, one fact a line."""
        low, middle, high = self.points
        lines = [
            f"recording   {self.name}",
            f"frames      {self.frames} of {self.rows} x {self.columns} pixels",
            f"gray        {self.gray_range[0]} to {self.gray_range[1]} ({self.bit_depth} bits)",
            f"points      {low} to {high} per frame, median {middle:g}; "
            f"{100 * self.depth_share:.2f} % of the pixels",
        ]
        if self.depth_range_mm:
            nearest, farthest = self.depth_range_mm
            lines.append(f"depth       {nearest:.0f} to {farthest:.0f} mm, as captured")
        lines.append(f"labels      {self.labelled_frames} frames")
        lines += [f"            {count} px {name}" for name, count in self.label_pixels.items()]
        lines += [f"warning     {warning}" for warning in self.warnings]
        return "\n".join(lines)


def summarise(recording: Recording) -> Report:
    """Read every frame once and return what the recording holds."""
    attributes = recording.attributes
    rows: list[tuple[int, int, int, int, int, float, float]] = []
    labels, labelled = np.zeros(len(LABELS), np.int64), 0
    for t in tqdm(range(len(recording)), desc="checking", unit="frame", disable=None):
        frame = recording.frame(t)
        top, z = int(frame.gray.max()), frame.xyz[:, 2]
        depths = (float(z.min()), float(z.max())) if len(z) else (np.nan, np.nan)
        at_top = int(np.count_nonzero(frame.gray == top))
        rows.append((frame.index, int(frame.gray.min()), top, at_top, len(z), *depths))
        if frame.labels is not None:
            labelled += 1
            labels += np.bincount(frame.labels.ravel(), minlength=len(LABELS))
    names = ["index", "low", "top", "at_top", "points", "nearest", "farthest"]
    table = pd.DataFrame(rows, columns=names)
    pixels = len(table) * attributes.rows * attributes.columns
    top, points = int(table["top"].max()), table["points"]
    saturated = int(table.loc[table["top"] == top, "at_top"].sum()) / pixels
    depth = (float(table["nearest"].min()), float(table["farthest"].max()))
    known_depth = depth if points.any() else None
    empty = table.loc[points == 0, "index"].tolist()
    return Report(
        name=attributes.name,
        frames=len(table),
        rows=attributes.rows,
        columns=attributes.columns,
        bit_depth=top.bit_length(),
        gray_range=(int(table["low"].min()), top),
        points=(int(points.min()), float(points.median()), int(points.max())),
        depth_share=int(points.sum()) / pixels,
        depth_range_mm=known_depth,
        labelled_frames=labelled,
        label_pixels=dict(zip(LABELS, labels.tolist(), strict=True)) if labelled else {},
        warnings=tuple(_warnings(empty, len(table), top, saturated, known_depth)),
    )


def _warnings(
    empty: list[int], frames: int, top: int, saturated: float, depth: tuple[float, float] | None
) -> Iterator[str]:
    if empty:
        yield f"{len(empty)} of {frames} frames without points, the first is {empty[0]}"
    if top == 0:
        yield "every pixel is black"
    elif top == 2 ** top.bit_length() - 1 and saturated > SATURATED_SHARE:
        yield f"{100 * saturated:.2f} % of the pixels are saturated at {top}"
    if 0 < top < 256:
        yield f"no gray value above {top}: 8-bit frames in 16-bit files?"
    low, high = PLAUSIBLE_DEPTH_MM
    if depth and not (low <= depth[0] and depth[1] <= high):
        yield (
            f"depths of {depth[0]:g} to {depth[1]:g} mm; between {low:g} and {high:g} expected: "
            "is the unit right, is the invalid value?"
        )
