"""PDA against Eqs 4.10 to 4.13 in plain code."""

import math

import numpy as np
import pytest

from kilnflight.association import JPDA, PDA
from kilnflight.tracking.gate import Detected, Gate, Predicted


def equations_in_plain_code(distance, size, sigma, area, p_g, p_d, a_0, printed):
    """Weights of one track of a round gate: [beta_0, beta_1, ...]."""
    determinant = sigma**4
    power = [d + a_0 * n + (math.log(determinant) if printed else 0.0) for d, n in
             zip(distance, size, strict=True)]  # fmt: skip
    e = [math.exp(-0.5 * c) for c in power]
    density = len(e) / area
    spread = math.sqrt((2 * math.pi) ** 2 * determinant)  # |2 pi S|^(1/2) of a 2 x 2 matrix
    b = density * spread * (1 - p_d * p_g) / p_d
    return np.array([b, *e]) / (b + sum(e))


@pytest.mark.parametrize("printed", [False, True])
def test_the_equations(make_pairs, printed):
    size = [[120.0, 30.0, 0.0]]
    pairs = make_pairs([[0, 0]], [[0, 3], [4, 0], [900, 0]], size=size)
    beta = PDA(detection_probability=0.8, size_weight=0.02, printed_determinant=printed)(pairs)
    expected = equations_in_plain_code(
        [9 / 25, 16 / 25], size[0][:2], 5.0, float(pairs.gate_area[0]), pairs.gate_probability,
        0.8, 0.02, printed,
    )  # fmt: skip
    np.testing.assert_allclose(beta[0], [*expected, 0.0], rtol=1e-12)


def test_units_do_not_matter_but_in_the_printed_form(make_pairs):
    """The same scene in pixels half as wide."""
    scene = [np.array([[0.0, 0.0]]), np.array([[0.0, 3.0], [4.0, 0.0]])]
    for printed, same in ((False, True), (True, False)):
        pda = PDA(printed_determinant=printed)
        coarse = pda(make_pairs(*scene))
        fine = pda(make_pairs(*(2 * places for places in scene), sigma=10.0))
        assert np.allclose(coarse, fine, rtol=1e-12) == same


def test_tracks_do_not_see_each_other(make_pairs):
    both = PDA()(make_pairs([[0, 0], [0, 6]], [[0, 2], [0, 4]]))
    alone = PDA()(make_pairs([[0, 0]], [[0, 2], [0, 4]]))
    np.testing.assert_allclose(both[0], alone[0], rtol=1e-12)
    np.testing.assert_allclose(both[1], alone[0, [0, 2, 1]], rtol=1e-12)


def test_likelihoods_too_small_for_a_float(make_pairs):
    pairs = make_pairs([[0, 0]], [[0, 1], [0, 2]], size=[[1e7, 1e7]])
    np.testing.assert_allclose(PDA()(pairs), [[1.0, 0.0, 0.0]])


def test_in_three_dimensions_by_hand():
    """Eq. 4.12 with |2 pi S|^(1/2) = (2 pi)^(3/2) 8 for S = 4 I, and a ball of four sigmas."""
    predicted = Predicted(np.zeros((1, 3)), 4.0 * np.eye(3)[None], *np.full((2, 1), np.nan))
    detected = Detected(np.array([[2.0, 0.0, 0.0]]), *np.full((2, 1), np.nan))
    pairs = Gate(4.0)(predicted, detected)
    assert pairs.dimensions == 3
    p_g = math.erf(4 / math.sqrt(2)) - math.sqrt(2 / math.pi) * 4 * math.exp(-8)  # chi, 3 degrees
    density = 1 / (4 / 3 * math.pi * (4 * 2) ** 3)
    b = density * (2 * math.pi) ** 1.5 * 8 * (1 - 0.9 * p_g) / 0.9
    e = math.exp(-0.5)
    np.testing.assert_allclose(PDA()(pairs), [[b / (b + e), e / (b + e)]], rtol=1e-12)
    np.testing.assert_allclose(JPDA()(pairs), [[b / (b + e), e / (b + e)]], rtol=1e-12)
