"""Time ours and a peer in the same run."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple


class Row(NamedTuple):
    """One line of figures/benchmarks.csv."""

    step: str
    unit: str
    size: int
    ours_s: float
    peer_s: float
    ratio: float
    peer: str


def compare(
    what: tuple[str, str, int, str],
    ours: Callable[[], object],
    peer: Callable[[], object],
    repeats: int = 3,
) -> Row:
    """Return the best times of both, run in turns; ``what``: step, unit, size, peer."""
    step, unit, size, name = what
    times: tuple[list[float], list[float]] = ([], [])
    for _ in range(repeats):
        for run, kept in zip((ours, peer), times, strict=True):
            start = time.perf_counter()
            run()
            kept.append(time.perf_counter() - start)
    mine, theirs = min(times[0]), min(times[1])
    return Row(step, unit, size, mine, theirs, theirs / mine, name)
