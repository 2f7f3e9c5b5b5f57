"""The belt papers, one particle and one pixel at a time."""

import numpy as np
from scipy.optimize import linear_sum_assignment


def observe(tracks, start_mm, target_mm):
    """Return last states with arrivals, and particles left out by reason (2020, Figs 2 and 5)."""
    rows, reasons = [], [0, 0, 0]  # gap, short, missed
    for particle, track in tracks.sort_values("frame").groupby("particle"):
        points = list(track[["frame", "time_s", "x", "y"]].itertuples(index=False))
        if points[-1].frame - points[0].frame + 1 != len(points):
            reasons[0] += 1
            continue
        begun = next((i for i, p in enumerate(points) if p.x >= start_mm), len(points))
        beyond = next((i for i, p in enumerate(points) if p.x >= target_mm), None)
        if begun < 3:
            reasons[1] += 1
        elif beyond is None:
            reasons[2] += 1
        else:
            a, b, c = points[begun - 3 : begun]
            p, q = points[beyond - 1], points[beyond]
            share = (target_mm - p.x) / (q.x - p.x)
            parabola = np.polyfit([a.time_s - c.time_s, b.time_s - c.time_s, 0], [a.x, b.x, c.x], 2)
            crossing = (p.time_s + share * (q.time_s - p.time_s), p.y + share * (q.y - p.y))
            rows.append((particle, c.time_s, parabola[1], 2 * parabola[0], *crossing))
    return rows, reasons


def limited_time(way, velocity, acceleration, limit, step=1e-5):
    """Return the time for a way by integration: accelerate up to a limit, then keep it."""
    x = time = 0.0
    while x < way and time < 3.0:
        # above the limit a particle keeps its velocity unless it slows down
        if acceleration > 0:
            gain = min(acceleration * step, max(limit - velocity, 0.0))
        else:
            gain = acceleration * step
        x += (velocity + gain / 2) * step
        velocity += gain
        if velocity < 0:
            return np.nan
        time += step
    return time


def whole_matrix(costs, unobserved, new):
    """Return the matrix of Fig. 3 (2016) and the sum of its cheapest assignment."""
    n, m = costs.shape
    whole = np.full((n + m, m + n), np.inf)
    whole[:n, :m], whole[n:, m:] = costs, 0.0
    whole[n + np.arange(m), np.arange(m)] = -np.log(new)
    whole[np.arange(n), m + np.arange(n)] = -np.log(unobserved)
    rows, columns = linear_sum_assignment(np.where(np.isinf(whole), 1e9, whole))
    return whole, whole[rows, columns].sum()


def valve_hits(bar, chosen, predicted, true):
    """Return which particles are hit: every valve against every particle."""
    pitch = bar.belt_mm / bar.valves
    width = pitch if bar.valve_mm is None else bar.valve_mm
    hit = np.zeros(len(chosen), dtype=bool)
    for i in np.flatnonzero(chosen & np.isfinite(predicted).all(axis=0)):
        valve = min(range(bar.valves), key=lambda k: abs((k + 0.5) * pitch - predicted[1][i]))
        for j in range(len(chosen)):
            across = abs((valve + 0.5) * pitch - true[1][j]) <= width / 2
            hit[j] |= across and abs(predicted[0][i] - true[0][j]) <= bar.open_s / 2
    return hit
