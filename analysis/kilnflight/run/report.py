"""Report of a run: tables, notes, a summary and a page.

`read_results` -> `doubts`, `summary` -> `page`
"""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from kilnflight import __version__
from kilnflight.flight import LOST, kept, reaching
from kilnflight.ignition import SEEN
from kilnflight.kiln import KilnRun
from kilnflight.project import style
from kilnflight.recording.frames import Recording
from kilnflight.regression import FITTED, Regression
from kilnflight.run.preparation import Settings, listed
from kilnflight.scores.flights import ignition_histogram
from kilnflight.scores.intervals import median_interval
from kilnflight.tracklets import tracked

HEAD = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{name}</title><style>
body {{ font: 16px/1.5 sans-serif; max-width: 60rem; margin: 2rem auto; }} img {{ width: 100%; }}
td {{ vertical-align: top; padding: 0.15rem 1rem 0.15rem 0; border-bottom: 1px solid #ccc; }}
</style></head><body><h1>{name}</h1>
"""


class RunResults(NamedTuple):
    """All tables of a recording, with settings and notes for the reader."""

    name: str
    detections: pd.DataFrame
    tracks: pd.DataFrame
    trajectories: pd.DataFrame
    flights: pd.DataFrame
    slices: pd.DataFrame
    settings: Settings
    notes: list[str]

    @property
    def counted(self) -> pd.DataFrame:
        """Accepted flights from the lance, which alone count.

        Section 5.3.1 of the thesis, and `kilnflight.flight.Plausible`.
        """
        return kept(self.flights[self.flights["from_lance"]])


def read_results(run: KilnRun, settings: Settings, notes: list[str]) -> RunResults:
    """Return the tables of a recording, with more notes; missing tables are made."""
    detections = run.detection.detections()
    tables = detections, run.tracks(), run.trajectories(), run.flights(), run.slices()
    results = RunResults(run.detection.source.name, *tables, settings, notes)
    more = doubts(results, run.rules.ignition is None or run.rules.ignition.above_background)
    return results._replace(notes=[*notes, *more])


def doubts(results: RunResults, above_background: bool = False) -> Iterator[str]:
    """Yield notes on missing or doubtful results."""
    fits, flights, counted = results.trajectories, results.flights, results.counted
    found, left = len(results.detections), len(results.tracks)
    from_lance, lost = flights[flights["from_lance"]], counted["ending"] == LOST
    ignited = int((counted["ignition"] == SEEN).sum())
    if not found:
        yield "Nothing was detected: a lower --threshold may find more."
    elif tracked(results.tracks).empty:
        yield (
            f"No tracks: of {found} detections {left} are in the air or without depth, and none of "
            "these follow each other. Do --threshold, --in-air and the wall fit the recording?"
        )
    if len(fits) and not (fits["outcome"] == FITTED).any():
        why = ", ".join(f"{reason} {n}" for reason, n in fits["outcome"].value_counts().items())
        yield (
            f"None of {len(fits)} tracks could be fitted ({why}): a trajectory needs "
            f"{Regression().fewest} or more detections with depth."
        )
    if len(counted) and lost.all():
        yield (
            f"All {len(counted)} flights from the lance were lost in the air, none was seen to "
            "land or burn out: there is no dwell time."
        )
    if len(flights) and from_lance.empty:
        early = fits.loc[fits["particle"].isin(flights["particle"]), "t0_at_bound"] < 0
        yield (
            f"{len(flights)} trajectories were fitted, but none starts at the lance: the first "
            f"positions lie {flights['start_mm'].median():.0f} mm from it (median); of "
            f"{early.sum()} no way back to it was found. Is the lance's outlet right (mm, as "
            "captured), and the depth_calibration? Only flights from the lance count."
        )
    if 2 * len(counted) < len(from_lance):
        yield (
            f"{len(from_lance) - len(counted)} of {len(from_lance)} flights from the lance are "
            "refused, as no particle flies so (the summary has the reasons). Is the lance's outlet "
            "right (mm, as captured), and the depth_calibration, and --air?"
        )
    if ignited and not above_background:
        yield (
            f"Ignition was seen in {ignited} of {len(counted)} flights as a step of the grey "
            "values as they are, after which the particle is brighter than the kiln behind it. The "
            "test is ours, the thesis prints none: compare --above-background."
        )


def summary(results: RunResults) -> pd.DataFrame:
    """Return the results in rows of ``what`` and ``value``, both texts.

    In brackets: 95 % interval over particles, by bootstrap; none for fewer than six.
    """
    tracks, counted, flights = tracked(results.tracks), results.counted, results.flights
    depth, fits = int(results.detections["z"].notna().sum()), results.trajectories
    refused = flights.loc[flights["from_lance"] & (flights["refused"] != ""), "refused"]
    dwell = counted.loc[counted["ending"] != LOST, "dwell_s"]  # lost: "cannot be analyzed" (A.1)
    rows = {"recording": results.name, **results.settings}
    rows["detections"] = f"{len(results.detections)}, with depth {depth}"
    rows["detections in the air or without depth"] = f"{len(results.tracks)}"
    rows["tracks"] = f"{tracks['particle'].nunique()} with {len(tracks)} detections"
    rows |= {f"trajectories {why}": f"{n}" for why, n in fits["outcome"].value_counts().items()}
    rows["flights from the lance"] = f"{len(counted)}"
    rows["left out: not from the lance"] = f"{(~flights['from_lance']).sum()}"
    rows |= {f"refused: {why}": f"{n}" for why, n in refused.value_counts().items()}
    rows |= {f"flights {end}": f"{n}" for end, n in counted["ending"].value_counts().items()}
    if len(dwell):
        interval = median_interval(dwell, np.random.default_rng(0))
        known = np.isfinite(interval[1:3]).all()
        value = "{:.3f} [{:.3f}, {:.3f}] s" if known else "{:.3f} s"
        rows["dwell time, median"] = value.format(*interval[:3])
    rows |= {f"ignition {how}": f"{n}" for how, n in counted["ignition"].value_counts().items()}
    for _, metre in reaching(results.slices, len(counted)).iterrows():
        value = f"median {metre['median_m_s']:.1f} m/s, {100 * metre['share']:.0f} % of the flights"
        rows[f"velocity in the metre up to {metre['slice_m']:g} m"] = value
    fitted = fits[fits["particle"].isin(counted["particle"])]
    if len(fitted):
        rmse = fitted[[f"rmse_{axis}_mm" for axis in "xyz"]].median()
        rows["RMSE of their fits in x, y, z, median"] = f"{listed(rmse.tolist(), 0)} mm"
    return pd.DataFrame(rows.items(), columns=["what", "value"])


def page(results: RunResults, recording: Recording) -> str:
    """Return the report as one HTML page that needs no network."""
    notes = pd.DataFrame({"what": "note", "value": results.notes})
    table = pd.concat([notes, summary(results)])
    parts = [HEAD.format(name=html.escape(results.name))]
    with pd.option_context("display.max_colwidth", None):
        parts.append(table.to_html(index=False, header=False, border=0))
    for figure, caption in _figures(results, recording):
        buffer = io.BytesIO()
        with style.style():
            figure.savefig(buffer, format="png", dpi=150, metadata={"Software": None})
        source = f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}"
        parts.append(f'<figure><img src="{source}"/><figcaption>{caption}</figcaption></figure>')
    return "\n".join([*parts, f"<p>kilnflight {__version__}</p></body></html>\n"])


def _figures(results: RunResults, recording: Recording) -> Iterator[tuple[Figure, str]]:
    """Yield figures and captions: tracks, dwell times, velocities, ignition.

    Those without data are left out. `RunResults.counted` are accepted flights from the lance.
    """
    yield plot_tracks(recording, results.tracks), "Tracks over the first frame, dark parts lifted."
    counted, slices = results.counted, results.slices
    complete = counted[counted["ending"] != LOST]
    if len(complete):
        figure, ((axes,),) = style.canvas(width_mm=120)
        complete.pivot(columns="ending", values="dwell_s").plot.hist(ax=axes, stacked=True)
        axes.set(xlabel="dwell time (s)", ylabel="flights")
        yield figure, "Dwell times of complete flights from the lance, by their ending."
    if len(slices):
        figure, ((axes,),) = style.canvas(width_mm=120)
        wide = slices.pivot(columns="slice_m", values="velocity_m_s")
        wide.plot.box(ax=axes, xlabel="end of slice (m from the lance)", ylabel="velocity (m/s)")
        yield figure, "Velocity towards the camera in each metre from the lance."
    if len(counted):
        bins = ignition_histogram(counted["ignition_s"].to_numpy(np.float64), 0.1)  # sec. 5.3.2
        figure, ((axes,),) = style.canvas(width_mm=120)
        axes.bar(bins["from_s"], bins["percent"], 0.1, align="edge", color="0.7", edgecolor="black")
        axes.set(xlabel="ignition after leaving the lance (s)", ylabel="flights (%)")
        yield figure, "Ignition as shares of all flights; the last bin holds all later ones."


def plot_tracks(recording: Recording, tracks: pd.DataFrame) -> Figure:
    """Return a figure of tracks over the first frame of their recording."""
    figure, ((axes,),) = style.canvas(width_mm=style.PAGE_MM, height_mm=130)
    style.draw_frame(axes, recording.gray(0))
    style.draw_tracks(axes, tracked(tracks))
    return figure
