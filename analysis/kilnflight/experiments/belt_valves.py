"""A bar of valves driven by exact positions and by pictures, and what it separates.

tracks or pictures -> Entering -> fitted models -> predictions -> events -> Separation

Neither paper evaluates valves. Particles to be blown out are drawn (`Trial`), or are those of a
class that the pictures tell (`kilnflight.experiments.belt_mixture`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.belt import COMBINATIONS
from kilnflight.belt.evaluation import last_states
from kilnflight.belt.models import (
    CA,
    CALV,
    CVBC,
    IV,
    ArrivalModel,
    LateralCA,
    LateralCV,
    LateralModel,
    Straight,
)
from kilnflight.belt.online import predict_arrivals
from kilnflight.belt.phase import Observed, PredictionPhase
from kilnflight.belt.pictures import Spots
from kilnflight.belt.tracker import BELT_FRAME_S
from kilnflight.belt.valves import Separation, ValveBar
from kilnflight.checks import InputError, check_inside, check_positive
from kilnflight.experiments.belt_2016 import PHASE, match, simulate_bodies
from kilnflight.experiments.belt_camera import Look, PictureTracks, track_together
from kilnflight.project import parallel
from kilnflight.sorter import simulation
from kilnflight.sorter.bodies import is_installed
from kilnflight.sorter.rendering import Pictures, at_rate

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.integer]
Key = TypeVar("Key")
Models = Sequence[tuple[str, ArrivalModel, LateralModel]]

# Fig. 10 and two more: what a line-scan camera implies (one velocity for all, straight), and
# constant velocity without its bias. Fig. 10 shows spreads, but a valve suffers from a bias.
MODELS = (
    ("IV-Straight", IV(), Straight()),
    *COMBINATIONS,
    ("CVBC-CV", CVBC(), LateralCV()),
)
# The belt's filter has a constant velocity, so models of acceleration are those without it.
OF_VELOCITY = tuple(
    (name, when, where)
    for name, when, where in MODELS
    if not isinstance(when, CA | CALV) and not isinstance(where, LateralCA)
)
OPEN_MS = (1.0, 2.0, 3.0, 4.0, 5.0, 7.0, 10.0, 15.0, 20.0)
SHIFTS_MS = (-2.0, -1.0, 0.0, 1.0, 2.0)  # of the delay from the median error of a model
PITCHES = (1.0, 1.5, 2.0, 3.0)  # that a jet is wide
LIMITS = (0.002, 0.005, 0.01, 0.02, 0.05)  # of the share of others that are hit
PASS_S = 1000.0  # from one pass of the same recording to the next, longer than any recording


class Entering(NamedTuple):
    """Tracks as they enter the prediction phase, and what truly arrives at the valves."""

    last: pd.DataFrame  # kilnflight.tables.BELT_LAST, a row for each track
    truth: Integers  # the particle of each track; -1: none that arrives
    arrival: pd.DataFrame  # kilnflight.tables.BELT_ARRIVAL, a row for each particle
    target_mm: float  # where the valves are

    @property
    def rows(self) -> Integers:
        """The row of ``arrival`` of each track's particle; -1: none."""
        return np.asarray(pd.Index(self.arrival["particle"]).get_indexer(self.truth))

    def halves(self) -> tuple[Entering, Entering]:
        """Return what arrives first and what arrives later, half of the particles each."""
        first = (self.arrival["time_s"].rank(method="first") <= len(self.arrival) / 2).to_numpy()
        rows, entry = self.rows, self.last["time_s"]
        early = (entry <= entry.median()).to_numpy()
        early = np.where(rows >= 0, first[rows], early) if len(first) else early
        first_half, second_half = (
            self._replace(
                last=self.last[tracks], truth=self.truth[tracks], arrival=self.arrival[particles]
            )
            for tracks, particles in ((early, first), (~early, ~first))
        )
        return first_half, second_half

    def fit(self, models: Models = OF_VELOCITY) -> Models:
        """Return the models calibrated with the tracks whose particle is known."""
        matched, target = self.rows >= 0, self.target_mm
        last = self.last[matched].assign(particle=self.truth[matched])
        arrival = self.arrival.iloc[self.rows[matched]]
        return [
            (name, when.calibrated(last, arrival, target), where.calibrated(last, arrival))
            for name, when, where in models
        ]

    def predict(self, when: ArrivalModel, where: LateralModel) -> pd.DataFrame:
        """Return `kilnflight.tables.BELT_PREDICTED` of all tracks."""
        return predict_arrivals(self.last, when, where, self.target_mm)

    def counts(self) -> dict[str, int]:
        """Return how many particles arrive, and how many have no prediction or several."""
        times = np.bincount(self.rows[self.rows >= 0], minlength=len(self.arrival))
        counts = {"particles": len(times), "missed": int((times == 0).sum())}
        return counts | {"doubled": int((times > 1).sum()), "tracks": len(self.last)}


class Trial(NamedTuple):
    """A recording that passes several times; each time another lot of particles is blown out.

    So each particle is to be blown out once and is one of the others in all other passes.
    """

    predicted: pd.DataFrame  # kilnflight.tables.BELT_PREDICTED
    arrival: pd.DataFrame  # kilnflight.tables.BELT_ARRIVAL
    chosen: npt.NDArray[np.bool_]
    late_s: float  # median of true minus predicted time

    def separate(self, bar: ValveBar) -> Separation:
        """Return what a bar of valves blows out in all passes."""
        return bar(self.predicted, self.arrival, self.chosen)


def draw_trial(entering: Entering, predicted: pd.DataFrame, blown: float, seed: int) -> Trial:
    """Draw the lots, each with a share ``blown`` of the particles.

    Tracks without a particle are not blown out: nobody knows what they are.

    Raises
    ------
    InputError
        If there are fewer particles than lots.
    """
    check_inside(blown, 0, 1, "draw_trial: blown")
    passes, arrival = round(1 / blown), entering.arrival
    if len(arrival) < passes:
        raise InputError(
            f"draw_trial: {len(arrival)} particles in {passes} lots; give more particles or a "
            "larger share to blow out."
        )
    lot = np.random.default_rng(seed).permutation(len(arrival)) % passes
    matched = entering.rows >= 0
    rows, meant = entering.rows[matched], predicted[matched]
    late = arrival["time_s"].to_numpy()[rows] - meant["time_s"].to_numpy()
    meant = meant.assign(time_s=meant["time_s"] + PASS_S * lot[rows])
    number = np.repeat(np.arange(passes), len(arrival))
    every = pd.concat([arrival] * passes, ignore_index=True)
    every["time_s"] += PASS_S * number
    late_s = float(np.nanmedian(late)) if np.isfinite(late).any() else 0.0
    return Trial(meant, every, np.tile(lot, passes) == number, late_s)


def of_bodies(bodies: pd.DataFrame, phase: PredictionPhase = PHASE) -> Entering:
    """Return tracks of exact positions; each is its particle."""
    return of_observed(phase.observe(bodies), phase)


def of_observed(observed: Observed, phase: PredictionPhase) -> Entering:
    """Return tracks from `PredictionPhase.observe`."""
    truth = observed.last["particle"].to_numpy()
    return Entering(observed.last, truth, observed.arrival, phase.target_mm)


def of_pictures(pictured: PictureTracks, bodies: pd.DataFrame) -> Entering:
    """Return valid tracks of pictures that enter the phase, with the particles they followed."""
    arrival = PHASE.observe(bodies).arrival
    last = last_states(pictured.followed, BELT_FRAME_S)
    states = pictured.followed.states
    measured = states[states["row"] >= 0]
    pairs = match(measured, at_rate(bodies, 1 / BELT_FRAME_S)).set_index("particle")["truth"]
    truth = last["particle"].map(pairs)
    truth = truth.where(truth.isin(arrival["particle"]), -1).astype(np.int64)
    return Entering(last, truth.to_numpy(), arrival, PHASE.target_mm)


def track_all(
    pictures: Mapping[Key, Pictures], jobs: int = 1, look: Look | None = None
) -> dict[Key, PictureTracks]:
    """Return `track_together` of several recordings, by ``jobs`` processes of this machine."""
    keys, jobs = list(pictures), min(jobs, len(pictures)) or 1
    groups = [keys[first::jobs] for first in range(jobs)]
    pieces = [([pictures[key] for key in group], 200, [Spots()], look) for group in groups]
    tracked = parallel.run_all(track_together, pieces, jobs)
    every = {
        key: one
        for group, parts in zip(groups, tracked, strict=True)
        for key, (one,) in zip(group, parts, strict=True)
    }
    return {key: every[key] for key in keys}


def simulate_feed(
    material: str, count: int, seed: int, feed: float = 1.0, jobs: int = 1
) -> pd.DataFrame:
    """Simulate tracks at 1000 Hz at ``feed`` times the papers' particles per second.

    Without MuJoCo the particles of the friction model, which do not touch, are moved in time.
    """
    check_positive(feed, "simulate_feed: feed")
    if feed != 1.0 and is_installed():
        usual = simulation.calibrated_sorter(material)
        names = ("feed_s", "feed_mean_s", "feed_std_s")
        times = {name: getattr(usual.slide, name) / feed for name in names}
        slide = replace(usual.slide, **times)
        return simulation.simulate_tracks(material, count, seed, jobs, replace(usual, slide=slide))
    bodies = simulate_bodies(material, count, seed, jobs)
    first = bodies.groupby("particle")["frame"].transform("min")
    frame = bodies["frame"] - first + (first / feed).round().astype(np.int64)
    return bodies.assign(frame=frame, time_s=frame / 1000.0)


def compare_bars(
    entering: Entering,
    bars: Iterable[ValveBar],
    seed: int,
    blown: float = 0.1,
    models: Models = MODELS,
) -> pd.DataFrame:
    """Return hits and co-deflections by model and bar.

    The first half of the particles calibrates the models, the second half is reported.

    Returns
    -------
    DataFrame
        ``model``, ``valves``, ``valve_mm`` (width of a jet), ``open_ms``, ``delay_ms``,
        ``hit_percent`` (of those to be blown out), ``inadvertent_percent`` (of the others).
    """
    first, second = entering.halves()
    rows, bars = [], list(bars)
    for name, when, where in first.fit(models):
        trial = draw_trial(second, second.predict(when, where), blown, seed)
        for bar in bars:
            shares = trial.separate(bar)
            row = {"model": name, "valves": bar.valves, "valve_mm": bar.width_mm}
            row |= {"open_ms": 1000 * bar.open_s, "delay_ms": round(1000 * bar.delay_s, 6)}
            row |= {"hit_percent": 100 * shares.hit_share}
            rows.append(row | {"inadvertent_percent": 100 * shares.inadvertent_share})
    return pd.DataFrame(rows)


def best_bars(trial: Trial, bar: ValveBar, limits: Sequence[float] = LIMITS) -> list[ValveBar]:
    """Return for each limit the bar with the most hits, by time open, delay and width of a jet.

    The share of others that are hit does not exceed the limit. Of bars with equally many hits it is
    the one with the fewest others hit. If all exceed the limit, it is that with the fewest of all.
    A jet wider than the pitch stands for a neighbour that opens as well.
    """
    bars = [
        replace(
            bar,
            valve_mm=pitches * bar.pitch_mm,
            open_s=open_ms / 1000,
            delay_s=trial.late_s + shift / 1000,
        )
        for pitches, open_ms, shift in product(PITCHES, OPEN_MS, SHIFTS_MS)
    ]
    parts = [trial.separate(each) for each in bars]
    hits, others = (
        np.array([getattr(part, name) for part in parts])
        for name in ("hit_share", "inadvertent_share")
    )
    best = []
    for limit in limits:
        allowed = others <= max(limit, others.min())
        best.append(bars[np.lexsort((others, -hits, ~allowed))[0]])
    return best


def optimised(
    entering: Entering,
    bar: ValveBar,
    seed: int,
    blown: float = 0.1,
    models: Models = OF_VELOCITY,
    limits: Sequence[float] = LIMITS,
) -> pd.DataFrame:
    """Return the curve of hits against co-deflections, by model and limit.

    Time, delay and width are `best_bars` of the first half of the particles. It calibrates the
    models, too. The second half is reported.

    Returns
    -------
    DataFrame
        ``model``, ``limit_percent``, ``valve_mm``, ``open_ms``, ``delay_ms``, ``hit_percent``,
        ``inadvertent_percent``, and of the first half ``fitted_hit_percent``,
        ``fitted_inadvertent_percent``.
    """
    first, second = entering.halves()
    rows = []
    for name, when, where in first.fit(models):
        trials = [
            draw_trial(half, half.predict(when, where), blown, seed) for half in (first, second)
        ]
        for limit, best in zip(limits, best_bars(trials[0], bar, limits), strict=True):
            row: dict[str, object] = {"model": name, "limit_percent": 100 * limit}
            row["valve_mm"] = best.width_mm
            row |= {"open_ms": 1000 * best.open_s, "delay_ms": round(1000 * best.delay_s, 6)}
            for kind, trial in zip(("fitted_", ""), trials, strict=True):
                shares = trial.separate(best)
                row[f"{kind}hit_percent"] = 100 * shares.hit_share
                row[f"{kind}inadvertent_percent"] = 100 * shares.inadvertent_share
            rows.append(row)
    return pd.DataFrame(rows)


def vary_feed(
    recordings: Mapping[float, Entering],
    bar: ValveBar,
    seed: int,
    blown: float = 0.1,
    limit: float = 0.01,
) -> pd.DataFrame:
    """Return purity and recovery over the feed, by model.

    As on a machine, models, time, delay and jets are set once: by the first half of the particles
    at the usual feed, 1.0. Every other feed is reported whole, the usual one by its second half.

    Returns
    -------
    DataFrame
        ``feed`` (times the usual), ``model``, ``open_ms``, ``valve_mm``, `Entering.counts`,
        ``recovery_percent`` (hit, of those to be blown out), ``inadvertent_percent``, and
        ``purity_blown_out_percent``, ``purity_left_percent``.
    """
    first, second = recordings[1.0].halves()
    rows = []
    for name, when, where in first.fit():
        trial = draw_trial(first, first.predict(when, where), blown, seed)
        (best,) = best_bars(trial, bar, [limit])
        for feed, entering in (dict(recordings) | {1.0: second}).items():
            shares = draw_trial(entering, entering.predict(when, where), blown, seed).separate(best)
            row: dict[str, object] = {"feed": feed, "model": name, "open_ms": 1000 * best.open_s}
            row["valve_mm"] = best.width_mm
            row |= entering.counts() | {"recovery_percent": 100 * shares.hit_share}
            row["inadvertent_percent"] = 100 * shares.inadvertent_share
            row["purity_blown_out_percent"] = 100 * shares.purity_blown_out
            row["purity_left_percent"] = 100 * shares.purity_left
            rows.append(row)
    return pd.DataFrame(rows)


def hits_by_error(
    entering: Entering, bar: ValveBar, near_mm: float, seed: int, blown: float = 0.1
) -> pd.DataFrame:
    """Return hits of particles predicted within a distance across the belt, and of the others.

    CVBC-CV, calibrated by the first half; the second half is reported. A bar without a perfect
    choice of valve misses a particle near the border of two jets, however small the error.

    Returns
    -------
    DataFrame
        Index: ``within``, ``beyond``, ``not predicted``. Columns ``particles`` and ``hit_percent``.
        Of a particle with two tracks the nearer one counts.
    """
    first, second = entering.halves()
    ((_, when, where),) = first.fit([model for model in MODELS if model[0] == "CVBC-CV"])
    predicted, rows = second.predict(when, where), second.rows
    trial = draw_trial(second, predicted, blown, seed)
    chosen_hit = trial.separate(replace(bar, delay_s=trial.late_s)).hit & trial.chosen
    hit = chosen_hit.reshape(-1, len(second.arrival)).max(axis=0)
    error = np.full(len(second.arrival), np.inf)
    away = np.abs(predicted["y"].to_numpy() - second.arrival["y"].to_numpy()[rows])
    np.fmin.at(error, rows[rows >= 0], away[rows >= 0])
    kind = np.where(
        error <= near_mm, "within", np.where(np.isinf(error), "not predicted", "beyond")
    )
    table = pd.Series(hit).groupby(kind).agg(["size", "mean"])
    table = table.reindex(["within", "beyond", "not predicted"])
    hit_percent = 100 * table["mean"].astype(np.float64)
    return pd.DataFrame({"particles": table["size"].fillna(0), "hit_percent": hit_percent})
