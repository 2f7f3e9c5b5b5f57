"""Confidence intervals of campaign results, and which differences are beyond chance.

95 % intervals: medians and quartiles by bootstrap over particles, shares by Wilson
(`kilnflight.scores.intervals` says what they leave out). A velocity is that of the particles that
passed the metre, and the interval is of those; "velocity last" is of the metre that is the last
one in the sample. The longest dwell time has none: no bootstrap gives one for a maximum.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import TypeVar

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.experiments.campaigns import Measurement
from kilnflight.experiments.results import (
    KEYS,
    CampaignKey,
    ignited,
    in_metre,
    of_campaign,
    pairs_to_compare,
    trajectories_from_lance,
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
Pairs = Sequence[tuple[Key, Key]]
QUARTILE = Bootstrap(least=11)  # `kilnflight.scores.intervals.between_quartiles` says why
NOTHING = Interval(np.nan, -np.inf, np.inf, (0,))
# Measures of a fit by axis, and their columns in Table 5.18.
FIT_MEASURES = {"rmse_{}_mm": "rmse_mm", "mape_{}_percent": "mape_percent"}
FIT_MEASURES |= {"r2_{}": "r2", "r2_adjusted_{}": "r2_adjusted"}
PLURALS = {"wood chip": "Wood chips", "confetti": "Confetti"}
PLURALS |= {"paper shred": "Paper shreds", "PE granule": "PE granules"}


def interval_columns(interval: Interval) -> dict[str, float]:
    """Return an interval as columns; infinite bounds become empty."""
    low, high = (np.nan if np.isinf(edge) else edge for edge in (interval.low, interval.high))
    number = sum(interval.numbers)
    return {"number": number, "estimate": interval.estimate, "low": low, "high": high}


def median_of(values: npt.ArrayLike, generator: np.random.Generator) -> Interval:
    """Return the median of the finite values with its 95 % interval (bootstrap)."""
    known = np.asarray(values, dtype=np.float64)
    return Bootstrap()(np.median, [known[np.isfinite(known)]], generator)


def outcome_intervals(
    flight_values: FlightValues, generator: np.random.Generator
) -> dict[str, Interval]:
    """Return the interval of each of `flights.outcomes`, by name and in its unit."""
    lit = flight_values.ignition_s[np.isfinite(flight_values.ignition_s)]
    every = len(flight_values.ignition_s)
    found = _velocity_intervals(flight_values.velocity_m_s, generator)
    found |= _dwell_intervals(flight_values.dwell_s, generator)
    found |= {
        "penetration (m)": median_of(flight_values.reached_m, generator),
        "ignited (%)": _percent(len(lit), every),
        "ignited < 0.1 s (%)": _percent(int((lit <= 0.1).sum()), every),
        "ignition median (s)": median_of(lit, generator),
    }
    for name, low, high in (("< 0.2", 0.0, 0.2), ("< 0.4", 0.0, 0.4), ("0.2-0.3", 0.2, 0.3)):
        number = int(((lit > low) & (lit <= high)).sum())
        found[f"ignited {name} s (% of ignited)"] = _percent(number, len(lit))
    return {name: found[name] for name in outcomes(flight_values).index}


def _velocity_intervals(velocity_m_s: Array, generator: np.random.Generator) -> dict[str, Interval]:
    """Return medians, spreads and remaining shares by metre; velocities (n, 5)."""
    count = len(velocity_m_s)
    passed = np.isfinite(velocity_m_s).sum(axis=0).tolist()
    each = [median_of(column, generator) for column in velocity_m_s.T]
    far = np.flatnonzero(remaining(velocity_m_s) >= 100.0 * LAST_SHARE)
    found = {"velocity last (m/s)": each[far[-1]] if len(far) else NOTHING}
    for k, metre in enumerate(METRES):
        found[f"velocity {metre - 1}-{metre} m (m/s)"] = each[k]
        found[f"remaining {metre} m (%)"] = _percent(passed[k], count)
        found[f"spread {metre - 1}-{metre} m (m/s)"] = _spread(velocity_m_s[:, k], generator)
    return found | {"landed 1 m (%)": _percent(count - passed[0], count)}


def _dwell_intervals(times: Array, generator: np.random.Generator) -> dict[str, Interval]:
    within = int(((times >= 0.3) & (times <= 0.4)).sum())
    longest = times.max() if len(times) else np.nan
    return {
        "dwell q25 (s)": QUARTILE(partial(np.quantile, q=0.25), [times], generator),
        "dwell median (s)": median_of(times, generator),
        "dwell q75 (s)": QUARTILE(partial(np.quantile, q=0.75), [times], generator),
        "dwell longest (s)": Interval(longest, -np.inf, np.inf, (len(times),)),
        "dwell 0.3-0.4 s (%)": _percent(within, len(times)),
        "dwell > 0.4 s (%)": _percent(int((times >= 0.4).sum()), len(times)),
        "dwell spread (s)": _spread(times, generator),
    }


def _spread(values: Array, generator: np.random.Generator) -> Interval:
    """Return the range between the quartiles of the finite values."""
    return QUARTILE(intervals.between_quartiles, [values[np.isfinite(values)]], generator)


def _percent(number: int, counted: int) -> Interval:
    """Return a share in per cent; of none nothing is known."""
    if counted == 0:
        return NOTHING
    estimate, low, high, numbers = intervals.share(number, counted)
    return Interval(100 * estimate, 100 * low, 100 * high, numbers)


def interval_table(
    found: Mapping[CampaignKey, FlightValues],
    true: Mapping[CampaignKey, FlightValues],
    quantities: Sequence[str],
    generator: np.random.Generator,
) -> pd.DataFrame:
    """Return every number that begins with one of these words, by campaign.

    Returns
    -------
    DataFrame
        ``fraction``, ``pressure_bar``, ``outcome``, ``number`` (of particles), ``estimate``,
        ``low``, ``high`` (empty where the sample is too small) and ``true``.
    """
    rows = []
    for key, one in found.items():
        truth = outcomes(true[key])
        for name, interval in outcome_intervals(one, generator).items():
            if name.split(" ")[0] in quantities:
                row = {**dict(zip(KEYS, key, strict=True)), "outcome": name}
                rows.append(row | interval_columns(interval) | {"true": truth[name]})
    columns = [*KEYS, "outcome", "number", "estimate", "low", "high", "true"]
    return pd.DataFrame(rows, columns=columns)


def with_intervals(
    published: pd.DataFrame, table: pd.DataFrame, name: str = "measured"
) -> pd.DataFrame:
    """Return a table of `results.beside_published` with intervals behind a column.

    Parameters
    ----------
    published
        With ``fraction``, ``pressure_bar``, ``outcome`` and the column ``name``.
    table
        Of `interval_table`, of the values that the column was worked out from.
    name
        Of the column; ``_low`` and ``_high`` are put behind it.
    """
    keys = [*KEYS, "outcome"]
    known = table.set_index(keys).reindex(pd.MultiIndex.from_frame(published[keys]))
    wide, place = published.copy(), list(published.columns).index(name)
    for k, side in enumerate(("low", "high")):
        wide.insert(place + 1 + k, f"{name}_{side}", known[side].to_numpy())
    return wide


def unseen_metres(
    slices: pd.DataFrame, true: Mapping[CampaignKey, FlightValues], generator: np.random.Generator
) -> pd.DataFrame:
    """Return what the velocities come to without metres passed before the first detection.

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
        many of them ``unseen``; how many were ``too_fast``, faster than any true particle of the
        campaign in that metre, and how many of these unseen; ``median_m_s``; ``seen_m_s`` with
        ``low`` and ``high``: the median of the seen ones; ``true_m_s``.
    """
    rows: list[dict[str, object]] = []
    for key, one in true.items():
        part = of_campaign(slices, key)
        for k, metre in enumerate(METRES):
            here = part[part["slice_m"] == metre]
            speed, seen = here["velocity_m_s"].to_numpy(np.float64), here["observed"].to_numpy(bool)
            real = one.velocity_m_s[np.isfinite(one.velocity_m_s[:, k]), k]
            fast = speed > real.max(initial=0.0)
            found = interval_columns(median_of(speed[seen], generator))
            row = {**dict(zip(KEYS, key, strict=True)), "metre": metre, "number": len(speed)}
            row |= {"unseen": int((~seen).sum()), "too_fast": int(fast.sum())}
            row |= {"too_fast_unseen": int((fast & ~seen).sum()), "median_m_s": quartiles(speed)[1]}
            row |= {"seen_m_s": found["estimate"], "low": found["low"], "high": found["high"]}
            rows.append(row | {"true_m_s": quartiles(real)[1]})
    return pd.DataFrame(rows)


def coverage(
    found: Mapping[CampaignKey, FlightValues],
    true: Mapping[CampaignKey, FlightValues],
    generator: np.random.Generator,
) -> pd.DataFrame:
    """Return the medians of each campaign, and whether their intervals cover the true ones.

    Returns
    -------
    DataFrame
        ``quantity`` (dwell time, ignition time, velocity in the first three metres),
        ``fraction``, ``pressure_bar``, ``number``, ``estimate``, ``low``, ``high``, ``true``
        (median of all flights in the same frames) and ``covers``.
    """
    quantities = {"dwell_s": (found, true, "dwell_s"), "ignition_s": (found, true, "ignition_s")}
    for metre in (1, 2, 3):
        both = in_metre(found, metre), in_metre(true, metre)
        quantities[f"velocity {metre - 1}-{metre} m"] = (*both, "velocity_m_s")
    rows = []
    for quantity, (measured, real, field) in quantities.items():
        for key in measured:
            row = {"quantity": quantity, **dict(zip(KEYS, key, strict=True))}
            row |= interval_columns(median_of(getattr(measured[key], field), generator))
            values = getattr(real[key], field)
            rows.append(row | {"true": quartiles(values[np.isfinite(values)])[1]})
    table = pd.DataFrame(rows)
    inside = (table["low"] <= table["true"]) & (table["true"] <= table["high"])
    return table.assign(covers=inside)


def ratio_table(
    found: Mapping[CampaignKey, FlightValues], generator: np.random.Generator
) -> pd.DataFrame:
    """Return the median velocity in the first metre at the highest pressure over the lowest."""
    rows, bars = [], sorted({bar for _, bar in found})
    for name in dict.fromkeys(fraction for fraction, _ in found):
        pair = [found[name, bar].velocity_m_s[:, 0] for bar in (bars[-1], bars[0])]
        known = [values[np.isfinite(values)] for values in pair]
        ratio = Bootstrap()(intervals.ratio_of_medians, known, generator)
        rows.append({"fraction": name, **interval_columns(ratio)})
    return pd.DataFrame(rows)


def dwell_medians(table: pd.DataFrame, true: Mapping[CampaignKey, FlightValues]) -> pd.DataFrame:
    """Return the median dwell times of an `interval_table`, and whether they cover the truth."""
    rows = table[table["outcome"] == "dwell median (s)"].drop(columns="outcome")
    rows = rows.rename(columns={"estimate": "measured_s", "true": "true_s"}).reset_index(drop=True)
    keys = zip(rows["fraction"], rows["pressure_bar"], strict=True)
    return rows.assign(
        true_number=[len(true[key].dwell_s) for key in keys],
        covers=(rows["low"] <= rows["true_s"]) & (rows["true_s"] <= rows["high"]),
    )


def ignited_shares(sources: Mapping[str, Mapping[CampaignKey, FlightValues]]) -> pd.DataFrame:
    """Return the share that ignites within 0.1 s, 0.2 s and at all, with its interval (Wilson)."""
    rows = []
    for source, found in sources.items():
        for key, one in found.items():
            row = {"source": source, **dict(zip(KEYS, key, strict=True))}
            for within in (0.1, 0.2, np.inf):
                lit = int((one.ignition_s <= within).sum())
                share = interval_columns(intervals.share(lit, len(one.ignition_s)))
                rows.append({**row, "within_s": "" if np.isinf(within) else within, **share})
    return pd.DataFrame(rows)


def all_differences(
    found: Mapping[CampaignKey, FlightValues],
    true: Mapping[CampaignKey, FlightValues],
    generator: np.random.Generator,
) -> pd.DataFrame:
    """Return the differences of all `pairs_to_compare`: dwell time, velocity, ignited share."""
    pairs, parts = pairs_to_compare(found), []
    for quantity in ("dwell_s", "velocity_m_s"):
        values, truth = (
            {key: getattr(one, quantity) for key, one in in_metre(results, 1).items()}
            for results in (found, true)
        )
        table = resolved_differences(values, pairs, generator, truth)
        parts.append(table.assign(quantity=quantity))
    counts, real = (
        {key: ignited(one) for key, one in results.items()} for results in (found, true)
    )
    shares = resolved_share_differences(counts, pairs, real)
    table = pd.concat([*parts, shares.assign(quantity="ignited share")], ignore_index=True)
    for side in ("first", "second"):
        table[side] = [f"{name}, {bar} bar" for name, bar in table[side]]
    columns = ["quantity", "first", "second", "number", "estimate", "low", "high", "true"]
    return table[[*columns, "resolved", "resolved_with_table_5_15"]]


def resolved_differences(
    groups: Mapping[Key, Array],
    pairs: Pairs[Key],
    generator: np.random.Generator,
    true: Mapping[Key, Array] | None = None,
) -> pd.DataFrame:
    """Return differences of medians, and whether they are beyond chance.

    Parameters
    ----------
    groups
        Values by campaign, or by fraction and axis; NaN are left out.
    pairs
        First and second; those that are not in ``groups`` are left out.
    generator
        Of the bootstrap.
    true
        True values likewise.

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
    known = {key: values[np.isfinite(values)] for key, values in groups.items()}
    counts = {key: (len(known[key]), len(groups[key])) for key in groups}

    def interval(first: Key, second: Key, sizes: Sequence[int] | None) -> Interval:
        both = [known[first], known[second]]
        return Bootstrap()(intervals.difference_of_medians, both, generator, sizes)

    medians = {
        key: quartiles(values[np.isfinite(values)])[1] for key, values in (true or {}).items()
    }
    return _resolved(pairs, counts, interval, medians)


def resolved_share_differences(
    counts: Mapping[Key, tuple[int, int]],
    pairs: Pairs[Key],
    true: Mapping[Key, tuple[int, int]] | None = None,
) -> pd.DataFrame:
    """Return `resolved_differences` of shares; ``counts``: how many, of how many."""
    published = trajectory_counts(counts)

    def interval(first: Key, second: Key, sizes: Sequence[int] | None) -> Interval:
        if sizes is None:
            return intervals.difference_of_shares(counts[first], counts[second])
        one, two = ((n, published[key]) for n, key in zip(sizes, (first, second), strict=True))
        return intervals.difference_of_shares(one, two)

    shares = {key: number / max(of, 1) for key, (number, of) in (true or {}).items()}
    return _resolved(pairs, counts, interval, shares)


def _resolved(
    pairs: Pairs[Key],
    counts: Mapping[Key, tuple[int, int]],
    interval: Callable[[Key, Key, Sequence[int] | None], Interval],
    true: Mapping[Key, float],
) -> pd.DataFrame:
    """Return a row per pair: with our numbers of particles and with those of Table 5.15."""
    published = trajectory_counts(counts)
    sizes = {k: round(published[k] * n / of) if of else 0 for k, (n, of) in counts.items()}
    rows = []
    for first, second in pairs:
        if first in counts and second in counts:
            ours = interval(first, second, None)
            row = {"first": first, "second": second, **interval_columns(ours)}
            row |= {"true": true[first] - true[second]} if true else {}
            theirs = interval(first, second, [sizes[first], sizes[second]])
            resolved = {"resolved": ours.resolves(), "resolved_with_table_5_15": theirs.resolves()}
            rows.append(row | resolved)
    return pd.DataFrame(rows)


def trajectory_counts(keys: Iterable[Key]) -> dict[Key, int]:
    """Return how many trajectories of each fraction the thesis has (Table 5.15)."""
    printed = claims.published("table_5.15")
    amount = printed["amount_of_trajectories"].set_axis(printed["fraction"].str.lower())
    return {key: int(amount[key[0].lower()]) for key in keys}


def in_words(table: pd.DataFrame, what: str) -> str:
    """Return which differences are beyond chance, as part of a reason.

    Examples
    --------
    >>> pairs = {"first": [("a", 4.5), ("a", 4.5)], "second": [("b", 4.5), ("c", 4.5)]}
    >>> found = pd.DataFrame({**pairs, "estimate": [0.2, 0.1], "resolved": [True, False]})
    >>> in_words(found.assign(resolved_with_table_5_15=False), "medians")
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
    parts = [f"{what} resolved: {' / '.join(apart) or 'none'}"]
    parts += [f"not: {' / '.join(close)}"] if close else []
    few = int(table["resolved_with_table_5_15"].sum())
    return "; ".join([*parts, f"with the numbers of Table 5.15: {few} of {len(table)}"])


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
    wide = claims.published("table_5.18").pivot(
        index=["fraction", "axis"], columns="measure", values="value"
    )
    printed = wide.rename(columns=str.lower).to_dict("index")
    rows = []
    for fraction in measured.trajectories["fraction"].unique():
        one = table[table["fraction"] == fraction]
        for axis in "xyz":
            fits = {name: one[column.format(axis)] for column, name in FIT_MEASURES.items()}
            row = {"fraction": fraction, "axis": axis}
            row |= {name: values.median() for name, values in fits.items()}
            row["tracks"] = len(one)
            theirs = printed[PLURALS[fraction], axis]
            row |= {f"{name}_published": theirs[name] for name in fits}
            for name, values in fits.items():
                bounds = interval_columns(median_of(values, generator))
                row |= {f"{name}_{side}": bounds[side] for side in ("low", "high")}
            rows.append(row)
    return pd.DataFrame(rows)
