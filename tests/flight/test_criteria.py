"""Start, plausibility and extrapolation of single flights."""

from dataclasses import replace

import numpy as np
import pytest

from kilnflight.checks import InputError
from kilnflight.detection.wall import Cylinder, InAir
from kilnflight.flight import BEHIND, LEAVES, TOO_FAST, Plausible
from kilnflight.flight.criteria import starts_at_lance, straight_on

WALL, LIMIT = Cylinder((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 772.0), InAir(800.0)


def rejection(fit, end_s=0.4, air_m_s=16.0):
    return Plausible(air_m_s)(fit, end_s, WALL, LIMIT)


@pytest.mark.parametrize(
    ("coefficients", "reason"),
    [
        (((0.0,), (0.0,), (-13_500.0,)), ""),  # a wood chip, Fig. 5.21
        (((0.0,), (0.0,), (-31_900.0, 40_000.0)), ""),
        (
            ((0.0,), (0.0,), (-32_100.0, 40_000.0)),
            TOO_FAST,
        ),  # twice the 16 m/s of sec. 2.1.1
        (
            ((0.0,), (0.0,), (-2000.0, 0.0, 0.0, -118e3)),
            TOO_FAST,
        ),  # 32.2 m/s at the end
        (
            ((31_000.0, -77_500.0), (0.0,), (-8200.0,)),
            LEAVES,
        ),  # swings out to 3.1 m and back
        (((11_000.0, -31_000.0), (0.0,), (-8000.0,)), LEAVES),  # to 976 mm
        (
            ((10_000.0, -28_500.0), (0.0,), (-8000.0,)),
            "",
        ),  # to 877 mm: within the margin
        (((0.0,), (0.0,), (-16_500.0,)), LEAVES),  # 100 mm behind the camera
        (((0.0,), (0.0,), (4_000.0, -20_000.0)), ""),  # to 200 mm behind the lance
        (((0.0,), (0.0,), (4_300.0, -20_000.0)), BEHIND),  # to 231 mm
        (((0.0,), (0.0,), (-4_000.0, 12_000.0)), BEHIND),
    ],
)
def test_impossible_flights_are_rejected(polynomials, coefficients, reason):
    assert rejection(polynomials(coefficients)) == reason


def test_only_the_flight_is_judged_and_its_end_is_straight(polynomials):
    bent = polynomials(((0.0,), (0.0,), (-2000.0, 0.0, 0.0, -118e3)))
    assert rejection(bent, 0.39) == ""
    assert rejection(bent, 0.4) == TOO_FAST
    assert rejection(bent, 0.4, air_m_s=17.0) == ""
    ends = replace(bent, last_s=0.38)
    assert rejection(ends, 0.45) == ""  # straight on with the speed of its last 20 ms
    assert rejection(ends, 0.75) == LEAVES  # behind the camera
    with pytest.raises(InputError, match="air_m_s"):
        Plausible(-1.0)


@pytest.mark.parametrize(
    ("across", "gone", "starts"),
    [
        (0.0, 990.0, True),
        (0.0, 1010.0, False),  # the first slice was not observed
        (700.0, 900.0, True),  # a shred on its way to the side wall
        (900.0, 0.0, False),  # at the lance's depth, but far to the side
        (340.0, 0.0, True),  # 0.7 * 438 mm + 38 mm: the depth may be wrong by two RMSE
        (350.0, 0.0, False),
        (0.0, -430.0, True),
        (0.0, -450.0, False),  # farther behind the lance than depths scatter
    ],
)
def test_a_start_is_judged_across_and_in_depth(polynomials, across, gone, starts):
    fit = polynomials(((0.0,), (0.0,), (-8000.0,)))
    place = [across * np.cos(2.0), across * np.sin(2.0), 6500.0 - gone]
    decided, distance = starts_at_lance(np.tile(place, (3, 1)), fit)
    assert decided == starts
    assert distance == pytest.approx(np.hypot(across, gone))


def test_after_the_last_detection_a_flight_is_straight(polynomials):
    fit = polynomials(((100.0, 900.0), (0.0,), (-8000.0, 500.0)), last_s=0.3)
    np.testing.assert_array_equal(straight_on(fit, [0.1, 0.3]), fit([0.1, 0.3]))
    mean_velocity = (fit(0.3) - fit(0.28)) / 0.02  # of the last 20 ms
    np.testing.assert_allclose(straight_on(fit, 0.5), fit(0.3) + 0.2 * mean_velocity)
