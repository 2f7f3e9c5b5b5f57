"""The median of the frames around a frame, for a chunk of neighbouring frames at a time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from kilnflight.background.selection import BOTH, EMIT, LOAD, LOW, program
from kilnflight.background.window import Held, Image, surrounding

CHUNK = 32  # frames; longer saves little time and costs memory: one more frame each
TILE_BYTES = 8192  # of one slot: some 125 slots of it fill a second-level cache of 1 MiB


@njit(cache=True)
def _copy(source: Image, out: Image) -> None:
    for p in range(source.size):
        out[p] = source[p]


@njit(cache=True)
def _low(a: Image, b: Image, out: Image) -> None:
    for p in range(out.size):
        out[p] = min(a[p], b[p])


@njit(cache=True)
def _high(a: Image, b: Image, out: Image) -> None:
    for p in range(out.size):
        out[p] = max(a[p], b[p])


@njit(cache=True)
def _both(a: Image, b: Image, low: Image, high: Image) -> None:
    for p in range(low.size):
        x, y = a[p], b[p]
        low[p] = min(x, y)
        high[p] = max(x, y)


@njit(cache=True)
def _middle(ranks: tuple[Image, Image, Image, Image], own: Image, out: Image) -> None:
    """Median without the own value: it moves the ranks from its own upwards by one."""
    low, above_low, high, above_high = ranks
    for p in range(out.size):
        x = own[p]
        lower = above_low[p] if x <= low[p] else low[p]
        upper = above_high[p] if x <= high[p] else high[p]
        out[p] = 0.5 * (np.float64(lower) + np.float64(upper))


@njit(cache=True)
def _execute(
    table: npt.NDArray[np.int32],
    scratch: Image,
    pixels: Image,
    slots: npt.NDArray[np.intp],
    own: npt.NDArray[np.intp],
    out: Image,
) -> None:
    """Run the program tile by tile; ``slots`` and ``own`` are rows of ``pixels``."""
    tile = scratch.shape[1]
    for first in range(0, pixels.shape[1], tile):
        last = min(first + tile, pixels.shape[1])
        for step in range(table.shape[0]):
            kind, a, b, c, d = table[step, :5]
            if kind == BOTH:
                _both(scratch[a], scratch[b], scratch[c], scratch[d])
            elif kind == LOAD:
                _copy(pixels[slots[a], first:last], scratch[b])
            elif kind == EMIT:
                ranks = (scratch[b], scratch[c], scratch[d], scratch[table[step, 5]])
                _middle(ranks, pixels[own[a], first:last], out[a, first:last])
            elif kind == LOW:
                _low(scratch[a], scratch[b], scratch[c])
            else:
                _high(scratch[a], scratch[b], scratch[d])


def _chunks(indices: Sequence[int], window: int, length: int) -> Iterator[list[int]]:
    """Yield the indices in their order, in groups whose windows start within `CHUNK` frames."""
    chunk: list[int] = []
    low = high = 0
    for index in indices:
        start = surrounding(index, window, length).start
        if chunk and (len(chunk) == CHUNK or max(high, start) - min(low, start) >= CHUNK):
            yield chunk
            chunk = []
        low, high = (min(low, start), max(high, start)) if chunk else (start, start)
        chunk.append(index)
    if chunk:
        yield chunk


def window_medians(
    held: Held, indices: Sequence[int], window: int
) -> Iterator[tuple[int, npt.NDArray[Any]]]:
    """Yield each index with the median of the ``window`` frames around it, itself left out.

    Of an even number of frames the mean of the two middle values, as `numpy.median`. The
    image is valid until the next is asked for. ``held`` needs room for ``window + CHUNK``.

    Windows with their own frame are consecutive frames, so a chunk shares nearly all
    work; the program gives the middle ranks with it, `_middle` takes it out.
    """
    out = np.empty((0, 0))
    for chunk in _chunks(indices, window, held.length):
        windows = [surrounding(index, window, held.length) for index in chunk]
        first = min(around.start for around in windows)
        slots = held.fetch(range(first, max(around.stop for around in windows)))
        own = held.fetch(chunk)
        if not out.size:
            out = np.empty((min(CHUNK, len(indices)), held.pixels.shape[1]), held.precise)
        others = len(windows[0]) - 1
        if others == 0:
            out[: len(chunk)] = held.pixels[own]
        else:
            low, high = (others - 1) // 2, others // 2
            ranks = (low, low + 1, high, high + 1)
            steps = program(others + 1, ranks, tuple(around.start - first for around in windows))
            tile = min(TILE_BYTES // held.pixels.itemsize, out.shape[1])
            scratch = np.zeros((steps.slots, tile), held.pixels.dtype)
            _execute(steps.table, scratch, held.pixels, slots, own, out)
        for index, background in zip(chunk, out, strict=False):
            yield index, background.reshape(held.shape)
