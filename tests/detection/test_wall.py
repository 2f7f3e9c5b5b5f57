from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from kilnflight.detection import wall
from kilnflight.detection.wall import (
    Cylinder,
    InAir,
    crossing,
    distance_to_axis,
    fit_cylinder,
)

# Table 5.12, with the direction as printed.
PUBLISHED = Cylinder((74.275, 495.0013, 9257.7), (21.6677, -41.4764, 1533.6), 772.1827)
AXIS = np.array(PUBLISHED.direction) / np.linalg.norm(PUBLISHED.direction)


def ring(cylinder, count, generator, arc_deg=(160, 380), length_mm=1500.0):
    """Points of an arc of a ring round the cylinder's centre, without errors."""
    axis = np.array(cylinder.direction) / np.linalg.norm(cylinder.direction)
    side = np.cross(axis, [1.0, 0, 0])
    side /= np.linalg.norm(side)
    angle = np.radians(generator.uniform(*arc_deg, count))[:, None]
    along = generator.uniform(-length_mm / 2, length_mm / 2, count)[:, None]
    around = np.cos(angle) * side + np.sin(angle) * np.cross(axis, side)
    return np.array(cylinder.centre_mm) + along * axis + cylinder.radius_mm * around


def captured(points, generator):
    """The same with an error of depth per patch along the line of sight, and 30 %
    outliers.
    """
    _, patch = np.unique(np.floor(points / 30.0), axis=0, return_inverse=True)
    scale = 1 + 0.022 * generator.normal(size=patch.max() + 1)
    points = points * scale[patch.ravel(), None] + generator.normal(0, 5, points.shape)
    others = (
        generator.uniform(-700, 700, (3 * len(points) // 7, 3)) + PUBLISHED.centre_mm
    )
    return np.concatenate([points, others])


@pytest.mark.parametrize(("arc", "off_mm"), [((160, 380), 6), ((210, 330), 25)])
def test_errors_of_depth_and_outliers_leave_the_wall_where_it_is(arc, off_mm):
    generator = np.random.default_rng(1)
    points = captured(ring(PUBLISHED, 7000, generator, arc), generator)
    first = fit_cylinder(points)
    assert fit_cylinder(points, np.random.default_rng(0)) == first
    for found in (first, fit_cylinder(generator.permutation(points), seed=1)):
        assert abs(found.radius_mm - PUBLISHED.radius_mm) < off_mm
        assert found.radius_mm == pytest.approx(first.radius_mm, abs=2)
        assert distance_to_axis([PUBLISHED.centre_mm], found)[0] < off_mm
        assert (
            np.degrees(np.arccos(found.direction @ AXIS)) < 2
        )  # towards the line of sight
        assert 0.65 < found.inliers / len(points) < 0.85


@given(
    st.tuples(st.floats(-200, 200), st.floats(-500, 500), st.just(9000.0)),
    st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05), st.just(1.0)),
    st.floats(300, 1500),
)
def test_any_wall_near_the_z_axis_is_found(centre, direction, radius):
    truth = Cylinder(centre, direction, radius)
    points = ring(truth, 600, np.random.default_rng(4), length_mm=2 * radius)
    points[0] = [1e9, 0, 0]
    found = fit_cylinder(points)
    assert found.radius_mm == pytest.approx(radius, abs=0.1)
    assert distance_to_axis([found.centre_mm], truth)[0] < 0.1
    assert (found.inliers, found.rms_mm) == (599, pytest.approx(0, abs=0.1))
    np.testing.assert_allclose(
        found.direction, direction / np.linalg.norm(direction), atol=1e-3
    )


def test_the_distance_is_the_length_of_the_normal_part():
    points = np.random.default_rng(8).normal(0, 1000, (50, 3))
    ways = points - PUBLISHED.centre_mm
    expected = np.linalg.norm(ways - (ways @ AXIS)[:, None] * AXIS, axis=1)
    np.testing.assert_allclose(distance_to_axis(points, PUBLISHED), expected)


@given(st.floats(400, 600), st.floats(20, 90), st.floats(650, 800), st.floats(20, 90))
def test_at_the_crossing_both_gaussians_are_as_high(air, narrow, on_wall, wide):
    found = crossing(air + narrow * np.arange(-1, 2), on_wall + wide * np.arange(-1, 2))
    assert air <= found <= on_wall
    heights = norm.logpdf(found, [air, on_wall], [narrow, wide])
    assert heights[0] == pytest.approx(heights[1], abs=1e-6)


def test_a_particle_is_in_the_air_up_to_the_threshold_and_nowhere_without_3d():
    cylinder = Cylinder((0, 0, 0), (0, 0, 1), 772.0)
    points = [[0, 0, 5000], [800, 0, 5000], [800.1, 0, 5000], [np.nan] * 3]
    assert InAir()(points, cylinder).tolist() == [True, True, False, False]
    assert InAir().on_wall(points, cylinder).tolist() == [False, False, True, False]
    assert InAir(760.0)(points, cylinder).tolist() == [True, False, False, False]
    assert InAir()([], cylinder).dtype == bool


def test_the_likelihood_mixes_a_gaussian_and_outliers():
    """Torr and Zisserman 2000; after five rounds of EM the mixing is nearly its fixed
    point.
    """
    points = captured(
        ring(PUBLISHED, 300, np.random.default_rng(5)), np.random.default_rng(5)
    )
    middle, radius = np.array(PUBLISHED.centre_mm), 772.0
    (cost,), (mixing,) = wall.likelihood(points, [middle], [AXIS], [radius], 2000.0)
    gauss = norm.pdf(distance_to_axis(points, PUBLISHED) - radius, scale=50 / 1.96)
    assert cost == pytest.approx(-np.log(mixing * gauss + (1 - mixing) / 2000).sum())
    share = mixing * gauss / (mixing * gauss + (1 - mixing) / 2000)
    assert share.mean() == pytest.approx(mixing, abs=1e-3)


def bad_calls():
    """Yield the argument that the error names, and the call."""
    generator = np.random.default_rng(7)
    box, across = (
        generator.uniform(-1000, 1000, (3000, 3)),
        ring(PUBLISHED, 3000, generator),
    )
    one, few, flat = np.ones((3000, 3)), np.zeros((9, 3)), np.zeros((20, 2))
    for points in (
        box,
        across[:, ::-1],
        one,
        few,
        flat,
        np.full((20, 3), np.nan),
        "wall",
    ):
        yield "points_mm", partial(fit_cylinder, points)
    yield "points_mm", partial(distance_to_axis, [0.0, 0.0, 0.0], PUBLISHED)
    yield (
        "direction",
        partial(distance_to_axis, one, Cylinder((0, 0, 0), (0, 0, 0), 1.0)),
    )
    for wrong in ([[np.nan, 0, 0]], [0, 0, 0]):
        yield "points_mm", partial(InAir(), wrong, PUBLISHED)
    yield "threshold_mm", partial(InAir, -1.0)
    swapped, within = ([800, 900], [600, 700]), ([0, 1400], [699, 702])
    for sets in (
        ([], [800, 900]),
        ([700, 700], [8, 9]),
        swapped,
        within,
        ([np.nan, 1], [1, 2]),
    ):
        yield "in_air_mm", partial(crossing, *sets)
