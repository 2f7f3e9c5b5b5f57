"""Medians of the frames around each frame, a chunk at a time.

All windows of a chunk share most of their frames. The shared frames are sorted once,
and the windows are separated by halving. Each half of the windows shares more frames,
which are merged in as sorted runs (Batcher's odd-even merge). A rank that cannot become
a middle rank of any window is dropped, with every comparison that only served it. The
program of minima and maxima is the same for every pixel; compiled code runs it tile by
tile. `numpy.median` selects from every window anew and takes some 600 times as long
(benchmarks.csv).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import chain
from typing import Any

import numpy as np
import numpy.typing as npt

from kilnflight.arrays import Anything, Shape
from kilnflight.background.frames import HeldFrames, surrounding
from kilnflight.compiled import compiled

# Frame numbers and images (rows, cols).
Backgrounds = Iterator[tuple[int, Anything]]
# Frames. A pixel and window takes 52 comparisons, 67 with chunks of 32; the slots of 96
# exceed the cache.
MEDIAN_CHUNK = 64
_BAND = 65_536  # pixels of all frames that are copied side by side
# Pixels. Some 270 slots of 16 bits fill a second-level cache; 512 px took longer.
_TILE = 1024
_LINE = 64  # bytes; values that begin at multiples are read and written twice as fast
_LOAD, _COMPARE, _EMIT = range(3)
_UNUSED = -1  # number of a result that is not read; in a program the last scratch row
_Comparison = tuple[int, int, int, int]  # two values, their minimum and their maximum
# Head of a row, values that are read, and values that are written.
_Step = tuple[list[int], Sequence[int], Sequence[int]]


@dataclass
class _Network:
    """Comparisons that find the middle ranks of all windows of a chunk, at one pixel.

    Values are numbered: value i below ``inputs`` is the pixel in frame i of the chunk,
    later ones are results of comparisons. A list of values is sorted, the smallest
    first.
    """

    size: int  # frames per window
    ranks: Shape  # wanted ranks of a window, ascending from 0
    inputs: int  # frames of the chunk
    steps: list[_Comparison] = field(default_factory=list)
    # sorted values of consecutive frames
    runs: dict[range, list[int]] = field(default_factory=dict)
    # values at `ranks`, by the window's first frame
    outputs: dict[int, list[int]] = field(default_factory=dict)

    def compare(self, a: int, b: int) -> list[int]:
        """Add a comparison; return the numbers of its minimum and its maximum."""
        low = self.inputs + 2 * len(self.steps)
        self.steps.append((a, b, low, low + 1))
        return [low, low + 1]

    def merge(self, first: list[int], second: list[int]) -> list[int]:
        """Return two sorted lists as one (odd-even merge; Knuth, TAOCP 3, 5.3.4)."""
        if not first or not second:
            return first + second
        if len(first) == len(second) == 1:
            return self.compare(first[0], second[0])
        even = self.merge(first[::2], second[::2])
        odd = self.merge(first[1::2], second[1::2])
        pairs = min(len(odd), len(even) - 1)
        merged = [even[0]]
        for i in range(pairs):
            merged += self.compare(odd[i], even[i + 1])
        return merged + odd[pairs:] + even[pairs + 1 :]

    def run(self, frames: range) -> list[int]:
        """Return the values of consecutive frames, sorted once for all windows."""
        if len(frames) <= 1:
            return list(frames)
        if frames not in self.runs:
            half = len(frames) // 2
            early = self.run(frames[:half])
            self.runs[frames] = self.merge(early, self.run(frames[half:]))
        return self.runs[frames]

    def select(
        self, starts: list[int], values: list[int], base: int, known: range
    ) -> None:
        """Find the outputs of the windows that begin at ``starts``, by halving them.

        All of them contain the frames ``known``. ``values`` are the sorted values of
        these frames, from rank ``base`` on: only ranks that may become a middle rank of
        some window. The other frames of a window can only raise the rank of a value.
        """
        shared = range(starts[-1], max(starts[0] + self.size, starts[-1]))
        before = self.run(range(shared.start, min(known.start, shared.stop)))
        after = self.run(range(known.stop, shared.stop))
        grown = self.merge(values, self.merge(before, after))
        first = max(self.ranks[0] - self.size + len(shared), 0)
        last = min(self.ranks[-1], len(shared) - 1)
        kept = grown[first - base : last + 1 - base]
        if len(starts) == 1:
            self.outputs[starts[0]] = [kept[rank - first] for rank in self.ranks]
            return
        half = len(starts) // 2
        self.select(starts[:half], kept, first, shared)
        self.select(starts[half:], kept, first, shared)

    def needed(self) -> list[_Comparison]:
        """Return the comparisons that outputs need; unread results are `_UNUSED`."""
        used = set(chain(*self.outputs.values()))
        steps = []
        for a, b, low, high in reversed(self.steps):
            if low in used or high in used:
                low, high = (v if v in used else _UNUSED for v in (low, high))
                steps.append((a, b, low, high))
                used |= {a, b}
        return steps[::-1]


@lru_cache  # most chunks share a program, which takes 30 ms
def _program(size: int, starts: Shape) -> npt.NDArray[np.uint64]:
    """Return the program (n, 6) that emits the four ranks of every window.

    Each row is a step; the ranks are those that `_middle` reads.

    Parameters
    ----------
    size
        Frames per window.
    starts
        First frame of each output's window, counted from the first frame of the chunk.
        Windows may be in any order and repeat.

    Notes
    -----
    A slot is a row of scratch memory. Columns by kind of step: `_LOAD`, frame, slot;
    `_COMPARE`, two slots, slot of the minimum, slot of the maximum; `_EMIT`, output,
    slots of the ranks. What is not read, and what fills a row, is the largest number.
    """
    low = (size - 2) // 2
    high = (size - 1) // 2
    distinct = sorted(set(starts))
    frames = distinct[-1] + size
    network = _Network(size, (low, low + 1, high, high + 1), frames)
    network.select(distinct, [], 0, range(frames, frames))
    outputs = [network.outputs[start] for start in starts]
    table = _allocated([*_scheduled(network.needed(), outputs)])
    program = np.array([row + [_UNUSED] * (6 - len(row)) for row in table])
    return np.where(program < 0, program.max() + 1, program).astype(np.uint64)


def _scheduled(
    comparisons: list[_Comparison], outputs: list[list[int]]
) -> Iterator[_Step]:
    """Yield comparisons and ``outputs``, which are lists of values, in order.

    Outputs come as early as they can.
    """
    numbered = enumerate(comparisons)
    made = {value: number for number, step in numbered for value in step[2:]}
    ready = [max(made[value] for value in values) for values in outputs]
    for number, step in enumerate(comparisons):
        yield [_COMPARE], step[:2], step[2:]
        for output, values in enumerate(outputs):
            if number == ready[output]:
                yield [_EMIT, output], values, ()


def _allocated(steps: list[_Step]) -> list[list[int]]:
    """Return rows with a slot for each value, frames loaded before their first use.

    Slots are used again after the last read. Results get theirs before the operands
    lose theirs: no step is in place.
    """
    last = {value: number for number, step in enumerate(steps) for value in step[1]}
    slots = {_UNUSED: _UNUSED}
    free = list(range(len(last)))[::-1]
    table = []
    for number, (head, read, written) in enumerate(steps):
        for value in (*read, *written):
            if value not in slots:
                slots[value] = free.pop()
                if value in read:
                    table.append([_LOAD, value, slots[value]])
        table.append([*head, *(slots[value] for value in (*read, *written))])
        done = [value for value in dict.fromkeys(read) if last[value] == number]
        free += [slots.pop(value) for value in done]
    return table


@compiled
def _execute(
    table: Any, scratch: Any, pixels: Any, frames: Any, out: Any, start: Any
) -> None:
    """Run a program on a band of p pixels and write the medians into ``out``.

    ``table`` (n, 6) is from `_program`, and ``scratch`` has more rows of `_TILE` pixels
    than there are slots. ``pixels`` (f, p) is the band in the f frames of the chunk.
    ``frames`` (outputs,) are the rows of ``pixels`` whose medians are wanted. The band
    begins at pixel ``start`` of ``out`` (outputs, all pixels). Tiles keep the scratch
    memory in the processor's cache.

    Numbers are unsigned, as negative ones would have to be tested; rows are no slices,
    whose owners are counted. Both take longer than the comparisons of a tile.
    """
    for first in range(np.uint64(0), np.uint64(pixels.shape[1]), np.uint64(_TILE)):
        count = min(np.uint64(_TILE), np.uint64(pixels.shape[1]) - first)
        for step in range(len(table)):
            kind, a, b, c, d, e = table[step]
            if kind == _COMPARE:
                for p in range(np.uint64(_TILE)):
                    x = scratch[a, p]
                    y = scratch[b, p]
                    scratch[c, p] = min(x, y)
                    scratch[d, p] = max(x, y)
            elif kind == _LOAD:
                for p in range(count):
                    scratch[b, p] = pixels[a, first + p]
            else:
                frame = pixels[frames[a], first : first + count]
                target = out[a, start + first : start + first + count]
                _middle(scratch, (b, c, d, e), frame, target)


@compiled
def _middle(scratch: Any, ranks: Any, frame: Any, out: Any) -> None:
    """Write into ``out`` (p,) the median of a window without the frame itself.

    ``ranks`` are four rows of ``scratch``: the window's values at the two middle ranks
    of the others, each followed by the next higher value. ``frame`` (p,) is the frame.
    Leaving out its value moves the ranks above it by one.
    """
    low, above_low, high, above_high = ranks
    for p in range(np.uint64(out.size)):
        x = frame[p]
        below = scratch[low, p]
        above = scratch[high, p]
        after_below = scratch[above_low, p]
        after_above = scratch[above_high, p]
        lower = after_below if x <= below else below  # both are read first: no branches
        upper = after_above if x <= above else above
        out[p] = 0.5 * (np.float64(lower) + np.float64(upper))


def _chunks(indices: Sequence[int], window: int, length: int) -> Iterator[list[int]]:
    """Yield groups of up to `MEDIAN_CHUNK` indices whose windows start that close."""
    chunk: list[int] = []
    for index in indices:
        starts = [surrounding(other, window, length).start for other in (*chunk, index)]
        if len(chunk) == MEDIAN_CHUNK or max(starts) - min(starts) >= MEDIAN_CHUNK:
            yield chunk
            chunk = []
        chunk.append(index)
    if chunk:
        yield chunk


def window_medians(
    held: HeldFrames, indices: Sequence[int], window: int
) -> Backgrounds:
    """Yield each frame number with the median of the frames around it, (rows, cols).

    ``indices`` are frame numbers, in any order. The ``window`` frames do not include
    the frame itself. The median is that of `numpy.median`. The image is valid until the
    next is asked for. ``held`` needs room for ``window + MEDIAN_CHUNK`` frames.

    Windows with the frame itself are consecutive frames and share nearly all work. So
    the program gives the middle ranks with the frame, and `_middle` takes it out.
    """
    out = np.empty((0, 0))
    for chunk in _chunks(indices, window, held.length):
        windows = [surrounding(index, window, held.length) for index in chunk]
        first = min(around.start for around in windows)
        needed = range(first, max(around.stop for around in windows))
        held.fetch(needed)
        if not out.size:
            shape = min(MEDIAN_CHUNK, len(indices)), held[first].size
            out = np.empty(shape, held.precise)
        if len(windows[0]) > 1:
            starts = tuple(around.start - first for around in windows)
            frames = (np.array(chunk) - first).astype(np.uint64)
            table = _program(len(windows[0]), starts)
            slots = int(table.max()) + 1
            # It begins at a multiple of `_LINE`.
            memory = np.zeros(slots * _TILE + _LINE, held.kind)
            begin = -memory.ctypes.data % _LINE // memory.itemsize
            scratch = memory[begin : begin + slots * _TILE].reshape(slots, _TILE)
            for start in range(0, out.shape[1], _BAND):
                pixels = slice(start, start + _BAND)
                band = np.stack([held[t].ravel()[pixels] for t in needed])
                _execute(table, scratch, band, frames, out, np.uint64(start))
        else:
            out[: len(chunk)] = [held[t].ravel() for t in chunk]
        for index, background in zip(chunk, out, strict=False):
            yield index, background.reshape(held.shape)


def stack_median(frames: Sequence[Anything]) -> Anything:
    """Return the median (rows, cols) of frames, each (rows, cols) of one type.

    It is ten times as fast as `numpy.median`.
    """
    # It is the median around a frame in front of them, which does not count.
    held = HeldFrames([frames[0], *frames], len(frames) + 1)
    _, middle = next(window_medians(held, [0], len(frames)))
    return middle
