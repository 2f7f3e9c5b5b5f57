"""How well detections were told to be in the air or on the wall (thesis, section 5.1.4)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.checks import InputError, check_shape
from kilnflight.scores.counts import rates
from kilnflight.scores.detections import FrameScore


def total_in_air(
    scores: Sequence[FrameScore],
    truth_in_air: Sequence[npt.ArrayLike],
    detected_in_air: Sequence[npt.ArrayLike],
) -> pd.DataFrame:
    """Return how well detections were told to be in the air, summed over frames.

    As Tables 5.13 and 5.14: TP is a particle in the air whose detection is told to be there;
    FP any other detection told to be in the air, be it on the wall or nothing; FN any other
    particle in the air, be it told to be on the wall or not detected. For Table 5.13 hand in
    the score of the truth against itself.

    Parameters
    ----------
    scores
        Per frame the assignment of detections to particles.
    truth_in_air, detected_in_air
        Per frame whether each particle (n,) and each detection (m,) is in the air *and* has
        3D; those without 3D are False and so "not taken into consideration" (section 5.1.4).
    """
    if not len(scores) == len(truth_in_air) == len(detected_in_air):
        raise InputError(
            f"{len(scores)} scores, but {len(truth_in_air)} and {len(detected_in_air)} frames of "
            "truth and detections; give one of each per frame."
        )
    counts = []
    frames = zip(scores, truth_in_air, detected_in_air, strict=True)
    for frame, (score, *both) in enumerate(frames):
        flying = [np.asarray(one, dtype=bool) for one in both]
        for side in range(2):
            where = f"total_in_air: {('truth', 'detected')[side]} of frame {frame}"
            check_shape(flying[side], (score.rows[side],), where)
        there = [flying[side][score.pairs[:, side]] for side in range(2)]
        tp = int(np.count_nonzero(there[0] & there[1]))
        fp = int(there[1].sum() + flying[1][score.spurious].sum()) - tp
        fn = int(there[0].sum() + flying[0][score.missed].sum()) - tp
        counts.append((tp, fp, fn))
    return _row(counts)


def _row(counts: Sequence[tuple[int, int, int]]) -> pd.DataFrame:
    tp, fp, fn = np.array(counts, dtype=np.intp).reshape(-1, 3).sum(axis=0)
    summed = pd.DataFrame({"tp": [tp], "fp": [fp], "fn": [fn]})
    return pd.concat([summed, rates(tp, fp, fn)], axis=1)
