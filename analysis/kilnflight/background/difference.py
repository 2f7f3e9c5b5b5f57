"""Moving frame difference: neighbouring frames as background (Eqs 2.5 and 2.6)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from kilnflight.background.window import (
    Foreground,
    Frames,
    Held,
    check_indices,
    difference,
)
from kilnflight.checks import check_count


def partner(index: int, step: int, length: int) -> int:
    """Return the frame ``step`` frames away; where there is none, the one as far the other way.

    If neither is in the recording, the farther end of it.
    """
    for candidate in (index + step, index - step):
        if 0 <= candidate < length:
            return candidate
    return 0 if index > length - 1 - index else length - 1


@dataclass(frozen=True)
class TwoFrame:
    """Absolute difference from an earlier frame (Eq. 2.5, Zhang 2023).

    Notes
    -----
    The first frames have no frame ``interval`` before them; they are compared with the
    frame as far after, and in a recording shorter than that with its farther end.
    """

    interval: int = 3  # frames, i of Eq. 2.5, Table 5.4

    def __post_init__(self) -> None:
        """Refuse an interval that leads nowhere."""
        check_count(self.interval, "TwoFrame: interval")

    def __call__(self, frames: Frames, indices: Iterable[int]) -> Iterator[Foreground]:
        """Yield the foreground of each wanted frame, (rows, cols) float32; see `Mean`."""
        held = Held(frames, 2 * self.interval + 1)
        return self._foregrounds(held, check_indices(indices, held.length))

    def _foregrounds(self, held: Held, indices: tuple[int, ...]) -> Iterator[Foreground]:
        for t in indices:
            before = partner(t, -self.interval, held.length)
            held.fetch([before, t])
            yield difference(held[t], held[before])


@dataclass(frozen=True)
class ThreeFrame:
    """Mean absolute difference from an earlier and a later frame (Eq. 2.6, Zhang 2023).

    Notes
    -----
    Where there is no earlier or no later frame, the other one counts twice; in a
    recording shorter than the interval its farther end stands for both.
    """

    interval: int = 3  # frames, i of Eq. 2.6, Table 5.4

    def __post_init__(self) -> None:
        """Refuse an interval that leads nowhere."""
        check_count(self.interval, "ThreeFrame: interval")

    def __call__(self, frames: Frames, indices: Iterable[int]) -> Iterator[Foreground]:
        """Yield the foreground of each wanted frame, (rows, cols) float32; see `Mean`."""
        held = Held(frames, 2 * self.interval + 1)
        return self._foregrounds(held, check_indices(indices, held.length))

    def _foregrounds(self, held: Held, indices: tuple[int, ...]) -> Iterator[Foreground]:
        for t in indices:
            before = partner(t, -self.interval, held.length)
            after = partner(t, self.interval, held.length)
            held.fetch([before, t, after])
            foreground = difference(held[t], held[before])
            foreground += difference(held[t], held[after])
            foreground *= 0.5
            yield foreground
