"""Otsu's threshold in plain code: Eqs 2.11 to 2.18, one level at a time."""

import numpy as np


def thresholds(values):
    """Return the levels of largest variance between the classes, to 1e-12 of it."""
    line, best = np.ravel(values).astype(float), {}
    for k in np.unique(line)[:-1].tolist():
        below, above = line[line <= k], line[line > k]
        best[int(k)] = below.size * above.size * (above.mean() - below.mean()) ** 2
    most = max(best.values(), default=0.0)
    return [k for k, value in best.items() if value >= most * (1 - 1e-12)] or [
        int(line[0])
    ]
