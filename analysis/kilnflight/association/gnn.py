"""Global nearest neighbour (thesis, sections 2.3.2 and 4.1.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilnflight.association.assignment import assign
from kilnflight.association.pairs import Array, Pairs, check_costs, check_pairs, cost, one_hot


@dataclass(frozen=True)
class GNN:
    """The assignment of least global cost, Eqs 2.49 and 4.9 with the threshold C_NA.

    Parameters
    ----------
    size_weight
        a_0 of Eq. 4.9, cost of one 3D point of difference.
    nonassignment_cost
        C_NA: what a track without a detection costs, and above which a pair is impossible.

    Raises
    ------
    InputError
        If ``size_weight`` is negative or a parameter is not finite.

    Notes
    -----
    The thesis sets pairs outside the gate to a large C and pairs above C_NA to C_NA, then
    solves the square problem. An assigned C_NA is a track without detection, so the same
    optimum is found here from the possible pairs alone, without C. A pair that costs
    exactly C_NA is taken.
    """

    # Not printed. Between frames of the twin half of the particles change by 7 points or less,
    # one in twenty by more than 200 (particles of 60 points): 100 points weigh as one unit of
    # squared distance, so size settles near ties and overexposure does not end a track.
    size_weight: float = 0.01
    # Not printed. Above the gate's d^2 (about 16) + ln|S| of a track lost for some frames
    # (100 px on both axes: 18) + a_0 times some hundred points: the gate decides, not C_NA.
    nonassignment_cost: float = 50.0

    def __post_init__(self) -> None:
        """Refuse parameters that are no costs."""
        check_costs(self.size_weight, self.nonassignment_cost, "GNN")

    def __call__(self, pairs: Pairs) -> Array:
        """Return weights (n, 1 + m) of 0 and 1; column 0 = missed.

        Among assignments of equal cost the result is always the same one for the same
        order of tracks and detections.

        Raises
        ------
        InputError
            If the pairs do not fit together or hold NaN.
        """
        pairs = check_pairs(pairs)
        costs = cost(pairs, self.size_weight)
        costs[costs > self.nonassignment_cost] = np.inf
        missed = np.full(len(costs), float(self.nonassignment_cost))
        return one_hot(assign(costs, missed)[0], costs.shape[1])
