"""The wall's cylinder against the same estimator in plain numpy, all points in every trial."""

from __future__ import annotations

import numpy as np
from measure import Row, compare
from scipy.optimize import least_squares

from kilnflight.detection.wall import Cylinder, CylinderFit, distance_to_axis

POINTS = (25_000, 100_000)
TRIALS = 100
TRUTH = Cylinder((74.3, 495.0, 9257.7), (21.67, -41.48, 1533.6), 772.18)


def cloud(count: int) -> np.ndarray:
    """Return a ring of the wall with depth errors, and 30 % other points."""
    generator = np.random.default_rng(count)
    axis = np.array(TRUTH.direction)
    side = np.cross(axis, [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    angle = generator.uniform(2.8, 6.6, count)[:, None]
    along = generator.uniform(-750, 750, count)[:, None]
    wall = np.cos(angle) * side + np.sin(angle) * np.cross(axis, side)
    points = along * axis + TRUTH.radius_mm * wall
    points[: 3 * count // 10] = generator.uniform(-700, 700, (3 * count // 10, 3))
    points += TRUTH.centre_mm
    points *= 1 + 0.022 * np.repeat(generator.normal(size=count // 5), 5)[:, None]
    return points


def distances(points: np.ndarray, centre: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Return the distance from an axis, as it is defined."""
    return np.linalg.norm(np.cross(points - centre, axis), axis=1)


def plain(points: np.ndarray, distance: float = 50.0) -> tuple[np.ndarray, np.ndarray, float]:
    """Return centre, direction and radius: MLESAC, one trial after the other."""
    generator = np.random.default_rng(0)
    sigma, best, found = distance / 1.96, np.inf, None
    width = 2 * np.quantile(np.linalg.norm(points - np.median(points, axis=0), axis=1), 0.95)
    for _ in range(TRIALS):
        tilt, turn = 0.087 * np.sqrt(generator.random()), generator.uniform(0, 2 * np.pi)
        axis = np.array([tilt * np.cos(turn), tilt * np.sin(turn), 1.0])
        axis /= np.linalg.norm(axis)
        three = points[generator.integers(len(points), size=3)]
        flat = three[:, :2] - three[:, 2:] * axis[:2] / axis[2]
        system = np.column_stack([2 * flat, np.ones(3)])
        if abs(np.linalg.det(system)) < 1e-6:
            continue
        x, y, _ = np.linalg.solve(system, (flat**2).sum(axis=1))
        centre = np.array([x, y, 0.0])
        radius = distances(three, centre, axis).mean()
        residual = distances(points, centre, axis) - radius
        inlier = np.exp(-0.5 * (residual / sigma) ** 2) / np.sqrt(2 * np.pi) / sigma
        mixing = 0.5
        for _ in range(5):
            mixing = np.mean(mixing * inlier / (mixing * inlier + (1 - mixing) / width))
        cost = -np.log(mixing * inlier + (1 - mixing) / width).sum()
        if cost < best and radius < 2000:
            best, found = cost, (centre, axis, radius)
    assert found is not None
    return settled(points, *found, distance)


def settled(points, centre, axis, radius, distance):
    """Return the least squares cylinder of its own inliers."""
    start = np.array([centre[0], centre[1], axis[0] / axis[2], axis[1] / axis[2], radius])

    def residual(x: np.ndarray, some: np.ndarray) -> np.ndarray:
        way = np.array([x[2], x[3], 1.0]) / np.sqrt(x[2] ** 2 + x[3] ** 2 + 1)
        return distances(some, np.array([x[0], x[1], 0.0]), way) - x[4]

    x = start
    for _ in range(30):
        kept = points[np.abs(residual(x, points)) <= distance]
        before = x
        x = least_squares(
            residual, x, args=(kept,), loss="soft_l1", f_scale=25.5, x_scale=[1, 1, 1e-4, 1e-4, 1]
        ).x
        if abs(x[4] - before[4]) < 0.1:
            break
    way = np.array([x[2], x[3], 1.0])
    return np.array([x[0], x[1], 0.0]), way / np.linalg.norm(way), float(x[4])


def rows() -> list[Row]:
    """Return every comparison, the results checked: the radius to 2 mm."""
    found = []
    for count in POINTS:
        points = cloud(count)
        ours = CylinderFit()(points)
        theirs = plain(points)
        np.testing.assert_allclose(ours.radius_mm, theirs[2], atol=2.0)
        name = "the same in plain numpy (radius to 2 mm)"
        found.append(
            compare(
                ("cylinder, MLESAC", "points", count, name),
                lambda points=points: CylinderFit()(points),
                lambda points=points: plain(points),
                repeats=2,
            )
        )
    centre, axis = np.array(TRUTH.centre_mm), np.array(TRUTH.direction)
    np.testing.assert_allclose(distance_to_axis(points, TRUTH), distances(points, centre, axis))
    found.append(
        compare(
            ("distance to the axis", "points", len(points), "numpy.cross"),
            lambda: distance_to_axis(points, TRUTH),
            lambda: distances(points, centre, axis),
        )
    )
    return found
