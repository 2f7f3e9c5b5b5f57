"""How far measured flights are from the true ones: bias, spread, what was found and resolved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeVar

import joblib
import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.experiments.campaigns import Campaign, Measured
from kilnflight.experiments.survey import CELL, named, of_cell
from kilnflight.experiments.trust import Flown, owned, owners, sightings, true_flights, ways
from kilnflight.flight import BURNT_OUT, LANDED, LOST
from kilnflight.regression import fits
from kilnflight.scores import intervals
from kilnflight.scores.flights import METRES, quartiles

Key = TypeVar("Key", bound=tuple[str, object])  # a cell, or a fraction and an axis
CASES = ("landed unlit", "landed burning", BURNT_OUT)  # (a), (b) and (c) of Fig. 5.18
QUANTITIES = {"dwell_s": "s", "velocity_m_s": "m/s", "ignition_s": "s"}


def compared(way: Flown, true: pd.DataFrame) -> pd.DataFrame:
    """Return measured beside true, one row per true particle whose whole flight is recorded.

    Of several tracks of a particle the one that was followed for longest counts; what starts
    at the lance and belongs to nobody comes last, without truth.

    Parameters
    ----------
    way
        Flights that were worked out in one way.
    true
        `kilnflight.experiments.trust.true_flights`.

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


def whole_chain(wanted: Sequence[Campaign], measured: Measured) -> pd.DataFrame:
    """Return `compared` of the measurement as it is, with fraction and pressure in front."""
    parts = []
    for one in wanted:
        cell = (one.fraction, one.pressure_bar)
        tracks, _, flights, slices = (of_cell(table, cell) for table in measured)
        belongs = owners(tracks, owned(tracks.reset_index(drop=True), sightings(one)))
        both = compared(Flown(flights, slices, belongs), true_flights(one))
        both.insert(0, "fraction", cell[0])
        both.insert(1, "pressure_bar", cell[1])
        parts.append(both)
    return pd.concat(parts, ignore_index=True)


def endings(both: pd.DataFrame) -> pd.DataFrame:
    """Return how flights end by how they truly do (Fig. 5.18), in particles.

    Parameters
    ----------
    both
        `whole_chain`.

    Returns
    -------
    DataFrame
        ``fraction``, ``pressure_bar``, ``true``; ``landed unlit``, ``landed burning``, ``burnt
        out`` and ``lost`` as measured, and ``not measured``.
    """
    real = both[both["particle"] >= 0]
    true = cases(real["true_ending"], real["true_ignition_s"].notna()).rename("true")
    told = cases(real["ending"], real["measured_ignition_s"].notna())
    told = told.where(real["track"] >= 0, "not measured")
    table = pd.crosstab([real["fraction"], real["pressure_bar"], true], told)
    every = [*CASES, LOST, "not measured"]
    return table.reindex(columns=every, fill_value=0).rename_axis(columns=None).reset_index()


def cases(ending: pd.Series, lit: pd.Series) -> pd.Series:
    """Return `CASES` of endings, by whether a particle burnt; other endings stay."""
    landed = lit.map({False: CASES[0], True: CASES[1]})
    return ending.where(ending != LANDED, landed)


def velocities(wanted: Sequence[Campaign], measured: Measured) -> pd.DataFrame:
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
        tracks, _, flights, slices = (of_cell(table, cell) for table in measured)
        belongs = owners(tracks, owned(tracks.reset_index(drop=True), sightings(one)))
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
        `compared`.
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


def account(way: Flown, true: pd.DataFrame) -> dict[str, int]:
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


def budget(wanted: Sequence[Campaign], measured: Measured, jobs: int = 1) -> pd.DataFrame:
    """Return `errors` of every cell and way of `trust.ways`, in so many processes."""
    rows = joblib.Parallel(n_jobs=jobs)(
        joblib.delayed(_budget)(
            one, *(of_cell(part, (one.fraction, one.pressure_bar)) for part in measured[:2])
        )
        for one in wanted
    )
    return pd.DataFrame([row for part in rows for row in part])


def _budget(
    campaign: Campaign, tracked: pd.DataFrame, trajectories: pd.DataFrame
) -> list[dict[str, object]]:
    """Return the rows of one campaign, given its tracks and their trajectories."""
    cell = {"fraction": campaign.fraction, "pressure_bar": campaign.pressure_bar}
    tracks = tracked.drop(columns=CELL).reset_index(drop=True)
    own = fits(trajectories.drop(columns=CELL))
    true, rows = true_flights(campaign), []
    for name, way in ways(campaign, tracks, own):
        rows.append({**cell, "way": name, **errors(compared(way, true)), **account(way, true)})
    return rows


def shares_told_apart(
    counts: Mapping[Key, tuple[int, int]],
    pairs: Sequence[tuple[Key, Key]],
    sizes: Mapping[Key, int] | None = None,
    true: Mapping[Key, tuple[int, int]] | None = None,
) -> pd.DataFrame:
    """Return differences of shares like `told_apart`; ``counts``: how many, of how many."""
    rows = []
    for first, second in pairs:
        one, two = counts[first], counts[second]
        if sizes is not None:
            one, two = _resized(one, sizes[first]), _resized(two, sizes[second])
        found = intervals.difference_of_shares(one, two)
        row = {"first": first, "second": second, **named(found)}
        if true is not None:
            shares = [true[cell][0] / max(true[cell][1], 1) for cell in (first, second)]
            row |= {"true": shares[0] - shares[1]}
        rows.append(row | {"resolved": found.resolves()})
    return pd.DataFrame(rows)


def _resized(count: tuple[int, int], size: int) -> tuple[int, int]:
    """Return how many of ``size`` the same share is."""
    number, of = count
    return (round(size * number / of) if of else 0), size


def told_apart(
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
        row = {"first": first, "second": second, **named(found)}
        if true is not None:
            one, two = (quartiles(true[c][np.isfinite(true[c])])[1] for c in (first, second))
            row |= {"true": float(one - two)}
        rows.append(row | {"resolved": found.resolves()})
    return pd.DataFrame(rows)
