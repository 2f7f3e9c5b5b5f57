"""The sliding median at full resolution against numpy.

The stack is made on demand: a random walk of every pixel, shifted and drifting. Our time
per frame is that of a run over so many consecutive frames, divided by their number, with
reading and subtraction; numpy's is one median of 150 frames that already lie in memory,
without either. It takes numpy some 10 s, so it is timed once.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable

import numpy as np
from measure import Row

from kilnflight.background import Median

FULL = (1536, 2048)


class Walk:
    """A stack in which every pixel walks at random, made on demand from eight images."""

    def __init__(self, length: int, shape: tuple[int, int]) -> None:
        generator = np.random.default_rng(length)
        steps = generator.integers(-40, 41, (8, *shape))
        self._path = (20_000 + steps.cumsum(axis=0)).astype(np.uint16)
        self._length = length
        self._level = generator.integers(-9, 10, length).cumsum()

    def __len__(self) -> int:
        return self._length

    def __getitem__(self, t: int) -> np.ndarray:
        rolled = np.roll(self._path[t % 8], t // 8, axis=1)
        rolled += np.uint16(self._level[t] % 2000)
        return rolled


def seconds(run: Callable[[], object]) -> float:
    """Return how long it takes."""
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


def last(found: Iterable[np.ndarray]) -> np.ndarray | None:
    """Use up what is yielded, one image at a time, and return the last."""
    kept = deque(found, maxlen=1)
    return kept[0] if kept else None


def median_rows() -> list[Row]:
    """Return the median against numpy, for runs of 10 and of 64 frames; the results are equal."""
    stack, model = Walk(300, FULL), Median()
    around = np.stack([stack[t] for t in (*range(25, 100), *range(101, 176))])
    start = time.perf_counter()
    expected = np.median(around, axis=0)
    numpy_s = time.perf_counter() - start
    np.testing.assert_array_equal(next(model(stack, [100])), np.abs(stack[100] - expected))
    found = []
    for frames in (10, 64):
        wanted = range(100, 100 + frames)
        ours = min(seconds(lambda wanted=wanted: last(model(stack, wanted))) for _ in range(3))
        step = f"temporal median, 150 frames, per frame of {frames} at 1536 x 2048"
        peer = "numpy.median of one frame"
        found.append(
            Row(step, "frames", frames, ours / frames, numpy_s, numpy_s * frames / ours, peer)
        )
    return found


def rows() -> list[Row]:
    """Return every comparison."""
    last(Median()(Walk(20, (8, 8)), range(8, 12)))  # compile first
    return median_rows()
