"""The sliding median at full resolution against numpy.

The stack is made on demand: a random walk of every pixel, shifted and drifting. Our
time per frame is that of a run over so many consecutive frames, divided by their
number, with reading and subtraction; numpy's is one median of 150 frames that already
lie in memory, without either.
"""

from __future__ import annotations

from collections import deque
from functools import partial

import numpy as np
from measure import Row, compare

from kilnflight.background import Median

FULL = (1536, 2048)


class Walk:
    """A stack in which every pixel walks at random, made on demand from eight
    images.
    """

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


def rows() -> list[Row]:
    """Return the median of 64 frames against numpy's of one; the results are equal."""
    stack = Walk(300, FULL)
    model = Median()
    wanted = range(100, 164)
    around = np.stack([stack[t] for t in (*range(25, 100), *range(101, 176))])
    expected = np.maximum(stack[100] - np.median(around, axis=0), 0)
    np.testing.assert_array_equal(next(model(stack, [100])), expected)
    what = ("temporal median over 150 frames, per frame", "frames", 64, "numpy.median")
    ours = partial(deque, maxlen=1)  # uses up what is yielded
    return [
        compare(
            what,
            lambda: ours(model(stack, wanted)),
            lambda: np.median(around, axis=0),
            share=1 / len(wanted),
        )
    ]
