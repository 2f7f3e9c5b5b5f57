"""Which particles ignite: the optical picture, our test of grey values, and their errors.

Section 5.3.2 of the thesis. Wood chips and PE granules are judged by Fig. 5.17, papers by grey
values along their tracks. All are of flights from the lance that are not refused.

tables of campaigns -> flights by reading -> errors, shares, verdicts; recording -> picture
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from kilnflight import kiln, regression
from kilnflight.checks import InputError
from kilnflight.experiments import confidence
from kilnflight.experiments.accuracy import compare_campaigns, errors
from kilnflight.experiments.campaigns import (
    KEYS,
    CampaignKey,
    Measurement,
    Results,
    campaign_keys,
    of_campaign,
    stack,
    twin_of,
    values_by_campaign,
)
from kilnflight.experiments.confidence import (
    Array,
    Values,
    group_differences,
    interval_columns,
)
from kilnflight.experiments.statements import (
    HEAVY,
    LEAST_FLIGHTS,
    PAPERS,
    beside_published,
    by_pressure,
    conditions,
)
from kilnflight.flight import kept
from kilnflight.ignition import BEFORE, SEEN, TOO_FEW, IgnitionResult, LitTrace
from kilnflight.project import claims
from kilnflight.project.style import PAGE_MM, canvas, draw_frame
from kilnflight.recording.frames import Recording
from kilnflight.scores import intervals
from kilnflight.scores.flights import FlightValues
from kilnflight.tables import FLIGHTS

AS_THEY_ARE, ABOVE = "as they are", "above background"
# Two readings of Fig. 5.17, as the text does not say whether differences are absolute.
PICTURES = {
    "lighter than the kiln behind": LitTrace(0.1),
    "lighter than any silhouette": LitTrace(1.0),
}
BASICALLY = 0.05  # of the flights: ours, for "do not combust basically" (section 5.3)


def above_background(results: Results) -> pd.DataFrame:
    """Return the flights with ignition read from grey values above the background.

    `kilnflight.kiln.background_gray` defines it; it uses only pictures, no truth.
    """
    parts = {}
    for campaign in results.campaigns:
        tables = (of_campaign(table, campaign.key) for table in results.tables[:2])
        tracks, trajectories = (table.drop(columns=KEYS) for table in tables)
        rules = campaign.run.rules
        above = replace(rules, ignition=replace(rules.ignition, above_background=True))
        run = replace(campaign.run, rules=above)
        parts[campaign.key] = kiln.flights_from(run, tracks, regression.fits(trajectories))
    return stack(parts)


def lit_traces(results: Results) -> dict[str, pd.DataFrame]:
    """Return the flights with ignition read from their traces, by reading of `PICTURES`."""
    parts: dict[str, dict[CampaignKey, pd.DataFrame]] = {name: {} for name in PICTURES}
    for campaign in results.campaigns:
        tracks, _, flights, _ = (of_campaign(table, campaign.key) for table in results.tables)
        flights = flights.drop(columns=KEYS)
        table = tracks[tracks["particle"].isin(kept(flights[flights["from_lance"]])["particle"])]
        source, frames = campaign.run.detection.source, campaign.frames
        table = table.assign(
            background=kiln.background_gray(table, source, frames),
            time_s=table["frame"] / campaign.run.frame_rate_hz,
        )
        for name, look in PICTURES.items():
            parts[name][campaign.key] = _with_traces(flights, table, look)
    return {name: stack(each) for name, each in parts.items()}


def _with_traces(flights: pd.DataFrame, tracks: pd.DataFrame, look: LitTrace) -> pd.DataFrame:
    """Return flights with the outcome of their tracks' traces, up to their end."""
    seen = {
        particle: _trace(track.sort_values("frame"), end_s, look)
        for (particle, track), end_s in zip(
            tracks.groupby("particle"),
            flights.set_index("particle")["end_s"].reindex(sorted(tracks["particle"].unique())),
            strict=True,
        )
    }
    found = [seen.get(particle, IgnitionResult(TOO_FEW)) for particle in flights["particle"]]
    table = flights.assign(
        # typed, also where nothing flew
        ignition=pd.Series([each.outcome for each in found], flights.index, dtype=str),
        ignition_s=np.array([each.time_s for each in found], np.float64) - flights["t0_s"],
        rise_gray=np.nan_to_num([each.after - each.before for each in found]),
    )
    return FLIGHTS.check(table)


def _trace(track: pd.DataFrame, end_s: float, look: LitTrace) -> IgnitionResult:
    flying = track[track["time_s"] <= end_s]
    return look(flying["time_s"], flying["gray"], flying["background"])


def readings(results: Results) -> dict[str, Measurement]:
    """Return the campaigns' tables by reading of ignition; flights differ, nothing else."""
    flights = {ABOVE: above_background(results), **lit_traces(results)}
    tables = {name: results.tables._replace(flights=each) for name, each in flights.items()}
    return {AS_THEY_ARE: results.tables, **tables}


def kept_values(tables: Measurement) -> dict[CampaignKey, FlightValues]:
    """Return the values of each campaign's flights that are not refused."""
    return values_by_campaign(tables._replace(flights=kept(tables.flights)))


def compare_readings(
    results: Results, tables: Mapping[str, Measurement]
) -> dict[str, pd.DataFrame]:
    """Return `accuracy.compare_campaigns` of kept flights by reading."""
    return {
        name: compare_campaigns(results.campaigns, each._replace(flights=kept(each.flights)))
        for name, each in tables.items()
    }


def ignition_errors(both: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Return how often and how well ignition was detected, by reading and campaign.

    Parameters
    ----------
    both
        `compare_readings`.

    Returns
    -------
    DataFrame
        ``reading``, fraction, pressure; ``lit`` and ``unlit``: detected particles that truly
        ignite in flight and that do not, and in how many of them ignition was detected;
        ``hit_percent`` and ``false_alarm_percent`` with their 95 % intervals (Wilson); number,
        median error and spread of the ignition time in s.
    """
    rows = []
    for name, table in both.items():
        for key in campaign_keys(table):
            row = {"reading": name} | dict(zip(KEYS, key, strict=True))
            rows.append(row | _rates(errors(of_campaign(table, key))))
    return pd.DataFrame(rows, columns=None if rows else ["reading", *KEYS])  # nothing flew


def _rates(error: Mapping[str, float]) -> dict[str, float]:
    """Return counts, hit rate and false alarms of the errors of one campaign."""
    names = ["detected_particles", "lit", "lit_detected", "unlit", "unlit_detected"]
    row = {name: error[name] for name in names}
    for name, kind in (("hit", "lit"), ("false_alarm", "unlit")):
        share = intervals.share(int(error[f"{kind}_detected"]), int(error[kind]))
        values = {"": share.estimate, "_low": share.low, "_high": share.high}
        known = error[kind] > 0
        row |= {
            f"{name}_percent{k}": round(100 * v, 2) if known else np.nan for k, v in values.items()
        }
    columns = {"n": "time_error_n", "bias": "time_error_median_s", "spread": "time_error_spread_s"}
    return row | {new: error[f"ignition_s_{old}"] for old, new in columns.items()}


def ignition_times(both: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Return measured and true ignition times of every particle (Figs 5.25 and 5.26).

    ``measured_s``: by our test of grey values as they are; ``measured_above_background_s``: of
    their rise above it.
    """
    names = {"measured_ignition_s": "measured_s", "true_ignition_s": "true_s"}
    table = both[AS_THEY_ARE].rename(columns=names)
    above = both[ABOVE]["measured_ignition_s"].to_numpy()
    table = table.assign(measured_above_background_s=above, detected=table["track"] >= 0)
    columns = ["particle", "measured_s", "measured_above_background_s", "true_s", "detected"]
    return table[[*KEYS, *columns]]


def trace_shares(traces: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Return how many flights light up in the picture, by campaign and reading.

    Parameters
    ----------
    traces
        `lit_traces`.

    Returns
    -------
    DataFrame
        ``picture``, fraction, pressure, ``light_up``, ``light_at_first`` (light from the first
        detection on), ``too_few`` points to judge; ``number``, ``estimate``, ``low``, ``high``
        of the share that lights up (Wilson).
    """
    rows = []
    for name, table in traces.items():
        flights = kept(table[table["from_lance"]])
        for key in campaign_keys(table):
            kinds = of_campaign(flights, key)["ignition"]
            count = {"light_up": SEEN, "light_at_first": BEFORE, "too_few": TOO_FEW}
            row = {label: int((kinds == kind).sum()) for label, kind in count.items()}
            share = interval_columns(intervals.share(row["light_up"], len(kinds)))
            rows.append({"picture": name, **dict(zip(KEYS, key, strict=True)), **row, **share})
    return pd.DataFrame(rows)


def optical_picture(recording: Recording, frames: range) -> Array:
    """Return a background plus the absolute differences of frames from it (5.2.2, Fig. 5.17).

    The background is the median of `kilnflight.kiln.BACKGROUND_FRAMES` frames spread over
    ``frames``. What lies within three times the noise is left out, or thousands of frames of
    noise would cover all: ours.
    """
    steps = np.linspace(frames[0], frames[-1], kiln.BACKGROUND_FRAMES).round().astype(int)
    chosen = np.stack([recording.gray(t) for t in np.unique(steps).tolist()])
    background = np.median(chosen, axis=0).astype(np.float32)
    noise = 3 * 1.4826 * np.median(np.abs(chosen - background), axis=0)
    total = background.copy()
    for t in frames:
        change = np.abs(recording.gray(t) - background)
        total += np.where(change > noise, change, 0.0)
    return total.astype(np.float64)


def draw_optical_pictures(results: Results, bar: float, most: int = 0) -> tuple[Figure, int]:
    """Draw `optical_picture` of each fraction at a pressure, after Fig. 5.17.

    Parameters
    ----------
    results
        The campaigns.
    bar
        The pressure.
    most
        Frames in the middle of each recording; 0: all.

    Returns
    -------
    picture, frames
        The second is the largest number of frames in a sum.
    """
    chosen = [each for each in results.campaigns if each.pressure_bar == bar]
    if not chosen:
        raise InputError(f"draw_optical_pictures: no campaign at {bar} bar.")
    rows, count = -(-len(chosen) // 2), 0
    picture, grid = canvas(rows, 2, width_mm=PAGE_MM, height_mm=62.0 * rows)
    for axes, campaign in zip(grid.flat, chosen, strict=False):
        frames = campaign.frames
        if most:
            first = frames.start + max(len(frames) - most, 0) // 2
            frames = range(first, min(first + most, frames.stop))
        total, count = optical_picture(twin_of(campaign), frames), max(count, len(frames))
        low, high = np.quantile(total, [0.05, 0.995])
        draw_frame(axes, np.clip((total - low) / max(float(high - low), 1.0), 0.0, 1.0), 4)
        axes.set(title=f"{campaign.fraction}, {bar} bar", xlabel="column (px)", ylabel="row (px)")
        axes.label_outer()
    return picture, count


def verdicts(
    results: Results,
    values: Mapping[str, Values],
    traces: pd.DataFrame,
    generator: np.random.Generator,
) -> list[claims.Verdict]:
    """Return the verdicts on ignition (section 5.3.2), each beside the twin's own truth.

    "If the gray value increases abruptly": the grey values are taken as they are. Where those above
    the background would give another verdict, the claim is not decidable.

    Parameters
    ----------
    results
        The campaigns.
    values
        Of kept flights by reading, `AS_THEY_ARE` and `ABOVE`: confetti and shreds.
    traces
        `trace_shares`: wood chips and PE granules; the first reading decides.
    generator
        Of the bootstrap.
    """
    numbers = kept(results.tables.flights[results.tables.flights["from_lance"]])
    missing = 8 - int((numbers.groupby(KEYS).size() >= LEAST_FLIGHTS).sum())
    if missing:
        reason = (
            f"fewer than {LEAST_FLIGHTS} flights in {missing} of the eight campaigns at this scale"
        )
        return [claims.undecidable(f"ign-{k}", reason, because="chain") for k in range(1, 5)]
    first, other, true = (
        _paper_claims(each, generator)
        for each in (values[AS_THEY_ARE], values[ABOVE], results.true)
    )
    note = (
        "our test of grey values as they are, brighter than the kiln behind afterwards; the thesis "
        "prints none; a printed share agrees if our 95 % interval holds it"
    )
    pairs = [(("paper shred", bar), ("confetti", bar)) for bar in (4.5, 5.0)]
    pairs += [((name, 5.0), (name, 4.5)) for name in PAPERS]
    times = {key: each.ignition_s for key, each in values[AS_THEY_ARE].items()}
    shares = confidence.in_words(group_differences(times, pairs, generator, shares=True), "shares")
    medians = confidence.in_words(group_differences(times, pairs, generator), "median times")
    notes = {"ign-4": f"{note}; {shares}; {medians}"}
    judged = [
        claims.in_both_readings(
            claims.judge(claim, first[claim], note=notes.get(claim, note), truth=true[claim]),
            claims.judge(claim, other[claim], truth=true[claim]),
            "rise above the background",
        )
        for claim in first
    ]
    fit = "the twin was fitted to the share of confetti at 4.5 bar"
    judged = [claims.fitted(each, fit) if each.id == "ign-2" else each for each in judged]
    return [_picture_verdict(traces, results.true), *judged]


def _picture_verdict(traces: pd.DataFrame, true: Values) -> claims.Verdict:
    """Return the verdict on wood chips and PE granules from the optical picture."""
    first, second = PICTURES
    heavy = traces[traces["fraction"].isin(HEAVY)]
    counts = {reading: _counts(heavy[heavy["picture"] == reading]) for reading in PICTURES}
    lit = {key: np.isfinite(each.ignition_s) for key, each in true.items() if key[0] in HEAVY}
    truth = {key: (int(each.sum()), len(each)) for key, each in lit.items()}
    others = "; ".join(_never(counts[second]))
    note = (
        f"traces in the sum of differences (Fig. 5.17) that turn {first}; {second}: {others}. "
        f"Up to {100 * BASICALLY:g} % is open, as 'basically' has no number"
    )
    return claims.judge("ign-1", _never(counts[first]), note=note, truth=_never(truth))


def _counts(rows: pd.DataFrame) -> dict[CampaignKey, tuple[int, int]]:
    """Return how many of how many flights light up, by campaign."""
    columns = [*KEYS, "light_up", "number"]
    return {
        (str(name), float(bar)): (int(lit), int(number))
        for name, bar, lit, number in rows[columns].itertuples(index=False, name=None)
    }


def _never(counts: Mapping[CampaignKey, tuple[int, int]]) -> dict[str, bool | None]:
    """Return whether none of a campaign's flights ignites; None: a few, open by the text."""
    return {
        f"{name} {bar} bar {lit} of {number}": (
            True if lit == 0 else None if lit < BASICALLY * number else False
        )
        for (name, bar), (lit, number) in counts.items()
    }


def _paper_claims(
    values: Values, generator: np.random.Generator
) -> dict[str, dict[str, bool | None]]:
    """Return what ign-2 to ign-4 ask for.

    Of the confetti 26 % burn, "among them" 3 % within 0.1 s: of all or of these, so both.
    """
    printed = beside_published(values, values, ["ignited"])
    printed = printed[printed["outcome"].isin(["ignited (%)", "ignited < 0.1 s (%)"])]
    among = (printed["fraction"] == "confetti") & (printed["outcome"] == "ignited < 0.1 s (%)")
    both = printed[among].assign(outcome="ignited < 0.1 s (% of ignited)")
    printed = pd.concat([printed, both])
    asked = {
        claim: conditions(printed, (name, 4.5), values, generator)
        | conditions(printed, (name, 5.0), values, generator)
        for claim, name in (("ign-2", "confetti"), ("ign-3", "paper shred"))
    }
    early = [name for name in asked["ign-2"] if name.startswith("ignited < 0.1 s")]
    for bar in (4.5, 5.0):
        bases = [name for name in early if f"at {bar} bar" in name]
        if len({asked["ign-2"][name] for name in bases}) > 1:
            asked["ign-2"] |= dict.fromkeys(bases)  # open: the text does not say which
    share, middle = (by_pressure(values, name) for name in ("ignited (%)", "ignition median (s)"))
    return asked | {"ign-4": _paper_conditions(share, middle)}


def _paper_conditions(share: pd.DataFrame, middle: pd.DataFrame) -> dict[str, bool | None]:
    """Return claims on papers; shares and median times by fraction and pressure."""
    conditions: dict[str, bool | None] = {}
    for bar in share.columns:
        often, early = (table[bar].reindex(PAPERS) for table in (share, middle))
        conditions[f"shreds more often at {bar} bar"] = bool(often.iloc[1] > often.iloc[0])
        conditions[f"shreds earlier at {bar} bar"] = bool(early.iloc[1] < early.iloc[0])
    for name in (name for name in PAPERS if name in share.index):
        fewer, later = (table.loc[name] for table in (share, middle))
        conditions[f"{name}: fewer at 5 bar"] = bool(fewer.iloc[-1] < fewer.iloc[0])
        conditions[f"{name}: later at 5 bar"] = bool(later.iloc[-1] > later.iloc[0])
    return conditions


def in_words(results: Results, values: Mapping[str, Values], traces: pd.DataFrame) -> str:
    """Return the shares of the verdicts beside the truth, in one sentence."""
    true, share, above = (
        by_pressure(each, "ignited (%)")
        for each in (results.true, values[AS_THEY_ARE], values[ABOVE])
    )
    papers = [
        f"{name} {bar} bar {share[bar][name]:.0f} % (above the background "
        f"{above[bar][name]:.0f} %, true {true[bar][name]:.0f} %)"
        for name, bar in results.true
        if name in PAPERS
    ]
    first = traces[(traces["picture"] == next(iter(PICTURES))) & traces["fraction"].isin(HEAVY)]
    heavy = [
        f"{row.fraction} {row.pressure_bar} bar {row.light_up} of {row.number}"
        for row in first.itertuples()
    ]
    return (
        f"Traces that light up in the optical picture: {', '.join(heavy)}. Ignition by our test "
        f"of grey values as they are: {', '.join(papers)}."
    )
