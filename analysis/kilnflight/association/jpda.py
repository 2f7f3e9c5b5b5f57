"""Joint probabilistic data association (thesis, sections 2.3.4 and 4.1.3)."""

from __future__ import annotations

from dataclasses import dataclass

from kilnflight.association.joint_events import check_states, marginals
from kilnflight.association.likelihood import check_probabilities, log_likelihoods
from kilnflight.association.pairs import Array, Pairs, check_pairs


@dataclass(frozen=True)
class JPDA:
    """Tracks weight their detections jointly: a detection belongs to at most one of them.

    The likelihoods are those of `PDA`; Eq. 2.64 sums them over all joint events, exactly
    (`kilnflight.association.joint_probabilities`).

    Parameters
    ----------
    detection_probability
        P_D of Eq. 4.12.
    size_weight
        a_0 of Eq. 4.9, as in `GNN`.
    printed_determinant
        Whether Eq. 4.11 keeps the ln |S| of Eq. 4.9; see `PDA`.
    most_states
        Largest work per group of tracks that is done exactly; see `joint_probabilities`, whose
        own bound is larger.

    Raises
    ------
    InputError
        If P_D is not between 0 and 1, a_0 is negative, or ``most_states`` is no whole
        number from 4.

    Notes
    -----
    "The probability regarding the joint events are computed following definitions in
    Chapter 2.3.4" without saying from what: the weight of a joint event is taken as the
    product of e_j of its pairs and b of its tracks without detection, so that a track that
    shares no detection gets the probabilities of `PDA`.

    A group at the bound of 2^20 states (15 tracks that all share 31 detections) was measured
    to cost 0.1 s per frame; at the 2^25 of `joint_probabilities` (20 and 31) it is 4 s.
    """

    # Not printed, but "appropriately large": a little above the detector's recall of 0.86
    # (Table 5.11, SIFT and DBSCAN combined).
    detection_probability: float = 0.9
    size_weight: float = 0.01  # per 3D point, not printed; see GNN
    printed_determinant: bool = False
    most_states: int = 2**20  # 8 MiB of tables; see Notes for the time

    def __post_init__(self) -> None:
        """Refuse parameters that are no probabilities."""
        check_probabilities(
            self.detection_probability, self.size_weight, self.printed_determinant, "JPDA"
        )
        check_states(self.most_states, "JPDA")

    def __call__(self, pairs: Pairs) -> Array:
        """Return weights (n, 1 + m); rows sum to 1, column 0 = missed.

        Raises
        ------
        InputError
            If the pairs do not fit together or hold NaN.

        Warns
        -----
        UserWarning
            If a group is too dense to be exact and pairs were left out.
        """
        pairs = check_pairs(pairs)
        log_e, log_b = log_likelihoods(
            pairs, self.detection_probability, self.size_weight, self.printed_determinant
        )
        return marginals(log_e, log_b, self.most_states)
