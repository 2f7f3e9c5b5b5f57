"""Confidence intervals of campaign results, and differences beyond chance.

95 % intervals: medians by bootstrap over particles, shares by Wilson
(`kilnflight.scores.intervals` says what they leave out). A velocity is that of the particles that
passed the metre, and the interval is of those; "velocity last" is of the metre that is the last
one in the sample.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import combinations
from typing import TypeVar

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy import stats

from kilnflight.experiments.campaigns import (
    KEYS,
    CampaignKey,
    Measurement,
    from_lance,
    of_campaign,
)
from kilnflight.project import claims
from kilnflight.scores import intervals
from kilnflight.scores.flights import (
    LAST_SHARE,
    METRES,
    FlightValues,
    outcomes,
    quartiles,
    remaining,
)
from kilnflight.scores.intervals import Bootstrap, Interval

Key = TypeVar("Key", bound=tuple[str, object])  # a campaign, or a fraction and an axis
Array = npt.NDArray[np.float64]
Values = Mapping[CampaignKey, FlightValues]
# Measures of a fit by axis, and their columns in Table 5.18.
FIT_MEASURES = {"rmse_{}_mm": "rmse_mm", "mape_{}_percent": "mape_percent"}
FIT_MEASURES |= {"r2_{}": "r2", "r2_adjusted_{}": "r2_adjusted"}
PLURALS = {"wood chip": "Wood chips", "confetti": "Confetti"}
PLURALS |= {"paper shred": "Paper shreds", "PE granule": "PE granules"}


def interval_columns(interval: Interval) -> dict[str, float]:
    """Return an interval as columns; ends that say nothing (of too few, of none) are empty."""
    number = sum(interval.numbers)
    known = number > 0 and np.isfinite([interval.low, interval.high])
    low, high = np.where(known, [interval.low, interval.high], np.nan).tolist()
    return {"number": number, "estimate": interval.estimate, "low": low, "high": high}


def finite(values: npt.ArrayLike) -> Array:
    """Return the values that are finite."""
    array = np.asarray(values, dtype=np.float64)
    return array[np.isfinite(array)]


def median_of(values: npt.ArrayLike, generator: np.random.Generator) -> Interval:
    """Return the median of the finite values with its 95 % interval (bootstrap)."""
    return Bootstrap()(np.median, [finite(values)], generator)


def median_table(measured: Values, true: Values, generator: np.random.Generator) -> pd.DataFrame:
    """Return each campaign's medians, and if their intervals cover the true ones.

    Returns
    -------
    DataFrame
        ``fraction``, ``pressure_bar``, ``outcome`` as in `kilnflight.scores.flights.outcomes`,
        ``number`` of particles, ``estimate``, ``low``, ``high`` (empty where the sample is too
        small), ``true`` (median of all flights in the same frames), ``true_number``, `covers`.
    """
    rows = []
    for key, flight_values in measured.items():
        truth = _samples(true[key])
        for outcome, values in _samples(flight_values).items():
            row = {**dict(zip(KEYS, key, strict=True)), "outcome": outcome}
            row |= interval_columns(median_of(values, generator))
            row |= {"true": quartiles(truth[outcome])[1], "true_number": len(truth[outcome])}
            rows.append(row)
    table = pd.DataFrame(rows)
    return table.assign(covers=covers(table, "true"))


def covers(table: pd.DataFrame, true: str) -> pd.Series:
    """Return whether intervals hold the true values of a column; NA where either is unknown."""
    known = table[["low", "high", true]].notna().all(axis=1)
    return table[true].between(table["low"], table["high"]).astype("boolean").where(known)


def _samples(flight_values: FlightValues) -> dict[str, Array]:
    """Return the finite values behind every median by the name of the outcome."""
    velocity = flight_values.velocity_m_s
    metres = zip(METRES, velocity.T, strict=True)
    samples = {f"velocity {k - 1}-{k} m (m/s)": finite(each) for k, each in metres}
    last = np.flatnonzero(remaining(flight_values)[0] >= 100.0 * LAST_SHARE)[-1:]
    return samples | {
        "velocity last (m/s)": finite(velocity[:, last]),
        "dwell median (s)": finite(flight_values.dwell_s),
        "ignition median (s)": finite(flight_values.ignition_s),
    }


def interval_of(
    flight_values: FlightValues, outcome: str, generator: np.random.Generator
) -> Interval:
    """Return an outcome with its 95 % interval: a median's by bootstrap, a share's by Wilson.

    In per cent for shares; the name is one of `kilnflight.scores.flights.outcomes`.
    """
    samples = _samples(flight_values)
    if outcome in samples:
        return median_of(samples[outcome], generator)
    lit = outcome.endswith("(% of ignited)")
    counted = len(finite(flight_values.ignition_s)) if lit else len(flight_values.ignition_s)
    if outcome.startswith("remaining"):  # lost flights say nothing beyond where they were lost
        counted = int(remaining(flight_values)[1][METRES.index(int(outcome.split()[1]))])
    percent = float(np.nan_to_num(outcomes(flight_values)[outcome]))
    each = intervals.share(round(percent / 100 * counted), counted)
    low, high = min(100 * each.low, percent), max(100 * each.high, percent)
    return Interval(percent, low, high, each.numbers)  # the share itself is of no whole number


def metres_before_detection(
    slices: pd.DataFrame, true: Values, generator: np.random.Generator
) -> pd.DataFrame:
    """Return the velocities without metres passed before the first detection.

    Parameters
    ----------
    slices
        `kilnflight.tables.SLICES` of flights from the lance, with fraction and pressure.
    true
        The truth of each campaign.
    generator
        Of the bootstrap.

    Returns
    -------
    DataFrame
        ``fraction``, ``pressure_bar``, ``metre``; ``number`` of flights that passed it and how
        many of them ``before_detection``; how many were ``too_fast``, faster than any true
        particle of the campaign in that metre, and ``too_fast_before_detection``;
        ``median_m_s``; ``detected_m_s`` with ``low`` and ``high``: the median of flights that
        were detected by then; ``true_m_s``.
    """
    rows: list[dict[str, object]] = []
    for key, flight_values in true.items():
        part = of_campaign(slices, key)
        for metre, velocity in zip(METRES, flight_values.velocity_m_s.T, strict=True):
            passed = part[part["slice_m"] == metre]
            speed = passed["velocity_m_s"].to_numpy(float)
            detected = passed["observed"].to_numpy(bool)
            fast = speed > finite(velocity).max(initial=0.0)
            median = interval_columns(median_of(speed[detected], generator))
            row = {**dict(zip(KEYS, key, strict=True)), "metre": metre, "number": len(speed)}
            row |= {"before_detection": (~detected).sum(), "too_fast": fast.sum()}
            row |= {"too_fast_before_detection": (fast & ~detected).sum()}
            row |= {"median_m_s": quartiles(speed)[1], "detected_m_s": median["estimate"]}
            row |= {"low": median["low"], "high": median["high"]}
            rows.append(row | {"true_m_s": quartiles(finite(velocity))[1]})
    return pd.DataFrame(rows)


def describe_before_detection(metres: pd.DataFrame) -> str:
    """Describe how many metres of `metres_before_detection` count unseen, and how much."""
    far, near = metres[metres["metre"] > 3], metres[metres["metre"] < 4]
    shift = (near["detected_m_s"] - near["median_m_s"]).abs().max()
    if np.isnan(shift):
        return "No metre was passed by a particle that was detected by then."
    return (
        f"Of {metres['number'].sum()} metres {metres['before_detection'].sum()} were passed before "
        f"the particle was detected, beyond 3 m {far['before_detection'].sum()} of "
        f"{far['number'].sum()}. Without them no median of the first three moves by more than "
        f"{shift:.2f} m/s."
    )


def slices_behind_lance(slices: pd.DataFrame) -> pd.DataFrame:
    """Return by campaign the number of slices behind the lance, of flights, and median."""
    behind = slices[slices["slice_m"] < 0].groupby(KEYS)
    return behind.agg({"particle": ["size", "nunique"], "velocity_m_s": "median"})


def ignited_shares(sources: Mapping[str, Values]) -> pd.DataFrame:
    """Return the share that ignites within 0.1 s, 0.2 s and at all.

    With its interval (Wilson).
    """
    rows = []
    for source, values in sources.items():
        for key, flight_values in values.items():
            times = flight_values.ignition_s
            for within in (0.1, 0.2, np.inf):
                share = intervals.share(int((times <= within).sum()), len(times))
                row = {"source": source, **dict(zip(KEYS, key, strict=True))}
                row["within_s"] = "" if np.isinf(within) else within
                rows.append(row | interval_columns(share))
    return pd.DataFrame(rows)


def all_differences(measured: Values, true: Values, generator: np.random.Generator) -> pd.DataFrame:
    """Return `group_differences` of dwell time, velocity and ignited share.

    The velocity is that in the first metre.
    Between fractions at one pressure, and between pressures of one fraction.
    """
    pairs = [(a, b) for a, b in combinations(measured, 2) if (a[0] == b[0]) != (a[1] == b[1])]
    quantities: dict[str, Callable[[FlightValues], Array]] = {
        "dwell time": lambda each: each.dwell_s,
        "velocity 0-1 m": lambda each: each.velocity_m_s[:, 0],
        "ignited share": lambda each: each.ignition_s,
    }
    tables = {}
    for name, of in quantities.items():
        ours, real = ({key: of(each) for key, each in kind.items()} for kind in (measured, true))
        tables[name] = group_differences(
            ours, pairs, generator, real, shares=name == "ignited share"
        )
    return pd.concat(tables, names=["quantity"]).reset_index("quantity")


def group_differences(
    groups: Mapping[Key, Array],
    pairs: Sequence[tuple[Key, Key]],
    generator: np.random.Generator,
    true: Mapping[Key, Array] | None = None,
    *,
    shares: bool = False,
) -> pd.DataFrame:
    """Return differences of medians, or shares with a value, and if due to chance.

    Parameters
    ----------
    groups
        Values by campaign, or by fraction and axis; NaN: none.
    pairs
        First and second; those that are not in ``groups`` are left out.
    generator
        Of the bootstrap.
    true
        True values likewise.
    shares
        Whether to compare the shares of particles that have a value, not the medians.

    Returns
    -------
    DataFrame
        ``first``, ``second``, ``number``, ``estimate``, ``low``, ``high``; ``true`` if given;
        ``resolved``; and ``resolved_with_table_5_15``: the same medians and scatter with as many
        particles as Table 5.15 has, of which as large a part has a value.

    Notes
    -----
    Different axes of one track are taken as if they were of different tracks: what they share
    would only narrow the interval of their difference.
    """
    known = {key: finite(values) for key, values in groups.items()}
    published = trajectory_counts(groups)
    expected = {k: round(published[k] * len(known[k]) / max(len(groups[k]), 1)) for k in groups}
    rows = []
    for first, second in pairs:
        if first not in groups or second not in groups:
            continue
        pair = (first, second)
        if shares:
            ours = [(len(known[key]), len(groups[key])) for key in pair]
            theirs = [(expected[key], published[key]) for key in pair]
            interval, published_size = (
                intervals.difference_of_shares(a, b) for a, b in (ours, theirs)
            )
        else:
            values, statistic = [known[key] for key in pair], intervals.difference_of_medians
            interval, published_size = (
                Bootstrap()(statistic, values, generator, sizes)
                for sizes in (None, [expected[key] for key in pair])
            )
        row = {"first": first, "second": second, **interval_columns(interval)}
        if true is not None:
            real = [_estimate(true[k], shares) for k in pair]
            row["true"] = real[0] - real[1]
        row["resolved"] = interval.resolves()
        row["resolved_with_table_5_15"] = published_size.resolves()
        rows.append(row)
    return pd.DataFrame(rows)


def _estimate(values: Array, share: bool) -> float:
    """Return the median of the finite values, or the share of finite ones."""
    return len(finite(values)) / max(len(values), 1) if share else quartiles(finite(values))[1]


def trajectory_counts(keys: Iterable[Key]) -> dict[Key, int]:
    """Return how many trajectories of each fraction the thesis has (Table 5.15)."""
    printed = claims.published("table_5.15")
    amount = printed["amount_of_trajectories"].set_axis(printed["fraction"].str.lower())
    return {key: int(amount[key[0].lower()]) for key in keys}


def in_words(table: pd.DataFrame, quantity: str) -> str:
    """Return which `group_differences` are beyond chance, as part of a reason.

    Examples
    --------
    >>> pairs = {"first": [("a", 4.5), ("a", 4.5)], "second": [("b", 4.5), ("c", 4.5)]}
    >>> table = pd.DataFrame({**pairs, "estimate": [0.2, 0.1], "resolved": [True, False]})
    >>> in_words(table.assign(resolved_with_table_5_15=False), "medians")
    'medians resolved: a 4.5 > b 4.5; not: a 4.5, c 4.5; with the numbers of Table 5.15: 0 of 2'
    """
    if table.empty:
        return ""
    apart, close = [], []
    for row in table.to_dict("records"):
        first, second = (" ".join(map(str, row[side])) for side in ("first", "second"))
        if row["resolved"]:
            apart.append(f"{first} {'>' if row['estimate'] > 0 else '<'} {second}")
        else:
            close.append(f"{first}, {second}")
    parts = [f"{quantity} resolved: {' / '.join(apart) or 'none'}"]
    parts += [f"not: {' / '.join(close)}"] if close else []
    few = int(table["resolved_with_table_5_15"].sum())
    return "; ".join([*parts, f"with the numbers of Table 5.15: {few} of {len(table)}"])


def by_fraction(rows: Iterable[tuple[str, float, object]]) -> str:
    """Return values of campaigns in words, a sentence for each fraction.

    Examples
    --------
    >>> by_fraction([("confetti", 4.5, 7), ("confetti", 5.0, 9), ("wood chip", 4.5, "1 of 2")])
    'Confetti: 7 at 4.5 bar, 9 at 5.0 bar. Wood chip: 1 of 2 at 4.5 bar.'
    """
    parts: dict[str, list[str]] = {}
    for fraction, bar, value in rows:
        parts.setdefault(fraction[0].upper() + fraction[1:], []).append(f"{value} at {bar} bar")
    return " ".join(f"{name}: {', '.join(values)}." for name, values in parts.items())


def medians_in_words(values: Values, outcome: str, digits: int) -> str:
    """Return a median of each fraction at the lowest pressure, and of how many flights it is.

    Of fewer than six it says "too few": one flight is no median.
    """
    lowest, parts = min(bar for _, bar in values), []
    for (fraction, bar), each in values.items():
        sample = _samples(each)[outcome]
        if bar == lowest:
            few = len(sample) < Bootstrap.least
            median = "too few" if few else f"{np.median(sample):.{digits}f}"
            parts.append(f"{fraction} {median} ({len(sample)})")
    return f"at {lowest} bar (in brackets: of how many flights): {', '.join(parts)}"


def describe_coverage(medians: pd.DataFrame) -> str:
    """Describe how many intervals of `median_table` cover the true median.

    Of dwell time, ignition time and velocity in the first three metres.
    """
    outcomes = [f"velocity {k - 1}-{k} m (m/s)" for k in (1, 2, 3)]
    outcomes += ["dwell median (s)", "ignition median (s)"]
    known = medians[medians["outcome"].isin(outcomes)].dropna(subset=["low", "true"])
    return f"Intervals cover the truth in {int(known['covers'].sum())} of {len(known)} cases."


def describe_resolved(differences: pd.DataFrame) -> str:
    """Describe how many of `all_differences` are resolved, and how many of them wrongly."""
    resolved = differences[differences["resolved"]]
    wrong = int((np.sign(resolved["estimate"]) * np.sign(resolved["true"]) < 0).sum())
    nothing, theirs = (resolved["true"] == 0).sum(), differences["resolved_with_table_5_15"].sum()
    return (
        f"Of {len(differences)} comparisons {len(resolved)} look significant; {wrong + nothing} of "
        f"them are wrong. With as few flights as in Table 5.15 it is {theirs}."
    )


def regression_table(tables: Measurement, generator: np.random.Generator) -> pd.DataFrame:
    """Return medians over the trajectories from the lance beside Table 5.18.

    Returns
    -------
    DataFrame
        ``fraction``, ``axis``, ``rmse_mm``, ``mape_percent``, ``r2``, ``r2_adjusted``,
        ``tracks``, the four published ones, and of each of ours ``_low`` and ``_high``: its
        95 % interval (bootstrap over trajectories).
    """
    fitted = from_lance(tables, "trajectories")
    printed = claims.published("table_5.18").set_index(["fraction", "axis", "measure"])["value"]
    printed = printed.rename(str.lower, level="measure")
    rows = []
    for fraction in tables.trajectories["fraction"].unique():
        part = fitted[fitted["fraction"] == fraction]
        for axis in "xyz":
            fits = {name: part[column.format(axis)] for column, name in FIT_MEASURES.items()}
            row = {"fraction": fraction, "axis": axis}
            row |= {name: values.median() for name, values in fits.items()}
            row["tracks"] = len(part)
            row |= {f"{name}_published": printed[PLURALS[fraction], axis, name] for name in fits}
            for name, values in fits.items():
                bounds = interval_columns(median_of(values, generator))
                row |= {f"{name}_{side}": bounds[side] for side in ("low", "high")}
            rows.append(row)
    return pd.DataFrame(rows)


def distribution_distances(simulated: Values, measured: Values) -> pd.DataFrame:
    """Return Kolmogorov and Smirnov's distances of dwell times and first velocities.

    Returns
    -------
    DataFrame
        ``fraction``, ``quantity``, number ``simulated`` and ``measured``, ``distance`` and ``p``
        (empty where there is none).
    """
    rows = []
    for key, flight_values in simulated.items():
        both = [flight_values, measured[key]]
        quantities = {
            "dwell time": [finite(each.dwell_s) for each in both],
            "velocity 0-1 m": [finite(each.velocity_m_s[:, 0]) for each in both],
        }
        for quantity, (first, second) in quantities.items():
            row: dict[str, object] = {"fraction": key[0], "quantity": quantity}
            row |= {"simulated": len(first), "measured": len(second)}
            test = stats.ks_2samp(first, second) if len(first) and len(second) else None
            row |= {"distance": test.statistic, "p": test.pvalue} if test else {}
            rows.append(row)
    columns = ["fraction", "quantity", "simulated", "measured", "distance", "p"]
    return pd.DataFrame(rows).reindex(columns=columns)
