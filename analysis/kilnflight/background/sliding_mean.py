"""The mean of the frames around a frame, from one frame to the next."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from kilnflight.background.window import Held, Image, surrounding


@njit(cache=True)
def _add(total: npt.NDArray[np.int64], frame: Image, sign: int) -> None:
    for pixel in range(total.size):
        total[pixel] += sign * np.int64(frame[pixel])


@njit(cache=True)
def _mean_of_others(total: npt.NDArray[np.int64], frame: Image, others: int, out: Image) -> None:
    for pixel in range(out.size):
        out[pixel] = (total[pixel] - np.int64(frame[pixel])) / others


@njit(cache=True)
def _mean_around(
    pixels: Image,
    slots: npt.NDArray[np.intp],
    own: int,
    excess: npt.NDArray[np.float64],
    out: Image,
) -> None:
    """Mean of float frames as own value plus mean excess: exact where nothing changes."""
    excess[:] = 0.0
    for slot in slots:
        for pixel in range(out.size):
            excess[pixel] += np.float64(pixels[slot, pixel]) - np.float64(pixels[own, pixel])
    for pixel in range(out.size):
        out[pixel] = pixels[own, pixel] + excess[pixel] / (len(slots) - 1)


def window_means(
    held: Held, indices: Sequence[int], window: int
) -> Iterator[tuple[int, npt.NDArray[Any]]]:
    """Yield each index with the mean of the ``window`` frames around it, itself left out.

    The image is valid until the next is asked for; the frames of its window are in
    ``held``, which needs room for ``window + 1``. Integer frames are summed exactly and
    incrementally, float frames anew each time: rounding must not depend on what was
    asked for before.
    """
    total: npt.NDArray[np.int64] | None = None
    seen = range(0)
    for index in indices:
        around = surrounding(index, window, held.length)
        gone = [other for other in seen if other not in around]
        if total is not None and len(gone) < len(around) // 2:
            for other in gone:
                _add(total, held[other].ravel(), -1)
        else:
            total, seen = None, range(0)
        slots = held.fetch(around)
        own = held.fetch([index])[0]
        out = np.empty(held.pixels.shape[1], held.precise)
        if len(around) == 1:
            out[:] = held.pixels[own]
        elif held.pixels.dtype.kind == "f":
            _mean_around(held.pixels, slots, own, np.empty(out.size), out)
        else:
            total = np.zeros(out.size, np.int64) if total is None else total
            for other, slot in zip(around, slots, strict=True):
                if other not in seen:
                    _add(total, held.pixels[slot], 1)
            seen = around
            _mean_of_others(total, held.pixels[own], len(around) - 1, out)
        yield index, out.reshape(held.shape)
