"""What a recording holds and what a run found, in words.

`summarise_recording` for ``kilnflight import`` and ``info``; `summary` for a run.
"""

from collections.abc import Iterable

import numpy as np
from pandas import DataFrame
from tqdm import tqdm

from kilnflight.arrays import Facts, Integers, Tables
from kilnflight.checks import printable
from kilnflight.film.spreading import followed, speeds
from kilnflight.flight import BURNT_OUT, LANDED, kept, reaching
from kilnflight.recording.files import FileRecording
from kilnflight.recording.frames import LABELS, Attributes, Frame
from kilnflight.recording.store import StoredRecording
from kilnflight.scores.intervals import median_interval

PICTURES = ("detections", "tracks", "lengths-and-speeds", "mean-square-displacement")
Rows = list[tuple[str, str]]  # a name, "note" or "warning", and a text
LEAST_MM = 100.0  # no kiln is so near
MOST_MM = 50_000.0  # nor so deep


class Printed(Rows):
    """Rows that are printed as soon as they are known."""

    def append(self, row: tuple[str, str]) -> None:
        """Add and print a row."""
        super().append(row)
        what, value = row
        with tqdm.external_write_mode():
            print(printable(f"{what:<15}  {value}"), flush=True)

    def extend(self, rows: Iterable[tuple[str, str]]) -> None:
        """Add and print rows."""
        for row in rows:
            self.append(row)


def _facts(frame: Frame) -> Facts:
    """Return what a frame holds.

    ``saturated`` is the share of pixels at its maximum, ``classes`` the number of
    pixels of each class of Table 5.1; 0 without labels.
    """
    z = frame.xyz[:, 2]
    brightest = frame.gray.max()
    labels = np.empty(0, np.uint8)
    if frame.labels is not None:
        labels = frame.labels.ravel()
    return {
        "darkest": int(frame.gray.min()),
        "brightest": int(brightest),
        "saturated": np.mean(frame.gray == brightest),
        "points": len(z),
        "nearest_mm": z.min(initial=np.inf),
        "farthest_mm": z.max(initial=-np.inf),
        "labelled": labels.size > 0,
        "classes": np.bincount(labels, minlength=len(LABELS)),
    }


def _labelled(attributes: Attributes, pixels: Integers) -> Rows:
    """Return what labels show, and what decides which of them count."""
    shares = 100 * pixels / pixels.sum()
    told = [f"{name} {share:.2g} %" for name, share in zip(LABELS, shares, strict=True)]
    return [
        ("classes", ", ".join(told)),
        ("roi", f"{attributes.roi or 'none: particles count everywhere'}"),
        ("flame_roi", f"{attributes.flame_roi or 'none: its flame is searched, too'}"),
    ]


def summarise_recording(recording: StoredRecording | FileRecording) -> Rows:
    """Read every frame once; print and return what it holds."""
    frames = tqdm(range(len(recording)), desc="checking", unit="frame", disable=None)
    each = DataFrame([_facts(recording.frame(t)) for t in frames])
    attributes = recording.attributes
    top = each["brightest"].max()
    points = each["points"]
    told = f"{points.min()} to {points.max()} per frame, median {points.median():g}"
    rows = Printed()
    rows.extend(
        [
            ("recording", attributes.name),
            (
                "frames",
                f"{len(each)} of {attributes.rows} x {attributes.columns} pixels",
            ),
            *(("note", note) for note in attributes.notes),
            (
                "gray",
                f"{each['darkest'].min()} to {top} ({int(top).bit_length()} bits)",
            ),
            *units(attributes),
            ("points", told),
            ("labels", f"of {each['labelled'].sum()} frames"),
        ]
    )
    if each["labelled"].any():
        rows.extend(_labelled(attributes, np.sum(each["classes"].to_list(), axis=0)))
    saturated = 100 * each["saturated"][each["brightest"] == top].sum() / len(each)
    if top & (top + 1) == 0 and saturated > 0.1:  # all bits of the largest are 1
        rows.append(
            ("warning", f"{saturated:.2f} % of the pixels are {top}: saturated?")
        )
    if points.any():
        how = "as captured"
        if attributes.depth_calibration is None:
            how = "no calibration stated"
        near = each["nearest_mm"].min()
        far = each["farthest_mm"].max()
        rows.append(("depth", f"{near:.0f} to {far:.0f} mm, {how}"))
        if near < LEAST_MM or far > MOST_MM:
            rows.append(
                (
                    "warning",
                    "depths: is the unit mm, and is the invalid value left out?",
                )
            )
    return rows


def units(attributes: Attributes) -> Rows:
    """Return frame rate and scale, where they are known."""
    rows = []
    if attributes.timed:
        rows.append(("frame rate", f"{attributes.frame_rate_hz:g} Hz"))
    if attributes.um_per_px:
        rows.append(("scale", f"{attributes.um_per_px:g} um/px"))
    return rows


def speed(tracks: DataFrame, attributes: Attributes) -> Rows:
    """Return the median speed, also in um/s where rate and scale are known."""
    steps = speeds(followed(tracks))
    if not len(steps):
        return []
    told = f"{np.median(steps):.3g} px/frame"
    if attributes.timed and attributes.um_per_px:
        per_px = attributes.um_per_px * attributes.frame_rate_hz
        # 12300, not 1.23e+04
        told += f", {float(f'{per_px * np.median(steps):.3g}'):g} um/s"
    return [("speed, median", told)]


def summary(tables: Tables) -> dict[str, str]:
    """Return the results, each by what it is.

    Only accepted flights from the lance count (section 5.3.1 of the thesis). In
    brackets: 95 % interval over particles, by bootstrap; none for fewer than six.
    """
    flights = tables["flights"]
    counted = kept(flights[flights["from_lance"]])
    detections = tables["detections"]
    tracks = followed(tables["tracks"])
    told = f"{len(detections)}"
    depth = detections["z"].notna().sum()
    if depth:
        told += f", {depth} with depth, {len(tables['tracks'])} not on the wall"
    n = tracks["particle"].nunique()
    each = f"{len(tracks) / max(n, 1):.3g} each"
    rows = {"detections": told, "tracks": f"{n} with {len(tracks)} detections, {each}"}
    if len(flights):
        rows["flights from the lance"] = (
            f"{len(counted)} of {len(flights)} trajectories"
        )
    # the end of other flights was not seen
    ended = counted["ending"].isin([LANDED, BURNT_OUT])
    dwell_s = counted.loc[ended, "dwell_s"]
    if len(dwell_s):
        median, low, high = median_interval(dwell_s, np.random.default_rng(0))[:3]
        told = f"{median:.3f} s "
        if len(dwell_s) > 5:
            told += f"{np.round([low, high], 3)}"
        rows["dwell time, median"] = told
    rows |= _counts(flights, "refused")
    rows |= _counts(counted, "ending")
    rows |= _counts(counted, "ignition")
    for _, metre in reaching(tables["slices"], len(counted)).iterrows():
        share = f"{100 * metre['share']:.0f} % of the flights"
        told = f"median {metre['median_m_s']:.1f} m/s, {share}"
        rows[f"velocity in the metre up to {metre['slice_m']:g} m"] = told
    return rows


def _counts(flights: DataFrame, what: str) -> dict[str, str]:
    """Return how often each reason in a column, not empty, occurs."""
    counts = flights[what].value_counts()
    return {f"{what}: {why}": f"{n}" for why, n in counts.items() if why}
