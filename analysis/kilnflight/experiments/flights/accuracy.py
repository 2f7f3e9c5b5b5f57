"""Errors of measured flights beside the truth.

measured flights, true flights -> `compare` -> `errors`: share detected, bias, spread
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pandas as pd
from pandas import DataFrame, Series

from kilnflight.arrays import Numbers
from kilnflight.experiments.flights import campaigns
from kilnflight.experiments.flights.campaigns import Campaign, counted_flights, stack
from kilnflight.experiments.flights.comparison import median_columns
from kilnflight.experiments.flights.tracking import true_particles
from kilnflight.flight import BURNT_OUT, LANDED, LOST
from kilnflight.scores import intervals
from kilnflight.simulated.kiln.truth import metre_velocities
from kilnflight.tracklets import tracked

QUANTITIES = {"dwell_s": "s", "velocity_m_s": "m/s", "ignition_s": "s"}


class FlightTables(NamedTuple):
    """Measured flights of one campaign, by the whole chain or with a step replaced."""

    flights: DataFrame  # `kilnflight.tables.FLIGHTS`
    slices: DataFrame  # `kilnflight.tables.SLICES`
    particles: Series  # index: track; value: its true particle, -1: none


def true_flights(campaign: Campaign) -> DataFrame:
    """Return the true flights within the frames of a campaign, one row per particle.

    Returns
    -------
    DataFrame
        ``particle``; ``true_ending``; ``true_dwell_s`` (NaN if it neither landed nor
        burnt out); ``true_velocity_m_s`` within the first metre; ``true_ignition_s``
        after the release (NaN: never); ``measurable``: visible in the air at five
        positions or more (`kilnflight.experiments.flights.campaigns.true_positions`).
    """
    life = campaigns.twin_of(campaign).life
    particle = life.table["particle"]
    ending = life.table["end"]
    table = DataFrame(
        {
            "particle": particle,
            "measurable": particle.isin(campaigns.true_positions(campaign)["particle"]),
            "true_ending": ending,
            "true_dwell_s": life.table["end_s"].where(ending.isin([LANDED, BURNT_OUT])),
            "true_velocity_m_s": metre_velocities(life.flights)[:, 0],
            "true_ignition_s": life.table["ignition_s"],
        }
    )
    return table[campaigns.whole_flights(campaign)]


def compare(measured: FlightTables, true: DataFrame) -> DataFrame:
    """Return measured beside true values, a row per particle and false flight.

    False flights belong to no particle and come last.

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
    ours["velocity_m_s"] = ours["track"].map(velocity)
    ours = ours.set_index(["track", "particle", "ending"])[[*QUANTITIES]]
    ours = ours.add_prefix("measured_").reset_index()
    false = ours[ours["particle"] < 0].assign(measurable=False)
    both = pd.concat([true.merge(ours, "left", "particle"), false], ignore_index=True)
    both = both.fillna({"track": -1, "ending": "", "true_ending": ""})
    return both.astype({"track": np.int64})


def with_particles(measured: FlightTables) -> DataFrame:
    """Return the longest accepted flight of each true particle, and the false flights.

    Returns
    -------
    DataFrame
        `kilnflight.tables.FLIGHTS` with ``track`` in place of ``particle``;
        ``particle`` is the true one (-1: none). ``dwell_s`` is NaN for lost flights.
    """
    flights = counted_flights(measured.flights).rename(columns={"particle": "track"})
    particle = flights["track"].map(measured.particles)
    dwell_s = flights["dwell_s"].mask(flights["ending"] == LOST)
    flights = flights.assign(particle=particle, dwell_s=dwell_s)
    length = (flights["last_s"] - flights["first_s"]).sort_values(kind="stable")
    shorter = particle[length.index].duplicated(keep="last")
    return flights[~shorter | (particle < 0)]


def matched(results: campaigns.Results) -> Iterator[tuple[Campaign, FlightTables]]:
    """Yield each campaign and its measured flights with their true particles."""
    for campaign in results.campaigns:
        tables = results.tables.of(campaign.key)
        true = campaigns.true_positions(campaign)
        particles = particle_of_track(tables.tracks, true)
        yield campaign, FlightTables(tables.flights, tables.slices, particles)


def compare_campaigns(results: campaigns.Results) -> DataFrame:
    """Return `compare` of all campaigns, ``fraction`` and ``pressure_bar`` first."""
    return stack(
        {each.key: compare(ours, true_flights(each)) for each, ours in matched(results)}
    )


def errors(both: DataFrame, seed: int = 0) -> Numbers:
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
    row: Numbers = {
        "measurable_particles": len(real),
        "detected_particles": measured.sum(),
        "false_flights": (both["particle"] < 0).sum(),
        "detected_low": share.low,
        "detected_high": share.high,
    }
    for name in QUANTITIES:
        off = real[f"measured_{name}"] - real[f"true_{name}"]
        low, high = off.quantile([0.16, 0.84])
        median = median_columns(off, generator)
        row[f"{name}_n"] = median["number"]
        row[f"{name}_bias"] = median["estimate"]
        row[f"{name}_spread"] = (high - low) / 2
        row[f"{name}_low"] = median["low"]
        row[f"{name}_high"] = median["high"]
    lit = real["true_ignition_s"].notna()
    seen = real["measured_ignition_s"].notna()
    for name, kind in (("lit", measured & lit), ("unlit", measured & ~lit)):
        row |= {name: kind.sum(), f"{name}_detected": (kind & seen).sum()}
    return row


def particle_of_track(tracks: DataFrame, true: DataFrame) -> Series:
    """Return the true particle of each track, a Series over tracks; -1: none.

    It is the particle of most of the track's detections, if it has at least half of
    them. ``tracks`` has ``frame``, ``particle`` (the track), ``row`` and ``col`` (px);
    ``true`` has the same columns of true particles.
    """
    owned = tracked(tracks.assign(owner=true_particles(tracks, true)))
    shares = owned.groupby("particle")["owner"].value_counts(normalize=True)
    table = shares.reset_index("owner")
    owner = table["owner"].where(table["proportion"] >= 0.5, -1)
    return owner.groupby("particle").max()
