"""Errors of measured flights: bias, spread, which particles were measured at all."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import joblib
import numpy as np
import pandas as pd

from kilnflight import ignition
from kilnflight.experiments.campaigns import Campaign, Measurement
from kilnflight.experiments.error_budget import (
    FlightTables,
    particle_of_track,
    replace_steps,
    true_flights,
    true_positions,
)
from kilnflight.experiments.results import KEYS, CampaignKey, of_campaign
from kilnflight.experiments.tracking import true_particles
from kilnflight.flight import BURNT_OUT, LANDED, LOST
from kilnflight.regression import fits
from kilnflight.scores import intervals
from kilnflight.scores.flights import METRES, FlightValues, quartiles

CASES = ("landed unlit", "landed burning", BURNT_OUT)  # (a), (b) and (c) of Fig. 5.18
QUANTITIES = {"dwell_s": "s", "velocity_m_s": "m/s", "ignition_s": "s"}


def compare(measured: FlightTables, true: pd.DataFrame) -> pd.DataFrame:
    """Return measured beside true, one row per true particle whose whole flight is recorded.

    Of several tracks of a particle the longest in time counts. False flights, which start at
    the lance and belong to no particle, come last, without truth.

    Parameters
    ----------
    measured
        Flights that were worked out in one way.
    true
        `kilnflight.experiments.error_budget.true_flights`.

    Returns
    -------
    DataFrame
        ``particle`` (-1: a false flight), ``measurable`` (whether a person could have followed
        it), ``track`` (-1: none), ``ending`` and ``true_ending``, and ``measured_`` and ``true_``
        of `QUANTITIES`.
    """
    counted = _from_lance(measured.flights, measured.particles)
    slices = measured.slices
    first = slices[slices["slice_m"] == 1.0].set_index("particle")["velocity_m_s"]
    velocity = counted["track"].map(first).astype(np.float64)
    table = counted[["track", "particle", "ending"]].assign(
        measured_dwell_s=counted["dwell_s"],
        measured_velocity_m_s=velocity,
        measured_ignition_s=counted["ignition_s"],
    )
    known = {name: f"true_{name}" for name in ("ending", *QUANTITIES)}
    there = true.loc[true["whole"], ["particle", "measurable", *known]].rename(columns=known)
    both = there.merge(table[counted["longest"]], how="left", on="particle")
    false = table[table["particle"] < 0].assign(measurable=False)
    both = pd.concat([both, false], ignore_index=True)
    both[["ending", "true_ending"]] = both[["ending", "true_ending"]].fillna("")
    return both.assign(track=both["track"].fillna(-1).astype(np.int64))


def _from_lance(flights: pd.DataFrame, particles: pd.Series) -> pd.DataFrame:
    """Return the flights from the lance by length, with ``track`` and true ``particle``.

    ``longest``: the longest track of a particle; -1 is no particle.
    """
    counted = flights[flights["from_lance"]].rename(columns={"particle": "track"})
    particle = counted["track"].map(particles).fillna(-1).astype(np.int64)
    counted = counted.assign(particle=particle)
    length = (counted["last_s"] - counted["first_s"]).sort_values(kind="stable")
    last = ~particle.loc[length.index].duplicated(keep="last")
    return counted.assign(longest=last & (particle >= 0))


def compare_campaigns(campaigns: Sequence[Campaign], measured: Measurement) -> pd.DataFrame:
    """Return `compare` of the measurement as it is, with fraction and pressure in front."""
    parts = [
        _with_key(compare(tables, true_flights(campaign)), campaign)
        for campaign, tables in _with_particles(campaigns, measured)
    ]
    return pd.concat(parts, ignore_index=True)


def _with_particles(
    campaigns: Sequence[Campaign], measured: Measurement
) -> Iterator[tuple[Campaign, FlightTables]]:
    """Yield each campaign with its flights, its slices and the true particles of its tracks."""
    for campaign in campaigns:
        tracks, _, flights, slices = (of_campaign(table, campaign.key) for table in measured)
        owner = true_particles(tracks.reset_index(drop=True), true_positions(campaign))
        yield campaign, FlightTables(flights, slices, particle_of_track(tracks, owner))


def _with_key(table: pd.DataFrame, campaign: Campaign) -> pd.DataFrame:
    table.insert(0, "fraction", campaign.fraction)
    table.insert(1, "pressure_bar", campaign.pressure_bar)
    return table


def ending_table(both: pd.DataFrame) -> pd.DataFrame:
    """Return how flights end by how they truly do (Fig. 5.18), in particles.

    Parameters
    ----------
    both
        `compare_campaigns`.

    Returns
    -------
    DataFrame
        ``fraction``, ``pressure_bar``, ``true``; ``landed unlit``, ``landed burning``, ``burnt
        out`` and ``lost`` as measured, and ``not measured``.
    """
    real = both[both["particle"] >= 0]
    true = ending_cases(real["true_ending"], real["true_ignition_s"].notna()).rename("true")
    measured = ending_cases(real["ending"], real["measured_ignition_s"].notna())
    measured = measured.where(real["track"] >= 0, "not measured")
    table = pd.crosstab([real["fraction"], real["pressure_bar"], true], measured)
    columns = [*CASES, LOST, "not measured"]
    return table.reindex(columns=columns, fill_value=0).rename_axis(columns=None).reset_index()


def ending_cases(ending: pd.Series, lit: pd.Series) -> pd.Series:
    """Return `CASES` of endings, by whether a particle burnt; other endings stay."""
    landed = lit.map({False: CASES[0], True: CASES[1]})
    return ending.where(ending != LANDED, landed)


def count_endings(measured: Measurement) -> pd.DataFrame:
    """Return how measured flights end by campaign, and how many do not start at the lance."""
    counted = measured.flights[measured.flights["from_lance"]]
    lit = counted["ignition"].isin([ignition.SEEN, ignition.BEFORE])
    ends = pd.crosstab([counted[key] for key in KEYS], ending_cases(counted["ending"], lit))
    left_out = measured.flights.assign(left_out=~measured.flights["from_lance"])
    table = left_out.groupby(KEYS)[["left_out"]].sum().reset_index()
    table = table.rename(columns={"left_out": "left out: not from the lance"})
    return table.merge(ends.reset_index(), how="left", on=KEYS).fillna(0)


def dwell_times(measured: Measurement, both: pd.DataFrame) -> pd.DataFrame:
    """Return the dwell times of Fig. 5.19: measured of all flights, true of all particles.

    Parameters
    ----------
    measured
        The campaigns.
    both
        `compare_campaigns`.

    Returns
    -------
    DataFrame
        ``fraction``, ``pressure_bar``, ``track``, ``measured_s``, ``ending``, ``particle`` (-1:
        of no whole flight), ``true_s``, ``true_ending``; empty where there is none.
    """
    flights = measured.flights[measured.flights["from_lance"]]
    flights = flights.rename(columns={"particle": "track", "dwell_s": "measured_s"})
    truth = both.rename(columns={"true_dwell_s": "true_s"})
    data = flights[[*KEYS, "track", "measured_s", "ending"]].merge(
        truth[[*KEYS, "track", "particle", "true_s", "true_ending"]], "outer", [*KEYS, "track"]
    )
    return data.fillna({"particle": -1}).astype({"particle": int})


def ignition_errors(both: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Return where ignition was detected, and the errors of its time, by reading and campaign."""
    rows = [
        {"reading": reading, **dict(zip(KEYS, key, strict=True)), **errors(one)}
        for reading, table in both.items()
        for key, one in table.groupby(KEYS, sort=False)
    ]
    columns = ["reading", *KEYS, "found", "lit", "lit_told", "unlit", "unlit_told"]
    columns += ["ignition_s_n", "ignition_s_bias", "ignition_s_spread"]
    return pd.DataFrame(rows).reindex(columns=columns)


def ignition_times(both: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Return measured and true ignition times of every particle (Figs 5.25 and 5.26)."""
    names = {"measured_ignition_s": "measured_s", "true_ignition_s": "true_s"}
    first, other = both["as published"].rename(columns=names), both["above background"]
    times = other["measured_ignition_s"].to_numpy()
    data = first.assign(measured_above_background_s=times, found=first["track"] >= 0)
    columns = ["particle", "measured_s", "true_s", "measured_above_background_s", "found"]
    return data[[*KEYS, *columns]]


def accuracy_in_words(
    whole: pd.DataFrame,
    found: Mapping[CampaignKey, FlightValues],
    true: Mapping[CampaignKey, FlightValues],
) -> pd.DataFrame:
    """Return the main table of accuracy as text: found, bias, interval and spread by campaign.

    Parameters
    ----------
    whole
        Rows of the `error_budget` of the whole chain.
    found, true
        Results by campaign.
    """
    rows = []
    for one in whole.to_dict("records"):
        key = one["fraction"], one["pressure_bar"]
        share = f"[{one['found_low']:.2f}, {one['found_high']:.2f}]"
        row = dict(zip(KEYS, key, strict=True))
        row["found"] = f"{one['found']:.0f} of {one['true']:.0f} {share}"
        for name, unit in QUANTITIES.items():
            short = f"{name.removesuffix('_s').removesuffix('_m')} ({unit})"
            bias, low, high, spread = (
                one[f"{name}_{what}"] for what in ("bias", "low", "high", "spread")
            )
            text = f"{bias:+.3f} [{low:+.3f}, {high:+.3f}] +- {spread:.3f}"
            row[short] = text if one[f"{name}_n"] else ""
        ours, real = (quartiles(results[key].dwell_s)[1] for results in (found, true))
        row["cell's dwell (s)"] = f"{ours:.3f}, true {real:.3f}"
        row["false flights"] = f"{one['spurious']:.0f} of {one['flights']:.0f}"
        row["ignition detected, rightly"] = f"{one['lit_told']:.0f} of {one['lit']:.0f}"
        row["detected of the unlit"] = f"{one['unlit_told']:.0f} of {one['unlit']:.0f}"
        rows.append(row)
    return pd.DataFrame(rows)


def compare_velocities(campaigns: Sequence[Campaign], measured: Measurement) -> pd.DataFrame:
    """Return the velocity in each metre, measured and true, one row per particle and metre.

    Of several tracks of a particle the longest in time counts.

    Returns
    -------
    DataFrame
        ``fraction``, ``pressure_bar``, ``particle`` (-1: a false flight), ``slice_m``,
        ``measured_m_s``, ``true_m_s`` (NaN where there is none).
    """
    parts = []
    for campaign, (flights, slices, particles) in _with_particles(campaigns, measured):
        counted = _from_lance(flights, particles)
        shorter = counted.loc[(counted["particle"] >= 0) & ~counted["longest"], "track"]
        table = slices.loc[~slices["particle"].isin(shorter), ["particle", "slice_m"]]
        table["particle"] = table["particle"].map(particles).fillna(-1).astype(np.int64)
        table["measured_m_s"] = slices["velocity_m_s"]
        true = true_flights(campaign)
        columns = {f"velocity_{metre}_m_s": float(metre) for metre in METRES}
        wide = true[true["whole"]].rename(columns=columns)
        tall = wide.melt("particle", list(columns.values()), "slice_m", "true_m_s").dropna()
        tall = tall.astype({"slice_m": np.float64})
        both = table.merge(tall, how="outer", on=["particle", "slice_m"])
        parts.append(both.assign(fraction=campaign.fraction, pressure_bar=campaign.pressure_bar))
    return pd.concat(parts, ignore_index=True)


def errors(both: pd.DataFrame, seed: int = 0) -> dict[str, float]:
    """Return number, bias and spread of each quantity, and where ignition was detected.

    Bias is the median of measured minus true, spread half the range that holds 68 % of it,
    over particles of which both are known; ``low`` and ``high`` are the 95 % interval of the
    bias (bootstrap over particles; NaN of fewer than six), and of the share that was found
    (Wilson).

    Parameters
    ----------
    both
        `compare`.
    seed
        Of the bootstrap.
    """
    generator = np.random.default_rng(seed)
    real = both[(both["particle"] >= 0) & both["measurable"]]
    found = real["track"] >= 0
    share = intervals.share(int(found.sum()), len(real))
    row = {
        "true": float(len(real)),
        "found": float(found.sum()),
        "spurious": float((both["particle"] < 0).sum()),
        "found_low": share.low,
        "found_high": share.high,
    }
    for name in QUANTITIES:
        off = (real[f"measured_{name}"] - real[f"true_{name}"]).dropna().to_numpy(np.float64)
        low, bias, high = np.quantile(off, [0.16, 0.5, 0.84]) if len(off) else 3 * (np.nan,)
        row |= {f"{name}_n": float(len(off)), f"{name}_bias": bias}
        row[f"{name}_spread"] = (high - low) / 2
        interval = intervals.Bootstrap()(np.median, [off], generator)
        for side in ("low", "high"):
            bound = getattr(interval, side)
            row[f"{name}_{side}"] = bound if np.isfinite(bound) else np.nan
    lit = real["true_ignition_s"].notna()
    detected = real["measured_ignition_s"].notna()
    for name, kind in (("lit", found & lit), ("unlit", found & ~lit)):
        row |= {name: float(kind.sum()), f"{name}_told": float((kind & detected).sum())}
    return row


def account_flights(measured: FlightTables, true: pd.DataFrame) -> dict[str, int]:
    """Return what became of every flight that starts at the lance; the parts add up.

    Returns
    -------
    dict
        ``flights``; of these ``found`` (the longest of a measurable particle whose whole
        flight is recorded), ``duplicates`` (further ones of any particle), ``cut`` (of a
        particle that flies on before or after the recording, or that no person could follow)
        and ``spurious`` (false flights).
    """
    particle = _from_lance(measured.flights, measured.particles)["particle"]
    good = true.loc[true["whole"] & true["measurable"], "particle"]
    known = particle[particle >= 0]
    first = known.drop_duplicates()
    found = int(first.isin(good).sum())
    return {
        "flights": len(particle),
        "found": found,
        "duplicates": len(known) - len(first),
        "cut": len(first) - found,
        "spurious": int((particle < 0).sum()),
    }


def error_budget(
    campaigns: Sequence[Campaign], measured: Measurement, jobs: int = 1
) -> pd.DataFrame:
    """Return `errors` of every campaign and way of `replace_steps`, in `jobs` processes."""
    rows = joblib.Parallel(n_jobs=jobs)(
        joblib.delayed(_campaign_budget)(
            campaign, *(of_campaign(table, campaign.key) for table in measured[:2])
        )
        for campaign in campaigns
    )
    return pd.DataFrame([row for part in rows for row in part])


def _campaign_budget(
    campaign: Campaign, tracks: pd.DataFrame, trajectories: pd.DataFrame
) -> list[dict[str, object]]:
    """Return the rows of one campaign, given its tracks and their trajectories."""
    tracks = tracks.drop(columns=KEYS).reset_index(drop=True)
    true = true_flights(campaign)
    return [
        {
            **dict(zip(KEYS, campaign.key, strict=True)),
            "way": name,
            **errors(compare(flights, true)),
            **account_flights(flights, true),
        }
        for name, flights in replace_steps(campaign, tracks, fits(trajectories.drop(columns=KEYS)))
    ]
