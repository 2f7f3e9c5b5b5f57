"""Flights with one step of the chain after the other replaced by the truth."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight import kiln, regression
from kilnflight.checks import InputError
from kilnflight.experiments.campaigns import Campaign, Measurement
from kilnflight.experiments.results import KEYS, of_campaign, twin_of
from kilnflight.experiments.tracking import true_particles
from kilnflight.kiln import KilnRun
from kilnflight.project.parallel import Workers
from kilnflight.regression import Regression
from kilnflight.scores.flights import METRES
from kilnflight.tracking.gate import Gate
from kilnflight.tracking.tracker import track
from kilnflight.tracklets import postprocess, tracked
from kilnflight.twin.truth import true_trajectories, velocities

UNLIT_GRAY, LIT_GRAY = 1000.0, 2000.0  # stand for the grey values where positions are true
STEPS = (
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
    over = release + flights.end_s * rate
    each = velocities(flights)
    table = twin.life.table[["particle"]].assign(ending=twin.life.table["end"])
    ended = table["ending"].isin(["landed", "burnt out"])
    table = table.assign(
        dwell_s=np.where(ended, flights.end_s, np.nan),
        velocity_m_s=each[:, 0],
        **{f"velocity_{metre}_m_s": each[:, k] for k, metre in enumerate(METRES)},
        ignition_s=flights.ignition_s,
        whole=(release >= frames.start) & (over < frames.stop),
        measurable=table["particle"].isin(true_positions(campaign)["particle"]),
    )
    return table[(release < frames.stop) & (over > frames.start)].reset_index(drop=True)


def true_positions(campaign: Campaign) -> pd.DataFrame:
    """Return where a person would see which particle in the air, kept."""
    return true_trajectories(twin_of(campaign), campaign.frames)


def prepare_truth(campaigns: Sequence[Campaign], workers: Workers) -> None:
    """Make the `true_positions` of all campaigns, several at a time."""
    workers(true_positions, list(campaigns), [len(one.frames) for one in campaigns], "truth")


def particle_of_track(tracks: pd.DataFrame, owner: npt.NDArray[np.int64]) -> pd.Series:
    """Return the true particle by track: whose most of its detections are, and at least half."""
    table = pd.DataFrame({"particle": tracks["particle"].to_numpy(), "owner": owner})
    table = table[table["particle"] >= 0]
    count = table.groupby(["particle", "owner"]).size().reset_index(name="number")
    count["of"] = count.groupby("particle")["number"].transform("sum")
    best = count.sort_values(["particle", "number"]).drop_duplicates("particle", keep="last")
    known = best["number"] * 2 >= best["of"]
    return best["owner"].where(known, -1).set_axis(best["particle"].to_numpy())


def replace_steps(
    campaign: Campaign, tracks: pd.DataFrame, fits: Mapping[int, regression.Fit] | None = None
) -> Iterator[tuple[str, FlightTables]]:
    """Yield the flights with one step after the other replaced by the truth; `STEPS`.

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
    lit = np.where(true["label"] == 2, LIT_GRAY, UNLIT_GRAY)
    positions = true.assign(gray=lit)
    owner = true_particles(tracks, true)
    belongs, exact = particle_of_track(tracks, owner), fit_tracks(run, positions)
    known = link_by_truth(tracks, owner, true)
    followed = postprocess(track(positions.drop(columns="particle"), run.tracker))
    deep = with_true_depth(tracks, owner, true)
    measured = fit_tracks(run, tracks) if fits is None else fits
    replaced = {name: exact[belongs[name]] for name in measured if belongs[name] in exact}
    weighted, robust = (
        fit_tracks(replace(run, regression=one), tracks) for one in (WEIGHTED, ROBUST)
    )
    each = (
        (positions, exact, _particles(positions, true)),
        (known, fit_tracks(run, known), particle_of_track(known, owner)),
        (followed, fit_tracks(run, followed), _particles(followed, true)),
        (deep, fit_tracks(run, deep), belongs),
        (tracks, {**measured, **replaced}, belongs),
        (tracks, weighted, belongs),
        (tracks, robust, belongs),
        (tracks, measured, belongs),
    )
    for name, (table, trajectories, particles) in zip(STEPS, each, strict=True):
        flights = kiln.flights_from(run, table, trajectories)
        yield name, FlightTables(flights, kiln.slices_from(flights, trajectories), particles)


def _particles(tracks: pd.DataFrame, true: pd.DataFrame) -> pd.Series:
    return particle_of_track(tracks, true_particles(tracks, true))


def link_by_truth(
    tracks: pd.DataFrame, owner: npt.NDArray[np.int64], true: pd.DataFrame
) -> pd.DataFrame:
    """Return the detections with their true particle, without the depths that are another's.

    A detection belongs to a particle by its place in the image; a depth that is off by more
    than the tracker's gate lets pass is that of something behind it, and left out.
    """
    place = true.set_index(["frame", "particle"])["z"]
    index = pd.MultiIndex.from_arrays([tracks["frame"], owner])
    off = np.abs(tracks["z"].to_numpy(np.float64) - place.reindex(index).to_numpy(np.float64))
    known = tracks.assign(particle=owner)
    known.loc[off >= Gate().depth_mm, ["x", "y", "z"]] = np.nan
    return known


def with_true_depth(
    tracks: pd.DataFrame, owner: npt.NDArray[np.int64], true: pd.DataFrame
) -> pd.DataFrame:
    """Return the tracks with the true place in space wherever a detection belongs to someone."""
    place = true.set_index(["frame", "particle"])[["x", "y", "z"]]
    index = pd.MultiIndex.from_arrays([tracks["frame"], owner])
    found = place.reindex(index).to_numpy(np.float64)
    measured = tracks[["x", "y", "z"]].to_numpy(np.float64)
    better = np.where(np.isnan(found), measured, found)
    return tracks.assign(**{axis: better[:, k] for k, axis in enumerate("xyz")})


def fit_tracks(run: KilnRun, table: pd.DataFrame) -> dict[int, regression.Fit]:
    """Return the trajectories by track of a table that did not come from the chain."""
    if run.exit_point_mm is None:
        raise InputError(f"{run.detection.source.name}: the lance's exit is not known.")
    rate, method = run.frame_rate_hz, run.regression
    return regression.fits(regression.regress_all(tracked(table), run.exit_point_mm, rate, method))


def flights_above_background(campaigns: Sequence[Campaign], measured: Measurement) -> pd.DataFrame:
    """Return the flights with ignition read from grey values above the background.

    `kilnflight.kiln.background_gray` says what that is; it uses only pictures, no truth.
    """
    parts = []
    for campaign in campaigns:
        key = campaign.key
        tracks, fits = (of_campaign(table, key).drop(columns=KEYS) for table in measured[:2])
        rules = replace(campaign.run.rules, above_background=True)
        run = replace(campaign.run, rules=rules)
        flights = kiln.flights_from(run, tracks, regression.fits(fits))
        flights.insert(0, "fraction", campaign.fraction)
        flights.insert(1, "pressure_bar", campaign.pressure_bar)
        parts.append(flights)
    return pd.concat(parts, ignore_index=True)
