"""Errors of measured flights, also with each step of the chain made true in turn.

measured flights, true flights -> `compare` -> `errors`: bias, spread, who was measured at all
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight import kiln, regression
from kilnflight.checks import InputError
from kilnflight.experiments.campaigns import (
    KEYS,
    Campaign,
    Measurement,
    Results,
    counted_flights,
    of_campaign,
    rows_by_campaign,
    stack,
    true_positions,
    twin_of,
    whole_flights,
)
from kilnflight.experiments.confidence import interval_columns, median_of
from kilnflight.experiments.tracking import true_particles
from kilnflight.flight import BURNT_OUT, LANDED, LOST
from kilnflight.kiln import KilnRun
from kilnflight.project import parallel
from kilnflight.regression import Regression
from kilnflight.scores import intervals
from kilnflight.scores.flights import METRES, quartiles
from kilnflight.tracking.gate import Gate
from kilnflight.tracking.tracker import track
from kilnflight.tracklets import postprocess, tracked
from kilnflight.twin.truth import metre_velocities

Array = npt.NDArray[np.float64]
Owners = npt.NDArray[np.int64]

CASES = ("landed unlit", "landed burning", BURNT_OUT)  # (a), (b) and (c) of Fig. 5.18
NOT_WHOLE, NOT_MEASURED = "no whole flight", "not measured"
QUANTITIES = {"dwell_s": "s", "velocity_m_s": "m/s", "ignition_s": "s"}
UNLIT_GRAY, LIT_GRAY = 1000.0, 2000.0  # stand for the grey values where positions are true
REPLACED_STEPS = (
    "true positions and links",
    "true links",
    "true positions",
    "true depth",
    "true trajectories",
    "weighted axes",
    "weighted, robust",
    "whole chain",
)
SCATTER_MM = (6.9, 7.0, 156.9)  # medians over the fractions of RMSE in x, y, z, Table 5.18
WEIGHTED = Regression(scale_mm=SCATTER_MM)
ROBUST = Regression(scale_mm=SCATTER_MM, robust=True)


class FlightTables(NamedTuple):
    """Flights that were worked out in one way."""

    flights: pd.DataFrame  # `kilnflight.tables.FLIGHTS`
    slices: pd.DataFrame  # `kilnflight.tables.SLICES`
    particles: pd.Series  # true particle by track; -1: none


def true_flights(campaign: Campaign) -> pd.DataFrame:
    """Return what is true of every particle that flies in the frames of a campaign.

    Returns
    -------
    DataFrame
        ``particle``; ``ending``, and ``dwell_s`` (NaN if it is neither on the wall nor burnt
        out); ``velocity_m_s`` of the first metre, and ``velocity_1_m_s`` to 5; ``ignition_s``
        (NaN: never); ``whole``: released and over within the frames; ``measurable``: followed
        by a person at five positions or more (`kilnflight.twin.truth.true_trajectories`).
    """
    twin, frames = twin_of(campaign), campaign.frames
    flights, rate = twin.life.flights, twin.scene.frame_rate_hz
    release = twin.life.release_s * rate
    metres = metre_velocities(flights)
    table = twin.life.table[["particle"]].assign(ending=twin.life.table["end"])
    table = table.assign(
        dwell_s=np.where(table["ending"].isin([LANDED, BURNT_OUT]), flights.end_s, np.nan),
        velocity_m_s=metres[:, 0],
        **{f"velocity_{metre}_m_s": metres[:, k] for k, metre in enumerate(METRES)},
        ignition_s=flights.ignition_s,
        whole=whole_flights(campaign),
        measurable=table["particle"].isin(true_positions(campaign)["particle"]),
    )
    flying = (release < frames.stop) & (release + flights.end_s * rate > frames.start)
    return table[flying].reset_index(drop=True)


def compare(measured: FlightTables, true: pd.DataFrame) -> pd.DataFrame:
    """Return measured beside true, a row per particle whose whole flight is recorded.

    Refused flights are left out, and lost ones have no dwell time. Of several tracks of a
    particle the longest in time counts. False flights, which start at the lance and belong to
    no particle, come last, without truth. ``true``: of `true_flights`.

    Returns
    -------
    DataFrame
        ``particle`` (-1: a false flight), ``measurable`` (whether a person could have followed
        it), ``track`` (-1: none), ``ending`` and ``true_ending``, and ``measured_`` and ``true_``
        of `QUANTITIES`.
    """
    counted, slices = _from_lance(measured), measured.slices
    first = slices[slices["slice_m"] == 1.0].set_index("particle")["velocity_m_s"]
    counted["velocity_m_s"] = counted["track"].map(first).astype(np.float64)
    ours = counted.rename(columns={name: f"measured_{name}" for name in QUANTITIES})
    columns = ["track", "particle", "ending", *(f"measured_{name}" for name in QUANTITIES)]
    names = {name: f"true_{name}" for name in ("ending", *QUANTITIES)}
    real = true.loc[true["whole"], ["particle", "measurable", *names]].rename(columns=names)
    both = real.merge(ours.loc[ours["longest"], columns], how="left", on="particle")
    false = ours.loc[ours["particle"] < 0, columns].assign(measurable=False)
    both = pd.concat([both, false], ignore_index=True)
    both[["ending", "true_ending"]] = both[["ending", "true_ending"]].fillna("")
    return both.assign(track=both["track"].fillna(-1).astype(np.int64))


def _from_lance(measured: FlightTables) -> pd.DataFrame:
    """Return the `counted_flights`, with ``track`` and true ``particle``.

    ``longest``: the longest track in time of a particle; -1 is no particle. Lost flights have
    no ``dwell_s``.
    """
    flights = _complete_only(counted_flights(measured.flights))
    particle = flights["particle"].map(measured.particles).fillna(-1).astype(np.int64)
    length = (flights["last_s"] - flights["first_s"]).sort_values(kind="stable")
    last = ~particle.loc[length.index].duplicated(keep="last")
    flights = flights.rename(columns={"particle": "track"})
    return flights.assign(particle=particle, longest=last & (particle >= 0))


def _complete_only(flights: pd.DataFrame) -> pd.DataFrame:
    """Return flights without the dwell times of lost ones."""
    return flights.assign(dwell_s=flights["dwell_s"].mask(flights["ending"] == LOST))


def compare_campaigns(campaigns: Sequence[Campaign], tables: Measurement) -> pd.DataFrame:
    """Return `compare` of the measurement as is, with fraction and pressure in front."""
    return stack(
        {
            campaign.key: compare(flights, true_flights(campaign))
            for campaign, flights in _with_particles(campaigns, tables)
        }
    )


def _with_particles(
    campaigns: Sequence[Campaign], tables: Measurement
) -> Iterator[tuple[Campaign, FlightTables]]:
    """Yield each campaign with its flights, slices and its tracks' true particles."""
    for campaign in campaigns:
        tracks, _, flights, slices = (of_campaign(table, campaign.key) for table in tables)
        owner = true_particles(tracks.reset_index(drop=True), true_positions(campaign))
        flights, slices = (table.drop(columns=KEYS) for table in (flights, slices))
        yield campaign, FlightTables(flights, slices, particle_of_track(tracks, owner))


def compare_refused(campaigns: Sequence[Campaign], tables: Measurement) -> pd.DataFrame:
    """Return `whom_refused` of all campaigns together."""
    parts = {}
    for campaign, measured in _with_particles(campaigns, tables):
        fitted = of_campaign(tables.trajectories, campaign.key).set_index("particle")
        points = measured.flights["particle"].map(fitted["points"])
        flights = measured.flights.assign(
            points=points, owner=measured.flights["particle"].map(measured.particles)
        )
        real = true_flights(campaign).query("whole").rename(columns={"particle": "owner"})
        real = real[["owner", "dwell_s", "velocity_m_s"]].add_prefix("true_")
        started = flights[flights["from_lance"]]
        merged = started.merge(real, how="left", left_on="owner", right_on="true_owner")
        parts[campaign.key] = merged
    return whom_refused(stack(parts))


def whom_refused(flights: pd.DataFrame) -> pd.DataFrame:
    """Return what is true of flights from the lance that are refused, beside those that count.

    Parameters
    ----------
    flights
        ``fraction``, ``pressure_bar``, ``refused`` (the reason), ``points`` of the fit, and
        ``true_owner``, ``true_dwell_s`` and ``true_velocity_m_s`` of the particle (NaN: none).

    Returns
    -------
    DataFrame
        ``fraction``; ``refused``; ``flights``; ``positions``: median of the fitted ones;
        ``particles`` whose flights these are, with the medians of their ``true_dwell_s`` and
        of their ``true_velocity_m_s`` in the first metre.
    """
    keys = ["fraction", "refused"]
    flights = flights.assign(refused=flights["refused"] != "")
    table = flights.groupby(keys).agg(flights=("points", "size"), positions=("points", "median"))
    once = flights.dropna(subset="true_owner").drop_duplicates([*KEYS, "refused", "true_owner"])
    true = {name: (name, "median") for name in ("true_dwell_s", "true_velocity_m_s")}
    table = table.join(once.groupby(keys).agg(particles=("true_owner", "size"), **true))
    order = {name: k for k, name in enumerate(dict.fromkeys(flights["fraction"]))}
    table = table.fillna({"particles": 0}).astype({"particles": int}).reset_index()
    return table.sort_values("fraction", key=lambda names: names.map(order), kind="stable")


def compare_velocities(campaigns: Sequence[Campaign], tables: Measurement) -> pd.DataFrame:
    """Return velocities by metre, measured and true, a row per particle and metre.

    Of several tracks of a particle the longest in time counts.

    Returns
    -------
    DataFrame
        ``fraction``, ``pressure_bar``, ``particle`` (-1: a false flight), ``slice_m``,
        ``measured_m_s``, ``true_m_s`` (NaN where there is none).
    """
    parts = {}
    for campaign, flights in _with_particles(campaigns, tables):
        counted = _from_lance(flights)
        counted = counted.loc[counted["longest"] | (counted["particle"] < 0)]
        slices = flights.slices.rename(
            columns={"particle": "track", "velocity_m_s": "measured_m_s"}
        )
        measured = slices.merge(counted[["track", "particle"]], on="track")
        columns = {f"velocity_{metre}_m_s": float(metre) for metre in METRES}
        wide = true_flights(campaign).query("whole").rename(columns=columns)
        true = wide.melt("particle", list(columns.values()), "slice_m", "true_m_s").dropna()
        true = true.astype({"slice_m": np.float64})
        measured = measured[["particle", "slice_m", "measured_m_s"]]
        parts[campaign.key] = measured.merge(true, how="outer", on=["particle", "slice_m"])
    return stack(parts)


def first_metre_errors(pairs: pd.DataFrame) -> str:
    """Return in words how far velocities in the first metre are off; of `compare_velocities`."""
    first = pairs[pairs["slice_m"] == 1.0]
    first = first.assign(off=first["measured_m_s"] - first["true_m_s"]).dropna(subset="off")
    if first.empty:
        return "no particle"
    low, middle, high = first["off"].quantile([0.25, 0.5, 0.75])
    medians = first.groupby(KEYS)["off"].median()
    return (
        f"median {middle:+.2f} m/s, half of them from {low:+.2f} to {high:+.2f} m/s ({len(first)} "
        f"particles); medians of campaigns from {medians.min():+.2f} to {medians.max():+.2f} m/s"
    )


def errors(both: pd.DataFrame, seed: int = 0) -> dict[str, float]:
    """Return number, bias and spread by quantity, and where ignition was detected.

    Bias is the median of measured minus true, spread half the range that holds 68 % of it,
    over particles of which both are known; ``low`` and ``high`` are the 95 % interval of the
    bias (bootstrap over particles; NaN of fewer than six), and of the share that was
    detected (Wilson).

    Parameters
    ----------
    both
        `compare`.
    seed
        Of the bootstrap.
    """
    generator = np.random.default_rng(seed)
    real = both[(both["particle"] >= 0) & both["measurable"]]
    measured = real["track"] >= 0
    share = intervals.share(int(measured.sum()), len(real))
    row = {
        "measurable_particles": float(len(real)),
        "detected_particles": float(measured.sum()),
        "false_flights": float((both["particle"] < 0).sum()),
        "detected_low": share.low,
        "detected_high": share.high,
    }
    for name in QUANTITIES:
        off = (real[f"measured_{name}"] - real[f"true_{name}"]).dropna().to_numpy(np.float64)
        low, bias, high = np.quantile(off, [0.16, 0.5, 0.84]) if len(off) else 3 * (np.nan,)
        interval = interval_columns(median_of(off, generator))
        row |= {f"{name}_n": float(len(off)), f"{name}_bias": bias}
        row |= {f"{name}_spread": (high - low) / 2}
        row |= {f"{name}_{side}": interval[side] for side in ("low", "high")}
    lit = real["true_ignition_s"].notna()
    detected = real["measured_ignition_s"].notna()
    for name, kind in (("lit", measured & lit), ("unlit", measured & ~lit)):
        row |= {name: float(kind.sum()), f"{name}_detected": float((kind & detected).sum())}
    return row


def error_budget(results: Results, jobs: int = 1) -> pd.DataFrame:
    """Return `errors` of every campaign and replaced step, in `jobs` processes."""
    keys = [campaign.key for campaign in results.campaigns]
    measured = results.tables[:2]  # tracks and trajectories
    pieces = (
        (campaign, *(of_campaign(table, campaign.key) for table in measured))
        for campaign in results.campaigns
    )
    parts = parallel.run_all(_budget, pieces, jobs)
    return stack(dict(zip(keys, parts, strict=True)))


def _budget(campaign: Campaign, tracks: pd.DataFrame, trajectories: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of one campaign, given its tracks and their trajectories."""
    tracks = tracks.drop(columns=KEYS).reset_index(drop=True)
    fits = regression.fits(trajectories.drop(columns=KEYS))
    true, rows = true_flights(campaign), []
    for step, tables in replace_steps(campaign, tracks, fits):
        number, counted = int(tables.flights["from_lance"].sum()), counted_flights(tables.flights)
        row = {"replaced_step": step, **errors(compare(tables, true)), "flights": len(counted)}
        rows.append(row | {"refused": number - len(counted)})
    return pd.DataFrame(rows)


def accuracy_in_words(whole: pd.DataFrame, results: Results) -> pd.DataFrame:
    """Return the main table of accuracy by campaign as text.

    Detected, bias, interval, spread. ``whole``: rows of the `error_budget` of the whole chain.
    """
    rows = {}
    for row in whole.to_dict("records"):
        key = row["fraction"], row["pressure_bar"]
        share = f"[{row['detected_low']:.2f}, {row['detected_high']:.2f}]"
        count = f"{row['detected_particles']:.0f} of {row['measurable_particles']:.0f}"
        text = {"detected": f"{count} {share}"}
        for name, unit in QUANTITIES.items():
            bias, low, high, spread = (
                row[f"{name}_{k}"] for k in ("bias", "low", "high", "spread")
            )
            interval = f"[{low:+.3f}, {high:+.3f}]" if np.isfinite(low) else "[fewer than six]"
            there = bool(row[f"{name}_n"])
            short = f"{name.removesuffix('_s').removesuffix('_m')} ({unit})"
            text[f"error of {short}"] = f"{bias:+.3f} {interval}" if there else ""
            text[f"scatter of {short}"] = f"{spread:.3f}" if there else ""
        ours, real = (quartiles(each[key].dwell_s)[1] for each in (results.measured, results.true))
        known = [f"{each:.3f}" if np.isfinite(each) else "unknown" for each in (ours, real)]
        text["campaign dwell (s)"] = f"{known[0]}, true {known[1]}"
        text["false flights"] = f"{row['false_flights']:.0f} of {row['flights']:.0f}"
        text["refused"] = f"{row['refused']:.0f}"
        text["lit reported as ignited"] = f"{row['lit_detected']:.0f} of {row['lit']:.0f}"
        text["unlit reported as ignited"] = f"{row['unlit_detected']:.0f} of {row['unlit']:.0f}"
        rows[key] = text
    return rows_by_campaign(rows)


def particle_of_track(tracks: pd.DataFrame, owner: Owners) -> pd.Series:
    """Return by track the true particle of most, at least half, of its detections."""
    table = pd.DataFrame({"particle": tracks["particle"].to_numpy(), "owner": owner})
    count = table[table["particle"] >= 0].value_counts(["particle", "owner"]).reset_index()
    count["of"] = count.groupby("particle")["count"].transform("sum")
    best = count.sort_values(["particle", "count", "owner"]).groupby("particle").last()
    return best["owner"].where(2 * best["count"] >= best["of"], -1)


def replace_steps(
    campaign: Campaign, tracks: pd.DataFrame, fits: Mapping[int, regression.Fit] | None = None
) -> Iterator[tuple[str, FlightTables]]:
    """Yield the flights with one step after the other replaced by the truth.

    Parameters
    ----------
    campaign
        Of the twin.
    tracks
        Its detections in the air with ``particle``, as measured.
    fits
        Their trajectories; worked out if None.
    """
    true, run = true_positions(campaign), campaign.run
    positions = true.assign(gray=np.where(true["label"] == 2, LIT_GRAY, UNLIT_GRAY))
    owner = true_particles(tracks, true)
    particles, exact = particle_of_track(tracks, owner), fit_tracks(run, positions)
    linked = link_by_truth(tracks, owner, true)
    followed = postprocess(track(positions.drop(columns="particle"), run.tracker))
    deep = with_true_depth(tracks, owner, true)
    measured = fit_tracks(run, tracks) if fits is None else fits
    replaced = {name: exact[particles[name]] for name in measured if particles[name] in exact}
    weighted, robust = (
        fit_tracks(replace(run, regression=method), tracks) for method in (WEIGHTED, ROBUST)
    )
    replacements = (
        (positions, exact, _particles(positions, true)),
        (linked, fit_tracks(run, linked), particle_of_track(linked, owner)),
        (followed, fit_tracks(run, followed), _particles(followed, true)),
        (deep, fit_tracks(run, deep), particles),
        (tracks, {**measured, **replaced}, particles),
        (tracks, weighted, particles),
        (tracks, robust, particles),
        (tracks, measured, particles),
    )
    for name, (table, trajectories, owners) in zip(REPLACED_STEPS, replacements, strict=True):
        flights = kiln.flights_from(run, table, trajectories)
        yield name, FlightTables(flights, kiln.slices_from(flights, trajectories), owners)


def _particles(tracks: pd.DataFrame, true: pd.DataFrame) -> pd.Series:
    return particle_of_track(tracks, true_particles(tracks, true))


def link_by_truth(tracks: pd.DataFrame, owner: Owners, true: pd.DataFrame) -> pd.DataFrame:
    """Return detections with their true particle, without depths that are another's.

    A detection belongs to a particle by its place in the image; a depth that is off by more
    than the tracker's gate lets pass is that of something behind it, and left out.
    """
    off = np.abs(tracks["z"].to_numpy(np.float64) - _true_places(tracks, owner, true, ["z"])[:, 0])
    linked = tracks.assign(particle=owner)
    linked.loc[off >= Gate().depth_mm, ["x", "y", "z"]] = np.nan
    return linked


def with_true_depth(tracks: pd.DataFrame, owner: Owners, true: pd.DataFrame) -> pd.DataFrame:
    """Return the tracks with true places in space where detections have a particle."""
    axes = ["x", "y", "z"]
    places = _true_places(tracks, owner, true, axes)
    measured = tracks[axes].to_numpy(np.float64)
    return tracks.assign(
        **dict(zip(axes, np.where(np.isnan(places), measured, places).T, strict=True))
    )


def _true_places(tracks: pd.DataFrame, owner: Owners, true: pd.DataFrame, axes: list[str]) -> Array:
    """Return true coordinates (n, axes) behind each detection; NaN without particle."""
    index = pd.MultiIndex.from_arrays([tracks["frame"], owner])
    return true.set_index(["frame", "particle"])[axes].reindex(index).to_numpy(np.float64)


def fit_tracks(run: KilnRun, table: pd.DataFrame) -> dict[int, regression.Fit]:
    """Return the trajectories by track of a table that did not come from the chain."""
    if run.exit_point_mm is None:
        raise InputError(f"{run.detection.source.name}: the lance's outlet is not known.")
    rate, method = run.frame_rate_hz, run.regression
    return regression.fits(regression.regress_all(tracked(table), run.exit_point_mm, rate, method))
