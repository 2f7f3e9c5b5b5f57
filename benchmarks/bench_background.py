"""Background models at full resolution: the sliding median against numpy, cost by frames, memory.

The stack is made on demand: a random walk of every pixel, shifted and drifting. Our time
per frame is that of a run over so many consecutive frames, divided by their number, with
reading and subtraction; numpy's is one median of 150 frames that already lie in memory,
without either. It takes numpy some 10 s, so it is timed once.
"""

from __future__ import annotations

import time
import tracemalloc
from collections import deque
from collections.abc import Callable, Iterable

import numpy as np
from measure import Row

from kilnflight.background import MODELS, Mean, Median

FULL = (1536, 2048)
QUARTER = (384, 512)  # for the cost by number of frames: a sixteenth of the pixels
LIMIT_GIB = 3.0


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


def mean_row() -> Row:
    """Return the sliding mean against numpy's mean of each window."""
    stack, wanted = Walk(300, FULL), range(100, 110)
    around = np.stack([stack[t] for t in (*range(75, 100), *range(101, 126))])
    peer = seconds(lambda: around.mean(axis=0))
    ours = min(seconds(lambda: last(Mean()(stack, wanted))) for _ in range(3)) / len(wanted)
    step = "temporal mean, 50 frames, per frame of 10 at 1536 x 2048"
    return Row(step, "frames", len(wanted), ours, peer, peer / ours, "numpy.mean of one frame")


def growth_rows() -> list[Row]:
    """Return each model's whole run over 100, 300 and 1000 frames of 384 x 512.

    The peer is the same model's time for 100 frames, scaled by the number of frames: a
    ratio of 1 is linear cost. 100 frames are fewer than the median's window, so all of them
    share one window; from 300 on its cost is linear too.
    """
    found = []
    for model in MODELS:
        base = 0.0
        for frames in (100, 300, 1000):
            stack = Walk(frames, QUARTER)
            ours = seconds(lambda model=model, stack=stack: last(model(stack, range(len(stack)))))
            base = base or ours / frames
            name = f"background {type(model).__name__} at 384 x 512, whole recording"
            linear = base * frames
            peer = "its own 100 frames, scaled"
            found.append(Row(name, "frames", frames, ours, linear, linear / ours, peer))
    return found


def check_memory() -> None:
    """Raise unless 1000 frames of full size would stay below the limit per worker."""
    stack = Walk(1000, QUARTER)
    tracemalloc.start()
    last(Median()(stack, range(400, 600)))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    scaled = peak * FULL[0] * FULL[1] / (QUARTER[0] * QUARTER[1]) / 2**30
    print(f"temporal median: peak {scaled:.2f} GiB at 1536 x 2048 (measured at 384 x 512)")
    if scaled > LIMIT_GIB:
        raise RuntimeError(f"the median holds {scaled:.2f} GiB, above {LIMIT_GIB} GiB")


def rows() -> list[Row]:
    """Return every comparison, the results checked to be equal."""
    for model in MODELS:  # compile first
        last(model(Walk(20, (8, 8)), range(8, 12)))
    check_memory()
    return [*median_rows(), mean_row(), *growth_rows()]
