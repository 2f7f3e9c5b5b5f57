from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from kilnflight.checks import InputError
from kilnflight.detection.wall import Cylinder, InAir
from kilnflight.flight import (
    BEHIND,
    LEAVES,
    TOO_FAST,
    Plausible,
    StartsAtLance,
    kept,
    straight_on,
)

WALL = Cylinder((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 772.0)
LIMIT = InAir(800.0)


def refusal(fit, end_s=0.4, **limits):
    return Plausible(**limits)(fit, end_s, WALL, LIMIT)


@pytest.mark.parametrize(
    ("coefficients", "reason"),
    [
        (((0.0,), (0.0,), (-13_500.0,)), ""),  # a wood chip, Fig. 5.21
        (((0.0,), (0.0,), (-31_900.0, 40_000.0)), ""),
        (((0.0,), (0.0,), (-32_100.0, 40_000.0)), TOO_FAST),  # twice the 16 m/s of sec. 2.1.1
        (((0.0,), (0.0,), (-2000.0, 0.0, 0.0, -118e3)), TOO_FAST),  # 32.2 m/s at the end
        (((31_000.0, -77_500.0), (0.0,), (-8200.0,)), LEAVES),  # swings out to 3.1 m and back
        (((11_000.0, -31_000.0), (0.0,), (-8000.0,)), LEAVES),  # to 976 mm
        (((10_000.0, -28_500.0), (0.0,), (-8000.0,)), ""),  # to 877 mm: within the margin
        (((0.0,), (0.0,), (-16_500.0,)), LEAVES),  # 100 mm behind the camera
        (((0.0,), (0.0,), (4_000.0, -20_000.0)), ""),  # to 200 mm behind the lance
        (((0.0,), (0.0,), (4_300.0, -20_000.0)), BEHIND),  # to 231 mm
        (((0.0,), (0.0,), (-4_000.0, 11_000.0)), ""),  # comes back to 160 mm behind it
        (((0.0,), (0.0,), (-4_000.0, 12_000.0)), BEHIND),
    ],
)
def test_what_no_particle_does_is_refused(polynomials, coefficients, reason):
    assert refusal(polynomials(coefficients)) == reason


def test_only_the_flight_is_judged_and_its_end_is_straight(polynomials):
    bent = polynomials(((0.0,), (0.0,), (-2000.0, 0.0, 0.0, -118e3)))
    assert refusal(bent, 0.39) == ""
    assert refusal(bent, 0.4) == TOO_FAST
    ends = replace(bent, last_s=0.38)
    assert refusal(ends, 0.45) == ""  # straight on with 27.9 m/s, 3.0 m + 2.0 m from the lance
    assert refusal(ends, 0.55) == LEAVES  # behind the camera


def test_limits_are_parameters(polynomials):
    fit = polynomials(((0.0,), (0.0,), (-8000.0,)))
    assert refusal(fit, factor=0.4) == TOO_FAST
    turning = polynomials(((0.0,), (0.0,), (1000.0, -10_000.0)))
    assert refusal(turning, behind_mm=20.0) == BEHIND
    aside = polynomials(((2050.0,), (0.0,), (-8000.0,)))
    assert refusal(aside) == ""
    assert refusal(aside, beyond_mm=10.0) == LEAVES
    for name in ("air_m_s", "factor", "behind_mm", "beyond_mm"):
        with pytest.raises(InputError, match=f"Plausible: {name}"):
            Plausible(**{name: -1.0})


def test_kept_flights_are_those_without_a_reason():
    table = pd.DataFrame({"particle": [1, 2, 3], "refused": ["", BEHIND, ""]})
    assert list(kept(table)["particle"]) == [1, 3]
    assert kept(table[:0]).empty
    with pytest.raises(InputError, match="refused"):
        kept(table[["particle"]])


@pytest.mark.parametrize(
    ("across", "gone", "starts"),
    [
        (0.0, 0.0, True),
        (0.0, 990.0, True),
        (0.0, 1010.0, False),  # the first slice was not observed
        (700.0, 900.0, True),  # a shred on its way to the side wall
        (900.0, 0.0, False),  # at the lance's depth, but far to the side
        (340.0, 0.0, True),  # 0.7 * 438 mm + 38 mm: the depth may be wrong by two RMSE
        (350.0, 0.0, False),
        (0.0, -430.0, True),
        (0.0, -450.0, False),  # farther behind the lance than a depth scatters
    ],
)
@pytest.mark.parametrize("angle", [0.0, 2.0])
def test_a_start_is_judged_across_as_well_as_in_depth(polynomials, across, gone, starts, angle):
    fit = polynomials(((0.0,), (0.0,), (-8000.0,)))
    place = [across * np.cos(angle), across * np.sin(angle), 6500.0 - gone]
    decided, distance = StartsAtLance()(np.tile(place, (3, 1)), fit)
    assert decided == starts
    assert distance == pytest.approx(np.hypot(across, gone))


def test_the_scatter_of_a_start_is_a_parameter(polynomials):
    fit = polynomials(((0.0,), (0.0,), (-8000.0,)))
    aside = np.array([[400.0, 0.0, 6500.0]])
    assert not StartsAtLance()(aside, fit)[0]
    assert StartsAtLance(across_scatter_mm=100.0)(aside, fit)[0]
    assert StartsAtLance(depth_scatter_mm=600.0)(aside, fit)[0]
    assert StartsAtLance(slope=1.0)(aside, fit)[0]


def test_past_the_last_detection_a_flight_goes_straight_on(polynomials):
    bent = polynomials(((0.0, 500.0), (100.0, 4900.0), (-9000.0, 4000.0, 7000.0)), last_s=0.4)
    time = np.linspace(bent.t0, bent.last_s, 9)
    np.testing.assert_array_equal(straight_on(bent, time), bent(time))
    later = bent.last_s + np.array([0.1, 0.5])
    steps = straight_on(bent, later) - bent(bent.last_s)
    np.testing.assert_allclose(steps, np.outer([0.1, 0.5], bent.velocity([bent.last_s])[0]))
    with pytest.raises(InputError, match="fitted trajectory"):
        straight_on(polynomials(((0.0,), (np.nan,), (0.0,))), 0.1)
