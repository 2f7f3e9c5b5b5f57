"""Errors of measured flights."""

from __future__ import annotations

from collections.abc import Sequence

import joblib
import numpy as np
import pandas as pd

from kilnflight.experiments.campaigns import Campaign, Measurement
from kilnflight.experiments.error_budget import (
    FlightTables,
    particle_of_track,
    replace_steps,
    true_flights,
    true_particles,
    true_positions,
)
from kilnflight.experiments.results import KEYS, of_campaign
from kilnflight.flight import BURNT_OUT, LANDED, LOST
from kilnflight.regression import fits
from kilnflight.scores import intervals
from kilnflight.scores.flights import METRES

CASES = ("landed unlit", "landed burning", BURNT_OUT)  # (a), (b) and (c) of Fig. 5.18
QUANTITIES = {"dwell_s": "s", "velocity_m_s": "m/s", "ignition_s": "s"}


def compare(way: FlightTables, true: pd.DataFrame) -> pd.DataFrame:
    """Return measured beside true, one row per true particle whose whole flight is recorded.

    Of several tracks of a particle the one that was followed for longest counts; what starts
    at the lance and belongs to nobody comes last, without truth.

    Parameters
    ----------
    way
        Flights that were worked out in one way.
    true
        `kilnflight.experiments.error_budget.true_flights`.

    Returns
    -------
    DataFrame
        ``particle`` (-1: nobody's), ``measurable`` (whether a person could have followed
        it), ``track`` (-1: none), ``ending`` and ``true_ending``, and ``measured_`` and ``true_``
        of `QUANTITIES`.
    """
    counted = way.flights[way.flights["from_lance"]]
    first = way.slices[way.slices["slice_m"] == 1.0].set_index("particle")["velocity_m_s"]
    table = pd.DataFrame(
        {
            "track": counted["particle"],
            "particle": counted["particle"].map(way.owners).fillna(-1).astype(np.int64),
            "ending": counted["ending"],
            "measured_dwell_s": counted["dwell_s"],
            "measured_velocity_m_s": counted["particle"].map(first).astype(np.float64),
            "measured_ignition_s": counted["ignition_s"],
            "seen_s": counted["last_s"] - counted["first_s"],
        }
    )
    mine = table[table["particle"] >= 0].sort_values("seen_s", kind="stable")
    mine = mine.drop_duplicates("particle", keep="last").drop(columns="seen_s")
    known = {name: f"true_{name}" for name in ("ending", *QUANTITIES)}
    there = true.loc[true["whole"], ["particle", "measurable", *known]].rename(columns=known)
    spurious = table[table["particle"] < 0].drop(columns="seen_s").assign(measurable=False)
    both = pd.concat([there.merge(mine, how="left", on="particle"), spurious], ignore_index=True)
    return both.assign(
        track=both["track"].fillna(-1).astype(np.int64),
        ending=both["ending"].fillna(""),
        true_ending=both["true_ending"].fillna(""),
    )


def compare_campaigns(wanted: Sequence[Campaign], measured: Measurement) -> pd.DataFrame:
    """Return `compare` of the measurement as it is, with fraction and pressure in front."""
    parts = []
    for one in wanted:
        cell = (one.fraction, one.pressure_bar)
        tracks, _, flights, slices = (of_campaign(table, cell) for table in measured)
        belongs = particle_of_track(
            tracks, true_particles(tracks.reset_index(drop=True), true_positions(one))
        )
        both = compare(FlightTables(flights, slices, belongs), true_flights(one))
        both.insert(0, "fraction", cell[0])
        both.insert(1, "pressure_bar", cell[1])
        parts.append(both)
    return pd.concat(parts, ignore_index=True)


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
    told = ending_cases(real["ending"], real["measured_ignition_s"].notna())
    told = told.where(real["track"] >= 0, "not measured")
    table = pd.crosstab([real["fraction"], real["pressure_bar"], true], told)
    every = [*CASES, LOST, "not measured"]
    return table.reindex(columns=every, fill_value=0).rename_axis(columns=None).reset_index()


def ending_cases(ending: pd.Series, lit: pd.Series) -> pd.Series:
    """Return `CASES` of endings, by whether a particle burnt; other endings stay."""
    landed = lit.map({False: CASES[0], True: CASES[1]})
    return ending.where(ending != LANDED, landed)


def compare_velocities(wanted: Sequence[Campaign], measured: Measurement) -> pd.DataFrame:
    """Return the velocity in each metre, measured and true, one row per particle and metre.

    Of several tracks of a particle the one that was followed for longest counts.

    Returns
    -------
    DataFrame
        ``fraction``, ``pressure_bar``, ``particle`` (-1: nobody's), ``slice_m``,
        ``measured_m_s``, ``true_m_s`` (NaN where there is none).
    """
    parts = []
    for one in wanted:
        cell = (one.fraction, one.pressure_bar)
        tracks, _, flights, slices = (of_campaign(table, cell) for table in measured)
        belongs = particle_of_track(
            tracks, true_particles(tracks.reset_index(drop=True), true_positions(one))
        )
        seen = slices[["particle", "slice_m", "velocity_m_s"]].copy()
        seen = seen[~seen["particle"].isin(_shorter(flights, belongs))]
        seen["particle"] = seen["particle"].map(belongs).fillna(-1).astype(np.int64)
        seen = seen.rename(columns={"velocity_m_s": "measured_m_s"})
        true = true_flights(one)
        columns = {f"velocity_{metre}_m_s": float(metre) for metre in METRES}
        wide = true[true["whole"]].rename(columns=columns)
        tall = wide.melt("particle", list(columns.values()), "slice_m", "true_m_s").dropna()
        tall = tall.astype({"slice_m": np.float64})
        both = seen.merge(tall, how="outer", on=["particle", "slice_m"])
        parts.append(both.assign(fraction=cell[0], pressure_bar=cell[1]))
    return pd.concat(parts, ignore_index=True)


def _shorter(flights: pd.DataFrame, belongs: pd.Series) -> pd.Series:
    """Return the tracks from the lance that are not the longest one of their particle."""
    counted = flights[flights["from_lance"]]
    owner = counted["particle"].map(belongs).fillna(-1)
    length = (counted["last_s"] - counted["first_s"]).sort_values(kind="stable")
    mine = owner[owner >= 0].reindex(length.index).dropna()
    return counted.loc[mine.index[mine.duplicated(keep="last")], "particle"]


def errors(both: pd.DataFrame, seed: int = 0) -> dict[str, float]:
    """Return number, bias and spread of each quantity, and how ignition was told.

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
    row = {
        "true": float(len(real)),
        "found": float(found.sum()),
        "spurious": float((both["particle"] < 0).sum()),
    }
    share = intervals.share(int(found.sum()), len(real))
    row |= {"found_low": share.low, "found_high": share.high}
    for name in QUANTITIES:
        off = (real[f"measured_{name}"] - real[f"true_{name}"]).dropna().to_numpy(np.float64)
        low, bias, high = np.quantile(off, [0.16, 0.5, 0.84]) if len(off) else 3 * (np.nan,)
        row |= {f"{name}_n": float(len(off)), f"{name}_bias": bias}
        row |= {f"{name}_spread": (high - low) / 2}
        sure = intervals.Bootstrap()(intervals.median, [off], generator)
        sides = [side if np.isfinite(side) else np.nan for side in (sure.low, sure.high)]
        row |= {f"{name}_low": sides[0], f"{name}_high": sides[1]}
    lit = real["true_ignition_s"].notna()
    told = real["measured_ignition_s"].notna()
    row |= {"lit": float((found & lit).sum()), "lit_told": float((found & lit & told).sum())}
    row |= {"unlit": float((found & ~lit).sum()), "unlit_told": float((found & ~lit & told).sum())}
    return row


def account_flights(way: FlightTables, true: pd.DataFrame) -> dict[str, int]:
    """Return what became of every flight that starts at the lance; the parts add up.

    Returns
    -------
    dict
        ``flights``; of these ``found`` (the longest of a measurable particle whose whole
        flight is recorded), ``duplicates`` (further ones of any particle), ``cut`` (of a
        particle that flies on before or after the recording, or that nobody could follow)
        and ``spurious`` (nobody's).
    """
    counted = way.flights[way.flights["from_lance"]]
    owner = counted["particle"].map(way.owners).fillna(-1).astype(np.int64)
    good = true.loc[true["whole"] & true["measurable"], "particle"]
    known = owner[owner >= 0]
    first = known.drop_duplicates()
    found = int(first.isin(good).sum())
    return {
        "flights": len(counted),
        "found": found,
        "duplicates": len(known) - len(first),
        "cut": len(first) - found,
        "spurious": int((owner < 0).sum()),
    }


def error_budget(wanted: Sequence[Campaign], measured: Measurement, jobs: int = 1) -> pd.DataFrame:
    """Return `errors` of every cell and way of `trust.ways`, in so many processes."""
    rows = joblib.Parallel(n_jobs=jobs)(
        joblib.delayed(_budget)(
            one, *(of_campaign(part, (one.fraction, one.pressure_bar)) for part in measured[:2])
        )
        for one in wanted
    )
    return pd.DataFrame([row for part in rows for row in part])


def _budget(
    campaign: Campaign, tracked: pd.DataFrame, trajectories: pd.DataFrame
) -> list[dict[str, object]]:
    """Return the rows of one campaign, given its tracks and their trajectories."""
    cell = {"fraction": campaign.fraction, "pressure_bar": campaign.pressure_bar}
    tracks = tracked.drop(columns=KEYS).reset_index(drop=True)
    own = fits(trajectories.drop(columns=KEYS))
    true, rows = true_flights(campaign), []
    for name, way in replace_steps(campaign, tracks, own):
        rows.append(
            {**cell, "way": name, **errors(compare(way, true)), **account_flights(way, true)}
        )
    return rows
