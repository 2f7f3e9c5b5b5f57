"""Trajectories in space: three polynomials through the lance's exit at one t0 (section 4.3).

    tracks -> `regress_all` -> `kilnflight.tables.TRAJECTORIES` -> `fits`

================  =============  ===============================================================
call              source         gives
================  =============  ===============================================================
`regress`         Eqs 4.26-4.33  the `Fit` of one track
`regress_all`     Table 5.18     a table, one row per track; `fits` takes the fits out of it
`order_measures`  Fig. 4.23      the measures under orders that are the same for all axes
`Regression`      section 4.3    the method, its parameters and how it was read
`Loss`            ours           squares, as printed, or a loss that bears depth jumps
================  =============  ===============================================================

Depth jumps are borne by a robust loss with the scatter of each axis, say
``Regression(loss=Loss.SOFT_L1, scale_mm=(10.0, 10.0, 150.0))``.
"""

from kilnflight.regression.fit import Fit
from kilnflight.regression.loss import Loss
from kilnflight.regression.polynomials import Regression
from kilnflight.regression.trajectories import (
    FITTED,
    NO_DEPTH,
    TOO_FEW,
    fits,
    order_measures,
    regress,
    regress_all,
)

__all__ = [
    "FITTED",
    "NO_DEPTH",
    "TOO_FEW",
    "Fit",
    "Loss",
    "Regression",
    "fits",
    "order_measures",
    "regress",
    "regress_all",
]
