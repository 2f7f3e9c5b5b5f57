"""Errors of measured flights, also with each step of the chain replaced by the truth.

measured flights, true flights -> `compare` -> `errors`: share detected, bias, spread
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight import chain, regression
from kilnflight.chain import Chain
from kilnflight.experiments.flights import campaigns
from kilnflight.experiments.flights.campaigns import (
    KEYS,
    Campaign,
    counted_flights,
    of_campaign,
    stack,
)
from kilnflight.experiments.flights.comparison import interval_columns, median_of
from kilnflight.experiments.flights.tracking import true_particles
from kilnflight.flight import BURNT_OUT, LANDED, LOST
from kilnflight.regression import Three
from kilnflight.scores import intervals
from kilnflight.scores.flights import METRES
from kilnflight.simulated.kiln.geometry import FULL_SCALE
from kilnflight.simulated.kiln.truth import metre_velocities
from kilnflight.store import parallel
from kilnflight.tracking.filter import Gate
from kilnflight.tracking.tracker import track
from kilnflight.tracklets import postprocess, tracked

Fits = dict[int, regression.Fit]
QUANTITIES = {"dwell_s": "s", "velocity_m_s": "m/s", "ignition_s": "s"}
UNLIT_GRAY = 1000.0
LIT_GRAY = FULL_SCALE  # of true positions: darker and lighter than the wall
SCATTER_MM = (
    6.9,
    7.0,
    156.9,
)  # medians over the fractions of RMSE in x, y, z, Table 5.18
WHOLE = "whole chain"
AXES = ["x", "y", "z"]


class FlightTables(NamedTuple):
    """Measured flights of one campaign, from the whole chain or with a step replaced."""

    flights: pd.DataFrame  # `kilnflight.tables.FLIGHTS`
    slices: pd.DataFrame  # `kilnflight.tables.SLICES`
    particles: pd.Series  # index: track; value: its true particle, -1: none


def true_flights(campaign: Campaign) -> pd.DataFrame:
    """Return the true flights in the frames of a campaign, one row per particle.

    Returns
    -------
    DataFrame
        ``particle``; ``ending``; ``dwell_s`` (NaN if it neither landed nor burnt out);
        ``velocity_m_s`` within the first metre; ``velocity_1_m_s`` to
        ``velocity_5_m_s`` within each metre (Eq. 5.8; NaN if not passed);
        ``ignition_s`` after the release (NaN: never); ``whole``: released and ended
        within the frames; ``measurable``: visible in the air at five positions or more
        (`kilnflight.simulated.kiln.truth.true_trajectories`).
    """
    twin = campaigns.twin_of(campaign)
    frames = campaign.frames
    flights = twin.life.flights
    rate = twin.scene.frame_rate_hz
    release = twin.life.release_s * rate
    metres = metre_velocities(flights)
    table = twin.life.table[["particle"]].assign(ending=twin.life.table["end"])
    table = table.assign(
        dwell_s=np.where(
            table["ending"].isin([LANDED, BURNT_OUT]), flights.end_s, np.nan
        ),
        velocity_m_s=metres[:, 0],
        **{f"velocity_{metre}_m_s": metres[:, k] for k, metre in enumerate(METRES)},
        ignition_s=flights.ignition_s,
        whole=campaigns.whole_flights(campaign),
        measurable=table["particle"].isin(
            campaigns.true_positions(campaign)["particle"]
        ),
    )
    flying = (release < frames.stop) & (release + flights.end_s * rate > frames.start)
    return table[flying].reset_index(drop=True)


def compare(measured: FlightTables, true: pd.DataFrame) -> pd.DataFrame:
    """Return measured beside true values, a row per particle and false flight.

    Only particles whose whole flight lies within the recorded frames have a row. A
    particle with several tracks is represented by the longest. False flights belong to
    no particle and come last.

    Parameters
    ----------
    measured
        Flights of one campaign.
    true
        From `true_flights`, of the same campaign.

    Returns
    -------
    DataFrame
        ``particle`` (-1: a false flight), ``measurable``, ``track`` (-1: not detected),
        ``ending`` and ``true_ending`` ("" if unknown), ``measured_`` and ``true_`` of
        `QUANTITIES`.
    """
    counted = with_particles(measured)
    slices = measured.slices
    first = slices[slices["slice_m"] == 1.0].set_index("particle")["velocity_m_s"]
    counted["velocity_m_s"] = counted["track"].map(first).astype(np.float64)
    ours = counted.rename(columns={name: f"measured_{name}" for name in QUANTITIES})
    columns = [
        "track",
        "particle",
        "ending",
        *(f"measured_{name}" for name in QUANTITIES),
    ]
    names = {name: f"true_{name}" for name in ("ending", *QUANTITIES)}
    real = true.loc[true["whole"], ["particle", "measurable", *names]].rename(
        columns=names
    )
    both = real.merge(ours.loc[ours["longest"], columns], how="left", on="particle")
    false = ours.loc[ours["particle"] < 0, columns].assign(measurable=False)
    both = pd.concat([both, false], ignore_index=True)
    both[["ending", "true_ending"]] = both[["ending", "true_ending"]].fillna("")
    return both.assign(track=both["track"].fillna(-1).astype(np.int64))


def with_particles(measured: FlightTables) -> pd.DataFrame:
    """Return the accepted flights from the lance with the true particle of each.

    Returns
    -------
    DataFrame
        `kilnflight.tables.FLIGHTS` with ``track`` in place of ``particle``;
        ``particle`` is the true one (-1: none). ``longest`` marks the track of longest
        duration of each particle. ``dwell_s`` is NaN for lost flights.
    """
    flights = counted_flights(measured.flights)
    flights = flights.assign(dwell_s=flights["dwell_s"].mask(flights["ending"] == LOST))
    particle = flights["particle"].map(measured.particles).fillna(-1).astype(np.int64)
    length = (flights["last_s"] - flights["first_s"]).sort_values(kind="stable")
    last = ~particle.loc[length.index].duplicated(keep="last")
    flights = flights.rename(columns={"particle": "track"})
    return flights.assign(particle=particle, longest=last & (particle >= 0))


def matched(results: campaigns.Results) -> Iterator[tuple[Campaign, FlightTables]]:
    """Yield each campaign and its measured flights with their true particles."""
    for campaign in results.campaigns:
        tracks, _, flights, slices = (
            of_campaign(each, campaign.key) for each in results.tables
        )
        true = campaigns.true_positions(campaign)
        flights, slices = (table.drop(columns=KEYS) for table in (flights, slices))
        yield campaign, FlightTables(flights, slices, particle_of_track(tracks, true))


def compare_campaigns(results: campaigns.Results) -> pd.DataFrame:
    """Return `compare` of all campaigns, ``fraction`` and ``pressure_bar`` first."""
    return stack(
        {each.key: compare(ours, true_flights(each)) for each, ours in matched(results)}
    )


def errors(both: pd.DataFrame, seed: int = 0) -> dict[str, float]:
    """Return bias and spread of measured quantities, and counts of particles.

    Parameters
    ----------
    both
        From `compare`, of one campaign.
    seed
        Seed of the bootstrap.

    Returns
    -------
    dict
        Numbers of ``measurable_particles``, ``detected_particles`` and
        ``false_flights``; ``detected_low`` and ``detected_high``: 95 % interval
        (Wilson) of the share detected. For each of `QUANTITIES`, in its unit: ``_n``
        particles, ``_bias`` (median of measured minus true), ``_spread`` (half the
        range that holds 68 %), ``_low`` and ``_high`` (95 % bootstrap interval of the
        bias; NaN for fewer than six). ``lit`` and ``unlit``: detected particles that
        truly ignite or not; ``lit_detected``, ``unlit_detected``: those measured as
        ignited.
    """
    generator = np.random.default_rng(seed)
    real = both[(both["particle"] >= 0) & both["measurable"]]
    measured = real["track"] >= 0
    share = intervals.share(int(measured.sum()), len(real))
    row = {
        "measurable_particles": float(len(real)),
        "detected_particles": float(measured.sum()),
    }
    row |= {"false_flights": float((both["particle"] < 0).sum())}
    row |= {"detected_low": share.low, "detected_high": share.high}
    for name in QUANTITIES:
        off = (
            (real[f"measured_{name}"] - real[f"true_{name}"])
            .dropna()
            .to_numpy(np.float64)
        )
        low, bias, high = (
            np.quantile(off, [0.16, 0.5, 0.84]) if len(off) else 3 * (np.nan,)
        )
        ends = interval_columns(median_of(off, generator))
        row |= {f"{name}_n": float(len(off)), f"{name}_bias": bias}
        row |= {f"{name}_spread": (high - low) / 2}
        row |= {f"{name}_low": ends["low"], f"{name}_high": ends["high"]}
    lit = real["true_ignition_s"].notna()
    seen = real["measured_ignition_s"].notna()
    for name, kind in (("lit", measured & lit), ("unlit", measured & ~lit)):
        row |= {name: float(kind.sum()), f"{name}_detected": float((kind & seen).sum())}
    return row


def error_budget(results: campaigns.Results, jobs: int = 1) -> pd.DataFrame:
    """Return `errors` of each campaign and replaced step, in ``jobs`` processes.

    It shows which step of the chain causes the errors (notebook 56).

    Returns
    -------
    DataFrame
        ``fraction``, ``pressure_bar``, ``replaced_step`` (see `replace_steps`), the
        entries of `errors`; ``flights`` that count.
    """
    pieces = ((campaign, results.tables[:2]) for campaign in results.campaigns)
    parts = zip(results.campaigns, parallel.run_all(_budget, pieces, jobs), strict=True)
    return stack({campaign.key: part for campaign, part in parts})


def _budget(
    campaign: Campaign, measured: tuple[pd.DataFrame, pd.DataFrame]
) -> pd.DataFrame:
    """Return the rows of `error_budget` for one campaign, without its key.

    ``measured`` holds the tracks and the trajectories of all campaigns.
    """
    parts = (of_campaign(table, campaign.key).drop(columns=KEYS) for table in measured)
    tracks, trajectories = (part.reset_index(drop=True) for part in parts)
    true = true_flights(campaign)
    rows = []
    for step, tables in replace_steps(campaign, tracks, regression.fits(trajectories)):
        counted = len(counted_flights(tables.flights))
        rows.append(
            {"replaced_step": step, **errors(compare(tables, true)), "flights": counted}
        )
    return pd.DataFrame(rows)


def particle_of_track(tracks: pd.DataFrame, true: pd.DataFrame) -> pd.Series:
    """Return the true particle of each track, a Series over tracks; -1: none.

    It is the particle of most of the track's detections, if it has at least half of
    them. ``tracks`` has ``frame``, ``particle`` (the track), ``row`` and ``col`` (px);
    ``true`` has the same columns of true particles.
    """
    owner = true_particles(tracks, true)
    table = pd.DataFrame({"particle": tracks["particle"].to_numpy(), "owner": owner})
    count = (
        table[table["particle"] >= 0].value_counts(["particle", "owner"]).reset_index()
    )
    count["of"] = count.groupby("particle")["count"].transform("sum")
    best = count.sort_values(["particle", "count", "owner"]).groupby("particle").last()
    return best["owner"].where(2 * best["count"] >= best["of"], -1)


def replace_steps(
    campaign: Campaign, tracks: pd.DataFrame, measured: Fits
) -> Iterator[tuple[str, FlightTables]]:
    """Yield a name and the flights, with each step in turn replaced by truth.

    This shows where errors come from (notebook 56).

    Parameters
    ----------
    campaign
        A simulated recording.
    tracks
        Measured tracks: detections in the air with ``particle``, the track (-1: none).
    measured
        Fitted trajectory of each track.

    Yields
    ------
    tuple
        Names are "true positions and links"; "true links" (detections linked by their
        true particle); "true positions" (linked by the tracker); "true depth" (measured
        tracks with true x, y, z); "true trajectories" (fitted to true positions);
        "weighted axes" (measured tracks, axes weighted by 1 / `SCATTER_MM`; no truth);
        "whole chain" (nothing replaced).
    """
    true = campaigns.true_positions(campaign)
    run = campaign.run
    positions = true.assign(gray=np.where(true["label"] == 2, LIT_GRAY, UNLIT_GRAY))
    followed = postprocess(track(positions.drop(columns="particle"), run.tracker))
    linked, deep = with_truth(tracks, true_particles(tracks, true), true)
    ours = particle_of_track(tracks, true)
    exact = fit_tracks(run, positions)
    replaced = {name: exact[ours[name]] for name in measured if ours[name] in exact}
    cases = {
        "true positions and links": (
            positions,
            exact,
            particle_of_track(positions, true),
        ),
        "true links": (
            linked,
            fit_tracks(run, linked),
            particle_of_track(linked, true),
        ),
        "true positions": (
            followed,
            fit_tracks(run, followed),
            particle_of_track(followed, true),
        ),
        "true depth": (deep, fit_tracks(run, deep), ours),
        "true trajectories": (tracks, {**measured, **replaced}, ours),
        "weighted axes": (tracks, fit_tracks(run, tracks, SCATTER_MM), ours),
        WHOLE: (tracks, measured, ours),
    }
    for name, (table, trajectories, owners) in cases.items():
        flights = chain.flights_from(run, table, trajectories)
        yield (
            name,
            FlightTables(flights, chain.slices_from(flights, trajectories), owners),
        )


def with_truth(
    tracks: pd.DataFrame, owner: npt.NDArray[np.int64], true: pd.DataFrame
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return detections linked by true particle, and tracks with true x, y, z.

    ``owner`` (n,) is the true particle of each row of ``tracks``; with -1 (none) x, y,
    z stay as measured. In the first table x, y, z (mm) become NaN if the depth is off
    by at least the tracker's gate: such points belong to the background.
    """
    index = pd.MultiIndex.from_arrays([tracks["frame"], owner])
    places = (
        true.set_index(["frame", "particle"])[AXES]
        .reindex(index)
        .set_axis(tracks.index)
    )
    linked = tracks.assign(particle=owner)
    linked.loc[(tracks["z"] - places["z"]).abs() >= Gate().depth_mm, AXES] = np.nan
    return linked, tracks.assign(**places.fillna(tracks[AXES]))


def fit_tracks(
    run: Chain, table: pd.DataFrame, scale_mm: Three = (1.0, 1.0, 1.0)
) -> Fits:
    """Return the trajectory by track, each axis weighted by one over its scale.

    ``table`` holds tracks with ``frame``, ``particle`` and x, y, z in mm. RMSE, MAPE
    and R2 of a fit refer to the axes divided by ``scale_mm``; its coefficients are in
    mm/s^k.
    """
    assert run.exit_point_mm is not None  # every campaign of the twin has a lance
    rows = tracked(table)
    scaled = rows.assign(
        **{axis: rows[axis] / scale for axis, scale in zip(AXES, scale_mm, strict=True)}
    )
    exit_point = np.divide(run.exit_point_mm, scale_mm)
    fits = regression.fits(
        regression.regress_all(scaled, exit_point, run.frame_rate_hz)
    )
    for name, fit in fits.items():
        factors = zip(fit.coefficients, scale_mm, strict=True)
        fits[name] = replace(
            fit,
            exit_point_mm=run.exit_point_mm,
            coefficients=tuple(
                tuple(c * scale for c in axis) for axis, scale in factors
            ),
        )
    return fits
