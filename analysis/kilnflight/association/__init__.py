r"""Data association: which detection continues which track (thesis, sections 2.3 and 4.1.3).

    gated pairs of n tracks and m detections -> associator -> weights (n, 1 + m)

=================  ======================  ============================  ==================
associator         equation                default                       source
=================  ======================  ============================  ==================
`NearestNeighbor`  sec. 2.3.2, Fig. 2.20   a_0 0, C_NA 50                not printed
`GNN`              2.49, 2.50, 4.9         a_0 0.01 per point, C_NA 50   not printed
`PDA`              2.51 to 2.53, 4.10      P_D 0.9, a_0 0.01             not printed
                   to 4.13
`JPDA`             2.57 to 2.64, 4.10      P_D 0.9, a_0 0.01             not printed
                   to 4.13
=================  ======================  ============================  ==================

Column 0 is "missed", rows sum to 1. `NearestNeighbor` and `GNN` give rows of 0 and 1, `PDA`
and `JPDA` probabilities; one Kalman update serves all. A track with an empty gate, and every
track of a frame without detections, is missed with weight 1.
"""

from typing import Protocol

from kilnflight.association.feasibility import feasible_events, most_events, validation_matrix
from kilnflight.association.gnn import GNN
from kilnflight.association.joint_events import joint_probabilities
from kilnflight.association.jpda import JPDA
from kilnflight.association.nearest import NearestNeighbor
from kilnflight.association.pairs import Array, Pairs
from kilnflight.association.pda import PDA


class Associator(Protocol):
    """What turns gated pairs into weights."""

    def __call__(self, pairs: Pairs) -> Array:
        """Return weights (tracks, 1 + detections); column 0 = missed."""


ASSOCIATORS: tuple[Associator, ...] = (NearestNeighbor(), GNN(), PDA(), JPDA())

__all__ = [
    "ASSOCIATORS",
    "GNN",
    "JPDA",
    "PDA",
    "Associator",
    "NearestNeighbor",
    "Pairs",
    "feasible_events",
    "joint_probabilities",
    "most_events",
    "validation_matrix",
]
