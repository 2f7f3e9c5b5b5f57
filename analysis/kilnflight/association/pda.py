"""Probabilistic data association (thesis, sections 2.3.3 and 4.1.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilnflight.association.likelihood import check_probabilities, log_likelihoods
from kilnflight.association.pairs import Array, Pairs, check_pairs


@dataclass(frozen=True)
class PDA:
    """Each track weights all detections in its gate as if it were alone, Eqs 4.10 to 4.13.

    Parameters
    ----------
    detection_probability
        P_D of Eq. 4.12.
    size_weight
        a_0 of Eq. 4.9, as in `GNN`.
    printed_determinant
        Whether Eq. 4.11 keeps the ln |S| of Eq. 4.9.

    Raises
    ------
    InputError
        If P_D is not between 0 and 1 or a_0 is negative.

    Notes
    -----
    Eq. 4.11 takes c_ij of Eq. 4.9, whose ln |P| divides e_j by |P|^(1/2), while Eq. 4.12
    multiplies b by the same: the determinant enters twice, and e_j against b is not free
    of units. By default e_j = exp(-(d^2 + a_0 |N_d - N_p|) / 2), the source's form [47];
    ``printed_determinant=True`` computes what is printed (with S in px^2).

    The second line of Eq. 4.10 prints "i = 0"; it is the weight of no detection, j = 0.
    m(i) counts the candidates of the whole gate, depth included, V(i) is the ellipse.
    """

    # Not printed, but "appropriately large": a little above the detector's recall of 0.86
    # (Table 5.11, SIFT and DBSCAN combined).
    detection_probability: float = 0.9
    size_weight: float = 0.01  # per 3D point, not printed; see GNN
    printed_determinant: bool = False

    def __post_init__(self) -> None:
        """Refuse parameters that are no probabilities."""
        check_probabilities(
            self.detection_probability, self.size_weight, self.printed_determinant, "PDA"
        )

    def __call__(self, pairs: Pairs) -> Array:
        """Return weights (n, 1 + m); rows sum to 1, column 0 = missed.

        Raises
        ------
        InputError
            If the pairs do not fit together or hold NaN.
        """
        pairs = check_pairs(pairs)
        log_e, log_b = log_likelihoods(
            pairs, self.detection_probability, self.size_weight, self.printed_determinant
        )
        logs = np.column_stack([log_b, log_e])
        beta = np.exp(logs - logs.max(axis=1, keepdims=True))
        return np.asarray(beta / beta.sum(axis=1, keepdims=True), dtype=np.float64)
