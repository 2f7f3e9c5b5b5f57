"""What the measured flights of campaigns come to, beside what is printed and true.

A campaign is a fraction at a pressure. Only flights that start at the lance count (Fig. 4.21).
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from kilnflight import regression
from kilnflight.checks import InputError
from kilnflight.experiments import statements
from kilnflight.experiments.campaigns import Campaign, Measurement
from kilnflight.experiments.statements import outcome_table
from kilnflight.flight import straight_on
from kilnflight.project import claims
from kilnflight.scores.flights import METRES, Findings
from kilnflight.tables import TRAJECTORIES
from kilnflight.twin import truth
from kilnflight.twin.particles import FRACTIONS
from kilnflight.twin.scene import Twin
from kilnflight.twin.scenes import PRESSURES_BAR

CampaignKey = tuple[str, float]
KEYS = ["fraction", "pressure_bar"]
LEAST_FLIGHTS = 6  # in a campaign; nothing is decided about fewer


def of_campaign(table: pd.DataFrame, key: CampaignKey) -> pd.DataFrame:
    """Return the rows of a campaign."""
    return table[(table["fraction"] == key[0]) & (table["pressure_bar"] == key[1])]


def by_campaign(measured: Measurement) -> dict[CampaignKey, Findings]:
    """Return what the flights of each campaign come to, see `of_flights`."""
    keys = measured.tracks[KEYS].drop_duplicates().itertuples(index=False, name=None)
    return {key: of_flights(*(of_campaign(table, key) for table in measured[1:])) for key in keys}


def of_flights(trajectories: pd.DataFrame, flights: pd.DataFrame, slices: pd.DataFrame) -> Findings:
    """Return dwell times, velocities by metre, ignition and reach of the flights that count.

    Dwell times of lost flights are included, as in the thesis (appendix A.1); they are lower
    bounds. Slices behind the lance are not.
    """
    counted = flights[flights["from_lance"]]
    wide = slices.pivot(index="particle", columns="slice_m", values="velocity_m_s")
    wide = wide.reindex(index=counted["particle"], columns=[float(metre) for metre in METRES])
    fits = regression.fits(trajectories[TRAJECTORIES.names])
    ends = zip(counted["particle"].tolist(), counted["end_s"].tolist(), strict=True)
    reached = [
        fits[particle].exit_point_mm[2] - straight_on(fits[particle], end)[0, 2]
        for particle, end in ends
    ]
    return Findings(
        counted["dwell_s"].to_numpy(np.float64),
        wide.to_numpy(np.float64),
        counted["ignition_s"].to_numpy(np.float64),
        np.array(reached, dtype=np.float64) / 1000.0,
    )


def twin_of(campaign: Campaign) -> Twin:
    """Return the recording of a campaign, with its truth."""
    recording = campaign.run.detection.source.recording()
    if not isinstance(recording, Twin):
        raise InputError(f"{recording.attributes.name}: its truth is not known; use the twin.")
    return recording


def true_results(campaigns: Sequence[Campaign]) -> dict[CampaignKey, Findings]:
    """Return what the flights in the same frames truly come to, detected or not.

    A flight counts if it begins after the first frame and is over by the last.
    """
    found = {}
    for campaign in campaigns:
        twin = twin_of(campaign)
        flights, release = twin.life.flights, twin.life.release_s * twin.scene.frame_rate_hz
        over = release + flights.end_s * twin.scene.frame_rate_hz
        inside = (release >= campaign.frames.start) & (over < campaign.frames.stop)
        found[campaign.key] = truth.flight_values(flights.only(inside))
    return found


def by_source(sources: Mapping[str, Mapping[CampaignKey, Findings]]) -> pd.DataFrame:
    """Return the `outcome_table` of several sources below each other, ``source`` in front."""
    tables = {name: outcome_table(found) for name, found in sources.items()}
    return pd.concat(tables, names=["source"]).reset_index("source")


def beside_published(
    measured: Mapping[CampaignKey, Findings],
    true: Mapping[CampaignKey, Findings],
    quantities: Sequence[str],
) -> pd.DataFrame:
    """Return every printed number of some quantities with truth and measurement beside it.

    Parameters
    ----------
    measured, true
        By campaign.
    quantities
        First words of the outcomes, such as "dwell".

    Returns
    -------
    DataFrame
        ``fraction``, ``pressure_bar``, ``outcome``, ``printed``, ``low``, ``high``, ``true``,
        ``measured``, and what the calibration used (``use``).
    """
    printed = statements.statements()
    keys = zip(printed["fraction"], printed["pressure_bar"], strict=True)
    printed = printed[np.array([key in measured for key in keys])]
    printed = printed[printed["outcome"].str.split(" ").str[0].isin(quantities)]
    printed = printed.drop_duplicates([*KEYS, "outcome", "printed"])
    both = {"true": true, "measured": measured}
    values = {
        name: statements.answer(printed, outcome_table(found)) for name, found in both.items()
    }
    return printed.drop(columns=["source", "use"]).assign(**values, use=printed["use"])


def conditions(published: pd.DataFrame, key: CampaignKey) -> dict[str, bool]:
    """Return whether the measurement agrees with each printed number of a campaign.

    Within the printed bounds; where one number is printed, within the unit of
    `kilnflight.experiments.statements.LEAST_UNIT`.
    """
    rows = of_campaign(published, key)
    units = statements.misfits(rows, rows["measured"])
    found: dict[str, bool] = {}
    for row, off in zip(rows.to_dict("records"), units, strict=True):
        allowed = 1.0 if row["low"] == row["high"] else 0.0
        value = f"{row['measured']:.3g} [{row['low']:g}, {row['high']:g}]"
        found[f"{row['outcome']} at {key[1]} bar {value}"] = bool(off <= allowed)
    return found or {"nothing measured": False}


def in_metre(found: Mapping[CampaignKey, Findings], metre: int) -> dict[CampaignKey, Findings]:
    """Return the findings with the velocity in one metre only, (n,)."""
    return {
        key: one._replace(velocity_m_s=one.velocity_m_s[:, metre - 1]) for key, one in found.items()
    }


def ignited(findings: Findings) -> tuple[int, int]:
    """Return how many particles ignite, and of how many."""
    return int(np.isfinite(findings.ignition_s).sum()), len(findings.ignition_s)


def pairs_to_compare(
    found: Mapping[CampaignKey, Findings],
) -> list[tuple[CampaignKey, CampaignKey]]:
    """Return pairs of campaigns: fractions at one pressure, and pressures of one fraction."""
    return [
        (first, second)
        for first, second in itertools.combinations(found, 2)
        if (first[0] == second[0]) != (first[1] == second[1])
    ]


def judge_all(
    measured: Measurement,
    given: Mapping[str, float | pd.Series | Mapping[str, bool]],
    note: str = "",
    resolved: Mapping[str, str] | None = None,
) -> list[claims.Verdict]:
    """Return verdicts on claims about all eight campaigns; undecidable if flights are missing.

    Parameters
    ----------
    measured
        The campaigns.
    given
        By claim: what `kilnflight.project.claims.judge` asks for.
    note
        What a reader must know beside the verdicts.
    resolved
        By claim: which differences are beyond chance (`confidence.in_words`). It stands in the
        reason; the verdict is that of the criterion, on the numbers as they are.
    """
    counted = measured.flights[measured.flights["from_lance"]].groupby(KEYS).size()
    missing = len(FRACTIONS) * len(PRESSURES_BAR) - int((counted >= LEAST_FLIGHTS).sum())
    if missing:
        reason = f"fewer than {LEAST_FLIGHTS} flights in {missing} of the eight cells at this scale"
        return [claims.undecidable(name, reason) for name in given]
    notes = {name: "; ".join(filter(None, [note, (resolved or {}).get(name)])) for name in given}
    return [claims.judge(name, value, note=notes[name]) for name, value in given.items()]


def trajectories_from_lance(measured: Measurement) -> pd.DataFrame:
    """Return the trajectories of flights that start at the lance."""
    keys = [*KEYS, "particle"]
    table = measured.trajectories.merge(measured.flights[[*keys, "from_lance"]], on=keys)
    return table[table["from_lance"]]


def fits_from_lance(
    measured: Measurement, key: CampaignKey, most: int
) -> tuple[dict[int, regression.Fit], pd.DataFrame]:
    """Return the first trajectories from the lance of a campaign, and their detections."""
    flights = of_campaign(measured.flights, key)
    names = flights.loc[flights["from_lance"], "particle"].sort_values().head(most).tolist()
    fits = regression.fits(of_campaign(measured.trajectories, key)[TRAJECTORIES.names])
    tracks = of_campaign(measured.tracks, key)
    return {name: fits[name] for name in names}, tracks[tracks["particle"].isin(names)]
