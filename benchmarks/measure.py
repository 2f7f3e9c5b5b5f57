"""Time ours and a peer in the same run, on links that are right."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

RIGHT = 0.99  # share of the true links that a tracker must find to be timed
sys.path.append(str(Path(__file__).resolve().parents[1]))  # tests.definitions


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


def share_of_links(table: pd.DataFrame, particle: np.ndarray) -> float:
    """Return the share of the true links among those found or true (Jaccard)."""
    found = []
    for label in (table["truth"].to_numpy(), particle):
        order = np.lexsort((table["frame"], label))
        same = (np.diff(label[order]) == 0) & (label[order][:-1] >= 0)
        found.append(set(zip(order[:-1][same], order[1:][same], strict=True)))
    return len(found[0] & found[1]) / len(found[0] | found[1])


def check_links(table: pd.DataFrame, particle: np.ndarray, name: str) -> None:
    """Raise unless the links are right."""
    share = share_of_links(table, particle)
    if share < RIGHT:
        raise ValueError(f"{name}: {share:.3f} of the links are right, too few.")
