import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.path import Path

from kilnflight.camera import (
    EQUATION_2_4,
    PLATE_DISTANCES_MM,
    DepthCalibration,
    calibrate_depth,
    calibrate_points,
    captured_depths,
    equalize,
    fit_depth_segments,
    inside,
    invert_depth,
    read_calibration,
    wall_profile,
)
from kilnflight.checks import InputError
from kilnflight.project import claims


def equation_in_plain_code(z):
    """Eq. 2.4, copied a second time from the page, one depth at a time."""
    if z < 3000:
        return -0.002055 * z * z + 10.65 * z - 10230
    if z <= 5000:
        return -0.00004158 * z * z + 1.367 * z - 857.5
    return 0.00004504 * z * z + 0.3219 * z + 2189


@given(st.lists(st.floats(0, 15_000), max_size=30))
def test_calibration_is_the_equation(depths):
    expected = [equation_in_plain_code(z) for z in depths]
    np.testing.assert_allclose(calibrate_depth(depths), expected, atol=1e-6)


def test_a_table_of_plates_is_joined_by_straight_lines():
    calibration = DepthCalibration.from_table([[4000, 3000], [1000, 1500], [2000, 2000]])
    depths = [500.0, 1000.0, 1500.0, 2000.0, 3000.0, 4000.0, 6000.0]
    expected = [1250.0, 1500.0, 1750.0, 2000.0, 2500.0, 3000.0, 4000.0]  # by hand
    np.testing.assert_allclose(calibration(depths), expected)


def test_points_stay_on_their_ray_and_without_a_calibration_as_they_are():
    points = [[100.0, -50.0, 5000.0], [0.0, 0.0, 3000.0]]
    calibrated = calibrate_points(points, EQUATION_2_4)
    expected = [[98.76, -49.38, 4938.0], [0.0, 0.0, 2869.28]]
    np.testing.assert_allclose(calibrated, expected, atol=0.005)
    np.testing.assert_array_equal(calibrate_points(points, None), points)


STATED = {
    "no calibration": (None, 500.0),
    "none": ("none", 500.0),
    "the thesis's": ("zhang-2023", -5418.75),
    "pairs": ([[0, 0], [1000, 2000]], 1000.0),
    "a fit": ({"breakpoints_mm": [100.0], "coefficients": [[0, 1], [2, 0]]}, 1000.0),
}


@pytest.mark.parametrize(("stated", "depth"), STATED.values(), ids=STATED)
def test_a_recording_states_its_depth_calibration(stated, depth):
    calibration = read_calibration(stated)
    assert (calibration(500.0) if calibration else 500.0) == pytest.approx(depth)


WRONG = {
    "an unknown word": ("zhang", "expected one of none, zhang-2023"),
    "a number": (2.4, "expected one of none, zhang-2023"),
    "a fit without coefficients": ({"breakpoints_mm": []}, "expected one of none"),
    "one pair": ([[1000, 1010]], "two or more pairs"),
    "pairs that fall": ([[1000, 1010], [2000, 900]], "growing with the captured"),
    "a plate twice": ([[1000, 1010], [1000, 1020]], "growing with the captured"),
    "triples": ([[1, 2, 3], [4, 5, 6]], "depth table"),
    "NaN": ([[1, 2], [4, np.nan]], "depth table.*not finite"),
    "text in a fit": ({"breakpoints_mm": [], "coefficients": [["a"]]}, "depth calibration"),
}


@pytest.mark.parametrize(("stated", "message"), WRONG.values(), ids=WRONG)
def test_what_is_no_depth_calibration_is_refused(stated, message):
    with pytest.raises(InputError, match=message):
        read_calibration(stated)


def test_the_breakpoints_belong_to_the_middle_segment():
    np.testing.assert_allclose(calibrate_depth([3000.0, 5000.0]), [2869.28, 4938.0])


def test_any_shape_comes_back_and_nothing_gives_nothing():
    assert calibrate_depth(np.full((2, 3), 4000.0)).shape == (2, 3)
    assert calibrate_depth(4000.0).shape == ()
    assert calibrate_depth([]).shape == (0,)


def test_a_depth_that_is_not_finite_is_refused():
    with pytest.raises(InputError, match="captured depth"):
        calibrate_depth([1000.0, np.nan])


def test_published_facts_about_the_equation():
    facts = claims.published("depth_calibration").set_index("where")["value"]
    jumps = [float(facts["jump at 3000 mm"]), float(facts["jump at 5000 mm"])]
    np.testing.assert_allclose(EQUATION_2_4.jumps(), jumps, atol=0.005)
    falling = EQUATION_2_4.falling(1300.0, 11000.0)
    assert falling.min() == pytest.approx(2591.2, abs=0.2)
    assert falling.max() == pytest.approx(3000.0, abs=0.2)
    for metre in range(1, 12):
        printed = facts[f"captured depth for true {1000 * metre} mm"]
        solutions = captured_depths(1000.0 * metre)
        assert [round(z, 1) for z in solutions] == [float(z) for z in printed.split("/")]


@given(st.floats(3000.0, 11_000.0))
def test_every_inverse_leads_back(true):
    for captured in captured_depths(true):
        assert calibrate_depth(captured) == pytest.approx(true, abs=1e-6)


def test_the_nearer_inverse_is_taken():
    assert invert_depth(3000.0) == pytest.approx(3117.5, abs=0.05)


@pytest.mark.parametrize(
    "calibration",
    [
        EQUATION_2_4,
        DepthCalibration((3000.0,), ((1.0, 0.0), (0.0, 1e-9, 2e-4, 0.5, 100.0))),
        DepthCalibration((3000.0,), ((2000.0,), (0.0, 1.0, 0.0))),
    ],
    ids=["Eq. 2.4", "degrees 1 and 3", "degrees 0 and 1"],
)
def test_all_depths_at_once_are_the_roots_of_numpy_one_by_one(calibration):
    for true in np.arange(5.0, 14_000.0, 333.3):
        expected = []
        for index, coefficients in enumerate(calibration.coefficients):
            roots = (np.poly1d(coefficients) - true).roots
            real = roots[np.abs(roots.imag) < 1e-9 * np.abs(roots)].real
            expected += real[(real > 0) & (calibration.segment(real) == index)].tolist()
        assert captured_depths(true, calibration) == sorted(expected)
        if expected:
            nearest = min(expected, key=lambda depth: abs(depth - true))
            assert invert_depth([[true]], calibration).tolist() == [[nearest]]


def test_a_depth_without_inverse_is_refused():
    gap = DepthCalibration((1000.0,), ((1.0, 0.0), (1.0, 500.0)))
    assert captured_depths(1200.0, gap) == []
    with pytest.raises(InputError, match="no captured depth gives 1200"):
        invert_depth(1200.0, gap)


def scattered_plates(points, generator):
    """Captured and true depth of plates at 1 m to 11 m, with scatter."""
    true = np.repeat(np.array(PLATE_DISTANCES_MM)[:, None], points, axis=1)
    captured = invert_depth(PLATE_DISTANCES_MM)[:, None] + generator.normal(0, 150, true.shape)
    return captured, true


coefficients = st.tuples(st.floats(-0.001, 0.001), st.floats(0.2, 5.0), st.floats(-5000.0, 5000.0))


@given(st.tuples(coefficients, coefficients, coefficients))
def test_a_fit_without_scatter_finds_the_coefficients(three):
    truth = DepthCalibration((3000.0, 5000.0), three)
    captured = np.linspace(500.0, 11_000.0, 200)
    fitted = fit_depth_segments(captured, truth(captured))
    np.testing.assert_allclose(fitted(captured), truth(captured), atol=1e-5)


@given(st.integers(0, 2**32 - 1), st.integers(1, 3))
def test_a_continuous_fit_does_not_jump_and_costs_little(seed, degree):
    captured, true = scattered_plates(20, np.random.default_rng(seed))
    fitted = fit_depth_segments(captured, true, degree=degree, continuous=True)
    np.testing.assert_allclose(fitted.jumps(), 0.0, atol=1e-6)
    free = fit_depth_segments(captured, true, degree=degree)
    cost = [np.sum((fit(captured) - true) ** 2) for fit in (free, fitted)]
    assert cost[0] <= cost[1] * (1 + 1e-9)


def test_without_breakpoints_it_is_one_polynomial():
    captured = np.linspace(1000.0, 5000.0, 50)
    true = captured + np.sin(captured)
    for continuous in (False, True):
        fitted = fit_depth_segments(captured, true, (), continuous=continuous)
        expected = np.polyval(np.polyfit(captured, true, 2), captured)
        np.testing.assert_allclose(fitted(captured), expected, atol=1e-6)


def test_a_continuous_fit_is_the_best_of_all_continuous_ones():
    """Against scipy's constrained minimiser, as a peer."""
    from scipy.optimize import minimize

    captured, true = scattered_plates(5, np.random.default_rng(1))
    captured, true = captured.ravel() / 1000, true.ravel() / 1000

    def curve(c, z):
        return np.select(
            [z < 3, z < 5],
            [np.polyval(c[:2], z), np.polyval(c[2:4], z)],
            np.polyval(c[4:], z),
        )

    def gap(c):
        return [
            np.polyval(c[:2], 3) - np.polyval(c[2:4], 3),
            np.polyval(c[2:4], 5) - np.polyval(c[4:], 5),
        ]

    best = minimize(
        lambda c: np.sum((curve(c, captured) - true) ** 2),
        np.tile([1.0, 0.0], 3),
        constraints={"type": "eq", "fun": gap},
        options={"ftol": 1e-14, "maxiter": 500},
    )
    fitted = fit_depth_segments(captured, true, (3.0, 5.0), degree=1, continuous=True)
    assert np.sum((fitted(captured) - true) ** 2) == pytest.approx(best.fun, rel=1e-6)


@pytest.mark.parametrize(
    ("captured", "true", "more", "message"),
    [
        ([1.0, 2.0], [1.0], {}, "2 captured depths, but 1 true"),
        ([1.0], [1.0], {"breakpoints_mm": (5.0, 3.0)}, "do not ascend"),
        ([4000.0] * 9, [4000.0] * 9, {}, r"the segments hold \[0, 1, 0\]"),
        ([np.inf], [1.0], {}, "captured depth"),
    ],
)
def test_what_cannot_be_fitted_is_refused(captured, true, more, message):
    with pytest.raises(InputError, match=message):
        fit_depth_segments(captured, true, **more)


def test_segments_that_make_no_calibration_are_refused():
    with pytest.raises(InputError, match="do not ascend"):
        DepthCalibration((5.0, 3.0), ((1.0,),) * 3)
    with pytest.raises(InputError, match="1 breakpoints make 2 segments, but there are 3"):
        DepthCalibration((5.0,), ((1.0,),) * 3)
    with pytest.raises(InputError, match="not made of numbers"):
        calibrate_depth("a")
    for degree in (-1, 1.5):
        with pytest.raises(InputError, match="degree"):
            fit_depth_segments([1.0], [1.0], degree=degree)


HOOK = [(0, 0), (0, 10), (10, 10), (10, 6), (4, 6), (4, 0)]  # not convex
coordinates = st.tuples(st.integers(0, 20), st.integers(0, 20))


def test_a_corner_is_cut_out_and_the_border_is_inside():
    row, col = [2, 7, 7, 4, 10, 0, 11], [3, 8, 3, 3, 8, 0, 8]
    assert inside(HOOK, row, col).tolist() == [True, True, False, True, True, True, False]


@given(st.lists(coordinates, min_size=3, max_size=8, unique=True), st.integers(0, 2**32 - 1))
def test_inside_is_what_counting_edges_and_matplotlib_say(corners, seed):
    if np.linalg.matrix_rank(np.subtract(corners, corners[0])) < 2:
        return
    points = np.random.default_rng(seed).uniform(-2, 22, (200, 2))
    expected = np.array([_even_odd(corners, p) for p in points])
    within = inside(corners, *points.T)
    np.testing.assert_array_equal(within, expected)
    if len(corners) == 3:
        np.testing.assert_array_equal(within, Path(corners).contains_points(points))
    turned = inside(np.roll(corners, 1, axis=0)[::-1], *points.T)
    np.testing.assert_array_equal(turned, within)
    assert inside(corners, *np.transpose(corners)).all()


def _even_odd(corners, point):
    """How many edges a walk along the row meets, in plain code."""
    crossings = 0
    for (r0, c0), (r1, c1) in zip(corners, [*corners[1:], corners[0]], strict=True):
        if (r0 > point[0]) != (r1 > point[0]):
            crossings += c0 + (point[0] - r0) * (c1 - c0) / (r1 - r0) > point[1]
    return crossings % 2 == 1


def test_the_shape_of_the_pixels_comes_back():
    row, col = np.mgrid[:12, :9]
    assert inside(HOOK, row, col).shape == (12, 9)
    assert inside(HOOK, 3, np.arange(5)).shape == (5,)
    assert inside(HOOK, [], []).shape == (0,)
    assert inside(HOOK, 1, 1).shape == ()


@pytest.mark.parametrize(
    ("polygon", "message"),
    [
        ([], "shape"),
        ([(0, 0), (5, 5)], r"2 different corner\(s\)"),
        ([(0, 0), (5, 5), (0, 0)], r"2 different corner\(s\)"),
        ([(0, 0), (5, 5), (9, 9)], "in one line"),
        ([(0, 0), (5, np.nan), (9, 9)], "polygon: 1 value"),
        ([(0, 0, 0)] * 4, r"shape \(4, 3\)"),
    ],
)
def test_corners_that_make_no_polygon_are_refused(polygon, message):
    with pytest.raises(InputError, match=message):
        inside(polygon, 1, 1)


def test_pixels_without_numbers_are_refused():
    with pytest.raises(InputError, match="row"):
        inside(HOOK, np.nan, 1)


RAMP = np.add.outer(np.arange(60.0), np.zeros(80))
WHOLE = ((0, 0), (0, 79), (59, 79), (59, 0))


def test_the_whole_picture_is_itself():
    picture = np.random.default_rng(1).normal(1400, 20, (60, 80))
    np.testing.assert_allclose(equalize(picture, WHOLE, 60, 80), picture, rtol=1e-5)


def floor_seen_in_perspective(length, near=1.0, far=8.0, height=0.7):
    """A floor whose temperature grows linearly from near to far, and the corners of a strip."""
    rows, columns, focal, middle = 400, 400, 300.0, 100.0
    row = np.indices((rows, columns), dtype=float)[0]
    depth = np.where(row > middle, focal * height / np.maximum(row - middle, 1e-6), far)
    picture = 1000.0 + 50.0 * np.clip(depth, near, far)
    corners = []
    for z, side in ((far, -1), (far, 1), (near, 1), (near, -1)):
        corners.append((middle + focal * height / z, 200 + side * focal * length / 2 / z))
    return picture, tuple(corners), far, near


def test_a_strip_in_perspective_gives_an_even_profile():
    """The definition: equal steps along the floor, so a linear temperature stays linear."""
    picture, corners, far, near = floor_seen_in_perspective(0.8)
    profile = wall_profile(picture, corners, rows=141)
    expected = 1000.0 + 50.0 * np.linspace(far, near, 141)
    np.testing.assert_allclose(profile[3:-3], expected[3:-3], atol=3.0)


@given(st.floats(0, 15), st.floats(0, 15), st.floats(25, 45), st.floats(60, 79))
def test_a_constant_picture_has_a_constant_profile(top, left, bottom, right):
    corners = ((top, left + 3), (top, right - 3), (bottom, right), (bottom, left))
    profile = wall_profile(np.full((60, 80), 1423.0), corners, rows=20)
    np.testing.assert_allclose(profile[1:-1], 1423.0, rtol=1e-4)


@pytest.mark.parametrize(
    ("picture", "corners", "message"),
    [
        (RAMP, WHOLE[:3], "four corners"),
        (RAMP[0], WHOLE, "one picture"),
        (RAMP, ((0, 0), (0, 90), (59, 79), (59, 0)), "leave the picture"),
        (RAMP, ((0, 0), (59, 79), (0, 79), (59, 0)), "no convex area"),
        (RAMP * np.nan, WHOLE, "not finite"),
    ],
)
def test_corners_that_make_no_strip_are_refused(picture, corners, message):
    with pytest.raises(InputError, match=message):
        wall_profile(picture, corners)
