"""Errors of measured flights, also with each step of the chain replaced by the truth.

measured flights, true flights -> `compare` -> `errors`: share detected, bias, spread
"""

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
    Campaign,
    Measurement,
    counted_flights,
    stack,
)
from kilnflight.experiments.flights.comparison import median_columns
from kilnflight.experiments.flights.tracking import true_particles
from kilnflight.flight import BURNT_OUT, LANDED, LOST
from kilnflight.regression import Three
from kilnflight.scores import intervals
from kilnflight.simulated.kiln.geometry import FULL_SCALE
from kilnflight.simulated.kiln.truth import metre_velocities
from kilnflight.store import parallel
from kilnflight.tracking.filter import Gate
from kilnflight.tracking.tracker import track
from kilnflight.tracklets import postprocess, tracked

Fits = dict[int, regression.Fit]
QUANTITIES = {"dwell_s": "s", "velocity_m_s": "m/s", "ignition_s": "s"}
# Grey values of true positions are below and above that of the wall.
UNLIT_GRAY = 1000.0
LIT_GRAY = FULL_SCALE
SCATTER_MM = (6.9, 7.0, 156.9)  # RMSE in x, y, z (Table 5.18), medians over fractions
WHOLE = "whole chain"
AXES = ["x", "y", "z"]


class FlightTables(NamedTuple):
    """Measured flights of one campaign, by the whole chain or with a step replaced."""

    flights: pd.DataFrame  # `kilnflight.tables.FLIGHTS`
    slices: pd.DataFrame  # `kilnflight.tables.SLICES`
    particles: pd.Series  # index: track; value: its true particle, -1: none


def true_flights(campaign: Campaign) -> pd.DataFrame:
    """Return the true flights within the frames of a campaign, one row per particle.

    Returns
    -------
    DataFrame
        ``particle``; ``ending``; ``dwell_s`` (NaN if it neither landed nor burnt out);
        ``velocity_m_s`` within the first metre; ``ignition_s`` after the release (NaN:
        never); ``measurable``: visible in the air at five positions or more
        (`kilnflight.simulated.kiln.truth.true_trajectories`).
    """
    life = campaigns.twin_of(campaign).life
    names = {"end": "ending", "end_s": "dwell_s"}
    table = life.table[["particle", *names, "ignition_s"]].rename(columns=names)
    complete = table["ending"].isin([LANDED, BURNT_OUT])
    seen = campaigns.true_positions(campaign)["particle"]
    table = table.assign(
        dwell_s=table["dwell_s"].where(complete),
        velocity_m_s=metre_velocities(life.flights)[:, 0],
        measurable=table["particle"].isin(seen),
    )
    return table[campaigns.whole_flights(campaign)].reset_index(drop=True)


def compare(measured: FlightTables, true: pd.DataFrame) -> pd.DataFrame:
    """Return measured beside true values, a row per particle and false flight.

    A particle with several tracks is represented by the longest. False flights belong
    to no particle and come last.

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
    first = measured.slices[measured.slices["slice_m"] == 1.0]
    velocity = first.set_index("particle")["velocity_m_s"]
    ours = with_particles(measured)
    ours["velocity_m_s"] = ours["track"].map(velocity).astype(np.float64)
    ours = ours.set_index(["track", "particle", "ending", "longest"])[[*QUANTITIES]]
    ours = ours.add_prefix("measured_").reset_index()
    longest = ours.pop("longest")
    real = true.set_index(["particle", "measurable"])[["ending", *QUANTITIES]]
    real = real.add_prefix("true_").reset_index()
    both = real.merge(ours[longest], how="left", on="particle")
    false = ours[ours["particle"] < 0].assign(measurable=False)
    both = pd.concat([both, false], ignore_index=True)
    return both.fillna({"track": -1, "ending": "", "true_ending": ""}).astype(
        {"track": np.int64}
    )


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
        tables = results.tables.of(campaign.key)
        true = campaigns.true_positions(campaign)
        yield (
            campaign,
            FlightTables(
                flights=tables.flights,
                slices=tables.slices,
                particles=particle_of_track(tables.tracks, true),
            ),
        )


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
        "measurable_particles": len(real),
        "detected_particles": measured.sum(),
        "false_flights": (both["particle"] < 0).sum(),
        "detected_low": share.low,
        "detected_high": share.high,
    }
    for name in QUANTITIES:
        off = real[f"measured_{name}"] - real[f"true_{name}"]
        found = _bias(off.dropna(), generator)
        row |= {f"{name}_{kind}": value for kind, value in found.items()}
    lit = real["true_ignition_s"].notna()
    seen = real["measured_ignition_s"].notna()
    for name, kind in (("lit", measured & lit), ("unlit", measured & ~lit)):
        row |= {name: kind.sum(), f"{name}_detected": (kind & seen).sum()}
    return {name: float(value) for name, value in row.items()}


def _bias(off: pd.Series, generator: np.random.Generator) -> dict[str, float]:
    """Return number, bias, spread, and the interval of the bias of measured - true."""
    low, bias, high = off.quantile([0.16, 0.5, 0.84])
    ends = median_columns(off, generator)
    return {
        "n": len(off),
        "bias": bias,
        "spread": (high - low) / 2,
        "low": ends["low"],
        "high": ends["high"],
    }


def error_budget(results: campaigns.Results, jobs: int = 1) -> pd.DataFrame:
    """Return `errors` of each campaign and replaced step, in ``jobs`` processes.

    It shows which step of the chain causes the errors (notebook 56).

    Returns
    -------
    DataFrame
        ``fraction``, ``pressure_bar``, ``replaced_step`` (see `replace_steps`), the
        entries of `errors`; ``flights`` that count.
    """
    pieces = [(each, results.tables.of(each.key)) for each in results.campaigns]
    parts = parallel.run_all(_budget, pieces, jobs)
    keys = [each.key for each in results.campaigns]
    return stack(dict(zip(keys, parts, strict=True)))


def _budget(campaign: Campaign, measured: Measurement) -> pd.DataFrame:
    """Return the rows of `error_budget` for one campaign, without its key."""
    true = true_flights(campaign)
    rows = []
    for step, tables in replace_steps(
        campaign, measured.tracks, regression.fits(measured.trajectories)
    ):
        found = errors(compare(tables, true))
        flights = len(counted_flights(tables.flights))
        rows.append({"replaced_step": step, **found, "flights": flights})
    return pd.DataFrame(rows)


def particle_of_track(tracks: pd.DataFrame, true: pd.DataFrame) -> pd.Series:
    """Return the true particle of each track, a Series over tracks; -1: none.

    It is the particle of most of the track's detections, if it has at least half of
    them. ``tracks`` has ``frame``, ``particle`` (the track), ``row`` and ``col`` (px);
    ``true`` has the same columns of true particles.
    """
    owner = true_particles(tracks, true)
    table = pd.DataFrame({"particle": tracks["particle"].to_numpy(), "owner": owner})
    pairs = table[table["particle"] >= 0].value_counts(["particle", "owner"])
    count = pairs.reset_index().sort_values(["particle", "count", "owner"])
    by_track = count.groupby("particle")
    best = by_track.last()
    return best["owner"].where(2 * best["count"] >= by_track["count"].sum(), -1)


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
    exact = fit_tracks(run, positions)
    ours = particle_of_track(tracks, true)
    replaced = {name: exact[ours[name]] for name in measured if ours[name] in exact}
    cases = (
        ("true positions and links", positions, exact),
        ("true links", linked, fit_tracks(run, linked)),
        ("true positions", followed, fit_tracks(run, followed)),
        ("true depth", deep, fit_tracks(run, deep)),
        ("true trajectories", tracks, measured | replaced),
        ("weighted axes", tracks, fit_tracks(run, tracks, SCATTER_MM)),
        (WHOLE, tracks, measured),
    )
    for step, table, fits in cases:
        flights = chain.flights_from(run, table, fits)
        yield (
            step,
            FlightTables(
                flights=flights,
                slices=chain.slices_from(flights, fits),
                particles=particle_of_track(table, true),
            ),
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
    places = true.set_index(["frame", "particle"])[AXES].reindex(index)
    places.index = tracks.index
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
    scaled = rows.assign(**(rows[AXES] / list(scale_mm)))
    exit_point = np.divide(run.exit_point_mm, scale_mm)
    fits = regression.fits(
        regression.regress_all(scaled, exit_point, run.frame_rate_hz)
    )
    for name, fit in fits.items():
        axes = zip(fit.coefficients, scale_mm, strict=True)
        fits[name] = replace(
            fit,
            exit_point_mm=run.exit_point_mm,
            coefficients=tuple(tuple(c * scale for c in axis) for axis, scale in axes),
        )
    return fits
