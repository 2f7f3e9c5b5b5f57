"""Sentences of the 2020 paper on how particles move (sections 4 and 5), from tracks.

tracks -> observe -> a number per particle -> quantities with intervals -> answers to the claims

Particles are resampled for the intervals, those of all quantities of a data set together.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.belt import models
from kilnflight.belt.models import BELT_VELOCITY_MM_S
from kilnflight.belt.phase import Observed, PredictionPhase
from kilnflight.experiments.belt_claims import (
    MEASURES,
    Answer,
    agree,
    below,
    beyond_chance,
    digits,
    measures,
)
from kilnflight.experiments.belt_profile import step_velocities, velocities_at

Array = npt.NDArray[np.float64]
Key = tuple[str, str]  # source, data set

PLACES_MM = np.arange(400.0, 751.0, 25.0)  # along the belt, where all particles are observed
CENTRES: dict[str, Callable[..., Array]] = {"mean": np.mean, "median": np.median}
UPSTREAM_MM = 40.0  # beside the phase, to see what its place does to the time in it; choice
STATES = ["as observed", "carried"]
SIGNED = "lateral velocity (mm/s)"  # its interval holds for three data sets together
EXCESS = "CADSC above CA where reversed, {} (mm)"
INTERVAL, JOINT = (0.025, 0.975), (0.05 / 6, 1 - 0.05 / 6)


def summarise_phase(observed: Mapping[Key, Observed], phase: PredictionPhase) -> pd.DataFrame:
    """Return what happens in the prediction phase along the belt, a row per data set.

    Returns
    -------
    DataFrame
        ``source``, ``data_set``; the share that CA predicts beyond the belt's velocity,
        ``beyond_belt`` as observed and ``beyond_belt_carried``; median and mean time in the phase:
        ``phase_ms``, ``phase_mean_ms``; and by how much the identical delay differs at most from
        the identical velocity: ``delay_ms`` with all at the start, ``delay_mean_ms`` for the mean
        delay, ``delay_apart_ms`` as observed.
    """
    rows = []
    for (source, data_set), part in observed.items():
        carried = phase.carry(part)
        row: dict[str, str | float] = {"source": source, "data_set": data_set}
        for name, last in (("", part.last), ("_carried", carried.last)):
            row |= {f"beyond_belt{name}": _beyond_belt(last, phase.target_mm)}
        duration = 1000.0 * (part.arrival["time_s"] - carried.last["time_s"])
        row |= {"phase_ms": duration.median(), "phase_mean_ms": duration.mean()}
        at_start = (carried.last["x"] - phase.start_mm).abs() < 1e-6  # others would stop before
        one_place = Observed(carried.last[at_start], part.arrival[at_start], {})
        row |= {"delay_ms": _delay_excess(one_place, phase, np.median)}
        row |= {"delay_mean_ms": _delay_excess(one_place, phase, np.mean)}
        rows.append(row | {"delay_apart_ms": _delay_excess(part, phase, np.median)})
    return pd.DataFrame(rows).round(6)  # differences of 1e-13 ms are none


def phase_answers(table: pd.DataFrame) -> dict[str, Answer]:
    """Return the answers to belt20-12, -13 and -21; ``table``: `summarise_phase` of a source."""
    table = table.set_index("data_set")
    return {
        "belt20-12": table[["beyond_belt", "beyond_belt_carried"]].set_axis(STATES, axis=1),
        "belt20-13": table["phase_ms"],
        "belt20-21": table["delay_ms"],
    }


def phase_details(
    table: pd.DataFrame, tracks: Mapping[str, pd.DataFrame], phase: PredictionPhase
) -> dict[str, str]:
    """Return what reasons of belt20-13 and -21 add, by id.

    ``table`` is as for `phase_answers`, ``tracks`` are those of its data sets. Beside the time in
    the phase stands that of a phase `UPSTREAM_MM` before.
    """
    start, target = (place - UPSTREAM_MM for place in (phase.start_mm, phase.target_mm))
    before = PredictionPhase(start, target)
    parts = {name: before.observe(tracks[name]) for name in table["data_set"]}
    keys = {("", name): part for name, part in parts.items()}
    earlier, here = summarise_phase(keys, before)["phase_ms"], table["phase_ms"]
    longer = "longer" if (earlier.to_numpy() > here.to_numpy()).all() else "no longer"
    names = f"({', '.join(table['data_set'])})"
    times, apart = (", ".join(map(digits, part)) for part in (earlier, table["delay_mean_ms"]))
    place = (
        f"another {UPSTREAM_MM:g} mm upstream it is {times} ms {names}; there it is {longer} than "
    )
    return {
        "belt20-13": f"{place}here; so the place, 15 mm upstream of the paper's, makes it {longer}",
        "belt20-21": f"with a mean delay they differ by {apart} ms {names}",
    }


def shown_phase(table: pd.DataFrame) -> pd.DataFrame:
    """Return `summarise_phase` as it is shown: percent, and names that say what differs."""
    shares = table.filter(like="beyond_belt").mul(100).round(2)
    names = {"beyond_belt": "beyond_belt_percent", "beyond_belt_carried": "carried_percent"}
    names |= {"phase_ms": "time_median_ms", "phase_mean_ms": "time_mean_ms"}
    endings = {"delay_ms": "median", "delay_mean_ms": "mean", "delay_apart_ms": "as observed"}
    names |= {name: f"difference from IV (ms), {way}" for name, way in endings.items()}
    return table.assign(**shares).round(3).rename(columns=names)


def _beyond_belt(last: pd.DataFrame, target_mm: float) -> float:
    """Return the share that is faster than the belt now, or at the target by CA (Eq. 5).

    Carrying a state on by its own acceleration keeps its speed at the target.
    """
    speed, gain = last["velocity_x_mm_s"], last["acceleration_x_mm_s2"]
    square = speed**2 + 2 * gain * (target_mm - last["x"])
    fastest = np.maximum(speed, np.sqrt(square.clip(lower=0.0)))
    return float((fastest > BELT_VELOCITY_MM_S).mean())


def _delay_excess(
    observed: Observed, phase: PredictionPhase, average: Callable[[Array], np.floating]
) -> float:
    """Return the largest difference of ID and IV in ms, with this average of the delays."""
    last, arrival = observed.last, observed.arrival
    velocity = models.IV().calibrated(last, arrival, phase.target_mm)
    delays = (arrival["time_s"] - last["time_s"]).to_numpy()
    same = models.ID(float(average(delays)))
    apart = same(last, phase.target_mm) - velocity(last, phase.target_mm)
    return float(1000.0 * np.abs(apart).max())


def summarise_lateral(
    observed: Mapping[Key, Observed],
    tracks: Mapping[Key, pd.DataFrame],
    phase: PredictionPhase,
    replicates: int,
    seed: int,
) -> pd.DataFrame:
    """Return how particles move across the belt, with intervals over particles.

    Returns
    -------
    DataFrame
        ``source``, ``data_set``, ``quantity``, ``value``, ``low``, ``high`` (95 %; of the signed
        velocity, that of three data sets together).
    """
    parts = []
    for (source, data_set), part in observed.items():
        columns = _by_particle(part, tracks[source, data_set], phase)
        generator, count = np.random.default_rng(seed), len(part.last)
        samples = [
            _quantities(columns[generator.integers(0, count, count)]) for _ in range(replicates)
        ]
        table = pd.DataFrame({"value": _quantities(columns)}).rename_axis("quantity")
        for end, shares in zip(("low", "high"), zip(INTERVAL, JOINT, strict=True), strict=True):
            usual, joint = (pd.DataFrame(samples).quantile(share) for share in shares)
            signed = table.index.str.contains(SIGNED, regex=False)
            table[end] = usual.where(~signed, joint).reindex(table.index)
        names = {"source": source, "data_set": data_set}
        parts.append(table.reset_index().assign(**names))
    table = pd.concat(parts, ignore_index=True).round(6)  # 1e-13 mm/s is neither above nor below 0
    return table[["source", "data_set", "quantity", *Known._fields]]


def shown(table: pd.DataFrame) -> pd.DataFrame:
    """Return `summarise_lateral` as it is shown: a unit per row, shares and gains in percent."""
    names, ends = table["quantity"], list(Known._fields)
    lost, share = names.str.startswith("share lost"), names.str.startswith("share")
    values = table[ends].mul(np.where(share, 100.0, 1.0), axis=0)
    values[lost] = -values.loc[lost, ["value", "high", "low"]].to_numpy()  # a gain is no loss
    unit = names.str.extract(r"\((.+)\)$")[0].mask(share, "%").fillna("1")
    words = names.str.replace(r" \(.+\)$", "", regex=True)
    words = words.str.replace(
        r"share lost, (\w+) speed", r"gain of \1 speed, 400 to 750 mm", regex=True
    )
    plain = table[["source", "data_set"]].assign(quantity=words, unit=unit)
    return plain.join(values.round(3) + 0.0)  # no -0


def _by_particle(observed: Observed, track: pd.DataFrame, phase: PredictionPhase) -> Array:
    """Return a row per particle: velocities across the belt, and deviations of two models.

    At the start, at the target, of CA and CADSC (with CA along the belt), at `PLACES_MM`.
    """
    last, arrival = observed.last, observed.arrival
    remaining = models.CA()(last, phase.target_mm) - last["time_s"].to_numpy()
    off = [
        model(last, remaining) - arrival["y"].to_numpy()
        for model in (models.LateralCA(), models.CADSC())
    ]
    kept = track[track["particle"].isin(last["particle"])]
    along = velocities_at(step_velocities(kept), "velocity_y_mm_s", PLACES_MM)
    start, end = (table["velocity_y_mm_s"] for table in (last, arrival))
    return np.column_stack([start, end, *off, along])


def _quantities(columns: Array) -> dict[str, float]:
    """Return the quantities of `summarise_lateral` from rows of `_by_particle`."""
    start, end = columns[:, :2].T
    speeds = np.abs(columns[:, 4:])
    speeds = speeds[np.isfinite(speeds).all(axis=1)]
    turned = start * end < 0
    values = {
        "share that reverses": float(turned.mean()),
        "share faster, in the phase": float((np.abs(end) > np.abs(start)).mean()),
        "share faster, 400 to 750 mm": float((speeds[:, -1] > speeds[:, 0]).mean()),
    }
    if turned.any():
        errors = measures(columns[turned, 2:4])
        for name, (plain, banned) in zip(MEASURES.values(), errors, strict=True):
            values[EXCESS.format(name)] = float(banned - plain)
    for name, centre in CENTRES.items():
        profile = centre(speeds, axis=0)
        slope, offset = np.polyfit(PLACES_MM, profile, 1)
        line = offset + slope * PLACES_MM
        values[f"R2 of a line, {name} speed"] = 1 - float(
            ((profile - line) ** 2).sum() / ((profile - profile.mean()) ** 2).sum()
        )
        values[f"share lost, {name} speed"] = float(1 - line[-1] / line[0])
        values[f"{name} {SIGNED}"] = float(centre(start))
    return values


class Known(NamedTuple):
    """A quantity and its interval over particles."""

    value: float
    low: float
    high: float

    @property
    def sign(self) -> bool | None:
        """Whether it is above zero, or below; None: not beyond chance."""
        return beyond_chance(self.low, self.high)


Quantities = dict[tuple[str, str], Known]  # by data set and name


def lateral_answers(table: pd.DataFrame) -> dict[str, Answer]:
    """Return the answers to belt20-17 to belt20-20; ``table``: of one source."""
    columns = (table[name].tolist() for name in ("data_set", "quantity", *Known._fields))
    known: Quantities = {(row[0], row[1]): Known(*row[2:]) for row in zip(*columns, strict=True)}
    faster = {
        where: {"cylinders": known["cylinders", f"share faster, {where}"].value}
        for where in ("in the phase", "400 to 750 mm")
    }
    return {
        "belt20-17": _sign_changes(known),
        "belt20-18": pd.DataFrame(faster),
        "belt20-19": _linear_decrease(known),
        "belt20-20": _zero_on_average(known),
    }


def _sign_changes(known: Quantities) -> dict[str, bool | None]:
    """Return whether cylinders reverse, and whether CADSC then deviates more than CA."""
    share = known["cylinders", "share that reverses"].value
    answer: dict[str, bool | None] = {f"{100 * share:.1f} % reverse": bool(share > 0)}
    if share > 0:
        excess = [known["cylinders", EXCESS.format(name)] for name in MEASURES.values()]
        text = ", ".join(f"{part.value:.2f}" for part in excess)
        holds = agree([part.sign for part in excess])
        answer[f"CADSC above CA for these by {text} mm (MAE, IQR)"] = holds
    return answer


def _linear_decrease(known: Quantities) -> dict[str, bool | None]:
    """Return whether the lateral speed of cuboids falls on a line, and that of spheres less."""
    fits = [known["cuboids", f"R2 of a line, {name} speed"].value for name in CENTRES]
    shown = ", ".join(f"{fit:.3f}" for fit in fits)
    linear = agree([below(1 - fit, 0.1) for fit in fits])
    each, texts = [], []
    for name in CENTRES:
        cuboids, spheres = (
            known[shape, f"share lost, {name} speed"] for shape in ("cuboids", "spheres")
        )
        less = beyond_chance(cuboids.low - spheres.high, cuboids.high - spheres.low)
        each.append(less if cuboids.sign is True else cuboids.sign)
        texts.append(f"{name} {100 * cuboids.value:.0f}, {100 * spheres.value:.0f} %")
    lost = f"lost by cuboids and spheres: {'; '.join(texts)}"
    return {f"cuboids: R2 {shown} (mean, median)": linear, lost: agree(each)}


def _zero_on_average(known: Quantities) -> dict[str, bool | None]:
    """Return whether mean and median of the signed velocity are zero, by data set."""
    answer = {}
    for data_set in dict.fromkeys(data_set for data_set, _ in known):
        both = [known[data_set, f"{name} {SIGNED}"] for name in CENTRES]
        text = ", ".join(f"{part.value:.2f} ({part.low:.2f} to {part.high:.2f})" for part in both)
        answer[f"{data_set}: mean and median {text} mm/s"] = agree([p.sign is None for p in both])
    return answer
