"""The whole life of a frame of the kiln: the only place where it is written out.

recording -> background -> flame taken out -> Eq. 2.4 -> combined detector -> one table
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.background import BackgroundModel, Median
from kilnflight.camera import calibrate_points
from kilnflight.detection.combination import Combination, View
from kilnflight.detection.flame import segment_flame
from kilnflight.recording.frames import PictureRecording
from kilnflight.tables import DETECTIONS


@dataclass(frozen=True)
class Pictures:
    """The grey values of a recording as a stack that is read frame by frame."""

    recording: PictureRecording

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.recording)

    def __getitem__(self, t: int) -> npt.NDArray[np.uint16]:
        """Return frame ``t``, (rows, cols)."""
        return self.recording.gray(t)


def views(
    recording: PictureRecording, wanted: Iterable[int], background: BackgroundModel | None = None
) -> Iterator[tuple[int, View]]:
    """Yield number and view of each wanted frame: what a detector may see of it.

    Parameters
    ----------
    recording
        Of the twin or from disk; only the background's window is held.
    wanted
        Numbers of frames.
    background
        The temporal median over 150 frames if None (section 5.1.2).

    Notes
    -----
    The first frame has no frame before it; the one after takes its place.
    """
    wanted = list(wanted)
    model = background if background is not None else Median()
    before, gray = -1, np.empty((0, 0), dtype=np.uint16)
    for t, foreground in zip(wanted, model(Pictures(recording), wanted), strict=True):
        frame = recording.frame(t)
        beside = t - 1 if t > 0 else min(1, len(recording) - 1)
        previous = gray if beside == before else recording.gray(beside)
        pixels, xyz = frame.pixels, calibrate_points(frame.xyz)
        if recording.attributes.flame_roi is not None:
            flame = segment_flame(frame.gray, recording.attributes.flame_roi)
            flame.clear(foreground)  # nobody else has it: models give every one anew
            keep = ~flame.holds(pixels)
            pixels, xyz = pixels.compress(keep, axis=0), xyz.compress(keep, axis=0)
        before, gray = t, frame.gray
        yield t, View(gray, previous, foreground, pixels, xyz)


def detect(
    recording: PictureRecording,
    wanted: Iterable[int],
    detector: Combination | None = None,
    background: BackgroundModel | None = None,
) -> pd.DataFrame:
    """Return the detections of the combined detector (`kilnflight.tables.DETECTIONS`)."""
    detector = detector if detector is not None else Combination()
    roi = recording.attributes.roi
    parts = [detector(view, roi, frame=t) for t, view in views(recording, wanted, background)]
    return pd.concat([DETECTIONS.empty(), *parts], ignore_index=True)
