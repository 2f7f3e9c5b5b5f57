"""Time ours and a peer in the same run; check the links of trackers."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

RIGHT = 0.99  # share of the true links that a tracker must find to be timed
TURN_S = 0.2  # a shorter call is repeated: the clock and other programs would decide
sys.path.append(str(Path(__file__).resolve().parents[1]))  # tests.definitions


class Row(NamedTuple):
    """One line of figures/benchmarks.csv: how many times longer the peer takes."""

    step: str
    unit: str
    size: int
    peer: str
    ratio: float  # median of the turns
    lowest: float
    highest: float


def seconds(call: Callable[[], object]) -> float:
    """Return the mean time of as many calls as take `TURN_S`, at least one."""
    start = time.perf_counter()
    calls = 0
    while (spent := time.perf_counter() - start) < TURN_S or not calls:
        call()
        calls += 1
    return spent / calls


def compare(
    what: tuple[str, str, int, str],
    ours: Callable[[], object],
    peer: Callable[[], object],
    share: float = 1.0,
    repeats: int = 5,
) -> Row:
    """Return the ratio of both times, run in turns.

    ``what``: step, unit, size, peer. The peer does only a ``share`` of what ours does.
    """
    ours(), peer()  # compile, and fill what they keep
    ratios = []
    for _ in range(repeats):
        own = seconds(ours)
        ratios.append(seconds(peer) / share / own)
    return Row(*what, float(np.median(ratios)), min(ratios), max(ratios))


def share_of_links(table: pd.DataFrame, particle: np.ndarray) -> float:
    """Return the share of the true links among those found or true (Jaccard)."""
    found = []
    for label in (table["truth"].to_numpy(), particle):
        order = np.lexsort((table["frame"], label))
        same = (np.diff(label[order]) == 0) & (label[order][:-1] >= 0)
        found.append(set(zip(order[:-1][same], order[1:][same], strict=True)))
    return len(found[0] & found[1]) / len(found[0] | found[1])


def check_links(
    table: pd.DataFrame, particle: np.ndarray, name: str, right: float = RIGHT
) -> None:
    """Raise unless at least the share ``right`` of the links is."""
    share = share_of_links(table, particle)
    if share < right:
        raise ValueError(f"{name}: {share:.3f} of the links are right, too few.")
