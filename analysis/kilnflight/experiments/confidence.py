"""Confidence intervals of what campaigns come to, and which differences are beyond chance."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TypeVar

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.experiments import results
from kilnflight.experiments.results import KEYS, CampaignKey, interval_columns, median_of
from kilnflight.project import claims
from kilnflight.scores import intervals
from kilnflight.scores.flights import LAST_SHARE, METRES, Findings, outcomes, quartiles, remaining
from kilnflight.scores.intervals import Bootstrap, Interval, Quantile

Key = TypeVar("Key", bound=tuple[str, object])  # a cell, or a fraction and an axis
Array = npt.NDArray[np.float64]
QUARTILE = Bootstrap(least=11)  # `Quantile` says why
NOTHING = Interval(np.nan, -np.inf, np.inf, (0,))


def outcome_intervals(findings: Findings, generator: np.random.Generator) -> dict[str, Interval]:
    """Return the interval of each of `flights.outcomes`, by name and in its unit."""
    lit = findings.ignition_s[np.isfinite(findings.ignition_s)]
    every = len(findings.ignition_s)
    found = _along(findings.velocity_m_s, generator) | _dwell(findings.dwell_s, generator)
    found |= {
        "penetration (m)": median_of(findings.reached_m, generator),
        "ignited (%)": _percent(len(lit), every),
        "ignited < 0.1 s (%)": _percent(int((lit <= 0.1).sum()), every),
        "ignition median (s)": median_of(lit, generator),
    }
    for name, low, high in (("< 0.2", 0.0, 0.2), ("< 0.4", 0.0, 0.4), ("0.2-0.3", 0.2, 0.3)):
        number = int(((lit > low) & (lit <= high)).sum())
        found[f"ignited {name} s (% of ignited)"] = _percent(number, len(lit))
    found["dwell spread (s)"] = _spread(findings.dwell_s, generator)
    for k, m in enumerate(METRES):
        found[f"spread {m - 1}-{m} m (m/s)"] = _spread(findings.velocity_m_s[:, k], generator)
    return {name: found[name] for name in outcomes(findings).index}


def _along(velocity_m_s: Array, generator: np.random.Generator) -> dict[str, Interval]:
    """Return velocities and remaining shares by metre; velocities (n, 5)."""
    count = len(velocity_m_s)
    passed = np.isfinite(velocity_m_s).sum(axis=0).tolist()
    each = [median_of(velocity_m_s[:, k], generator) for k in range(len(METRES))]
    far = np.flatnonzero(remaining(velocity_m_s) >= 100.0 * LAST_SHARE)
    last = each[far[-1]] if len(far) else NOTHING
    found = {f"velocity {m - 1}-{m} m (m/s)": v for m, v in zip(METRES, each, strict=True)}
    share = {f"remaining {m} m (%)": _percent(passed[m - 1], count) for m in METRES}
    found |= {"velocity last (m/s)": last} | share
    return found | {"landed 1 m (%)": _percent(count - passed[0], count)}


def _dwell(times: Array, generator: np.random.Generator) -> dict[str, Interval]:
    """Return what is said of dwell times (n,)."""
    within = int(((times >= 0.3) & (times <= 0.4)).sum())
    longest = times.max() if len(times) else np.nan
    return {
        "dwell q25 (s)": QUARTILE(Quantile(0.25), [times], generator),
        "dwell median (s)": median_of(times, generator),
        "dwell q75 (s)": QUARTILE(Quantile(0.75), [times], generator),
        "dwell longest (s)": Interval(longest, -np.inf, np.inf, (len(times),)),
        "dwell 0.3-0.4 s (%)": _percent(within, len(times)),
        "dwell > 0.4 s (%)": _percent(int((times >= 0.4).sum()), len(times)),
    }


def _spread(values: Array, generator: np.random.Generator) -> Interval:
    """Return the range between the quartiles of what is known."""
    return QUARTILE(intervals.between_quartiles, [values[np.isfinite(values)]], generator)


def _percent(number: int, counted: int) -> Interval:
    """Return a share in per cent; of none nothing is known."""
    if counted == 0:
        return NOTHING
    estimate, low, high, numbers = intervals.share(number, counted)
    return Interval(100 * estimate, 100 * low, 100 * high, numbers)


def interval_table(
    found: Mapping[CampaignKey, Findings],
    true: Mapping[CampaignKey, Findings],
    quantities: Sequence[str],
    generator: np.random.Generator,
) -> pd.DataFrame:
    """Return every number that begins with one of these words, by cell.

    Returns
    -------
    DataFrame
        ``fraction``, ``pressure_bar``, ``outcome``, ``number`` (of particles), ``estimate``,
        ``low``, ``high`` (empty where the sample is too small) and ``true``.
    """
    rows = []
    for cell, one in found.items():
        truth = outcomes(true[cell])
        for name, interval in outcome_intervals(one, generator).items():
            if name.split(" ")[0] in quantities:
                row = {**dict(zip(KEYS, cell, strict=True)), "outcome": name}
                rows.append(row | results.interval_columns(interval) | {"true": truth[name]})
    columns = [*KEYS, "outcome", "number", "estimate", "low", "high", "true"]
    return pd.DataFrame(rows, columns=columns)


def with_intervals(
    said: pd.DataFrame, certain: pd.DataFrame, name: str = "measured"
) -> pd.DataFrame:
    """Return a table of `results.beside_published` with intervals behind a column.

    Parameters
    ----------
    said
        With ``fraction``, ``pressure_bar``, ``outcome`` and the column ``name``.
    certain
        Of `interval_table`, of the findings that the column was worked out from.
    name
        Of the column; ``_low`` and ``_high`` are put behind it.
    """
    keys = [*KEYS, "outcome"]
    known = certain.set_index(keys).reindex(pd.MultiIndex.from_frame(said[keys]))
    wide, place = said.copy(), list(said.columns).index(name)
    for k, side in enumerate(("low", "high")):
        wide.insert(place + 1 + k, f"{name}_{side}", known[side].to_numpy())
    return wide


def unseen_metres(
    slices: pd.DataFrame, true: Mapping[CampaignKey, Findings], generator: np.random.Generator
) -> pd.DataFrame:
    """Return what the velocities come to without the metres that were passed before being seen.

    Parameters
    ----------
    slices
        `kilnflight.tables.SLICES` of flights from the lance, with fraction and pressure.
    true
        What is true of each cell.
    generator
        Of the bootstrap.

    Returns
    -------
    DataFrame
        ``fraction``, ``pressure_bar``, ``metre``; ``number`` of flights that passed it and how
        many of them ``unseen``; how many were ``too_fast``, faster than any true particle of the
        cell in that metre, and how many of these unseen; ``median_m_s``; ``seen_m_s`` with
        ``low`` and ``high``: the median of the seen ones; ``true_m_s``.
    """
    rows: list[dict[str, object]] = []
    for cell, one in true.items():
        part = results.of_campaign(slices, cell)
        for k, metre in enumerate(METRES):
            here = part[part["slice_m"] == metre]
            speed, seen = here["velocity_m_s"].to_numpy(np.float64), here["observed"].to_numpy(bool)
            real = one.velocity_m_s[np.isfinite(one.velocity_m_s[:, k]), k]
            fast = speed > real.max(initial=0.0)
            found = results.interval_columns(median_of(speed[seen], generator))
            row = {**dict(zip(KEYS, cell, strict=True)), "metre": metre, "number": len(speed)}
            row |= {"unseen": int((~seen).sum()), "too_fast": int(fast.sum())}
            row |= {"too_fast_unseen": int((fast & ~seen).sum()), "median_m_s": quartiles(speed)[1]}
            row |= {"seen_m_s": found["estimate"], "low": found["low"], "high": found["high"]}
            rows.append(row | {"true_m_s": quartiles(real)[1]})
    return pd.DataFrame(rows)


def resolved_differences(
    groups: Mapping[Key, Array],
    pairs: Sequence[tuple[Key, Key]],
    generator: np.random.Generator,
    true: Mapping[Key, Array] | None = None,
) -> pd.DataFrame:
    """Return `deviations.told_apart`, also with the thesis's numbers of particles.

    Parameters
    ----------
    groups
        Values by cell, or by fraction and axis.
    pairs
        First and second; those that are not in ``groups`` are left out.
    generator
        Of the bootstrap.
    true
        True values likewise.

    Returns
    -------
    DataFrame
        With a column ``resolved_with_table_5_15``: whether the same medians and scatter, but as
        many particles as Table 5.15 has, would be told apart.

    Notes
    -----
    Different axes of one track are taken as if they were of different tracks: what they share
    would only narrow the interval of their difference.
    """
    there = [one for one in pairs if one[0] in groups and one[1] in groups]
    ours = median_differences(groups, there, generator, true=true)
    theirs = median_differences(groups, there, generator, trajectory_counts(groups))
    return ours.assign(resolved_with_table_5_15=theirs.get("resolved"))


def resolved_share_differences(
    counts: Mapping[Key, tuple[int, int]],
    pairs: Sequence[tuple[Key, Key]],
    true: Mapping[Key, tuple[int, int]] | None = None,
) -> pd.DataFrame:
    """Return `resolved_differences` of shares; ``counts``: how many, of how many."""
    there = [one for one in pairs if one[0] in counts and one[1] in counts]
    ours = share_differences(counts, there, true=true)
    theirs = share_differences(counts, there, trajectory_counts(counts))
    return ours.assign(resolved_with_table_5_15=theirs.get("resolved"))


def trajectory_counts(keys: Iterable[Key]) -> dict[Key, int]:
    """Return how many trajectories of each fraction the thesis has (Table 5.15)."""
    printed = claims.published("table_5.15")
    amount = dict(
        zip(printed["fraction"].str.lower(), printed["amount_of_trajectories"], strict=True)
    )
    return {key: int(amount[key[0].lower()]) for key in keys}


def in_words(table: pd.DataFrame, what: str) -> str:
    """Return which differences of a `resolved_differences` are beyond chance, as part of a reason.

    Examples
    --------
    >>> pairs = {"first": [("a", 4.5), ("a", 4.5)], "second": [("b", 4.5), ("c", 4.5)]}
    >>> found = pd.DataFrame({**pairs, "estimate": [0.2, 0.1], "resolved": [True, False]})
    >>> in_words(found.assign(resolved_with_table_5_15=False), "medians")
    'medians told apart: a 4.5 > b 4.5; not: a 4.5, c 4.5; with the numbers of Table 5.15: 0 of 2'
    """
    if table.empty:
        return ""
    apart, close = [], []
    for one in table.to_dict("records"):
        first, second = (" ".join(map(str, one[side])) for side in ("first", "second"))
        if one["resolved"]:
            apart.append(f"{first} {'>' if one['estimate'] > 0 else '<'} {second}")
        else:
            close.append(f"{first}, {second}")
    said = [f"{what} told apart: {' / '.join(apart) or 'none'}"]
    said += [f"not: {' / '.join(close)}"] if close else []
    few = int(table["resolved_with_table_5_15"].sum())
    return "; ".join([*said, f"with the numbers of Table 5.15: {few} of {len(table)}"])


def share_differences(
    counts: Mapping[Key, tuple[int, int]],
    pairs: Sequence[tuple[Key, Key]],
    sizes: Mapping[Key, int] | None = None,
    true: Mapping[Key, tuple[int, int]] | None = None,
) -> pd.DataFrame:
    """Return differences of shares like `median_differences`; ``counts``: how many, of how many."""
    rows = []
    for first, second in pairs:
        one, two = counts[first], counts[second]
        if sizes is not None:
            one, two = _resized(one, sizes[first]), _resized(two, sizes[second])
        found = intervals.difference_of_shares(one, two)
        row = {"first": first, "second": second, **interval_columns(found)}
        if true is not None:
            shares = [true[cell][0] / max(true[cell][1], 1) for cell in (first, second)]
            row |= {"true": shares[0] - shares[1]}
        rows.append(row | {"resolved": found.resolves()})
    return pd.DataFrame(rows)


def _resized(count: tuple[int, int], size: int) -> tuple[int, int]:
    """Return how many of ``size`` the same share is."""
    number, of = count
    return (round(size * number / of) if of else 0), size


def median_differences(
    groups: Mapping[Key, npt.NDArray[np.float64]],
    pairs: Sequence[tuple[Key, Key]],
    generator: np.random.Generator,
    sizes: Mapping[Key, int] | None = None,
    true: Mapping[Key, npt.NDArray[np.float64]] | None = None,
) -> pd.DataFrame:
    """Return differences of medians with their interval, and whether they are resolved.

    Parameters
    ----------
    groups
        Values by cell; NaN are left out.
    pairs
        First and second.
    generator
        Of the bootstrap.
    sizes
        How many particles to reckon with, if not with all, with and without a value: as many
        of them as of ours have one.
    true
        True values by cell: their difference of medians stands beside.
    """
    known = {name: values[np.isfinite(values)] for name, values in groups.items()}
    rows = []
    for first, second in pairs:
        both = known[first], known[second]
        wanted = None
        if sizes is not None:
            counts = ((len(known[name]), len(groups[name])) for name in (first, second))
            ends = zip(counts, (sizes[first], sizes[second]), strict=True)
            wanted = [_resized(count, size)[0] for count, size in ends]
        found = intervals.Bootstrap()(intervals.difference_of_medians, both, generator, wanted)
        row = {"first": first, "second": second, **interval_columns(found)}
        if true is not None:
            one, two = (quartiles(true[c][np.isfinite(true[c])])[1] for c in (first, second))
            row |= {"true": float(one - two)}
        rows.append(row | {"resolved": found.resolves()})
    return pd.DataFrame(rows)
