"""Report of a run: tables, notes, a summary and a page.

`collect` -> `doubts`, `summary` -> `page`
"""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Iterable, Iterator
from string import Template
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.figure import Figure

from kilnflight import __version__
from kilnflight.flight import LOST, kept, reaching
from kilnflight.ignition import BEFORE, SEEN, TOO_FEW
from kilnflight.kiln import KILN_STEPS, KilnRun
from kilnflight.project import style
from kilnflight.recording.frames import Recording
from kilnflight.regression import FITTED, Regression
from kilnflight.scores.flights import ignition_histogram
from kilnflight.scores.intervals import Interval, median_interval, share
from kilnflight.tracklets import tracked

SEED = 0  # of the bootstrap
BIN_S = 0.1  # sec. 5.3.2
NAMED = 10  # refused flights of a reason that are named; the table of flights has all
PAGE = Template("""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>$name</title><style>
body { font: 16px/1.5 sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; }
table { border-collapse: collapse; }
th, td { text-align: left; padding: 0.15rem 1rem 0.15rem 0; border-bottom: 1px solid #ccc; }
figure { margin: 2rem 0; } img { max-width: 100%; } figcaption { font-size: 0.9rem; }
</style></head><body><h1>$name</h1>$notes
<h2>Summary</h2><table>$rows</table>
<p>In brackets: 95 % intervals over particles; none of fewer than six.</p>
<h2>Figures</h2>$figures
<p>kilnflight $version</p></body></html>
""")

Row = tuple[str, str]  # what and value
Captioned = tuple[Figure, str]


class Results(NamedTuple):
    """All tables of a recording, with notes for the reader."""

    name: str
    frames: int
    detections: pd.DataFrame
    tracks: pd.DataFrame
    trajectories: pd.DataFrame
    flights: pd.DataFrame
    slices: pd.DataFrame
    notes: tuple[str, ...] = ()
    settings: tuple[Row, ...] = ()

    @property
    def counted(self) -> pd.DataFrame:
        """Return the flights from the lance that can be: they alone count.

        Section 5.3.1 of the thesis, and `kilnflight.flight.Plausible`.
        """
        return kept(self.flights[self.flights["from_lance"]])


def collect(
    prepared: KilnRun, notes: tuple[str, ...] = (), settings: tuple[Row, ...] = ()
) -> Results:
    """Return the tables of a recording, with more notes.

    Missing tables are made.
    """
    name, frames = prepared.detection.source.name, len(prepared.frames)
    detections = prepared.detection.detections()
    tracks, trajectories, flights, slices = (prepared.table(step)() for step in KILN_STEPS)
    results = Results(name, frames, detections, tracks, trajectories, flights, slices)
    notes = (*notes, *doubts(results, prepared.rules.ignition.above_background))
    return results._replace(notes=notes, settings=settings)


def doubts(results: Results, above_background: bool = False) -> Iterator[str]:
    """Yield notes on missing or doubtful results."""
    flights, counted = results.flights, results.counted
    if results.detections.empty:
        yield "Nothing was detected: a lower --threshold may find more."
    elif tracked(results.tracks).empty:
        yield (
            f"No tracks: of {len(results.detections)} detections {len(results.tracks)} are in the "
            "air or without depth, and none of these follow each other. Do --threshold, --in-air "
            "and the kiln's wall fit the recording?"
        )
    reasons = results.trajectories["outcome"]
    if len(reasons) and not (reasons == FITTED).any():
        why = ", ".join(f"{reason} {n}" for reason, n in reasons.value_counts().items())
        yield (
            f"None of {len(reasons)} tracks could be fitted ({why}): a trajectory needs "
            f"{Regression().fewest} or more detections with depth. Dwell times, velocities and "
            "ignition were not made."
        )
    if len(counted) and (counted["ending"] == LOST).all():
        yield (
            f"All {len(counted)} flights from the lance were lost in the air, none was seen to "
            "land or burn out: there is no dwell time."
        )
    from_lance = flights[flights["from_lance"]]
    if len(flights) and from_lance.empty:
        fitted = results.trajectories["particle"].isin(flights["particle"])
        early = int((results.trajectories.loc[fitted, "t0_at_bound"] < 0).sum())
        way = f"; of {early} no way back to it was found (t0 is the earliest that was searched)"
        yield (
            f"{len(flights)} trajectories were fitted, but none starts at the lance: the first "
            f"positions lie {flights['start_mm'].median():.0f} mm from it (median)"
            f"{way if early else ''}. Is the lance's outlet right (mm, as captured), and the "
            "depth_calibration? Dwell times, velocities and ignition are of flights from the "
            "lance only."
        )
    refused = len(from_lance) - len(counted)
    if 2 * refused > len(from_lance):
        yield (
            f"{refused} of {len(from_lance)} flights from the lance are refused, as no particle "
            "flies so (the summary has the reasons, the table of flights all of them). Is the "
            "lance's outlet right (mm, as captured), and the depth_calibration, and --air?"
        )
    ignited = int((counted["ignition"] == SEEN).sum())
    if ignited and not above_background:
        yield (
            f"Ignition was seen in {ignited} of {len(counted)} flights as a step of the grey "
            "values as they are, after which the particle is brighter than the kiln behind it. The "
            "test is ours, the thesis prints none: compare --above-background."
        )


def listed(values: Iterable[float], digits: int) -> str:
    """Return numbers with ``digits`` decimals, separated by commas."""
    return ", ".join(f"{value:.{digits}f}" for value in values)


def summary(results: Results) -> pd.DataFrame:
    """Return the results in rows of ``what`` and ``value``, both texts.

    In brackets: 95 % intervals, by bootstrap over particles and of shares by Wilson; none of
    fewer than six.
    """
    tracks, counted = tracked(results.tracks), results.counted
    reasons = results.trajectories["outcome"].value_counts().sort_index()
    endings = counted["ending"].value_counts().sort_index()
    depth = int(results.detections["z"].notna().sum())
    rows = [
        ("recording", results.name),
        ("frames", str(results.frames)),
        *results.settings,
        ("detections", f"{len(results.detections)}, with depth {depth}"),
        ("detections in the air or without depth", str(len(results.tracks))),
        ("tracks", f"{tracks['particle'].nunique()} with {len(tracks)} detections"),
        ("trajectories fitted", str(int(reasons.get("fitted", 0)))),
        *((f"not fitted: {why}", str(n)) for why, n in reasons.items() if why != "fitted"),
        ("flights from the lance", str(len(counted))),
        ("left out: not from the lance", str(int((~results.flights["from_lance"]).sum()))),
        *_refused(results.flights[results.flights["from_lance"]]),
        *((f"flights {ending}", str(n)) for ending, n in endings.items()),
        *(_ignited(counted) if len(counted) else ()),
        *_velocities(results),
        *_outliers(results),
    ]
    return pd.DataFrame(rows, columns=["what", "value"])


def _refused(from_lance: pd.DataFrame) -> Iterator[Row]:
    """Yield a row for each reason that refuses flights from the lance, with their names."""
    refused = from_lance[from_lance["refused"] != ""]
    for reason, group in refused.groupby("refused"):
        names = ", ".join(map(str, group["particle"].iloc[:NAMED]))
        more = ", ..." if len(group) > NAMED else ""
        yield f"refused: {reason}", f"{len(group)} (particle {names}{more})"


def _ignited(counted: pd.DataFrame) -> Iterator[Row]:
    """Yield the rows of dwell time and ignition.

    Dwell times are of complete flights: those that were lost "cannot be analyzed" (A.1). There is
    one row more where some particles burnt from the first detection on.
    """
    complete = counted.loc[counted["ending"] != LOST, "dwell_s"]
    if len(complete):
        dwell = median_interval(complete, np.random.default_rng(SEED))
        yield "dwell time, median", f"{_text(dwell, 3)} s"
    yield "of complete flights", f"{len(complete)} of {len(counted)}"
    kinds, shares = counted["ignition"], {"ignition seen": [SEEN]}
    if (kinds == BEFORE).any():
        shares["ignition seen, or alight when first seen"] = [SEEN, BEFORE]
    for label, outcomes in shares.items():
        interval = share(int(kinds.isin(outcomes).sum()), len(counted))
        yield label, f"{_text(interval, 0, 100)} %"
    few = int((kinds == TOO_FEW).sum())
    yield "too few points to judge ignition", f"{few} of {len(counted)}"


def _text(interval: Interval, digits: int, factor: float = 1.0) -> str:
    """Return an estimate with its interval, as text.

    If the sample is too small, it has no interval.
    """
    estimate, low, high = (f"{factor * value:.{digits}f}" for value in interval[:3])
    return f"{estimate} [{low}, {high}]" if np.isfinite(interval[1:3]).all() else estimate


def _velocities(results: Results) -> Iterator[Row]:
    """Yield the row of each metre's velocity.

    It holds the median, and the share of the flights that passed the metre.
    """
    groups, total = results.slices.groupby("slice_m")["velocity_m_s"], len(results.counted)
    for far, number in reaching(results.slices, total)[["slice_m", "number"]].to_numpy():
        middle = median_interval(groups.get_group(far).to_numpy(), np.random.default_rng(SEED))
        passed = _text(share(int(number), total), 0, 100)
        value = f"median {_text(middle, 1)} m/s, {passed} % of the flights"
        yield f"velocity in the metre up to {far:g} m", value


def _outliers(results: Results) -> Iterator[Row]:
    """Yield the rows of outliers in depth and velocity.

    They are of the flights that count; which are refused stands above.
    """
    slices, fits = results.slices, results.trajectories.dropna(subset=["rmse_z_mm"])
    fits = fits[fits["particle"].isin(results.counted["particle"])]
    if len(fits):
        rmse = fits[[f"rmse_{axis}_mm" for axis in "xyz"]].median()
        yield "RMSE of their fits in x, y, z, median", f"{listed(rmse, 0)} mm"
        worst = fits.iloc[int(np.argmax(fits["rmse_z_mm"]))]
        value = f"{worst['rmse_z_mm']:.0f} mm (particle {worst['particle']})"
        yield "largest RMSE in depth", value
    if len(slices):
        fast = slices.iloc[int(np.argmax(slices["velocity_m_s"].abs()))]
        place = f"particle {fast['particle']}, up to {fast['slice_m']:g} m"
        yield "fastest metre", f"{fast['velocity_m_s']:.1f} m/s ({place})"
        before = f"{int((~slices['observed']).sum())} of {len(slices)}"
        yield "metres passed before the particle was first seen", before


def page(results: Results, recording: Recording) -> str:
    """Return the report as one HTML page that needs no network."""
    notes = "".join(f"<li>{html.escape(note)}</li>" for note in results.notes)
    rows = "".join(
        f"<tr><th>{html.escape(what)}</th><td>{html.escape(value)}</td></tr>"
        for what, value in summary(results).to_numpy().tolist()
    )
    return PAGE.substitute(
        name=html.escape(results.name),
        notes=f"<h2>To know</h2><ul>{notes}</ul>" if notes else "",
        rows=rows,
        figures="".join(_embedded(*captioned) for captioned in _figures(results, recording)),
        version=__version__,
    )


def _figures(results: Results, recording: Recording) -> Iterator[Captioned]:
    """Yield each figure of the report with its caption."""
    counted, slices = results.counted, results.slices
    caption = "Tracks after post-processing over the first frame (dark parts lifted)."
    yield plot_tracks(recording, results.tracks), caption
    complete = counted[counted["ending"] != LOST]
    if len(complete):
        yield _dwell_figure(complete)
    if len(slices):
        yield _velocity_figure(slices, len(counted))
    if len(counted):
        yield _ignition_figure(counted["ignition_s"].to_numpy(np.float64))


def _embedded(figure: Figure, caption: str) -> str:
    buffer = io.BytesIO()
    with style.style():
        figure.savefig(buffer, format="png", dpi=150, metadata={"Software": None})
    plt.close(figure)
    data, caption = base64.b64encode(buffer.getvalue()).decode(), html.escape(caption)
    return (
        f'<figure><img alt="{caption}" src="data:image/png;base64,{data}"/>'
        f"<figcaption>{caption}</figcaption></figure>"
    )


def _dwell_figure(flights: pd.DataFrame) -> Captioned:
    """Draw the dwell times of complete flights, stacked by ending."""
    groups = dict(list(flights.groupby("ending")["dwell_s"]))
    edges = np.arange(0.0, flights["dwell_s"].max() + BIN_S, BIN_S / 2)
    figure, axes = style.canvas(width_mm=style.PAGE_MM * 2 / 3)
    look = {"color": style.COLOURS[1 : 1 + len(groups)], "hatch": style.HATCHES[: len(groups)]}
    axes[0, 0].hist(list(groups.values()), edges, stacked=True, label=list(groups), **look)
    axes[0, 0].set(xlabel="dwell time (s)", ylabel="flights")
    axes[0, 0].legend()
    return figure, "Dwell times of complete flights from the lance, by their ending."


def _velocity_figure(slices: pd.DataFrame, flights: int) -> Captioned:
    """Draw the velocities, and the share of flights that remain.

    Velocities are median and middle half in each metre.
    """
    figure, axes = style.canvas(2, width_mm=style.PAGE_MM * 2 / 3, height_mm=90, sharex=True)
    groups = slices.groupby("slice_m")["velocity_m_s"]
    low, middle, high = (groups.quantile(part) for part in (0.25, 0.5, 0.75))
    reach = [middle - low, high - middle]
    axes[0, 0].errorbar(middle.index, middle, yerr=reach, fmt="o-", color="black", capsize=2)
    left = reaching(slices, flights)
    axes[1, 0].bar(left["slice_m"], 100 * left["share"], 0.6, color="0.7", edgecolor="black")
    axes[0, 0].set(ylabel="velocity (m/s)")
    axes[1, 0].set(ylabel="flights (%)", xlabel="distance from the lance, end of slice (m)")
    return figure, (
        "Velocity towards the camera in each metre from the lance: median, and the middle half "
        "of the flights; below, the share of flights that get as far."
    )


def _ignition_figure(ignition_s: npt.NDArray[np.float64]) -> Captioned:
    """Draw when flights ignite, as shares of all of them."""
    bins = ignition_histogram(ignition_s, BIN_S)
    figure, axes = style.canvas(width_mm=style.PAGE_MM * 2 / 3)
    look = {"align": "edge", "color": "0.7", "edgecolor": "black"}
    axes[0, 0].bar(bins["from_s"], bins["percent"], BIN_S, **look)
    label = "ignition after leaving the lance (s); the last bin holds all later"
    axes[0, 0].set(xlabel=label, ylabel="flights (%)")
    return figure, (
        f"Ignition after leaving the lance, in bins of {BIN_S:g} s: shares of all "
        f"{len(ignition_s)} flights; in {np.isfinite(ignition_s).sum()} of them ignition was seen."
    )


def plot_tracks(recording: Recording, tracks: pd.DataFrame) -> Figure:
    """Return a figure of tracks over the first frame of their recording."""
    figure, axes = style.canvas(width_mm=style.PAGE_MM, height_mm=130)
    style.draw_frame(axes[0, 0], recording.gray(0))
    style.draw_tracks(axes[0, 0], tracked(tracks))
    return figure
