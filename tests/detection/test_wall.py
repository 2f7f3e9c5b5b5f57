import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from kilnflight.checks import InputError
from kilnflight.detection import wall
from kilnflight.detection.wall import Cylinder, CylinderFit, InAir, crossing, distance_to_axis
from kilnflight.project import claims

Z = np.array([0.0, 0.0, 1.0])
PUBLISHED = Cylinder((74.275, 495.0013, 9257.7), (21.6677, -41.4764, 1533.6), 772.1827)


def wall_points(cylinder, count, generator, arc_deg=(160, 380), length_mm=1500.0):
    """Points of an arc of a ring round the cylinder's centre, without errors."""
    axis = np.array(cylinder.direction)
    side = np.cross(axis, [1.0, 0, 0])
    side /= np.linalg.norm(side)
    angle = np.radians(generator.uniform(*arc_deg, count))[:, None]
    along = generator.uniform(-length_mm / 2, length_mm / 2, count)[:, None]
    around = np.cos(angle) * side + np.sin(angle) * np.cross(axis, side)
    return np.array(cylinder.centre_mm) + along * axis + cylinder.radius_mm * around


def captured(points, generator, patch_mm=30.0, relative=0.022):
    """The same with an error of depth per patch, along the line of sight."""
    _, patch = np.unique(np.floor(points / patch_mm), axis=0, return_inverse=True)
    scale = 1 + relative * generator.normal(size=patch.max() + 1)
    return points * scale[patch.ravel(), None] + generator.normal(0, 5, points.shape)


def outliers(count, generator, size_mm=700.0):
    """Points anywhere near the wall."""
    box = generator.uniform(-size_mm, size_mm, (count, 3))
    return np.array(PUBLISHED.centre_mm) + box


def test_a_wall_without_errors_is_found_exactly():
    points = wall_points(PUBLISHED, 3000, np.random.default_rng(0))
    found = CylinderFit()(points)
    assert found.radius_mm == pytest.approx(PUBLISHED.radius_mm, abs=1e-3)
    np.testing.assert_allclose(found.direction, PUBLISHED.direction, atol=1e-6)
    assert distance_to_axis([found.centre_mm], PUBLISHED)[0] < 1e-3
    assert found.inliers == 3000
    assert found.rms_mm < 1e-3
    axis = wall.Axis(np.array(found.centre_mm), np.array(found.direction), found.radius_mm)
    assert np.degrees(wall.covered_arc(points, axis)) == pytest.approx(220, abs=1)
    along = (points - axis.centre) @ axis.direction
    assert np.quantile(along, [0.02, 0.98]) == pytest.approx([-720, 720], abs=15)
    assert np.degrees(np.arccos(found.direction[2])) == pytest.approx(1.748, abs=1e-3)


@pytest.mark.parametrize(
    ("arc", "radius_error_mm", "axis_error_mm"), [((160, 380), 5, 6), ((210, 330), 20, 25)]
)
def test_errors_of_depth_and_outliers_leave_the_wall_where_it_is(
    arc, radius_error_mm, axis_error_mm
):
    for seed in range(3):
        generator = np.random.default_rng(seed)
        points = captured(wall_points(PUBLISHED, 14_000, generator, arc), generator)
        points = np.concatenate([points, outliers(6000, generator)])
        found = CylinderFit()(points, seed=seed)
        assert abs(found.radius_mm - PUBLISHED.radius_mm) < radius_error_mm
        assert distance_to_axis([PUBLISHED.centre_mm], found)[0] < axis_error_mm
        cosine = np.dot(found.direction, PUBLISHED.direction)
        assert np.degrees(np.arccos(cosine)) < 2  # drawn towards the line of sight
        assert 0.65 < found.inliers / len(points) < 0.85


def test_the_wall_does_not_depend_on_seed_or_order():
    generator = np.random.default_rng(1)
    points = captured(wall_points(PUBLISHED, 7000, generator), generator)
    points = np.concatenate([points, outliers(3000, generator)])
    first = CylinderFit()(points)
    assert CylinderFit()(points, seed=0) == first == CylinderFit()(points.astype(object))
    for seed in range(1, 5):
        other = CylinderFit()(generator.permutation(points), seed=seed)
        assert other.radius_mm == pytest.approx(first.radius_mm, abs=2)
        np.testing.assert_allclose(other.centre_mm[:2], first.centre_mm[:2], atol=2)
    assert CylinderFit()(points, np.random.default_rng(0)) == first


def test_one_point_at_the_end_of_the_world_does_no_harm():
    points = wall_points(PUBLISHED, 1000, np.random.default_rng(2))
    points[0] = [1e9, 0, 0]
    found = CylinderFit()(points)
    assert found.radius_mm == pytest.approx(PUBLISHED.radius_mm, abs=0.01)
    assert found.inliers == 999


def test_an_unrefined_trial_is_near():
    points = wall_points(PUBLISHED, 3000, np.random.default_rng(3))
    fit = CylinderFit(trials=3000, confidence=1 - 1e-12)
    trial = wall.search(points, fit, np.random.default_rng(0))
    assert trial.radius == pytest.approx(PUBLISHED.radius_mm, abs=25)
    few = CylinderFit(trials=120, max_angle_deg=30.0)(points)
    assert few.radius_mm == pytest.approx(PUBLISHED.radius_mm, abs=0.1)


@settings(max_examples=15, deadline=None)
@given(
    st.floats(-200, 200),
    st.floats(-500, 500),
    st.floats(-0.05, 0.05),
    st.floats(-0.05, 0.05),
    st.floats(300, 1500),
)
def test_any_wall_near_the_reference_is_found(x, y, tilt_x, tilt_y, radius):
    truth = Cylinder((x, y, 9000.0), (tilt_x, tilt_y, 1.0), radius)
    points = wall_points(truth, 600, np.random.default_rng(4), length_mm=2 * radius)
    found = CylinderFit()(points)
    assert found.radius_mm == pytest.approx(radius, abs=0.1)
    np.testing.assert_allclose(found.direction, truth.direction, atol=1e-3)


def test_the_reference_may_point_anywhere():
    points = wall_points(PUBLISHED, 1000, np.random.default_rng(5))
    turned = CylinderFit(reference=(0.0, 2.0, 0.0))(points[:, [0, 2, 1]])
    np.testing.assert_allclose(
        np.array(turned.direction)[[0, 2, 1]], PUBLISHED.direction, atol=1e-4
    )
    back = CylinderFit(reference=(0.0, 0.0, -1.0))(points)
    np.testing.assert_allclose(back.direction, -np.array(PUBLISHED.direction), atol=1e-4)


def test_the_axis_stays_within_the_limit():
    found = CylinderFit(max_angle_deg=1.0)(wall_points(PUBLISHED, 2000, np.random.default_rng(6)))
    assert 0.9 < np.degrees(np.arccos(found.direction[2])) <= 1.0


def ball(count, generator):
    way = generator.normal(size=(count, 3))
    return way / np.linalg.norm(way, axis=1, keepdims=True)


def plane(count, generator):
    flat = generator.uniform(-700, 700, (count, 3))
    flat[:, 0] = generator.normal(500, 10, count)
    return flat


CLOUDS = {
    "a plane along the axis": (plane, "a plane"),
    "an exact plane": (lambda n, g: plane(n, g) * [0, 1, 1], "a plane|line or plane"),
    "a plane across the axis": (lambda n, g: plane(n, g)[:, [1, 2, 0]], "fewer than 50%"),
    "a large ball": (lambda n, g: 700 * ball(n, g), "fewer than 50%"),
    "a small ball": (lambda n, g: 300 * ball(n, g), "a ball"),
    "a box": (lambda n, g: g.uniform(-1000, 1000, (n, 3)), "fewer than 50%"),
    "a line": (lambda n, g: plane(n, g) * [0.02, 0.02, 1], "a line|a plane|fewer"),
    "one point": (lambda n, g: np.ones((n, 3)), "line or plane"),
    "a wall across": (lambda n, g: wall_points(PUBLISHED, n, g)[:, ::-1], "fewer than 50%"),
}


@pytest.mark.parametrize("name", CLOUDS)
def test_a_cloud_without_a_cylinder_is_refused(name):
    make, message = CLOUDS[name]
    with pytest.raises(InputError, match=f"no cylinder in the cloud: .*({message})"):
        CylinderFit()(make(3000, np.random.default_rng(7)))


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((0, 3)), r"0 point\(s\) do not determine"),
        (np.zeros((9, 3)), r"9 point\(s\) do not determine"),
        (np.zeros((20, 2)), r"shape \(20, 2\), expected \(n, 3\)"),
        (np.full((20, 3), np.nan), "not finite"),
        ("wall", "not made of numbers"),
    ],
)
def test_points_that_cannot_be_used_are_refused(points, message):
    with pytest.raises(InputError, match=message):
        CylinderFit()(points)


@pytest.mark.parametrize(
    "wrong",
    [
        {"max_distance_mm": 0.0},
        {"reference": (0.0, 0.0, 0.0)},
        {"reference": (0.0, 1.0)},
        {"max_angle_deg": 90.0},
        {"trials": 0},
        {"trials": 1.5},
        {"confidence": 1.0},
        {"min_share": 1.5},
    ],
)
def test_parameters_out_of_range_are_refused(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        CylinderFit(**wrong)


def test_a_cylinder_is_checked_and_its_direction_made_a_unit():
    assert np.linalg.norm(PUBLISHED.direction) == pytest.approx(1)
    for wrong in [((0, 0, 0), (0, 0, 0), 1.0), ((0, 0), (0, 0, 1), 1.0), ((0, 0, 0), (0, 0, 1), 0)]:
        with pytest.raises(InputError, match="cylinder"):
            Cylinder(*wrong)


def test_the_distance_is_the_length_of_the_normal_part():
    points = np.random.default_rng(8).normal(0, 1000, (50, 3))
    axis = np.array(PUBLISHED.direction)
    for point, found in zip(points, distance_to_axis(points, PUBLISHED), strict=True):
        way = point - PUBLISHED.centre_mm
        assert found == pytest.approx(np.linalg.norm(way - (way @ axis) * axis))
    assert distance_to_axis(np.empty((0, 3)), PUBLISHED).shape == (0,)
    with pytest.raises(InputError, match="not finite"):
        distance_to_axis([[0, 0, np.nan]], PUBLISHED)
    with pytest.raises(InputError, match="expected"):
        distance_to_axis([0.0, 0.0, 0.0], PUBLISHED)


def test_gaussians_of_one_width_cross_in_the_middle():
    assert crossing([600, 700, 800], [800, 900, 1000]) == pytest.approx(800)


@given(
    st.lists(st.integers(0, 800), min_size=3, max_size=20),
    st.lists(st.integers(500, 1200), min_size=3, max_size=20),
)
def test_at_the_crossing_both_gaussians_are_as_high(air, on_wall):
    try:
        found = crossing(air, on_wall)
    except InputError:
        return
    assert np.mean(air) <= found <= np.mean(on_wall)
    heights = [norm.logpdf(found, np.mean(d), np.std(d, ddof=1)) for d in (air, on_wall)]
    assert heights[0] == pytest.approx(heights[1], abs=1e-6)


@pytest.mark.parametrize(
    ("air", "on_wall", "message"),
    [
        ([], [800, 900], "0 and 2 distances"),
        ([700, 700], [800, 900], "two different"),
        ([800, 900], [600, 700], "order of the arguments"),
        ([0, 1400], [699, 702], "do not cross"),
        ([np.nan, 1.0], [1.0, 2.0], "not finite"),
    ],
)
def test_sets_without_a_crossing_are_refused(air, on_wall, message):
    with pytest.raises(InputError, match=message):
        crossing(air, on_wall)


def test_a_particle_is_in_the_air_up_to_the_threshold_and_nowhere_without_3d():
    cylinder = Cylinder((0, 0, 0), (0, 0, 1), 772.0)
    points = [[0, 0, 5000], [800, 0, 5000], [800.1, 0, 5000], [np.nan] * 3]
    assert InAir()(points, cylinder).tolist() == [True, True, False, False]
    assert InAir().on_wall(points, cylinder).tolist() == [False, False, True, False]
    assert InAir(760.0)(points, cylinder).tolist() == [True, False, False, False]
    assert InAir()([], cylinder).shape == (0,)
    assert InAir()([], cylinder).dtype == bool
    for wrong in ([[np.nan, 0, 0]], [[np.inf] * 3], [0, 0, 0]):
        with pytest.raises(InputError):
            InAir()(wrong, cylinder)
    with pytest.raises(InputError, match="threshold_mm"):
        InAir(-1.0)


def test_the_published_cylinder_is_the_one_above():
    table = claims.published("table_5.12").set_index("quantity")["value_mm"]
    printed = [float(x) for x in table["Orientation"].strip("[]").split(",")]
    np.testing.assert_allclose(np.array(printed) / np.linalg.norm(printed), PUBLISHED.direction)
    assert float(table["Radius"]) == PUBLISHED.radius_mm


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
    directions = wall.draw_directions(CylinderFit(trials=4), generator)
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
    directions = wall.draw_directions(CylinderFit(trials=20), generator)
    for triple, way, centre, radius in zip(
        triples, directions, *wall.circles(triples, directions), strict=True
    ):
        distance = wall.residuals(triple, wall.Axis(centre, way, radius))
        np.testing.assert_allclose(distance, 0, atol=1e-6 * max(1, radius))


def test_three_points_in_a_line_have_no_circle():
    triple = np.array([[[0.0, 0, 0], [1, 1, 5], [2, 2, -5]], [[1.0, 0, 0]] * 3])
    assert np.isnan(wall.circles(triple, np.stack([Z, Z]))[1]).all()


def test_directions_are_even_over_the_cone():
    drawn = wall.draw_directions(CylinderFit(trials=20_000), np.random.default_rng(1))
    np.testing.assert_allclose(np.linalg.norm(drawn, axis=1), 1)
    angle = np.degrees(np.arccos(drawn[:, 2]))
    assert angle.max() <= 5.0
    # Half of the cone's area lies beyond 5/sqrt(2) degrees.
    assert np.mean(angle > 5 / np.sqrt(2)) == pytest.approx(0.5, abs=0.02)
    np.testing.assert_allclose(drawn.mean(axis=0)[:2], 0, atol=2e-3)


def test_good_directions_are_all_of_a_narrow_cone_and_few_of_a_wide_one():
    assert wall.good_directions(CylinderFit(), 0.0) == pytest.approx(1.0)
    assert wall.good_directions(CylinderFit(), 50 / np.radians(2.5)) == pytest.approx(
        0.25, abs=0.001
    )


def test_nothing_is_found_among_equal_points():
    same = np.ones((20, 3))
    assert wall.search(same, CylinderFit(trials=300), np.random.default_rng(2)) is None


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
