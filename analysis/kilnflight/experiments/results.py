"""What the measured flights of campaigns come to, beside what is printed and true."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight import regression
from kilnflight.checks import InputError
from kilnflight.experiments import statements
from kilnflight.experiments.campaigns import Campaign, Measurement
from kilnflight.experiments.statements import outcome_table
from kilnflight.project import claims
from kilnflight.scores import intervals
from kilnflight.scores.flights import METRES, Findings
from kilnflight.scores.intervals import Bootstrap, Interval
from kilnflight.slicing import straight_on
from kilnflight.tables import TRAJECTORIES
from kilnflight.twin import truth
from kilnflight.twin.particles import FRACTIONS
from kilnflight.twin.scene import Twin
from kilnflight.twin.scenes import PRESSURES_BAR

CampaignKey = tuple[str, float]
KEYS = ["fraction", "pressure_bar"]


def of_campaign(table: pd.DataFrame, cell: CampaignKey) -> pd.DataFrame:
    """Return the rows of a cell."""
    return table[(table["fraction"] == cell[0]) & (table["pressure_bar"] == cell[1])]


def by_campaign(measured: Measurement) -> dict[CampaignKey, Findings]:
    """Return what the flights of each cell come to; `of_flights` each."""
    keys = measured.tracks[KEYS].drop_duplicates().itertuples(index=False, name=None)
    return {cell: of_flights(*(of_campaign(one, cell) for one in measured[1:])) for cell in keys}


def of_flights(trajectories: pd.DataFrame, flights: pd.DataFrame, slices: pd.DataFrame) -> Findings:
    """Return dwell times, velocities by metre, ignition and reach of the flights that count.

    Dwell times of flights that were lost are in, as the thesis has them in (appendix A.1);
    they are lower bounds. Slices behind the lance are not.
    """
    counted = flights[flights["from_lance"]]
    wide = slices.pivot(index="particle", columns="slice_m", values="velocity_m_s")
    wide = wide.reindex(index=counted["particle"], columns=[float(metre) for metre in METRES])
    fits = regression.fits(trajectories[TRAJECTORIES.names])
    ends = zip(counted["particle"].tolist(), counted["end_s"].tolist(), strict=True)
    ways = [(fits[name], end) for name, end in ends]
    reached = [fit.exit_point_mm[2] - straight_on(fit, end)[0, 2] for fit, end in ways]
    return Findings(
        counted["dwell_s"].to_numpy(np.float64),
        wide.to_numpy(np.float64),
        counted["ignition_s"].to_numpy(np.float64),
        np.array(reached, dtype=np.float64) / 1000.0,
    )


def fits_from_lance(
    measured: Measurement, cell: CampaignKey, most: int
) -> tuple[dict[int, regression.Fit], pd.DataFrame]:
    """Return the first trajectories from the lance of a cell, and their detections."""
    flights = of_campaign(measured.flights, cell)
    names = flights.loc[flights["from_lance"], "particle"].sort_values().head(most).tolist()
    every = regression.fits(of_campaign(measured.trajectories, cell)[TRAJECTORIES.names])
    tracks = of_campaign(measured.tracks, cell)
    return {name: every[name] for name in names}, tracks[tracks["particle"].isin(names)]


def twin_of(campaign: Campaign) -> Twin:
    """Return the recording of a campaign, with its truth."""
    recording = campaign.run.detection.source.recording()
    if not isinstance(recording, Twin):
        raise InputError(f"{recording.attributes.name}: nothing is known to be true of it.")
    return recording


def true_results(wanted: Sequence[Campaign]) -> dict[CampaignKey, Findings]:
    """Return what the flights in the same frames truly come to, seen or not.

    A flight counts if it begins after the first frame and is over by the last.
    """
    found = {}
    for one in wanted:
        twin = twin_of(one)
        flights, release = twin.life.flights, twin.life.release_s * twin.scene.frame_rate_hz
        over = release + flights.end_s * twin.scene.frame_rate_hz
        inside = (release >= one.frames.start) & (over < one.frames.stop)
        found[one.fraction, one.pressure_bar] = truth.flight_values(flights.only(inside))
    return found


def beside_published(
    measured: Mapping[CampaignKey, Findings],
    true: Mapping[CampaignKey, Findings],
    quantities: Sequence[str],
) -> pd.DataFrame:
    """Return every printed number of some quantities with truth and measurement beside it.

    Parameters
    ----------
    measured, true
        By cell.
    quantities
        First words of the outcomes, such as "dwell".

    Returns
    -------
    DataFrame
        ``fraction``, ``pressure_bar``, ``outcome``, ``printed``, ``low``, ``high``, ``true``,
        ``measured``, and what the calibration saw (``use``).
    """
    said = statements.statements()
    cells = zip(said["fraction"], said["pressure_bar"], strict=True)
    said = said[np.array([cell in measured for cell in cells])]
    said = said[said["outcome"].str.split(" ").str[0].isin(quantities)]
    said = said.drop_duplicates(["fraction", "pressure_bar", "outcome", "printed"])
    both = {"true": true, "measured": measured}
    answers = {name: statements.answer(said, outcome_table(found)) for name, found in both.items()}
    return said.drop(columns=["source", "use"]).assign(**answers, use=said["use"])


def conditions(said: pd.DataFrame, cell: CampaignKey) -> dict[str, bool]:
    """Return whether the measurement agrees with each printed number of a cell.

    Within the printed bounds; where one number is printed, within the unit of
    `kilnflight.experiments.statements.LEAST_UNIT`.
    """
    rows = of_campaign(said, cell)
    units = statements.misfits(rows, rows["measured"])
    found: dict[str, bool] = {}
    for one, off in zip(rows.to_dict("records"), units, strict=True):
        allowed = 1.0 if one["low"] == one["high"] else 0.0
        value = f"{one['measured']:.3g} [{one['low']:g}, {one['high']:g}]"
        found[f"{one['outcome']} at {cell[1]} bar {value}"] = bool(off <= allowed)
    return found or {"nothing measured": False}


def median_of(values: npt.ArrayLike, generator: np.random.Generator) -> Interval:
    """Return the median of what is known with its 95 % interval (bootstrap)."""
    known = np.asarray(values, dtype=np.float64)
    return Bootstrap()(intervals.median, [known[np.isfinite(known)]], generator)


def medians(
    found: Mapping[CampaignKey, Findings], quantity: str, generator: np.random.Generator
) -> pd.DataFrame:
    """Return the median of a field of `Findings` by cell with its 95 % interval."""
    rows = []
    for (name, bar), one in found.items():
        interval = median_of(getattr(one, quantity), generator)
        rows.append({"fraction": name, "pressure_bar": bar, **interval_columns(interval)})
    return pd.DataFrame(rows)


def in_metre(found: Mapping[CampaignKey, Findings], number: int) -> dict[CampaignKey, Findings]:
    """Return the findings with the velocity in one metre only, (n,)."""
    return {
        cell: one._replace(velocity_m_s=one.velocity_m_s[:, number - 1])
        for cell, one in found.items()
    }


def ignited(findings: Findings) -> tuple[int, int]:
    """Return how many particles ignite, and of how many."""
    return int(np.isfinite(findings.ignition_s).sum()), len(findings.ignition_s)


def pairs_to_compare(
    found: Mapping[CampaignKey, Findings],
) -> list[tuple[CampaignKey, CampaignKey]]:
    """Return what is compared: fractions at one pressure, and pressures of one fraction."""
    return [
        (one, two)
        for one, two in itertools.combinations(found, 2)
        if (one[0] == two[0]) != (one[1] == two[1])
    ]


def interval_columns(interval: Interval) -> dict[str, float]:
    """Return an interval as columns; what is infinite stays empty."""
    bounds = [np.nan if np.isinf(edge) else edge for edge in (interval.low, interval.high)]
    return {
        "number": sum(interval.numbers),
        "estimate": interval.estimate,
        "low": bounds[0],
        "high": bounds[1],
    }


LEAST_FLIGHTS = 6  # flights in a cell, below which nothing is said about it


def judge_all(
    measured: Measurement,
    given: Mapping[str, float | pd.Series | Mapping[str, bool]],
    note: str = "",
    apart: Mapping[str, str] | None = None,
) -> list[claims.Verdict]:
    """Return verdicts on claims about all eight cells; "not decidable" where flights are missing.

    Parameters
    ----------
    measured
        The campaigns.
    given
        By claim: what `kilnflight.project.claims.judge` asks for.
    note
        What a reader must know beside the verdicts.
    apart
        By claim: what of it is beyond chance (`certainty.in_words`). It stands in the
        reason; the verdict is that of the criterion, on the numbers as they are.
    """
    counted = measured.flights[measured.flights["from_lance"]].groupby(KEYS).size()
    few = counted[counted < LEAST_FLIGHTS]
    missing = len(FRACTIONS) * len(PRESSURES_BAR) - len(counted) + len(few)
    if missing:
        reason = f"fewer than {LEAST_FLIGHTS} flights in {missing} of the eight cells at this scale"
        return [claims.undecidable(name, reason) for name in given]
    notes = {name: "; ".join(filter(None, [note, (apart or {}).get(name, "")])) for name in given}
    return [claims.judge(name, value, note=notes[name]) for name, value in given.items()]


FITTED = {"rmse_{}_mm": "rmse_mm", "mape_{}_percent": "mape_percent"}
FITTED |= {"r2_{}": "r2", "r2_adjusted_{}": "r2_adjusted"}
PLURALS = {"wood chip": "Wood chips", "confetti": "Confetti"}
PLURALS |= {"paper shred": "Paper shreds", "PE granule": "PE granules"}


def trajectories_from_lance(measured: Measurement) -> pd.DataFrame:
    """Return the trajectories from the lance."""
    keys = [*KEYS, "particle"]
    table = measured.trajectories.merge(measured.flights[[*keys, "from_lance"]], on=keys)
    return table[table["from_lance"]]


def regression_table(measured: Measurement, generator: np.random.Generator) -> pd.DataFrame:
    """Return medians over the trajectories from the lance beside Table 5.18.

    Returns
    -------
    DataFrame
        ``fraction``, ``axis``, ``rmse_mm``, ``mape_percent``, ``r2``, ``r2_adjusted``,
        ``tracks``, the four published ones, and of each of ours ``_low`` and ``_high``: its
        95 % interval (bootstrap over trajectories).
    """
    table = trajectories_from_lance(measured)
    rows = [
        {"fraction": name, "axis": axis}
        | {to: one[of.format(axis)].median() for of, to in FITTED.items()}
        | {"tracks": len(one)}
        for name in measured.trajectories["fraction"].unique()
        for one in [table[table["fraction"] == name]]
        for axis in "xyz"
    ]
    ours = pd.DataFrame(rows)
    said = claims.published("table_5.18")
    said = said.pivot(index=["fraction", "axis"], columns="measure", values="value")
    said = said.rename(columns=str.lower)
    place = [(PLURALS[str(one.fraction)], one.axis) for one in ours.itertuples()]
    for name in FITTED.values():
        ours[f"{name}_published"] = said[name].reindex(place).to_numpy()
    for of, to in FITTED.items():
        found = [
            median_of(table.loc[table["fraction"] == one.fraction, of.format(one.axis)], generator)
            for one in ours.itertuples()
        ]
        for side in ("low", "high"):
            ours[f"{to}_{side}"] = [interval_columns(interval)[side] for interval in found]
    return ours
