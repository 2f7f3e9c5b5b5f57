"""What the measured flights of campaigns come to, beside what is printed and true.

A campaign is a fraction at a pressure. Only flights that start at the lance count (Fig. 4.21).
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from scipy import stats

from kilnflight import regression
from kilnflight.checks import InputError
from kilnflight.experiments import statements
from kilnflight.experiments.campaigns import Campaign, Measurement
from kilnflight.experiments.statements import outcome_table
from kilnflight.flight import straight_on
from kilnflight.project import claims
from kilnflight.scores.flights import METRES, FlightValues, along, box
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


def by_campaign(measured: Measurement) -> dict[CampaignKey, FlightValues]:
    """Return what the flights of each campaign come to, see `of_flights`."""
    keys = measured.tracks[KEYS].drop_duplicates().itertuples(index=False, name=None)
    return {key: of_flights(*(of_campaign(table, key) for table in measured[1:])) for key in keys}


def of_flights(
    trajectories: pd.DataFrame, flights: pd.DataFrame, slices: pd.DataFrame
) -> FlightValues:
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
    return FlightValues(
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


def true_results(campaigns: Sequence[Campaign]) -> dict[CampaignKey, FlightValues]:
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


def by_source(sources: Mapping[str, Mapping[CampaignKey, FlightValues]]) -> pd.DataFrame:
    """Return the `outcome_table` of several sources below each other, ``source`` in front."""
    tables = {name: outcome_table(found) for name, found in sources.items()}
    return pd.concat(tables, names=["source"]).reset_index("source")


def beside_published(
    measured: Mapping[CampaignKey, FlightValues],
    true: Mapping[CampaignKey, FlightValues],
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


def in_metre(
    found: Mapping[CampaignKey, FlightValues], metre: int
) -> dict[CampaignKey, FlightValues]:
    """Return the values with the velocity in one metre only, (n,)."""
    return {
        key: one._replace(velocity_m_s=one.velocity_m_s[:, metre - 1]) for key, one in found.items()
    }


def ignited(flight_values: FlightValues) -> tuple[int, int]:
    """Return how many particles ignite, and of how many."""
    return int(np.isfinite(flight_values.ignition_s).sum()), len(flight_values.ignition_s)


def pairs_to_compare(
    found: Mapping[CampaignKey, FlightValues],
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


def remaining_table(
    sources: Mapping[str, Mapping[CampaignKey, FlightValues]], published: pd.DataFrame
) -> pd.DataFrame:
    """Return the shares that pass each metre by source, and the published ones below them."""
    parts = [along(outcome_table(found)).assign(source=name) for name, found in sources.items()]
    shares = pd.concat(parts).query("quantity == 'remaining'")
    bounds = published[published["outcome"].str.startswith("remaining")]
    at = bounds["outcome"].str.extract(r"remaining (\d)")[0].astype(float)
    return pd.concat([shares, bounds.assign(at=at, source="published")])


def behind_lance(measured: Measurement) -> pd.DataFrame:
    """Return how many slices lie behind the lance, in how many flights, and their velocity."""
    slices = measured.slices[measured.slices["slice_m"] < 0]
    columns = {
        "slices": ("velocity_m_s", "size"),
        "flights": ("particle", "nunique"),
        "median_m_s": ("velocity_m_s", "median"),
    }
    return slices.groupby(KEYS).agg(**columns).reset_index()


def fit_outcomes(measured: Measurement) -> pd.DataFrame:
    """Return how many tracks were fitted, or why not, by campaign.

    ``t0_earliest`` and ``t0_at_first_detection``: t0 lies at that end of its range;
    ``from_lance``: trajectories that start at the lance.
    """
    table = measured.trajectories
    count = table.groupby([*KEYS, "outcome"], sort=False).size().unstack(fill_value=0)
    bounds = table[table["outcome"] == "fitted"].groupby(KEYS)["t0_at_bound"]
    count["t0_earliest"] = bounds.agg(lambda at: (at < 0).sum())
    count["t0_at_first_detection"] = bounds.agg(lambda at: (at > 0).sum())
    count["from_lance"] = measured.flights.groupby(KEYS)["from_lance"].sum()
    return count.fillna(0).astype(int).reset_index()


def depth_outliers(measured: Measurement) -> pd.DataFrame:
    """Return median, outliers of a box plot and maximum of the RMSE in depth, by campaign."""
    rows = []
    for key, one in trajectories_from_lance(measured).groupby(KEYS, sort=False):
        deep = box(one["rmse_z_mm"].to_numpy())
        row = {**dict(zip(KEYS, key, strict=True)), "tracks": len(one)}
        row |= {"median_mm": deep["median"], "outliers_beyond_mm": deep["whisker_high"]}
        rows.append(row | {"outliers": int(deep["outliers"]), "largest_mm": one["rmse_z_mm"].max()})
    columns = ["tracks", "median_mm", "outliers_beyond_mm", "outliers", "largest_mm"]
    return pd.DataFrame(rows, columns=[*KEYS, *columns])


def measures_by_order(
    campaigns: Sequence[Campaign], measured: Measurement, most: int = 40
) -> pd.DataFrame:
    """Return medians of the measures of fits by ``order`` and ``axis`` (Fig. 4.23).

    Over the first trajectories from the lance of each campaign, at most so many.
    """
    parts = []
    for campaign in campaigns:
        flights = of_campaign(measured.flights, campaign.key)
        some = flights.loc[flights["from_lance"], "particle"].head(most)
        tracks = of_campaign(measured.tracks, campaign.key)
        tracks = tracks[tracks["particle"].isin(some)]
        rate, exit_point = campaign.run.frame_rate_hz, campaign.run.exit_point_mm
        if exit_point is None:
            raise InputError(f"{campaign.key}: the lance's exit is not known.")
        parts.append(regression.order_measures(tracks, exit_point, rate))
    columns = ["rmse_mm", "mape_percent", "r2", "r2_adjusted"]
    orders = pd.concat([part for part in parts if len(part)] or parts[:1], ignore_index=True)
    return orders.groupby(["order", "axis"])[columns].median().reset_index()


def distribution_distances(
    simulated: Mapping[CampaignKey, FlightValues], measured: Mapping[CampaignKey, FlightValues]
) -> pd.DataFrame:
    """Return Kolmogorov and Smirnov's distances of dwell times and first velocities.

    Returns
    -------
    DataFrame
        ``fraction``, ``quantity``, number ``simulated`` and ``measured``, ``distance`` and ``p``
        (empty where there is none).
    """
    rows: list[dict[str, object]] = []
    for key, one in simulated.items():
        pairs = {
            "dwell time": (one.dwell_s, measured[key].dwell_s),
            "velocity 0-1 m": (one.velocity_m_s[:, 0], measured[key].velocity_m_s[:, 0]),
        }
        for quantity, values in pairs.items():
            first, second = (part[np.isfinite(part)] for part in values)
            numbers = {"simulated": len(first), "measured": len(second)}
            row: dict[str, object] = {"fraction": key[0], "quantity": quantity, **numbers}
            if len(first) and len(second):
                test = stats.ks_2samp(first, second)
                row |= {"distance": test.statistic, "p": test.pvalue}
            rows.append(row)
    columns = ["fraction", "quantity", "simulated", "measured", "distance", "p"]
    return pd.DataFrame(rows).reindex(columns=columns)


def count_tracks(campaigns: Sequence[Campaign], measured: Measurement) -> pd.DataFrame:
    """Return length, detections in the air, tracks and flights from the lance, by campaign."""
    rows = []
    for campaign in campaigns:
        tracks = of_campaign(measured.tracks, campaign.key)
        linked, frames = tracks[tracks["particle"] >= 0], len(campaign.frames)
        row = {**dict(zip(KEYS, campaign.key, strict=True)), "frames": frames}
        row |= {"seconds": frames / campaign.run.frame_rate_hz}
        row |= {"detections_in_air": len(tracks), "tracked": len(linked)}
        row |= {"tracks": linked["particle"].nunique()}
        flights = of_campaign(measured.flights, campaign.key)
        rows.append(row | {"from_lance": int(flights["from_lance"].sum())})
    return pd.DataFrame(rows)


def tracks_from_lance(measured: Measurement) -> pd.DataFrame:
    """Return the tracks of flights that start at the lance."""
    keys = [*KEYS, "particle"]
    flights = measured.flights.loc[measured.flights["from_lance"], keys]
    return measured.tracks.merge(flights, on=keys)
