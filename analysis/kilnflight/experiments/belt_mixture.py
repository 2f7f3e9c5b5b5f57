"""Two materials on one belt, told by size and shape of their spots, and what errors cost.

pictures of each material alone -> classifier
pictures of both -> spots -> tracks -> class of each track -> events -> Separation -> costs

Entry times and classes are drawn together, so both materials come as one feed. They are simulated
apart and joined in the pictures. So a contact between two materials is neglected, and where they
overlap the one drawn last hides the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import cv2
import joblib
import numpy as np
import numpy.typing as npt
import pandas as pd
from sklearn.discriminant_analysis import QuadraticDiscriminantAnalysis
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler

from kilnflight.belt.pictures import Picture, Spots
from kilnflight.belt.valves import ValveBar
from kilnflight.checks import InputError, check_count, check_inside, check_positive
from kilnflight.experiments.belt_2016 import simulate_bodies
from kilnflight.experiments.belt_camera import PictureTracks
from kilnflight.experiments.belt_valves import Entering, Trial, best_bars
from kilnflight.sorter import simulation
from kilnflight.sorter.bodies import is_installed
from kilnflight.sorter.machine import BULKS, Bulk, Feed, Slide
from kilnflight.sorter.rendering import Pictures

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

REACH_PX = 40  # half of a window around a spot: four particles long
FEATURES = ["area_px", "elongation"]
GOOD, BAD = "good", "bad"  # stays, is to be blown out


@dataclass(frozen=True)
class TimedSlide(Slide):
    """A slide whose particles come at given times, ascending, in s."""

    time_s: tuple[float, ...] = ()

    def __call__(
        self, bulk: Bulk, count: int, belt_mm: float, generator: np.random.Generator
    ) -> Feed:
        """Return particles as `Slide` does, at the given times."""
        return (
            super().__call__(bulk, count, belt_mm, generator)._replace(time_s=np.array(self.time_s))
        )


def simulate_mixture(
    good: str, bad: str, count: int, bad_share: float, seed: int, jobs: int = 1
) -> tuple[pd.DataFrame, int]:
    """Simulate one feed of two materials; return tracks at 1000 Hz and the first bad particle.

    Entry times are those of the usual feed of as many good particles. The class of each particle is
    drawn with the share of bad ones. Batches begin when the belt is empty of both.

    Parameters
    ----------
    good, bad
        Names of `BULKS`.
    count
        Particles of both together.
    bad_share
        Probability that a particle is bad.
    seed, jobs
        As of `kilnflight.sorter.simulation.simulate_tracks`; here batches run in threads.
    """
    check_count(count, "simulate_mixture: count", least=1)
    check_inside(bad_share, 0, 1, "simulate_mixture: bad_share")
    sizes = [min(simulation.BATCH, count - done) for done in range(0, count, simulation.BATCH)]
    tasks = []
    for number, size in enumerate(sizes):
        generator = np.random.default_rng([seed, number])
        time_s = Slide()(BULKS[good], size, Slide.width_mm, generator).time_s
        is_bad = generator.random(size) < bad_share
        batch_seed = int(generator.integers(2**31))
        tasks += [(good, time_s[~is_bad], batch_seed), (bad, time_s[is_bad], batch_seed + 1)]
    run = joblib.Parallel(n_jobs=min(jobs, len(tasks)), prefer="threads")
    parts = run(joblib.delayed(_simulate_at)(*task) for task in tasks)
    return join_materials(*_in_turn(parts[::2], parts[1::2]))


def _simulate_at(material: str, time_s: Array, seed: int) -> pd.DataFrame:
    """Return tracks of particles that enter at given times.

    Without MuJoCo the particles of the friction model, which do not touch, are moved in time.
    """
    count = len(time_s)
    if is_installed():
        usual = simulation.calibrated_sorter()
        slide = TimedSlide(**vars(usual.slide), time_s=tuple(time_s.tolist()))
        return simulation.simulate_tracks(material, count, seed, 1, replace(usual, slide=slide))
    bodies = simulate_bodies(material, count, seed)
    first = bodies.groupby("particle")["frame"].transform("min")
    entry = pd.Series(np.rint(1000.0 * time_s).astype(np.int64), np.unique(bodies["particle"]))
    frame = bodies["frame"] - first + bodies["particle"].map(entry)
    return bodies.assign(frame=frame, time_s=frame / 1000.0)


def _in_turn(*feeds: Sequence[pd.DataFrame]) -> list[pd.DataFrame]:
    """Return each material's batches as one table, batches of all materials at the same times."""
    begins, particles = 0, [0] * len(feeds)
    joined: list[list[pd.DataFrame]] = [[] for _ in feeds]
    for batch in zip(*feeds, strict=True):
        for number, part in enumerate(batch):
            frame, particle = part["frame"] + begins, part["particle"] + particles[number]
            joined[number].append(
                part.assign(frame=frame, time_s=frame / 1000.0, particle=particle)
            )
            particles[number] += part["particle"].nunique()
        begins = 1 + max(int(parts[-1]["frame"].max()) for parts in joined if len(parts[-1]))
    return [pd.concat(parts, ignore_index=True) for parts in joined]


def join_materials(good: pd.DataFrame, bad: pd.DataFrame) -> tuple[pd.DataFrame, int]:
    """Return the tracks of both on one belt, and the number of the first bad particle."""
    first = 1 + int(good["particle"].max()) if len(good) else 0
    return pd.concat([good, bad.assign(particle=bad["particle"] + first)], ignore_index=True), first


@dataclass(frozen=True)
class MixedPictures(Pictures):
    """Pictures of two materials: particles from ``first_bad`` on have the shape of ``bad``."""

    bad: Bulk | None = None
    first_bad: int = 0

    def _outlines(self, visible: pd.DataFrame) -> Array:
        outlines = super()._outlines(visible)
        if self.bad is None:
            return outlines
        others = replace(self, bulk=self.bad, bad=None)._outlines(visible)
        is_bad = (visible["particle"] >= self.first_bad).to_numpy()
        return np.where(is_bad[:, None], others, outlines)


def elongations(picture: Picture, background: Picture, places: Array) -> Array:
    """Return the `elongation` of the spots at places (n, 2), row and col, in a picture.

    Returns
    -------
    ndarray
        (n,); NaN where the centroid is not in the spot, as of a ring of particles.
    """
    mask = (cv2.absdiff(picture, background) > Spots().threshold).astype(np.uint8)
    values, middles = np.full(len(places), np.nan), np.rint(places).astype(np.int64)
    if not len(places) or not mask.any():
        return values
    _, labels = cv2.connectedComponents(mask)
    pixels = np.reshape(cv2.findNonZero(mask), (-1, 2))[:, ::-1].astype(np.int64)
    label = labels[pixels[:, 0], pixels[:, 1]]
    order = np.argsort(label, kind="stable")  # those of a spot stay in the order of rows
    wanted = labels[middles[:, 0], middles[:, 1]]
    edges = np.searchsorted(label[order], np.stack([wanted, wanted + 1]))
    shown = np.flatnonzero(wanted)
    spreads = np.empty((len(shown), 2, 2))
    for spread, k in zip(spreads, shown, strict=True):
        spot = pixels[order[edges[0, k] : edges[1, k]]]
        near = (np.abs(spot - middles[k]) <= REACH_PX).all(axis=1)
        spread[:] = _spread(spot[near] - np.maximum(0, middles[k] - REACH_PX))
    values[shown] = _ratios(spreads)
    return values


def features(pictured: PictureTracks) -> pd.DataFrame:
    """Return `FEATURES` of each track: medians over its spots, which look as `elongations` has it.

    Spots that are marked as several particles count only where a track has no other. A track
    without a measured elongation is left out.

    Returns
    -------
    DataFrame
        Index ``particle`` (the track), columns `FEATURES`.
    """
    spots = pictured.spots.assign(elongation=pictured.looks)
    states = pictured.followed.states
    measured = states[states["row"] >= 0]
    table = spots[[*FEATURES, "touching"]].iloc[measured["row"]].reset_index(drop=True)
    table["particle"] = measured["particle"].to_numpy()
    table = table.dropna()
    alone = table["touching"] == table.groupby("particle")["touching"].transform("min")
    return table[alone].groupby("particle")[FEATURES].median()


def fit_classes(good: pd.DataFrame, bad: pd.DataFrame) -> Pipeline:
    """Return a quadratic rule from `features` of pictures of each material alone.

    Both classes count as equally frequent; how many of each come is the threshold's business.

    Raises
    ------
    InputError
        If either has fewer tracks than three, which have no spread in two features.
    """
    for name, table in ((GOOD, good), (BAD, bad)):
        if len(table) < 3:
            raise InputError(
                f"fit_classes: {len(table)} tracks of the {name} material; take pictures of at "
                "least three particles of each."
            )
    every = pd.concat([good, bad])[FEATURES].to_numpy()
    is_bad = np.arange(len(every)) >= len(good)
    # A spread of a thousandth of that of all: features without noise have an inverse, too.
    rule = QuadraticDiscriminantAnalysis(priors=[0.5, 0.5], reg_param=1e-3)
    return make_pipeline(StandardScaler(), rule).fit(every, is_bad)


def odds_bad(rule: Pipeline, table: pd.DataFrame) -> pd.Series[float]:
    """Return the logarithm of the odds that a track is bad, by track, of `features`."""
    if not len(table):
        return pd.Series(dtype=np.float64)
    return pd.Series(rule.decision_function(table[FEATURES].to_numpy()), table.index)


def are_bad(entering: Entering, first_bad: int) -> Flags:
    """Return which particles (n,) that arrive are of the bad material."""
    return np.asarray(entering.arrival["particle"] >= first_bad)


def decide(entering: Entering, log_odds: pd.Series[float], threshold: float = 0.0) -> Flags:
    """Return which tracks (n,) are blown out: those of log odds from a threshold on.

    A track without a class has even odds, log odds of 0.
    """
    known = log_odds.reindex(entering.last["particle"]).fillna(0.0)
    return np.asarray(known.to_numpy() >= threshold)


def bayes_threshold(ratio: float, bad_share: float) -> float:
    """Return the log odds from which blowing out costs less on average.

    Parameters
    ----------
    ratio
        Cost of a bad particle left over that of a good one blown out.
    bad_share
        Share of bad particles in the feed; the classifier takes both as equally frequent.
    """
    check_positive(ratio, "bayes_threshold: ratio")
    check_inside(bad_share, 0, 1, "bayes_threshold: bad_share")
    return float(np.log((1 - bad_share) / (ratio * bad_share)))


def confusion(entering: Entering, first_bad: int, blow: Flags) -> pd.DataFrame:
    """Return true classes against decisions, in particles.

    Parameters
    ----------
    entering, first_bad
        Tracks and particles, and the first of the bad ones.
    blow
        (tracks,), the decision. A particle with two tracks is blown out if either is.

    Returns
    -------
    DataFrame
        Rows good, bad and ``no particle`` (tracks that follow none); columns ``left``,
        ``blown out``, ``missed`` (no track, so left) and ``correct_percent``, which is NaN for a
        class that does not occur.
    """
    rows, particles, bad = entering.rows, len(entering.arrival), are_bad(entering, first_bad)
    tracked = np.bincount(rows[rows >= 0], minlength=particles) > 0
    blown = np.bincount(rows[blow & (rows >= 0)], minlength=particles) > 0
    outcome = np.where(blown, 1, np.where(tracked, 0, 2))
    counts = np.zeros((3, 3), dtype=np.int64)
    for kind, outcomes in ((0, outcome[~bad]), (1, outcome[bad]), (2, blow[rows < 0].astype(int))):
        counts[kind] = np.bincount(outcomes, minlength=3)
    table = pd.DataFrame(counts, [GOOD, BAD, "no particle"], ["left", "blown out", "missed"])
    right = counts[[0, 1, 2], [0, 1, 0]] + counts[[0, 1, 2], 2] * np.array([1, 0, 1])
    total = counts.sum(axis=1)
    return table.assign(correct_percent=100 * right / np.where(total > 0, total, np.nan))


def confusion_by_touch(
    entering: Entering, first_bad: int, blow: Flags, touched: npt.NDArray[np.integer]
) -> pd.DataFrame:
    """Return `confusion` of particles that never shared a spot, and of those that ever did.

    Parameters
    ----------
    entering, first_bad, blow
        See `confusion`.
    touched
        Particles from `kilnflight.experiments.belt_camera.particles_in_shared_spots`.

    Returns
    -------
    DataFrame
        ``particle``, ``shared_spot`` (never, ever; empty for tracks of no particle) and the columns
        of `confusion`.
    """
    whole, parts = confusion(entering, first_bad, blow), []
    for name, shared in (("never", False), ("ever", True)):
        arrives = np.isin(entering.arrival["particle"], touched) == shared
        tracks = (entering.rows >= 0) & (np.isin(entering.truth, touched) == shared)
        part = Entering(
            entering.last[tracks],
            entering.truth[tracks],
            entering.arrival[arrives],
            entering.target_mm,
        )
        table = confusion(part, first_bad, blow[tracks]).loc[[GOOD, BAD]]
        parts.append(table.assign(shared_spot=name))
    parts.append(whole.loc[["no particle"]].assign(shared_spot=""))
    table = pd.concat(parts).rename_axis("particle").reset_index()
    return table[["particle", "shared_spot", *whole.columns]]


class Setting(NamedTuple):
    """What a mixture is sorted with, and the half of it that is reported."""

    model: str  # its name
    bar: ValveBar
    predicted: pd.DataFrame  # kilnflight.tables.BELT_PREDICTED of all of the half's tracks
    entering: Entering


def set_up(
    alone: Entering,
    mixture: Entering,
    log_odds: pd.Series[float],
    first_bad: int,
    bar: ValveBar,
    limit: float = 0.05,
) -> Setting:
    """Calibrate models with a recording, and choose one and its bar with half of the mixture.

    Parameters
    ----------
    alone
        Calibrates the models: the bad material, or whatever it shall be compared with.
    mixture, log_odds, first_bad
        Tracks of the mixture, their classes from `odds_bad`, and the first bad particle. With its
        first half the model and its `best_bars` are chosen, its second half is reported.
    limit
        Of the share of good particles that are hit.
    """
    first, second = mixture.halves()
    blow, bad, rows = decide(first, log_odds), are_bad(first, first_bad), first.rows
    meant = (rows >= 0) & bad[rows] if len(bad) else rows >= 0
    true, settings = first.arrival["time_s"].to_numpy()[rows[meant]], []
    for name, when, where in alone.fit():
        predicted = first.predict(when, where)
        late = true - predicted["time_s"].to_numpy()[meant]
        late_s = float(np.nanmedian(late)) if np.isfinite(late).any() else 0.0
        trial = Trial(predicted[blow], first.arrival, bad, late_s)
        (best,) = best_bars(trial, bar, [limit])
        setting = Setting(name, best, second.predict(when, where), second)
        settings.append((np.nan_to_num(trial.separate(best).hit_share), setting))
    return max(settings, key=lambda pair: pair[0])[1]


def costs(
    setting: Setting,
    first_bad: int,
    log_odds: pd.Series[float],
    bars: Sequence[ValveBar],
    thresholds: Sequence[float],
    ratios: Sequence[float],
) -> pd.DataFrame:
    """Return what both errors cost, for each ratio of costs, bar and threshold.

    Parameters
    ----------
    setting, first_bad
        Predictions and particles, and the first of those to be blown out.
    log_odds, thresholds
        See `decide`.
    bars
        To compare; that of the setting is no other.
    ratios
        Cost of a bad particle left, in units of a good one blown out.

    Returns
    -------
    DataFrame
        ``ratio``, ``open_ms``, ``log_odds`` (the threshold), ``bad``, ``bad_left``, ``good``,
        ``good_blown_out`` (particles), ``cost_per_particle``.
    """
    rows, bad = [], are_bad(setting.entering, first_bad)
    for bar, threshold in product(bars, thresholds):
        blow = decide(setting.entering, log_odds, threshold)
        shares = bar(setting.predicted[blow], setting.entering.arrival, bad)
        left, lost = int((bad & ~shares.hit).sum()), int((~bad & shares.hit).sum())
        for ratio in ratios:
            row = {"ratio": ratio, "open_ms": 1000 * bar.open_s, "log_odds": threshold}
            row |= {"bad": int(bad.sum()), "bad_left": left}
            row |= {"good": int((~bad).sum()), "good_blown_out": lost}
            rows.append(row | {"cost_per_particle": (ratio * left + lost) / max(1, len(bad))})
    return pd.DataFrame(rows)


def cheapest(costs: pd.DataFrame, axis: str) -> dict[float, str]:
    """Return in words, for each ratio of `costs`, where on an axis the cost is least.

    Places of equal cost are named from the first to the last.
    """
    places = {}
    for ratio in costs["ratio"].unique():
        part = costs[costs["ratio"] == ratio]
        cost = part["cost_per_particle"]
        least = part.loc[np.isclose(cost, cost.min(), rtol=1e-9, atol=0.0), axis]
        first, last = f"{least.min():g}", f"{least.max():g}"
        places[float(ratio)] = first if first == last else f"{first} to {last}"
    return places


def elongation(spot: npt.ArrayLike) -> float:
    """Return how much longer than wide a spot is, 1 or above, by its second moments.

    ``spot`` (rows, cols) is True where its pixels are. The ratio is that of an ellipse or a
    rectangle with these moments: 1 for a disc, 3 for a rectangle of 9 mm x 3 mm. A pixel is a
    square, so a row of n pixels has n. NaN without pixels.
    """
    pixels = np.argwhere(spot)
    return float(_ratios(_spread(pixels))) if len(pixels) else np.nan


def _spread(pixels: npt.NDArray[np.integer]) -> Array:
    """Return the second moments (2, 2) of pixels (n, 2), each a square."""
    return np.asarray(np.cov(pixels.T.astype(np.float64), bias=True) + np.eye(2) / 12.0)


def _ratios(spreads: Array) -> Array:
    """Return the ratios of the axes of second moments (..., 2, 2)."""
    squares = np.linalg.eigvalsh(spreads)
    return np.asarray(np.sqrt(squares[..., 1] / squares[..., 0]))
