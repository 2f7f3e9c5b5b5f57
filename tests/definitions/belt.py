"""The belt papers, one particle and one pixel at a time."""

import numpy as np
from scipy.optimize import linear_sum_assignment


def observe(tracks, start_mm, target_mm, extrapolated_mm=0.0):
    """Return last states with arrivals, and particles left out by reason (2020, Figs 2
    and 5).
    """
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
        elif beyond is None and points[-1].x < target_mm - extrapolated_mm:
            reasons[2] += 1
        else:
            c, along, _ = parabolas(points[begun - 3 : begun])
            if beyond is not None:
                p, q = points[beyond - 1], points[beyond]
                share = (target_mm - p.x) / (q.x - p.x)
                crossing = (
                    p.time_s + share * (q.time_s - p.time_s),
                    p.y + share * (q.y - p.y),
                )
            else:
                p, further, across = parabolas(points[-3:])
                roots = np.roots(further - [0, 0, target_mm])
                roots = sorted(
                    root.real for root in roots if root.imag == 0 and root.real > 0
                )
                if not roots:
                    reasons[2] += 1
                    continue
                crossing = (p.time_s + roots[0], np.polyval(across, roots[0]))
            rows.append((particle, c.time_s, along[1], 2 * along[0], *crossing))
    return rows, reasons


def parabolas(points):
    """Return the last of three points, and the parabolas x and y through them, from it
    on.
    """
    time = [point.time_s - points[-1].time_s for point in points]
    x, y = (
        np.polyfit(time, [getattr(point, name) for point in points], 2) for name in "xy"
    )
    return points[-1], x, y


def limited_time(way, velocity, acceleration, limit, step=1e-5):
    """Return the time for a way by integration: accelerate up to a limit, then
    keep it.
    """
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
    hit = np.zeros(len(chosen), dtype=bool)
    for i in np.flatnonzero(chosen & np.isfinite(predicted).all(axis=0)):
        valve = min(
            range(bar.valves), key=lambda k: abs((k + 0.5) * pitch - predicted[1][i])
        )
        for j in range(len(chosen)):
            across = abs((valve + 0.5) * pitch - true[1][j]) <= pitch / 2
            hit[j] |= across and abs(predicted[0][i] - true[0][j]) <= bar.open_s / 2
    return hit
