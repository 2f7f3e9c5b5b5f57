"""Counts of detections -> precision, recall, F1 (Eqs 3.1 to 3.3, thesis)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.checks import InputError


def rates(
    true_positives: npt.ArrayLike, false_positives: npt.ArrayLike, false_negatives: npt.ArrayLike
) -> pd.DataFrame:
    """Return precision, recall and F1 of counts.

    ``precision = TP / (TP + FP)``, ``recall = TP / (TP + FN)``,
    ``F1 = 2 TP / (2 TP + FP + FN)``; a ratio without anything below the line is 0,
    so that a detector that finds nothing has no score rather than no number.

    Parameters
    ----------
    true_positives, false_positives, false_negatives
        Counts, scalars or arrays of one shape (n,), not negative.

    Returns
    -------
    DataFrame
        Columns ``precision``, ``recall``, ``f1``, one row per entry.

    Examples
    --------
    >>> rates(3256, 76, 1131).round(4).loc[0].tolist()
    [0.9772, 0.7422, 0.8436]
    """
    tp, fp, fn = (
        np.atleast_1d(np.asarray(counts, dtype=np.float64))
        for counts in (true_positives, false_positives, false_negatives)
    )
    if not all((counts >= 0).all() for counts in (tp, fp, fn)):
        raise InputError("counts of detections must be numbers not below 0.")

    def ratio(above: npt.NDArray[np.float64], below: npt.NDArray[np.float64]) -> npt.ArrayLike:
        return np.divide(above, below, out=np.zeros_like(below), where=below > 0)

    return pd.DataFrame(
        {
            "precision": ratio(tp, tp + fp),
            "recall": ratio(tp, tp + fn),
            "f1": ratio(2 * tp, 2 * tp + fp + fn),
        }
    )
