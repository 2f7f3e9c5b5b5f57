import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from kilnflight.checks import InputError
from kilnflight.detection.wall import Cylinder, CylinderFit, InAir, crossing, distance_to_axis
from kilnflight.project import claims

PUBLISHED = Cylinder((74.275, 495.0013, 9257.7), (21.6677, -41.4764, 1533.6), 772.1827)


def wall(cylinder, count, generator, arc_deg=(160, 380), length_mm=1500.0):
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
    found = CylinderFit()(wall(PUBLISHED, 3000, np.random.default_rng(0)))
    assert found.radius_mm == pytest.approx(PUBLISHED.radius_mm, abs=1e-3)
    np.testing.assert_allclose(found.direction, PUBLISHED.direction, atol=1e-6)
    assert distance_to_axis([found.centre_mm], PUBLISHED)[0] < 1e-3
    assert found.inliers == found.points == 3000
    assert found.rms_mm < 1e-3
    assert found.arc_deg == pytest.approx(220, abs=1)
    assert found.length_mm == pytest.approx(0.96 * 1500, rel=0.02)
    assert found.angle_deg == pytest.approx(1.748, abs=1e-3)


@pytest.mark.parametrize(
    ("arc", "radius_error_mm", "axis_error_mm"), [((160, 380), 5, 6), ((210, 330), 20, 25)]
)
def test_errors_of_depth_and_outliers_leave_the_wall_where_it_is(
    arc, radius_error_mm, axis_error_mm
):
    for seed in range(3):
        generator = np.random.default_rng(seed)
        points = captured(wall(PUBLISHED, 14_000, generator, arc), generator)
        points = np.concatenate([points, outliers(6000, generator)])
        found = CylinderFit()(points, seed=seed)
        assert abs(found.radius_mm - PUBLISHED.radius_mm) < radius_error_mm
        assert distance_to_axis([PUBLISHED.centre_mm], found)[0] < axis_error_mm
        cosine = np.dot(found.direction, PUBLISHED.direction)
        assert np.degrees(np.arccos(cosine)) < 2  # drawn towards the line of sight
        assert 0.65 < found.mixing < 0.85


def test_the_wall_does_not_depend_on_seed_or_order():
    generator = np.random.default_rng(1)
    points = captured(wall(PUBLISHED, 7000, generator), generator)
    points = np.concatenate([points, outliers(3000, generator)])
    first = CylinderFit()(points)
    assert CylinderFit()(points, seed=0) == first == CylinderFit()(points.astype(object))
    for seed in range(1, 5):
        other = CylinderFit()(generator.permutation(points), seed=seed)
        assert other.radius_mm == pytest.approx(first.radius_mm, abs=2)
        np.testing.assert_allclose(other.centre_mm[:2], first.centre_mm[:2], atol=2)
    assert CylinderFit()(points, np.random.default_rng(0)) == first


def test_one_point_at_the_end_of_the_world_does_no_harm():
    points = wall(PUBLISHED, 1000, np.random.default_rng(2))
    points[0] = [1e9, 0, 0]
    found = CylinderFit()(points)
    assert found.radius_mm == pytest.approx(PUBLISHED.radius_mm, abs=0.01)
    assert found.inliers == 999


def test_an_unrefined_trial_is_near():
    points = wall(PUBLISHED, 3000, np.random.default_rng(3))
    found = CylinderFit(refine=False, trials=3000, confidence=1 - 1e-12)(points)
    assert found.radius_mm == pytest.approx(PUBLISHED.radius_mm, abs=25)
    assert CylinderFit(trials=120, max_angle_deg=30.0)(points).trials == 120


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
    points = wall(truth, 600, np.random.default_rng(4), length_mm=2 * radius)
    found = CylinderFit()(points)
    assert found.radius_mm == pytest.approx(radius, abs=0.1)
    np.testing.assert_allclose(found.direction, truth.direction, atol=1e-3)


def test_the_reference_may_point_anywhere():
    points = wall(PUBLISHED, 1000, np.random.default_rng(5))
    turned = CylinderFit(reference=(0.0, 2.0, 0.0))(points[:, [0, 2, 1]])
    np.testing.assert_allclose(
        np.array(turned.direction)[[0, 2, 1]], PUBLISHED.direction, atol=1e-4
    )
    back = CylinderFit(reference=(0.0, 0.0, -1.0))(points)
    np.testing.assert_allclose(back.direction, -np.array(PUBLISHED.direction), atol=1e-4)


def test_the_axis_stays_within_the_limit():
    found = CylinderFit(max_angle_deg=1.0)(wall(PUBLISHED, 2000, np.random.default_rng(6)))
    assert 0.9 < found.angle_deg <= 1.0


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
    "a wall across": (lambda n, g: wall(PUBLISHED, n, g)[:, ::-1], "fewer than 50%"),
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
def test_points_that_cannot_be_used_are_told(points, message):
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
def test_parameters_out_of_range_are_told(wrong):
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
    shifted = crossing([600, 700, 800] * 4, [800, 900, 1000], by_number=True)
    assert shifted > 800


@given(
    st.lists(st.integers(0, 800), min_size=3, max_size=20),
    st.lists(st.integers(500, 1200), min_size=3, max_size=20),
    st.booleans(),
)
def test_at_the_crossing_both_gaussians_are_as_high(air, on_wall, by_number):
    try:
        found = crossing(air, on_wall, by_number=by_number)
    except InputError:
        return
    assert np.mean(air) <= found <= np.mean(on_wall)
    heights = [
        norm.logpdf(found, np.mean(d), np.std(d, ddof=1)) + by_number * np.log(len(d))
        for d in (air, on_wall)
    ]
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
def test_sets_without_a_crossing_are_told(air, on_wall, message):
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
