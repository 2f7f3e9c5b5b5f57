"""Which particles ignite: the optical picture, our test of grey values, and their errors.

Section 5.3.2 of the thesis. Wood chips and PE granules are judged by Fig. 5.17, papers by grey
values along their tracks. All are of flights from the lance that are not refused.

tables of campaigns -> flights by reading -> errors, shares, verdicts; recording -> picture
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.figure import Figure
from numba import njit

from kilnflight import kiln, regression
from kilnflight.background.sliding_median import stack_median
from kilnflight.checks import InputError
from kilnflight.experiments import confidence
from kilnflight.experiments.accuracy import errors
from kilnflight.experiments.campaigns import (
    KEYS,
    CampaignKey,
    Measurement,
    Results,
    campaign_keys,
    counted_flights,
    of_campaign,
    rows_by_campaign,
    stack,
    twin_of,
)
from kilnflight.experiments.confidence import (
    Array,
    Values,
    by_fraction,
    group_differences,
    interval_columns,
)
from kilnflight.experiments.statements import (
    EARLY,
    EARLY_OF_IGNITED,
    HEAVY,
    IGNITED,
    PAPERS,
    beside_published,
    by_pressure,
    conditions,
    judge_all,
)
from kilnflight.ignition import BEFORE, SEEN, TOO_FEW, LitTrace
from kilnflight.project import claims
from kilnflight.project.style import PAGE_MM, canvas, draw_frame
from kilnflight.recording.frames import Recording
from kilnflight.scores import intervals
from kilnflight.twin.scenes import PRESSURES_BAR

# Two readings of grey values that increase "abruptly" (5.3.2), the first as it is printed.
AS_THEY_ARE, ABOVE = "as they are", "above background"
# Two readings of Fig. 5.17, as the text does not say whether differences are absolute.
LIGHTER, TWICE = "lighter than the kiln behind", "twice as light as the kiln behind"
PICTURES = {LIGHTER: LitTrace(0.1), TWICE: LitTrace(1.0)}
COUNTS = ("unlit", "unlit_light", "lit", "lit_light")  # of `trace_shares`
BASICALLY = 0.05  # of the flights: ours, for "do not combust basically" (section 5.3)
STRETCH = 151  # frames with one median background: 75 before and 75 after (Table 5.4)
Conditions = dict[str, bool | None]


def readings(results: Results) -> dict[str, Measurement]:
    """Return the campaigns' tables by reading of grey values; flights differ, nothing else.

    `kilnflight.kiln.background_gray` defines what is above; it uses only pictures, no truth.
    """
    parts = {}
    for campaign in results.campaigns:
        tables = (of_campaign(table, campaign.key) for table in results.tables[:2])
        tracks, trajectories = (table.drop(columns=KEYS) for table in tables)
        rules = campaign.run.rules
        above = replace(rules, ignition=replace(rules.ignition, above_background=True))
        run = replace(campaign.run, rules=above)
        parts[campaign.key] = kiln.flights_from(run, tracks, regression.fits(trajectories))
    return {AS_THEY_ARE: results.tables, ABOVE: results.tables._replace(flights=stack(parts))}


def ignition_errors(both: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Return how often and how well ignition was detected, by reading and campaign.

    Parameters
    ----------
    both
        By reading: `kilnflight.experiments.accuracy.compare_campaigns`.

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
            error = errors(of_campaign(table, key))
            row = {"reading": name, **dict(zip(KEYS, key, strict=True))}
            row["detected_particles"] = error["detected_particles"]
            for rate, kind in (("hit", "lit"), ("false_alarm", "unlit")):
                found, number = int(error[f"{kind}_detected"]), int(error[kind])
                row |= {kind: number, f"{kind}_detected": found}
                share = intervals.share(found, number)
                ends = {"": share.estimate, "_low": share.low, "_high": share.high}
                row |= {
                    f"{rate}_percent{end}": round(100 * value, 2) if number else np.nan
                    for end, value in ends.items()
                }
            row |= {"time_error_n": error["ignition_s_n"]}
            row |= {"time_error_median_s": error["ignition_s_bias"]}
            rows.append(row | {"time_error_spread_s": error["ignition_s_spread"]})
    return pd.DataFrame(rows, columns=None if rows else ["reading", *KEYS])  # nothing flew


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


def trace_shares(results: Results, true: pd.DataFrame) -> pd.DataFrame:
    """Return how many flights light up in the optical picture, by reading and campaign.

    Parameters
    ----------
    results
        The campaigns.
    true
        `kilnflight.experiments.accuracy.compare_campaigns`: which flights truly ignite.

    Returns
    -------
    DataFrame
        ``picture``, fraction, pressure, ``light_up``, ``light_at_first`` (light from the first
        detection on), ``too_few`` points to judge; ``number``, ``estimate``, ``low``, ``high``
        of the share that lights up (Wilson); of those ``unlit`` and ``lit`` in truth, how many
        are light at first or later (``unlit_light``, ``lit_light``).
    """
    rows: dict[str, dict[CampaignKey, dict[str, float]]] = {name: {} for name in PICTURES}
    for campaign in results.campaigns:
        tracks, _, flights, _ = (of_campaign(each, campaign.key) for each in results.tables)
        flights = counted_flights(flights)
        tracks = tracks[tracks["particle"].isin(flights["particle"])]
        behind = kiln.background_gray(tracks, campaign.run.detection.source, campaign.frames)
        time_s = tracks["frame"] / campaign.run.frame_rate_hz
        tracks = tracks.assign(background=behind, time_s=time_s)
        known = _truly_ignite(of_campaign(true, campaign.key))
        for name, look in PICTURES.items():
            rows[name][campaign.key] = _count_lit(flights, tracks, look, known)
    tables = {name: rows_by_campaign(each) for name, each in rows.items()}
    return pd.concat(tables, names=["picture"]).reset_index("picture").reset_index(drop=True)


def _truly_ignite(true: pd.DataFrame) -> pd.Series:
    """Return whether the particle of a track truly ignites in flight, by track.

    Of `accuracy.compare`, without false flights and further tracks of a particle.
    """
    known = true[(true["track"] >= 0) & (true["particle"] >= 0)]
    return known.set_index("track")["true_ignition_s"].notna()


def _count_lit(
    flights: pd.DataFrame, tracks: pd.DataFrame, look: LitTrace, ignites: pd.Series
) -> dict[str, float]:
    """Return how many flights light up before they end; the wall ignites all that land (5.1.1).

    ``ignites``: whether a flight's particle truly does (`_truly_ignite`).
    """
    end_s = tracks["particle"].map(flights.set_index("particle")["end_s"])
    flying = tracks[tracks["time_s"] <= end_s].sort_values("frame")
    seen = pd.Series(
        {
            particle: look(track["time_s"], track["gray"], track["background"])
            for particle, track in flying.groupby("particle")
        },
        dtype=object,
    ).reindex(flights["particle"], fill_value=TOO_FEW)
    count: dict[str, float] = {
        "light_up": (seen == SEEN).sum(),
        "light_at_first": (seen == BEFORE).sum(),
    }
    count["too_few"] = (seen == TOO_FEW).sum()
    count |= interval_columns(intervals.share(int(count["light_up"]), len(flights)))
    known = seen[seen.ne(TOO_FEW) & seen.index.isin(ignites.index)]
    truly = ignites.reindex(known.index).to_numpy(dtype=bool)
    light = known.isin([SEEN, BEFORE]).to_numpy()
    count |= {"unlit": (~truly).sum(), "unlit_light": (light & ~truly).sum()}
    return count | {"lit": truly.sum(), "lit_light": (light & truly).sum()}


def optical_picture(recording: Recording, frames: range) -> Array:
    """Return a background plus every place's greatest difference from it (5.2.2, Fig. 5.17).

    The thesis adds up the differences. In thousands of frames of the twin the flickering kiln
    adds up to more than a particle that passes once. So each place has its greatest difference,
    with its sign: what is lighter than the kiln behind stays light, what is darker dark. The
    background is the median of `kilnflight.kiln.BACKGROUND_FRAMES` frames of each stretch of
    about `STRETCH`: "constant over a specific time period" (5.1.2). The last one is drawn.
    """
    if not len(frames):
        raise InputError("optical_picture: no frame; give at least one.")
    most = np.zeros((recording.attributes.rows, recording.attributes.columns), np.float32)
    for part in np.array_split(np.asarray(frames), -(-len(frames) // STRETCH)):
        steps = np.linspace(part[0], part[-1], kiln.BACKGROUND_FRAMES).round().astype(int)
        pictures = {t: recording.gray(t) for t in np.unique(steps).tolist()}
        background = stack_median(list(pictures.values())).astype(np.float32)
        for t in part.tolist():
            picture = pictures.pop(t) if t in pictures else recording.gray(t)
            keep_greatest(picture.ravel(), background.ravel(), most.ravel())
    return (background + most).astype(np.float64)


@njit(cache=True)
def keep_greatest(
    picture: npt.NDArray[Any], background: npt.NDArray[np.float32], most: npt.NDArray[np.float32]
) -> None:
    """Keep in ``most`` each place's greatest difference (pixels,) from the background, signed.

    Of equal ones the first.
    """
    for p in range(most.size):
        change = np.float32(picture[p]) - background[p]
        if abs(change) > abs(most[p]):
            most[p] = change


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
        The second is the largest number of frames in a panel.
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
        low, high = np.quantile(total, [0.01, 0.998])
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

    "If the gray value increases abruptly": the grey values are taken as they are. Where another
    reading would give another verdict, the claim is not decidable.

    Parameters
    ----------
    results
        The campaigns.
    values
        By reading, `AS_THEY_ARE` and `ABOVE`: confetti and shreds.
    traces
        `trace_shares`: wood chips and PE granules.
    generator
        Of the bootstrap.
    """
    flights = counted_flights(results.tables.flights)
    true_lit = {
        key: dict.fromkeys(COUNTS, 0)
        | {"light_up": int(np.isfinite(each.ignition_s).sum()), "number": len(each.ignition_s)}
        for key, each in results.true.items()
    }
    true = _evidence(results.true, rows_by_campaign(true_lit), generator)
    notes = _notes(values[AS_THEY_ARE], traces, generator)
    first, other = (
        judge_all(
            flights,
            _evidence(values[name], traces[traces["picture"] == look], generator),
            "",
            notes,
            true,
        )
        for name, look in ((AS_THEY_ARE, LIGHTER), (ABOVE, TWICE))
    )
    if not first[0].measured:  # campaigns are missing
        return first
    looks = [_tells_lit_from_unlit(table) for _, table in traces.groupby("picture")]
    names = {"ign-1": TWICE}
    judged = [
        claims.in_both_readings(one, two, names.get(one.id, "rise above the background"))
        for one, two in zip(first, other, strict=True)
    ]
    if not any(looks):  # it is our test of traces that decides nothing, not the words
        judged[0] = replace(judged[0], because="method")
    fit = "the twin was fitted to the share of confetti at 4.5 bar"
    return [claims.fitted(each, fit) if each.id == "ign-2" else each for each in judged]


def _notes(values: Values, traces: pd.DataFrame, generator: np.random.Generator) -> dict[str, str]:
    """Return by claim what a reader must know, and which differences are beyond chance."""
    note = (
        "our test of grey values as they are, brighter than the kiln behind afterwards; the thesis "
        "prints none; a printed share agrees if our 95 % interval holds it"
    )
    pairs = [(("paper shred", bar), ("confetti", bar)) for bar in PRESSURES_BAR]
    pairs += [((name, 5.0), (name, 4.5)) for name in PAPERS]
    times = {key: each.ignition_s for key, each in values.items()}
    told = [
        confidence.in_words(group_differences(times, pairs, generator, shares=share), name)
        for name, share in (("shares", True), ("median times", False))
    ]
    seen = "; ".join(f"{name}: {_light_in_words(traces, name)}" for name in PICTURES)
    picture = (
        f"traces in the optical picture (Fig. 5.17) that turn {LIGHTER}. Up to "
        f"{100 * BASICALLY:g} % is open, as 'basically' has no number. Open, too, where our test "
        f"tells nothing: it takes more of the unlit for light, or misses most of the lit ({seen})"
    )
    return {"ign-1": picture, "ign-2": note, "ign-3": note, "ign-4": "; ".join([note, *told])}


def _evidence(
    values: Values, traces: pd.DataFrame, generator: np.random.Generator
) -> dict[str, Conditions]:
    """Return what the claims ask for: papers by their ignition times, the others by traces."""
    tells = _tells_lit_from_unlit(traces)
    never: Conditions = {
        f"{name} {bar} bar {lit} of {number}": not lit
        if tells and not 0 < lit < BASICALLY * number
        else None
        for name, bar, lit, number in _light_up(traces)
    }
    shares = {
        claim: _printed_shares(values, name, generator)
        for claim, name in zip(("ign-2", "ign-3"), PAPERS, strict=True)
    }
    return {"ign-1": never, **shares, "ign-4": _more_and_earlier(values)}


def _tells_lit_from_unlit(traces: pd.DataFrame) -> bool:
    """Return whether a test of traces can decide on a share that is `BASICALLY` none.

    Of wood chips and granules that truly stay unlit it may take that share for light, no more; of
    the particles that ignite, papers too, it must see half. Both are ours.
    """
    unlit = traces.loc[traces["fraction"].isin(HEAVY), ["unlit", "unlit_light"]].sum()
    lit = traces[["lit", "lit_light"]].sum()
    few = unlit["unlit_light"] <= BASICALLY * unlit["unlit"]
    return bool(few and 2 * lit["lit_light"] >= lit["lit"])


def _light_in_words(traces: pd.DataFrame, picture: str) -> str:
    """Return how many that are unlit and lit in truth are light in a reading of the picture."""
    table = traces[traces["picture"] == picture]
    unlit = table.loc[table["fraction"].isin(HEAVY), ["unlit_light", "unlit"]].sum()
    lit = table[["lit_light", "lit"]].sum()
    return (
        f"light are {unlit['unlit_light']:g} of {unlit['unlit']:g} unlit wood chips and granules, "
        f"and {lit['lit_light']:g} of {lit['lit']:g} particles of all fractions that ignite"
    )


def _light_up(traces: pd.DataFrame) -> list[tuple[str, float, int, int]]:
    """Return campaigns of wood and PE, how many flights light up, and of how many."""
    heavy = traces[traces["fraction"].isin(HEAVY)].astype({"light_up": int, "number": int})
    return list(heavy[[*KEYS, "light_up", "number"]].itertuples(index=False, name=None))


def _printed_shares(values: Values, name: str, generator: np.random.Generator) -> Conditions:
    """Return whether the shares printed of a paper hold.

    Of the confetti 26 % burn, "among them" 3 % within 0.1 s: of all or of these. Where the bases
    answer differently, that is open.
    """
    printed = beside_published(values, values, ["ignited"])
    holds: Conditions = {}
    for key in ((name, bar) for bar in PRESSURES_BAR):
        holds |= conditions(printed[printed["outcome"] == IGNITED], key, values, generator)
        early = printed[printed["outcome"].isin([EARLY, EARLY_OF_IGNITED])]
        bases = conditions(early, key, values, generator)
        answers = set(bases.values())
        holds[" or ".join(bases)] = answers.pop() if len(answers) == 1 else None
    return holds


def _more_and_earlier(values: Values) -> Conditions:
    """Return whether shreds ignite more often and earlier, and both less at more pressure."""
    share, middle = (by_pressure(values, name) for name in (IGNITED, "ignition median (s)"))
    confetti, shred = PAPERS
    holds: Conditions = {}
    for bar in share.columns:
        often, early = share[bar].reindex(PAPERS), middle[bar].reindex(PAPERS)
        holds[f"shreds more often at {bar} bar"] = bool(often[shred] > often[confetti])
        holds[f"shreds earlier at {bar} bar"] = bool(early[shred] < early[confetti])
    for name in (name for name in PAPERS if name in share.index):
        fewer, later = share.loc[name], middle.loc[name]
        holds[f"{name}: fewer at 5 bar"] = bool(fewer.iloc[-1] < fewer.iloc[0])
        holds[f"{name}: later at 5 bar"] = bool(later.iloc[-1] > later.iloc[0])
    return holds


def in_words(
    results: Results,
    values: Mapping[str, Values],
    traces: pd.DataFrame,
    rates: pd.DataFrame,
) -> str:
    """Return the shares of the verdicts beside the truth, a sentence for each fraction.

    ``rates``: `ignition_errors`; what of these shares are hits, and what false alarms.
    """
    first, above, true = (
        by_pressure(each, IGNITED) for each in (values[AS_THEY_ARE], values[ABOVE], results.true)
    )
    papers = [
        (name, bar, " / ".join(f"{each[bar][name]:.0f}" for each in (first, above, true)))
        for name, bar in results.true
        if name in PAPERS
    ]
    lit = _light_up(traces[traces["picture"] == LIGHTER])
    heavy = [(name, bar, f"{light} of {number}") for name, bar, light, number in lit]
    return (
        f"Traces that light up in the optical picture. {by_fraction(heavy)} Of those whose truth "
        f"is known, {_light_in_words(traces, LIGHTER)}. Ignition in %, by our "
        f"test of grey values as they are / above the background / true. {by_fraction(papers)} "
        f"{_rates_in_words(rates)}"
    )


def _rates_in_words(rates: pd.DataFrame) -> str:
    """Return how many papers that ignite are found, and how many that do not, by reading."""
    parts = []
    for name, table in rates[rates["fraction"].isin(PAPERS)].groupby("reading", sort=False):
        sums = table[["lit_detected", "lit", "unlit_detected", "unlit"]].sum()
        parts.append(
            f"{name} finds {sums['lit_detected']:g} of {sums['lit']:g} papers that ignite, and "
            f"{sums['unlit_detected']:g} of {sums['unlit']:g} that do not"
        )
    return f"{'; '.join(parts)}.".capitalize() if parts else "No paper's truth is known."
