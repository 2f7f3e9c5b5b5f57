"""Programs of minima and maxima that select ranks from many overlapping windows at once.

All windows of a chunk share most of their frames. The shared frames are sorted once and
the windows told apart by halving: each half of the windows shares some more frames,
which are merged in as sorted runs (Batcher's odd-even merge). A rank that can no longer
become one of the wanted ranks of any window is dropped on the way, and with it every
comparison that only served it. The program is the same for every pixel.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import chain
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

LOAD, LOW, HIGH, BOTH, EMIT = range(5)
NONE = -1


class Program(NamedTuple):
    """A table of steps over slots of memory.

    Columns of ``table`` (int32) by kind of step: LOAD frame, slot; LOW a, b, slot of the
    minimum; HIGH a, b, -, slot of the maximum; BOTH a, b, minimum, maximum; EMIT output,
    then the slots of the wanted ranks. A step never writes a slot that it reads.
    """

    table: npt.NDArray[np.int32]
    slots: int


class Compare(NamedTuple):
    """Two values and the names of their minimum and maximum (NONE where nobody asks)."""

    a: int
    b: int
    low: int
    high: int


@dataclass
class Network:
    """Comparisons of values; value i below ``inputs`` is frame i of the chunk."""

    size: int
    ranks: tuple[int, ...]
    inputs: int
    steps: list[Compare] = field(default_factory=list)
    runs: dict[tuple[int, int], list[int]] = field(default_factory=dict)
    outputs: dict[int, list[int]] = field(default_factory=dict)

    def compare(self, a: int, b: int) -> list[int]:
        """Return the values of the minimum and the maximum."""
        low = self.inputs + 2 * len(self.steps)
        self.steps.append(Compare(a, b, low, low + 1))
        return [low, low + 1]

    def merge(self, one: list[int], other: list[int]) -> list[int]:
        """Return two sorted lists as one (odd-even merge; Knuth, TAOCP 3, 5.3.4)."""
        if not one or not other:
            return one + other
        if len(one) == len(other) == 1:
            return self.compare(one[0], other[0])
        even = self.merge(one[::2], other[::2])
        odd = self.merge(one[1::2], other[1::2])
        pairs = min(len(odd), len(even) - 1)
        merged = [even[0]]
        for i in range(pairs):
            merged += self.compare(odd[i], even[i + 1])
        return merged + odd[pairs:] + even[pairs + 1 :]

    def run(self, frames: range) -> list[int]:
        """Return some consecutive frames, sorted; runs are shared between windows."""
        key = (frames.start, frames.stop)
        if len(frames) <= 1:
            return list(frames)
        if key not in self.runs:
            half = len(frames) // 2
            self.runs[key] = self.merge(self.run(frames[:half]), self.run(frames[half:]))
        return self.runs[key]

    def select(self, starts: list[int], values: list[int], base: int, seen: range) -> None:
        """Tell windows apart that share the frames ``seen``, whose ranks from ``base`` are kept."""
        if len(starts) == 1:
            self.outputs[starts[0]] = [values[rank - base] for rank in self.ranks]
            return
        half = len(starts) // 2
        for part in (starts[:half], starts[half:]):
            shared = range(part[-1], max(part[0] + self.size, part[-1]))
            left = range(shared.start, min(seen.start, shared.stop)) if seen else shared
            right = range(seen.stop, shared.stop) if seen else range(0)
            grown = self.merge(values, self.merge(self.run(left), self.run(right)))
            self.select(part, *self.kept(grown, base, shared), shared)

    def kept(self, values: list[int], base: int, seen: range) -> tuple[list[int], int]:
        """Return the ranks that the frames still to come can move onto a wanted rank."""
        to_come = self.size - len(seen)
        first = max(self.ranks[0] - to_come, 0)
        last = min(self.ranks[-1], len(seen) - 1)
        return values[first - base : last + 1 - base], first


def _without_unused(network: Network) -> list[Compare]:
    """Return the comparisons that lead to an output, the results nobody reads taken out."""
    needed = {value for output in network.outputs.values() for value in output}
    steps = []
    for a, b, low, high in reversed(network.steps):
        if low in needed or high in needed:
            needed |= {a, b}
            steps.append(
                Compare(a, b, low if low in needed else NONE, high if high in needed else NONE)
            )
    return steps[::-1]


class _Slots:
    """Which value lies in which slot, and when a slot is free again."""

    def __init__(self, uses: Iterable[int]) -> None:
        self.left: dict[int, int] = {}
        for value in uses:
            self.left[value] = self.left.get(value, 0) + 1
        self.where: dict[int, int] = {}
        self.free: list[int] = []
        self.count = 0

    def take(self, value: int) -> int:
        if value == NONE:
            return NONE
        if not self.free:
            self.free.append(self.count)
            self.count += 1
        self.where[value] = self.free.pop()
        return self.where[value]

    def release(self, values: Iterable[int]) -> None:
        for value in values:
            self.left[value] -= 1
            if not self.left[value]:
                self.free.append(self.where.pop(value))


@lru_cache(maxsize=64)
def program(size: int, ranks: tuple[int, ...], starts: tuple[int, ...]) -> Program:
    """Return the steps that emit the ``ranks`` of every window.

    Parameters
    ----------
    size
        Frames per window.
    ranks
        Wanted ranks, ascending, counted from 0.
    starts
        First frame of the window of each output, counted from the first frame of all; in
        any order, windows may occur more than once.
    """
    distinct = sorted(set(starts))
    network = Network(size, ranks, distinct[-1] + size)
    shared = range(distinct[-1], max(distinct[0] + size, distinct[-1]))
    network.select(distinct, *network.kept(network.run(shared), 0, shared), shared)
    outputs = [network.outputs[start] for start in starts]
    return _on_slots(_without_unused(network), outputs)


def _on_slots(steps: list[Compare], outputs: list[list[int]]) -> Program:
    """Return the program that loads frames late, emits early and reuses slots."""
    made = {value: number for number, step in enumerate(steps) for value in step[2:]}
    emits: dict[int, list[int]] = {}  # by the step after which all ranks are there
    for output, values in enumerate(outputs):
        emits.setdefault(max(made[value] for value in values), []).append(output)
    slots = _Slots(
        chain.from_iterable([*(step[:2] for step in steps), *(values for values in outputs)])
    )
    table: list[list[int]] = []
    for number, step in enumerate(steps):
        for value in step[:2]:
            if value not in slots.where:
                table.append([LOAD, value, slots.take(value)])
        a, b = (slots.where[value] for value in step[:2])
        kind = LOW if step.high == NONE else HIGH if step.low == NONE else BOTH
        # Results get their slots before the operands lose theirs: no step is in place.
        table.append([kind, a, b, slots.take(step.low), slots.take(step.high)])
        slots.release(step[:2])
        for output in emits.get(number, []):
            table.append([EMIT, output, *(slots.where[value] for value in outputs[output])])
            slots.release(outputs[output])
    width = max(map(len, table))
    rows = [row + [NONE] * (width - len(row)) for row in table]
    return Program(np.array(rows, dtype=np.int32), slots.count)
