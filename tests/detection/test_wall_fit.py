import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kilnflight.detection import wall

Z = np.array([0.0, 0.0, 1.0])
LIMITS = wall.Limits(Z, 5.0, 50.0)


def likelihood_in_plain_code(points, centre, direction, radius, sigma, width):
    """Torr and Zisserman's likelihood, one point at a time."""
    distances = []
    for point in points:
        way = point - centre
        distances.append(np.linalg.norm(way - (way @ direction) * direction) - radius)
    mixing = 0.5
    gauss = [np.exp(-(d**2) / (2 * sigma**2)) / np.sqrt(2 * np.pi * sigma**2) for d in distances]
    for _ in range(5):
        parts = [mixing * g / (mixing * g + (1 - mixing) / width) for g in gauss]
        mixing = np.mean(parts)
    return -sum(np.log(mixing * g + (1 - mixing) / width) for g in gauss), mixing


@given(st.integers(0, 2**32 - 1))
def test_the_likelihood_is_its_definition(seed):
    generator = np.random.default_rng(seed)
    points = generator.normal(0, 500, (30, 3))
    centres = generator.normal(0, 100, (4, 3))
    directions = wall.draw_directions(LIMITS, 4, generator)
    radii = generator.uniform(100, 1000, 4)
    costs, mixings = wall.likelihood(points, centres, directions, radii, 25.0, 2000.0)
    for k in range(4):
        expected = likelihood_in_plain_code(
            points, centres[k], directions[k], radii[k], 25.0, 2000.0
        )
        assert (costs[k], mixings[k]) == pytest.approx(expected)


def test_em_finds_the_share_of_inliers():
    generator = np.random.default_rng(0)
    angle = generator.uniform(0, 2 * np.pi, 4000)
    radius = 700 + generator.normal(0, 25, 4000)
    radius[:1200] = 700 + generator.uniform(-600, 600, 1200)
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), angle], axis=1)
    where = np.zeros((1, 3)), Z[None], np.array([700.0])
    assert wall.likelihood(points, *where, 25.0, 1200.0)[1][0] == pytest.approx(0.7, abs=0.03)


@given(st.integers(0, 2**32 - 1))
def test_circles_go_through_their_points(seed):
    generator = np.random.default_rng(seed)
    triples = generator.normal(0, 500, (20, 3, 3))
    directions = wall.draw_directions(LIMITS, 20, generator)
    for triple, way, centre, radius in zip(
        triples, directions, *wall.circles(triples, directions), strict=True
    ):
        distance = wall.residuals(triple, wall.Axis(centre, way, radius))
        np.testing.assert_allclose(distance, 0, atol=1e-6 * max(1, radius))


def test_three_points_in_a_line_have_no_circle():
    triple = np.array([[[0.0, 0, 0], [1, 1, 5], [2, 2, -5]], [[1.0, 0, 0]] * 3])
    assert np.isnan(wall.circles(triple, np.stack([Z, Z]))[1]).all()


def test_directions_are_even_over_the_cone():
    drawn = wall.draw_directions(LIMITS, 20_000, np.random.default_rng(1))
    np.testing.assert_allclose(np.linalg.norm(drawn, axis=1), 1)
    angle = np.degrees(np.arccos(drawn[:, 2]))
    assert angle.max() <= 5.0
    # Half of the cone's area lies beyond 5/sqrt(2) degrees.
    assert np.mean(angle > 5 / np.sqrt(2)) == pytest.approx(0.5, abs=0.02)
    np.testing.assert_allclose(drawn.mean(axis=0)[:2], 0, atol=2e-3)


def test_good_directions_are_all_of_a_narrow_cone_and_few_of_a_wide_one():
    assert wall.good_directions(LIMITS, 0.0) == pytest.approx(1.0)
    assert wall.good_directions(LIMITS, 50 / np.radians(2.5)) == pytest.approx(0.25, abs=0.001)


def test_nothing_is_found_among_equal_points():
    same = np.ones((20, 3))
    assert wall.search(same, LIMITS, 300, 0.99, np.random.default_rng(2)) is None


def test_the_arc_is_what_the_points_cover():
    for low, high in ((-170, 170), (100, 260), (0, 350), (10, 40)):
        angle = np.radians(np.linspace(low, high, 2000))
        points = 700 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
        points = np.concatenate([points, [[-700.0 * np.cos(np.radians(low + 5)), 0, 0]]])
        arc = wall.covered_arc(points[:-1], wall.Axis(np.zeros(3), Z, 700.0))
        assert np.degrees(arc) == pytest.approx(high - low, abs=1)


def test_a_parabola_along_the_axis_bends_by_its_sagitta():
    along = np.linspace(-500, 500, 1001)
    assert wall.bending(along, 30 * (along / 480) ** 2, 150.0) == pytest.approx(30, rel=1e-6)
    assert wall.bending(along, 0.1 * along, 150.0) == pytest.approx(0, abs=1e-9)
