"""Sections 4.2.1 to 4.2.4 of the thesis in plain code, and hand-made tracklets.

A tracklet is a dict from frame to (row, col, z), z NaN where unknown. Every iteration
judges every pair anew.
"""

import math
from itertools import pairwise

import numpy as np
import pandas as pd

IMPOSSIBLE = math.inf


def tracklets_of(tracks: pd.DataFrame) -> list[dict]:
    """Return the tracklets of a table, by first frame, then first position."""
    found = []
    for _, one in tracks[tracks["particle"] >= 0].groupby("particle"):
        one = one.sort_values("frame")
        depth = one["z"] if "z" in one else [math.nan] * len(one)
        places = zip(one["row"], one["col"], depth, strict=True)
        found.append(dict(zip(one["frame"].tolist(), places, strict=True)))
    return sorted(found, key=lambda t: (min(t), t[min(t)][:2]))


def velocities(part: list) -> list:
    """Return Eq. 4.17 of a list of (frame, place)."""
    return [
        ((q[0] - p[0]) / (t - s), (q[1] - p[1]) / (t - s))
        for (s, p), (t, q) in pairwise(part)
    ]


def angle(u: tuple, v: tuple) -> float:
    """Return the angle of two velocities in degrees, 0 without a direction."""
    lengths = math.hypot(*u) * math.hypot(*v)
    if lengths == 0:
        return 0.0
    return math.degrees(
        math.acos(max(-1.0, min(1.0, (u[0] * v[0] + u[1] * v[1]) / lengths)))
    )


def is_outlier(u: tuple, v: tuple) -> bool:
    """Return Eq. 4.18."""
    return angle(u, v) > 30 and math.dist(u, v) > 18


def speed(part: list) -> float:
    """Return Eq. 4.16."""
    steps = [math.hypot(*v) for v in velocities(part)]
    return sum(steps) / len(steps) if steps else 0.0


def correlation(part: list) -> float:
    """Return the correlation of a path with its polynomials of degree 2, pooled."""
    if len(part) < 4:
        return 1.0
    time = np.array([t for t, _ in part], dtype=float)
    time = (time - time.mean()) / (time[-1] - time[0])
    real, fitted = [], []
    for axis in (0, 1):
        values = np.array([p[axis] for _, p in part])
        model = np.polyval(np.polyfit(time, values, 2), time)
        real.extend(values - values.mean())
        fitted.extend(model - model.mean())
    if not np.any(real):
        return 1.0
    return float(
        np.dot(real, fitted) / math.sqrt(np.dot(real, real) * np.dot(fitted, fitted))
    )


def eliminate(tracklets: list[dict]) -> list[dict]:
    """Return those that Eq. 4.15 lets persist."""
    parts = [(t, sorted(t.items())) for t in tracklets]
    return [t for t, p in parts if len(t) > 2 and speed(p) > 1 and correlation(p) > 0.9]


def without_outliers(tracklet: dict) -> dict:
    """Return a tracklet after section 4.2.2."""
    left = sorted(tracklet.items())
    while True:
        v = velocities(left)
        count = len(left)
        if count >= 5 and is_outlier(v[0], tuple(np.mean(v[1:4], axis=0))):
            del left[0]
            continue
        met = [
            i
            for i in range(count - 3, 0, -1)
            if i + 1 < len(v) and is_outlier(v[i], v[i + 1])
        ]  # Eq. 4.20
        if met and met[0] == 1:
            del left[1]
            continue
        for i in range(2, count):
            if is_outlier(v[i - 2], v[i - 1]):
                del left[i]
                break
        else:
            return dict(left)


def mean(p: tuple, q: tuple) -> tuple:
    """Return the mean of two places; what only one knows is taken from it."""
    return tuple(
        b if math.isnan(a) else a if math.isnan(b) else (a + b) / 2
        for a, b in zip(p, q, strict=True)
    )


def joined(one: dict, other: dict) -> dict:
    """Return two tracklets as one, the mean of both in common frames."""
    return {
        **one,
        **other,
        **{t: mean(one[t], other[t]) for t in one.keys() & other.keys()},
    }


def connected_part(one: dict, other: dict) -> list:
    """Return the connected part of Fig. 4.10 as a list of (frame, place)."""
    common = sorted(one.keys() & other.keys())
    low, high = (common[0], common[-1]) if common else (min(other) - 1, max(one) + 1)
    before = [t for t in sorted(one) if t <= low][-3:]
    after = [t for t in sorted(other) if t >= high][:3]
    part = {t: one[t] for t in before}
    for t in after:
        part[t] = mean(part[t], other[t]) if t in part else other[t]
    return sorted(part.items())


def cost(one: dict, other: dict, fusion: bool) -> float:
    """Return Eq. 4.24 without its last term, infinite where Eqs 4.21 to 4.23 forbid."""
    common = one.keys() & other.keys()
    gap = min(other) - max(one)
    if fusion:
        if (
            not common
            or np.mean([math.dist(one[t][:2], other[t][:2]) for t in common]) > 10
        ):
            return IMPOSSIBLE
    elif max(other) <= max(one) or (gap >= 15 if gap > 0 else len(common) >= 5):
        return IMPOSSIBLE
    part = connected_part(one, other)
    v = velocities(part)
    turns = list(pairwise(v))
    if (
        any(is_outlier(*turn) for turn in turns)
        or speed(part) <= 1
        or correlation(part) <= 0.9
    ):
        return IMPOSSIBLE
    shown = [
        [math.hypot(*u) for u in velocities(sorted(t.items()))] for t in (one, other)
    ]
    limit = 18 + max(np.median(each) if each else 0.0 for each in shown)
    most = max([limit, *shown[0], *shown[1]])
    v_joined = velocities(sorted(joined(one, other).items()))
    if not fusion and (
        any(math.hypot(*u) > limit for u in v)
        or any(math.hypot(*u) > most for u in v_joined)
    ):
        return IMPOSSIBLE
    deep = [(t, p[2]) for t, p in part if not math.isnan(p[2])]
    steps = [abs((b - a) / (t - s)) for (s, a), (t, b) in pairwise(deep)]
    if any(step >= 1500 for step in steps):
        return IMPOSSIBLE
    total = 0.1 * sum(steps) / max(len(steps), 1)
    total += 2 * sum(angle(*turn) for turn in turns) / max(len(turns), 1)
    total += 2 * sum(math.dist(*turn) for turn in turns) / max(len(turns), 1)
    return total if fusion else total + 2 * len(common) + max(gap, 0)


def matrix(tracklets: list[dict], fusion: bool) -> np.ndarray:
    """Return the cost of every pair, the earlier tracklet first."""
    found = np.full((len(tracklets),) * 2, IMPOSSIBLE)
    for i, one in enumerate(tracklets):
        for k, other in enumerate(tracklets):
            if i != k and (min(one), max(one), i) < (min(other), max(other), k):
                found[i, k] = cost(one, other, fusion)
    return found


def join(tracklets: list[dict], fusion: bool = False) -> list[dict]:
    """Return the trajectories after section 4.2.3, or of 4.2.4, with dual nearest
    neighbours.
    """
    tracklets = list(tracklets)
    while True:
        costs = matrix(tracklets, fusion)
        near = np.minimum(costs, costs.T)
        nearest = near.argmin(axis=1) if len(tracklets) else []
        pairs = [
            (i, k)
            for i, k in enumerate(nearest)
            if i < k and nearest[k] == i and near[i, k] < IMPOSSIBLE
        ]
        if not pairs:
            return tracklets
        for i, k in pairs:
            tracklets[i] = joined(tracklets[i], tracklets[k])
        gone = {k for _, k in pairs}
        tracklets = [t for i, t in enumerate(tracklets) if i not in gone]


def postprocess(tracks: pd.DataFrame) -> list[dict]:
    """Return the trajectories of a track table after chapter 4.2."""
    cleaned = [without_outliers(t) for t in eliminate(tracklets_of(tracks))]
    cleaned = [t for t in cleaned if t]
    cleaned.sort(key=lambda t: (min(t), t[min(t)][:2]))
    connected = join(cleaned)
    connected.sort(key=lambda t: (min(t), t[min(t)][:2]))
    return join(connected, fusion=True)


def make_table(*tracklets) -> pd.DataFrame:
    """Return the table of tracklets given as (frames, rows, cols) or (..., depths)."""
    parts = []
    for particle, (frame, row, col, *depth) in enumerate(tracklets):
        part = {
            "particle": particle,
            "row": row,
            "col": col,
            "z": depth[0] if depth else math.nan,
        }
        part = pd.DataFrame({"frame": frame} | part)
        parts.append(part.astype({"row": float, "col": float, "z": float}))
    table = pd.concat(parts, ignore_index=True)
    return table.assign(gray=np.arange(len(table), dtype=float))


def make_flights(seed: int, flights: int, frames: int = 80) -> pd.DataFrame:
    """Return noisy flights cut into tracklets, with gaps, overlaps, duplicates and
    clutter.
    """
    rng = np.random.default_rng(seed)
    parts = []
    for _ in range(flights):
        t = np.arange(rng.integers(8, 50))
        place = rng.uniform(0, 150, (1, 2)) + rng.uniform(-9, 9, (1, 2)) * t[:, None]
        depth = rng.uniform(3e3, 4e3) + rng.normal(0, 300, len(t))
        start = rng.integers(0, frames)
        for first in range(0, len(t), 12):
            kept = np.arange(first, min(first + rng.integers(8, 18), len(t)))
            kept = kept[rng.random(len(kept)) < 0.85]
            wild = rng.normal(0, 40, (len(kept), 2)) * (
                rng.random((len(kept), 1)) < 0.04
            )
            row, col = (place[kept] + rng.normal(0, 1.5, (len(kept), 2)) + wild).T
            z = np.where(rng.random(len(kept)) < 0.3, np.nan, depth[kept])
            if len(kept):
                parts.append((start + kept, row, col, z))
    return make_table(*parts)
