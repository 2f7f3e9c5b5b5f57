"""What a recording holds and what a run found, in words.

`summarise_recording` for ``kilnflight import`` and ``info``; `summary` for a run.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from tqdm import tqdm

from kilnflight.checks import printable
from kilnflight.film.spreading import followed
from kilnflight.flight import BURNT_OUT, LANDED, kept, reaching
from kilnflight.recording.store import StoredRecording
from kilnflight.scores.intervals import median_interval

Tables = Mapping[
    str, pd.DataFrame
]  # detections, and those of `kilnflight.chain.CHAIN_STEPS`


def summarise_recording(recording: StoredRecording) -> pd.DataFrame:
    """Read every frame once; return rows of ``what`` and ``value``, both texts."""
    attributes = recording.attributes
    rows = []
    recording.content()  # refused where it was changed after it was written
    for t in tqdm(range(len(recording)), desc="checking", unit="frame", disable=None):
        frame = recording.frame(t)
        gray, z, top = frame.gray, frame.xyz[:, 2], frame.gray.max()
        ends = z.min(initial=np.inf), z.max(initial=-np.inf)
        rows.append(
            (gray.min(), top, np.mean(gray == top), len(z), *ends, frame.labels is None)
        )
    low, tops, shares, points, near, far, unlabelled = map(
        np.array, zip(*rows, strict=True)
    )
    top = int(tops.max())
    ends = (near.min(), far.max())
    saturated = 100 * shares[tops == top].sum() / len(rows)
    facts = [
        ("recording", attributes.name),
        ("frames", f"{len(rows)} of {attributes.rows} x {attributes.columns} pixels"),
        *(("note", note) for note in attributes.notes),
        ("gray", f"{low.min()} to {top} ({top.bit_length()} bits)"),
        (
            "points",
            f"{points.min()} to {points.max()} per frame, median {np.median(points):g}",
        ),
        ("labels", f"of {len(rows) - unlabelled.sum()} frames"),
    ]
    if top & (top + 1) == 0 and saturated > 0.1:  # all bits of the largest are 1
        facts.append(
            ("warning", f"{saturated:.2f} % of the pixels are {top}: saturated?")
        )
    if points.any():
        how = (
            "no calibration stated"
            if attributes.depth_calibration is None
            else "as captured"
        )
        facts.append(("depth", "{:.0f} to {:.0f} mm, ".format(*ends) + how))
        if ends[0] < 100.0 or ends[1] > 50_000.0:  # mm; no kiln is so near or deep
            facts.append(
                ("warning", "depths: is the unit right, is the invalid value?")
            )
    return pd.DataFrame(facts, columns=["what", "value"])


def aligned(rows: pd.DataFrame) -> str:
    """Return rows of ``what`` and ``value`` as text, one a line."""
    width = max(10, rows["what"].str.len().max())
    return "\n".join(
        printable(f"{what:<{width}}  {value}") for what, value in rows.to_numpy()
    )


def summary(tables: Tables) -> dict[str, str]:
    """Return the results, each by what it is.

    Only accepted flights from the lance count (section 5.3.1 of the thesis). In
    brackets: 95 % interval over particles, by bootstrap; none for fewer than six.
    """
    flights = tables["flights"]
    tracks = followed(tables["tracks"])
    found = tables["detections"]
    counted = kept(flights[flights["from_lance"]])
    depth = int(found["z"].notna().sum())
    deep = (
        f", {depth} with depth, {len(tables['tracks'])} not on the wall"
        if depth
        else ""
    )
    rows = {"detections": f"{len(found)}{deep}"}
    n = tracks["particle"].nunique()
    rows["tracks"] = (
        f"{n} with {len(tracks)} detections, {len(tracks) / max(n, 1):.3g} each"
    )
    if len(flights):
        rows["flights from the lance"] = (
            f"{len(counted)} of {len(flights)} trajectories"
        )
    ended = counted["ending"].isin(
        [LANDED, BURNT_OUT]
    )  # of others the end was not seen
    dwell = counted.loc[ended, "dwell_s"]
    if len(dwell):
        median, *ends = median_interval(dwell, np.random.default_rng(0))[:3]
        rows["dwell time, median"] = (
            f"{median:.3f} s {np.round(ends, 3) if len(dwell) > 5 else ''}"
        )
    for name, values in {
        "refused": flights["refused"],
        **counted[["ending", "ignition"]],
    }.items():
        rows |= {
            f"{name}: {why}": f"{n}" for why, n in values.value_counts().items() if why
        }
    for _, metre in reaching(tables["slices"], len(counted)).iterrows():
        value = (
            f"median {metre['median_m_s']:.1f} m/s, {100 * metre['share']:.0f} % of "
            "the flights"
        )
        rows[f"velocity in the metre up to {metre['slice_m']:g} m"] = value
    return rows
