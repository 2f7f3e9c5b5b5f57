"""All orders of a trajectory against scipy over all unknowns, and the cost over size."""

from __future__ import annotations

import time
from itertools import product

import numpy as np
import pandas as pd
import plain_regression
from measure import Row, compare

from kilnflight.project import figures
from kilnflight.regression import range_of_start, regress_all, trajectory_solver

EXIT, RATE = np.array([120.0, 60.0, 6500.0]), 330.0
SCATTER = np.array([7.0, 7.0, 150.0])
PEER_TRACKS = 2
TRIED = [(2, 2, 2), (2, 3, 2), (3, 2, 4), (6, 6, 6)]  # of 125; the peer is timed on these
GROWTH = (30, 100, 300, 1000)  # trajectories of 60 points
POINTS = (30, 60, 120, 240)  # points of 200 trajectories


def tracks(count: int, points: int = 60) -> pd.DataFrame:
    """Return flights of one fraction, each with a t0 of its own."""
    rng = np.random.default_rng(count)
    parts = []
    for particle in range(count):
        first = int(rng.integers(100, 3000))
        since = (np.arange(points) * 60 / points + rng.uniform(5, 20)) / RATE
        speed = np.array([400.0, 900.0, -11_000.0]) * rng.uniform(0.7, 1.3, 3)
        bend = np.array([-300.0, -4900.0, 6000.0])
        places = EXIT + since[:, None] * speed + since[:, None] ** 2 * bend
        places += rng.normal(size=places.shape) * SCATTER
        part = pd.DataFrame(places, columns=list("xyz"))
        parts.append(part.assign(time_s=first / RATE + since, particle=particle))
    return pd.concat(parts, ignore_index=True)


def prepared(track: pd.DataFrame) -> tuple:
    """Return what both start from: times 0 to 1, places, the range of t0 and the first guess."""
    at = track["time_s"].to_numpy()
    unit = (at - at[0]) / (at[-1] - at[0])
    moved = np.ascontiguousarray((track[list("xyz")].to_numpy() - EXIT).T)
    longest = 1.0 / (at[-1] - at[0])
    limits, first = range_of_start(unit, moved, 20, longest, np.random.default_rng(0))
    return unit, moved, limits, first


def check(data: list[tuple]) -> None:
    """Raise unless both find the same minimum."""
    for unit, moved, limits, first in data:
        solve = trajectory_solver(unit, moved, 6, limits, first)
        for orders in TRIED:
            peer = plain_regression.solve(unit, moved.T, np.zeros(3), orders, first, limits)
            np.testing.assert_allclose(solve(orders).costs.sum(), 2 * peer.cost, rtol=1e-6)
            np.testing.assert_allclose(solve(orders).start, peer.x[-1], atol=1e-4)


def every(data: list[tuple]) -> None:
    """Solve all combinations of orders; a track that is regressed asks for some of them only."""
    for unit, moved, limits, first in data:
        solve = trajectory_solver(unit, moved, 6, limits, first)
        for orders in product(range(2, 7), repeat=3):
            solve(orders)


def plainly(data: list[tuple], combinations_tried: list[tuple[int, int, int]]) -> None:
    """Solve some combinations with the peer."""
    for unit, moved, limits, first in data:
        for orders in combinations_tried:
            plain_regression.solve(unit, moved.T, np.zeros(3), orders, first, limits)


def rows() -> list[Row]:
    """Return the comparison, the results checked to be equal; the peer's time is scaled up."""
    data = [prepared(part) for _, part in tracks(PEER_TRACKS).groupby("particle")]
    check(data)
    row = compare(
        ("regression, all combinations of orders", "trajectories", PEER_TRACKS,
         "scipy over all unknowns, 4 of 125 combinations scaled up"),
        lambda: every(data),
        lambda: plainly(data, TRIED),
        repeats=2,
    )  # fmt: skip
    scale = len(list(product(range(5), repeat=3))) / len(TRIED)
    return [row._replace(peer_s=row.peer_s * scale, ratio=row.ratio * scale)]


def growth() -> pd.DataFrame:
    """Return the seconds of `regress_all` and of all combinations, over numbers and points."""
    found = []
    sizes = [(count, 60) for count in GROWTH] + [(200, points) for points in POINTS]
    for count, points in sizes:
        table = tracks(count, points)
        start, used = time.perf_counter(), time.process_time()
        assert (regress_all(table, EXIT)["outcome"] == "fitted").all()
        took = time.perf_counter() - start, time.process_time() - used
        start = time.perf_counter()
        every([prepared(part) for _, part in table.groupby("particle")])
        found.append((count, points, *took, time.perf_counter() - start))
    columns = ["trajectories", "points", "seconds", "cpu_seconds", "all_combinations_seconds"]
    return pd.DataFrame(found, columns=columns)


def save() -> None:
    """Save what regression costs, by number and length of tracks."""
    table = growth()
    print(table.to_string(index=False))
    caption = (
        "Seconds, one core, of the regression of some trajectories of some points, which solves "
        "those of the 125 combinations of orders that its choice looks at, and of all 125."
    )
    origin = figures.trace("benchmarks/bench_regression", {"scale": "full"}, mark="")
    figures.save("benchmark-regression", table, caption=caption, provenance=origin)


if __name__ == "__main__":
    print(*rows(), sep="\n")
    save()
