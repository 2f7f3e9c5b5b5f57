"""Nearest neighbour (thesis, section 2.3.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilnflight.association.pairs import Array, Pairs, check_costs, check_pairs, cost, one_hot


@dataclass(frozen=True)
class NearestNeighbor:
    """Each track takes its nearest detection, whatever the others do.

    If two tracks want the same detection, the nearer one takes it and the other goes
    without, even if another detection is in its gate (Fig. 2.20, middle). At equal cost
    the first track and the first detection win.

    Parameters
    ----------
    size_weight
        a_0 of Eq. 4.9; 0 asks for distance alone, as section 2.3.2 does.
    nonassignment_cost
        C_NA; a pair that costs more is impossible.

    Raises
    ------
    InputError
        If ``size_weight`` is negative or a parameter is not finite.

    Notes
    -----
    "Nearest" is the least cost of Eq. 4.9. Within one track ln |S| is the same for all its
    detections; between tracks it keeps one with a wide gate from taking everything.
    """

    size_weight: float = 0.0  # per 3D point; section 2.3.2 knows no size
    nonassignment_cost: float = 50.0  # not printed; see GNN

    def __post_init__(self) -> None:
        """Refuse parameters that are no costs."""
        check_costs(self.size_weight, self.nonassignment_cost, "NearestNeighbor")

    def __call__(self, pairs: Pairs) -> Array:
        """Return weights (n, 1 + m) of 0 and 1; column 0 = missed.

        Raises
        ------
        InputError
            If the pairs do not fit together or hold NaN.
        """
        pairs = check_pairs(pairs)
        costs = cost(pairs, self.size_weight)
        tracks, detections = costs.shape
        nearest = np.full(tracks, -1, dtype=np.intp)
        if costs.size:
            wanted = costs.argmin(axis=1)
            price = costs[np.arange(tracks), wanted]
            # Cheapest first: the first to name a detection has it.
            order = np.argsort(price, kind="stable")
            order = order[price[order] <= self.nonassignment_cost]
            winners = order[np.unique(wanted[order], return_index=True)[1]]
            nearest[winners] = wanted[winners]
        return one_hot(nearest, detections)
