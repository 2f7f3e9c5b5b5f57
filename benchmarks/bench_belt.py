"""The belt models and their preparation against the definitions, one particle at a time."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
from measure import Row, compare

from kilnflight.belt import ARRIVAL_MODELS, COMBINATIONS, PredictionPhase
from kilnflight.belt.models import checked
from kilnflight.belt.phase import Observed
from kilnflight.sorter import friction
from kilnflight.tables import BELT_ARRIVAL, BELT_LAST

PARTICLES = (1100, 4400, 17600)
PHASE = PredictionPhase()


def tracks(particles: int) -> pd.DataFrame:
    """Return cuboids of the friction simulation."""
    belt = friction.FrictionBelt(particles=particles)
    return belt(np.random.default_rng(particles))


def observe_one_by_one(table: pd.DataFrame) -> list[tuple[float, ...]]:
    """Return last state and arrival of each particle, by a loop over particles."""
    rows = []
    for _, one in table.groupby("particle"):
        x, y, t = (one[name].to_numpy() for name in ("x", "y", "time_s"))
        begun, beyond = int(np.argmax(x >= 623.0)), int(np.argmax(x >= 773.0))
        step = t[begun - 1] - t[begun - 2]
        state = [t[begun - 1]]
        for values in (x, y):
            a, b, c = values[begun - 3 : begun]
            state += [c, (3 * c - 4 * b + a) / (2 * step), (c - 2 * b + a) / step**2]
        share = (773.0 - x[beyond - 1]) / (x[beyond] - x[beyond - 1])
        rows.append((*state, t[beyond - 1] + share * (t[beyond] - t[beyond - 1])))
    return rows


def predict_one_by_one(observed: Observed) -> dict[str, list[float]]:
    """Return the predictions of every model, by a loop over particles (sections 4.1, 4.2)."""
    last = list(observed.last.itertuples(index=False))
    t = dict(zip(observed.arrival["particle"], observed.arrival["time_s"], strict=True))
    y = dict(zip(observed.arrival["particle"], observed.arrival["velocity_y_mm_s"], strict=True))
    way = [773.0 - p.x for p in last]
    own = [t[p.particle] - p.time_s for p in last]
    mean = float(np.median([d / s for d, s in zip(way, own, strict=True)]))
    delay = float(
        np.median([s - d / p.velocity_x_mm_s for p, d, s in zip(last, way, own, strict=True)])
    )
    optimal = float(
        np.median(
            [2 * (d - p.velocity_x_mm_s * s) / s**2 for p, d, s in zip(last, way, own, strict=True)]
        )
    )
    ratio = float(np.median([y[p.particle] / p.velocity_y_mm_s for p in last]))
    out: dict[str, list[float]] = {name: [] for name in (*arrival_names(), *combination_names())}
    for p, d in zip(last, way, strict=True):
        v, a, u, b = (
            p.velocity_x_mm_s,
            p.acceleration_x_mm_s2,
            p.velocity_y_mm_s,
            p.acceleration_y_mm_s2,
        )
        time = {"IV": d / mean, "CV": d / v, "CVBC": d / v + delay}
        time |= {"CA": cover(d, v, a), "IA": cover(d, v, optimal)}
        until = (1500.0 - v) / a if a > 0 else math.inf
        done = v * until + a * until**2 / 2 if until < math.inf else math.inf
        time["CALV"] = until + (d - done) / 1500.0 if done < d else time["CA"]
        for name in arrival_names():
            out[name].append(p.time_s + time[name])
        stop = -u / b if u * b < 0 else math.inf
        for name, arrival, lateral in COMBINATIONS:
            s = time[arrival.name]
            r = min(s, stop)
            moved = {"Straight": 0.0, "CV": s * u, "CA": s * u + s * s * b / 2}
            moved |= {"CADSC": r * u + r * r * b / 2, "Ratio": s * u * (1 + ratio) / 2}
            out[name].append(p.y + moved[lateral.name])
    return out


def cover(d: float, v: float, a: float) -> float:
    """Return the smallest positive root of Eq. 6."""
    inside = v * v + 2 * a * d
    return 2 * d / (v + math.sqrt(inside)) if inside >= 0 else math.nan


def arrival_names() -> list[str]:
    return [model.name for model in ARRIVAL_MODELS]


def combination_names() -> list[str]:
    return [name for name, _, _ in COMBINATIONS]


def predict_all(observed: Observed) -> dict[str, np.ndarray]:
    """Return the predictions of every model, calibrated on all particles."""
    last, reached = checked(observed.last, BELT_LAST), checked(observed.arrival, BELT_ARRIVAL)
    out = {}
    for model in ARRIVAL_MODELS:
        fitted = model.calibrated(last, reached, PHASE.target_mm)
        out[model.name] = fitted(last, PHASE.target_mm)
    for name, arrival, lateral in COMBINATIONS:
        timed = arrival.calibrated(last, reached, PHASE.target_mm)
        remaining = timed(last, PHASE.target_mm) - last["time_s"]
        out[name] = lateral.calibrated(last, reached)(last, remaining)
    return out


def rows() -> list[Row]:
    """Return every comparison, the results checked to be equal."""
    return [row for particles in PARTICLES for row in rows_for(particles)]


def rows_for(particles: int) -> list[Row]:
    """Return the comparisons at one number of particles."""
    table = tracks(particles)
    observed = PHASE.observe(table)
    mine, theirs = predict_all(observed), predict_one_by_one(observed)
    for name in mine:
        np.testing.assert_allclose(mine[name], theirs[name], rtol=1e-9)
    plain = np.array(observe_one_by_one(table))
    np.testing.assert_allclose(observed.arrival["time_s"], plain[:, -1], rtol=1e-12)
    peer = "definitions, one particle at a time"
    return [
        compare(
            ("all arrival and lateral models", "particles", particles, peer),
            lambda: predict_all(observed),
            lambda: predict_one_by_one(observed),
        ),
        compare(
            ("last observations and arrivals", "particles", particles, peer),
            lambda: PHASE.observe(table),
            lambda: observe_one_by_one(table),
        ),
    ]
