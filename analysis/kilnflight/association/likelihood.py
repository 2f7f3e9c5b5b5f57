"""Likelihoods of pairs and of a miss (thesis, Eqs 4.11 to 4.13)."""

from __future__ import annotations

import numpy as np

from kilnflight.association.pairs import Array, Pairs, check_size_weight
from kilnflight.checks import InputError, check_kind, is_number


def log_likelihoods(
    pairs: Pairs, detection_probability: float, size_weight: float, printed_determinant: bool
) -> tuple[Array, Array]:
    """Return ln e_j (n, m), -inf outside the gate, and ln b (n,): Eqs 4.11 to 4.13, thesis.

    A track whose gate is empty has no density of detections (Eq. 4.13 gives 0); it is
    missed for certain, so its ln b is set to 0.
    """
    a_0, p_d, p_g = size_weight, detection_probability, pairs.gate_probability
    log_e = -0.5 * (pairs.distance_squared + a_0 * pairs.size_difference)
    if printed_determinant:
        log_e -= 0.5 * pairs.log_determinant[:, None]
    m = np.isfinite(pairs.distance_squared).sum(axis=1)
    some = m > 0
    log_b = np.zeros(len(m))
    log_density = np.log(m[some] / pairs.gate_area[some])
    d = pairs.dimensions
    log_spread = 0.5 * (d * np.log(2 * np.pi) + pairs.log_determinant[some])  # ln |2 pi S|^(1/2)
    log_b[some] = log_density + log_spread + np.log((1 - p_d * p_g) / p_d)
    return log_e, log_b


def check_probabilities(
    detection_probability: float, size_weight: float, printed_determinant: bool, where: str
) -> None:
    """Raise an `InputError` unless P_D lies between 0 and 1 and a_0 is a weight."""
    check_size_weight(size_weight, where)
    check_kind(printed_determinant, bool, f"{where}: printed_determinant")
    if not (is_number(detection_probability) and 0 < detection_probability < 1):
        raise InputError(
            f"{where}: detection_probability is {detection_probability!r}, expected between 0 and "
            "1, both excluded: a track can always be missed, and never only missed."
        )
