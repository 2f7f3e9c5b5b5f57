"""Grey values of what is behind a detection: the kiln without its particles.

A particle that flies from before a dark end plate to before a hot wall brightens without
burning. The thesis reads its grey values as they are; what rises above the background is
another reading of ignition (`kilnflight.flight.Rules`).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.detection.correspondence import mean_gray
from kilnflight.recording.frames import PictureRecording

PICTURES = 21  # frames in the median picture that stands for the background; ours


def behind(
    detections: pd.DataFrame, recording: PictureRecording, frames: range
) -> npt.NDArray[np.float64]:
    """Return the background (n,) of detections in grey values: its mean within their discs.

    Parameters
    ----------
    detections
        With ``row``, ``col`` and ``radius_px``.
    recording
        Where they are from; only pictures are asked.
    frames
        Over which the median of `PICTURES` frames is spread.
    """
    steps = np.linspace(frames.start, frames.stop - 1, PICTURES).round().astype(int)
    picture = np.median([recording.gray(int(t)) for t in steps], axis=0)
    return mean_gray(picture, detections[["row", "col", "radius_px"]].to_numpy(np.float64))
