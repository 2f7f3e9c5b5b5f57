"""What a recording holds, in numbers a person can check at a glance."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd
from tqdm import tqdm

from kilnflight.recording.frames import LABELS, Recording

SATURATED_SHARE = 0.001  # of all pixels at the highest possible value: worth a warning
PLAUSIBLE_DEPTH_MM = (100.0, 50_000.0)
LEAST_WIDTH = 10  # characters before a value


def summarise(recording: Recording) -> pd.DataFrame:
    """Read every frame once; return rows of ``what`` and ``value``, both texts."""
    rows, labels = [], []
    for t in tqdm(range(len(recording)), desc="checking", unit="frame", disable=None):
        frame = recording.frame(t)
        gray, z = frame.gray, frame.xyz[:, 2]
        row = {"index": frame.index, "points": len(z), "low": gray.min(), "top": gray.max()}
        depths = {"nearest": z.min(initial=np.inf), "farthest": z.max(initial=-np.inf)}
        rows.append(row | depths | {"at_top": np.count_nonzero(gray == row["top"])})
        if frame.labels is not None:
            labels.append(np.bincount(frame.labels.ravel(), minlength=len(LABELS)))
    table, attributes = pd.DataFrame(rows), recording.attributes
    pixels = len(table) * attributes.rows * attributes.columns
    points, top, low = table["points"], int(table["top"].max()), table["low"].min()
    per_frame = f"{points.min()} to {points.max()} per frame, median {points.median():g}"
    facts = [
        ("recording", attributes.name),
        ("frames", f"{len(table)} of {attributes.rows} x {attributes.columns} pixels"),
        ("gray", f"{low} to {top} ({top.bit_length()} bits)"),
        ("points", f"{per_frame}; {100 * points.sum() / pixels:.2f} % of the pixels"),
    ]
    depth = float(table["nearest"].min()), float(table["farthest"].max())
    if points.any():
        facts.append(("depth", "{:.0f} to {:.0f} mm, as captured".format(*depth)))
        if (calibration := attributes.depth_calibration) is None:
            facts.append(("", "taken as true: no depth_calibration is stated"))
        else:
            true = calibration(depth)
            facts.append(("", f"{true[0]:.0f} and {true[1]:.0f} mm by its depth_calibration"))
    facts.append(("labels", f"{len(labels)} frames"))
    if labels:
        counts = zip(np.sum(labels, axis=0), LABELS, strict=True)
        facts += [("", f"{count} px {name}") for count, name in counts]
    saturated = table.loc[table["top"] == top, "at_top"].sum() / pixels
    empty = table.loc[points == 0, "index"].tolist()
    warnings = _warnings(empty, len(table), top, saturated, depth)
    facts += [("warning", warning) for warning in warnings]
    return pd.DataFrame(facts, columns=["what", "value"])


def aligned(summary: pd.DataFrame) -> str:
    """Return rows of ``what`` and ``value`` as text, one a line."""
    width = max(LEAST_WIDTH, summary["what"].str.len().max())
    return "\n".join(f"{what:<{width}}  {value}" for what, value in summary.to_numpy().tolist())


def _warnings(
    empty: list[int], frames: int, top: int, saturated: float, depth: tuple[float, float]
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
    if len(empty) < frames and not (low <= depth[0] and depth[1] <= high):
        yield (
            f"depths of {depth[0]:g} to {depth[1]:g} mm; between {low:g} and {high:g} expected: "
            "is the unit right, is the invalid value?"
        )
