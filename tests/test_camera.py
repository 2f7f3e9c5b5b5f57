"""Depth calibration against plain definitions."""

import numpy as np
import pytest

from kilnflight.camera import (
    EQUATION_2_4,
    calibrate_depth,
    calibrate_points,
    captured_depths,
    invert_depth,
    read_calibration,
)
from kilnflight.publication import claims


def equation_in_plain_code(z):
    """Eq. 2.4, copied a second time from the page, one depth at a time."""
    if z < 3000:
        return -0.002055 * z * z + 10.65 * z - 10230
    if z <= 5000:
        return -0.00004158 * z * z + 1.367 * z - 857.5
    return 0.00004504 * z * z + 0.3219 * z + 2189


def test_calibration_is_the_equation():
    depths = np.append(
        np.random.default_rng(0).uniform(0, 15_000, 98), [3000.0, 5000.0]
    )
    expected = [equation_in_plain_code(z) for z in depths]
    np.testing.assert_allclose(calibrate_depth(depths), expected, atol=1e-6)


def test_points_stay_on_their_ray_and_without_a_calibration_as_they_are():
    points = [[100.0, -50.0, 5000.0], [0.0, 0.0, 3000.0]]
    expected = [[98.76, -49.38, 4938.0], [0.0, 0.0, 2869.28]]
    np.testing.assert_allclose(
        calibrate_points(points, EQUATION_2_4), expected, atol=0.005
    )
    np.testing.assert_array_equal(calibrate_points(points, None), points)
    assert calibrate_points([], EQUATION_2_4).shape == (0, 3)


@pytest.mark.parametrize(
    ("stated", "depths"),
    [
        (None, [500.0, 6000.0]),
        ("none", [500.0, 6000.0]),
        ("zhang-2023", [-5418.75, 5741.84]),
        (
            [[4000, 3000], [1000, 1500], [2000, 2000]],
            [1250.0, 4000.0],
        ),  # straight lines, by hand
        (
            {"breakpoints_mm": [1000.0], "coefficients": [[0, 1], [2, 0]]},
            [1.0, 12_000.0],
        ),
    ],
)
def test_a_recording_states_its_depth_calibration(stated, depths):
    calibration = read_calibration(stated) or np.asarray
    np.testing.assert_allclose(calibration([500.0, 6000.0]), depths)


def test_published_facts_about_the_equation():
    facts = claims.published("depth_calibration").set_index("where")["value"]
    jumps = [float(facts["jump at 3000 mm"]), float(facts["jump at 5000 mm"])]
    np.testing.assert_allclose(EQUATION_2_4.jumps(), jumps, atol=0.005)
    falling = EQUATION_2_4.falling(1300.0, 11000.0)
    np.testing.assert_allclose(
        [falling.min(), falling.max()], [2591.2, 3000.0], atol=0.2
    )
    for metre in range(1, 12):
        printed = facts[f"captured depth for true {1000 * metre} mm"]
        solutions = captured_depths(1000.0 * metre)
        assert [round(z, 1) for z in solutions] == [
            float(z) for z in printed.split("/")
        ]
        np.testing.assert_allclose(calibrate_depth(solutions), 1000.0 * metre)


def test_the_inverse_nearest_to_the_true_depth_is_taken():
    assert invert_depth([[3000.0]]) == pytest.approx(np.array([[3117.5]]), abs=0.05)
    assert EQUATION_2_4(invert_depth(9000.0)) == pytest.approx(9000.0)
