"""What a recording holds, in numbers a person can check at a glance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from tqdm import tqdm

from kilnflight.recording.frames import LABELS, Recording

SATURATED_SHARE = 0.001  # of all pixels at the highest possible value: worth a warning
PLAUSIBLE_DEPTH_MM = (100.0, 50_000.0)


@dataclass(frozen=True)
class Report:
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
    points: list[int] = []
    lows: list[int] = []
    highs: list[tuple[int, int]] = []  # highest value, and how many pixels have it
    depths: list[tuple[float, float]] = []
    labels = np.zeros(len(LABELS), np.int64)
    empty: list[int] = []
    labelled = 0
    for t in tqdm(range(len(recording)), desc="checking", unit="frame", disable=None):
        frame = recording.frame(t)
        top = int(frame.gray.max())
        lows.append(int(frame.gray.min()))
        highs.append((top, int(np.count_nonzero(frame.gray == top))))
        points.append(len(frame.xyz))
        if points[-1]:
            depths.append((float(frame.xyz[:, 2].min()), float(frame.xyz[:, 2].max())))
        else:
            empty.append(frame.index)
        if frame.labels is not None:
            labelled += 1
            labels += np.bincount(frame.labels.ravel(), minlength=len(LABELS))
    pixels = len(points) * attributes.rows * attributes.columns
    top = max(value for value, _ in highs)
    saturated = sum(count for value, count in highs if value == top) / pixels
    depth = (min(d[0] for d in depths), max(d[1] for d in depths)) if depths else None
    return Report(
        name=attributes.name,
        frames=len(points),
        rows=attributes.rows,
        columns=attributes.columns,
        bit_depth=top.bit_length(),
        gray_range=(min(lows), top),
        points=(min(points), float(np.median(points)), max(points)),
        depth_share=sum(points) / pixels,
        depth_range_mm=depth,
        labelled_frames=labelled,
        label_pixels=dict(zip(LABELS, labels.tolist(), strict=True)) if labelled else {},
        warnings=tuple(_warnings(empty, len(points), top, saturated, depth)),
    )


def _warnings(
    empty: list[int], frames: int, top: int, saturated: float, depth: tuple[float, float] | None
) -> list[str]:
    found = []
    if empty:
        found.append(f"{len(empty)} of {frames} frames without points, the first is {empty[0]}")
    if top == 0:
        found.append("every pixel is black")
    elif top == 2 ** top.bit_length() - 1 and saturated > SATURATED_SHARE:
        found.append(f"{100 * saturated:.2f} % of the pixels are saturated at {top}")
    if top and top < 256:
        found.append(f"no gray value above {top}: 8-bit frames in 16-bit files?")
    low, high = PLAUSIBLE_DEPTH_MM
    if depth and not (low <= depth[0] and depth[1] <= high):
        found.append(
            f"depths of {depth[0]:g} to {depth[1]:g} mm; between {low:g} and {high:g} expected: "
            "is the unit right, is the invalid value?"
        )
    return found
