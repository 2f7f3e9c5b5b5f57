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
    rows, labels = [], []
    for t in tqdm(range(len(recording)), desc="checking", unit="frame", disable=None):
        frame = recording.frame(t)
        gray, z = frame.gray, frame.xyz[:, 2]
        row = {"index": frame.index, "points": len(z), "low": gray.min(), "top": gray.max()}
        depths = {"nearest": z.min(initial=np.inf), "farthest": z.max(initial=-np.inf)}
        rows.append(row | depths | {"at_top": np.count_nonzero(gray == row["top"])})
        if frame.labels is not None:
            labels.append(np.bincount(frame.labels.ravel(), minlength=len(LABELS)))
    table = pd.DataFrame(rows)
    pixels = len(table) * attributes.rows * attributes.columns
    top, points = int(table["top"].max()), table["points"]
    saturated = int(table.loc[table["top"] == top, "at_top"].sum()) / pixels
    nearest, farthest = float(table["nearest"].min()), float(table["farthest"].max())
    depth = (nearest, farthest) if points.any() else None
    counts = dict(zip(LABELS, np.sum(labels, axis=0).tolist(), strict=True)) if labels else {}
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
        depth_range_mm=depth,
        labelled_frames=len(labels),
        label_pixels=counts,
        warnings=tuple(_warnings(empty, len(table), top, saturated, depth)),
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
