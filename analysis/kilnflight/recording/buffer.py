"""Frames that are held from their first use to their last."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import replace

from kilnflight.arrays import Gray
from kilnflight.recording.frames import Frame, Recording


class FrameBuffer:
    """Stack of a recording's grey values; each needed frame is read once.

    Background models read a frame before it is detected in; it is held until its last
    use.

    Parameters
    ----------
    recording
        Recording to read.
    uses
        Frame numbers that `take` will be called with, each as often as listed.
    """

    def __init__(self, recording: Recording, uses: Iterable[int] = ()) -> None:
        self._recording = recording
        self._uses = Counter(uses)
        self._held: dict[int, Frame] = {}

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self._recording)

    def __getitem__(self, t: int) -> Gray:
        """Return the grey values (rows, cols) of frame ``t``."""
        if self._uses[t]:
            view = self._fetch(t).gray.view()
        else:
            view = self._recording.gray(t).view()
        view.flags.writeable = False  # a background model holds it without a copy
        return view

    def take(self, t: int) -> Frame:
        """Return frame ``t``, without labels, and release it after its last use."""
        frame = self._fetch(t)
        self._uses[t] -= 1
        if self._uses[t] <= 0:
            del self._held[t]
        return frame

    def _fetch(self, t: int) -> Frame:
        if t not in self._held:
            self._held[t] = replace(self._recording.frame(t), labels=None)
        return self._held[t]
