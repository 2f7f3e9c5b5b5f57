import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kilnflight.checks import InputError
from kilnflight.tracking.gate import Detected, Gate, Predicted

seeds = st.integers(0, 2**32 - 1)
NAN = np.nan


def tracks(positions, residual=None, depth=None, points=None):
    n = len(positions)
    return Predicted(
        np.asarray(positions, dtype=float).reshape(n, 2),
        np.tile(np.eye(2), (n, 1, 1)) if residual is None else np.asarray(residual, dtype=float),
        np.full(n, NAN) if depth is None else np.asarray(depth, dtype=float),
        np.full(n, NAN) if points is None else np.asarray(points, dtype=float),
    )


def found(positions, depth=None, points=None):
    first = tracks(positions, None, depth, points)
    return Detected(first.positions, first.depth_mm, first.points)


@settings(deadline=None)
@given(seed=seeds, n=st.integers(0, 6), m=st.integers(0, 6), distance=st.floats(0, 6))
def test_eq_4_8_pair_by_pair(seed, n, m, distance):
    rng = np.random.default_rng(seed)
    roots = rng.normal(0, 2, (n, 2, 2))
    residual = roots @ roots.transpose(0, 2, 1) + 0.2 * np.eye(2)
    depth, detected = rng.uniform(1000, 5000, n), rng.uniform(1000, 5000, m)
    depth[rng.random(n) < 0.3], detected[rng.random(m) < 0.3] = NAN, NAN
    sizes, counts = rng.integers(1, 50, n), rng.integers(1, 50, m)
    first = tracks(rng.normal(0, 4, (n, 2)), residual, depth, sizes)
    other = found(rng.normal(0, 4, (m, 2)), detected, counts)
    pairs = Gate(distance)(first, other)
    assert pairs.distance_squared.shape == pairs.size_difference.shape == (n, m)
    for i in range(n):
        log = np.linalg.slogdet(residual[i])[1]
        assert pairs.log_determinant[i] == pytest.approx(log, abs=1e-9)
        area = np.pi * distance**2 * np.sqrt(np.linalg.det(residual[i]))
        assert pairs.gate_area[i] == pytest.approx(area, abs=1e-9)
        for j in range(m):
            apart = other.positions[j] - first.positions[i]
            square = apart @ np.linalg.inv(residual[i]) @ apart
            inside = square < distance**2 and not abs(depth[i] - detected[j]) >= 1500
            expected = square if inside else np.inf
            assert pairs.distance_squared[i, j] == pytest.approx(expected, rel=1e-6)
            size = abs(int(sizes[i]) - int(counts[j])) if inside else 0
            assert pairs.size_difference[i, j] == size


def test_the_limits_themselves_are_outside():
    inside = Gate(2.0, 100.0)(
        tracks([[0, 0]], depth=[500]),
        found([[0, 2], [0, 1.999], [0, 1], [0, 1]], depth=[500, 500, 600, 599]),
    ).distance_squared
    np.testing.assert_array_equal(np.isfinite(inside), [[False, True, False, True]])


def test_no_depth_passes_and_no_size_makes_no_difference():
    pairs = Gate()(
        tracks([[0, 0], [0, 0]], depth=[500, NAN], points=[10, NAN]),
        found([[0, 1], [0, 1]], depth=[NAN, 9000], points=[NAN, 4]),
    )
    np.testing.assert_array_equal(np.isfinite(pairs.distance_squared), [[True, False], [True] * 2])
    assert not pairs.size_difference.any()


def test_the_share_of_a_gaussian_that_passes():
    assert Gate(4.0)(tracks([]), found([])).gate_probability == pytest.approx(1 - np.exp(-8))
    rng = np.random.default_rng(0)
    residual = np.array([[4.0, 1.0], [1.0, 2.0]])
    detected = rng.multivariate_normal([0, 0], residual, 100_000)
    pairs = Gate(1.5)(tracks([[0, 0]], [residual]), found(detected))
    share = np.isfinite(pairs.distance_squared).mean()
    assert share == pytest.approx(pairs.gate_probability, abs=0.01)


def test_a_gate_of_width_zero_lets_nothing_pass():
    pairs = Gate(0.0)(tracks([[1, 1]]), found([[1, 1]]))
    assert np.isinf(pairs.distance_squared).all()
    assert pairs.gate_probability == 0.0


@pytest.mark.parametrize("field", ["distance", "depth_mm"])
@pytest.mark.parametrize("bad", [-1.0, NAN, "4", None, True, [4.0], 1j])
def test_a_gate_that_is_invalid_is_refused(field, bad):
    with pytest.raises(InputError, match=f"Gate: {field}: must be 0"):
        Gate(**{field: bad})


def test_only_depth_may_have_no_limit():
    for far in (np.inf, 1e200, 10**400):
        with pytest.raises(InputError, match=r"Gate: distance: must be"):
            Gate(distance=far)
    pairs = Gate(1_000_000, np.inf)(tracks([[0, 0]], depth=[1]), found([[9e5, 0]], depth=[1e9]))
    assert pairs.distance_squared == pytest.approx(8.1e11)


def test_tracks_and_detections_that_cannot_be_are_refused():
    with pytest.raises(InputError, match="residual covariance of track 1 is singular"):
        Gate()(tracks([[0, 0], [0, 0]], [np.eye(2), np.ones((2, 2))]), found([]))
    with pytest.raises(InputError, match="residual covariance of track 0 is singular"):
        Gate()(tracks([[0, 0]], [np.full((2, 2), NAN)]), found([]))
    with pytest.raises(InputError, match="positions of detections"):
        Gate()(tracks([[0, 0]]), found([[0, NAN]]))
    with pytest.raises(InputError, match="residual covariance: shape"):
        Gate()(tracks([[0, 0]], [np.eye(3)]), found([]))
