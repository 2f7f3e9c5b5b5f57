"""What a recording holds, in numbers: for `kilnflight import` and `info`."""

from __future__ import annotations

import numpy as np
import pandas as pd
from tqdm import tqdm

from kilnflight.recording.frames import Recording

PLAUSIBLE_DEPTH_MM = 100.0, 50_000.0


def summarise_recording(recording: Recording) -> pd.DataFrame:
    """Read every frame once; return rows of ``what`` and ``value``, both texts."""
    rows, attributes = [], recording.attributes
    for t in tqdm(range(len(recording)), desc="checking", unit="frame", disable=None):
        frame = recording.frame(t)
        gray, z, top = frame.gray, frame.xyz[:, 2], frame.gray.max()
        ends = z.min(initial=np.inf), z.max(initial=-np.inf)
        rows.append(
            (gray.min(), top, np.mean(gray == top), len(z), *ends, frame.labels is not None)
        )
    low, tops, shares, points, near, far, labelled = map(np.array, zip(*rows, strict=True))
    top, ends = int(tops.max()), (near.min(), far.max())
    saturated = shares[tops == top].sum() / len(rows)
    facts = [
        ("recording", attributes.name),
        ("frames", f"{len(rows)} of {attributes.rows} x {attributes.columns} pixels"),
        *(("", note) for note in attributes.notes),
        ("gray", f"{low.min()} to {top} ({top.bit_length()} bits)"),
    ]
    if top & (top + 1) == 0 and saturated > 0.001:  # all bits of the largest are 1
        facts.append(("warning", f"{100 * saturated:.2f} % of the pixels are {top}: saturated?"))
    if points.any():
        median = f"{points.min()} to {points.max()} per frame, median {np.median(points):g}"
        true = "taken as true: no depth_calibration is stated"
        if attributes.depth_calibration is not None:
            calibrated = attributes.depth_calibration(ends)
            true = "{:.0f} and {:.0f} mm by its depth_calibration".format(*calibrated)
        depth = "{:.0f} to {:.0f} mm, as captured".format(*ends)
        facts += [("points", median), ("depth", depth), ("", true)]
        if not points.all():
            facts.append(("warning", f"{sum(points == 0)} frames without points"))
        if ends[0] < PLAUSIBLE_DEPTH_MM[0] or ends[1] > PLAUSIBLE_DEPTH_MM[1]:
            facts.append(("warning", "depths: is the unit right, is the invalid value?"))
    if labelled.any():
        facts.append(("labels", f"of {labelled.sum()} frames"))
    return pd.DataFrame(facts, columns=["what", "value"])


def aligned(rows: pd.DataFrame) -> str:
    """Return rows of ``what`` and ``value`` as text, one a line."""
    width = max(10, rows["what"].str.len().max())
    return "\n".join(f"{what:<{width}}  {value}" for what, value in rows.to_numpy().tolist())
