"""MLESAC for a cylinder, on plain arrays: trials, their likelihood, refinement.

A cylinder is a point of its axis (3,), a unit direction (3,) and a radius, in mm.
P. Torr, A. Zisserman, MLESAC: A new robust estimator with application to estimating image
geometry, Computer Vision and Image Understanding 78, 2000 (reference 113 of the thesis).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit
from scipy.optimize import least_squares

Array = npt.NDArray[np.float64]

BATCH = 100  # trials between two looks at the confidence
GAUSSIAN_95 = 1.96  # an inlier stays within 1.96 sigma (Torr and Zisserman, 95 %)
ROUNDS = 30  # of least squares, at most
SETTLED_MM = 0.1
EM_STEPS = 5  # Torr and Zisserman: "two or three" suffice


class Axis(NamedTuple):
    """A cylinder in plain arrays."""

    centre: Array
    direction: Array
    radius: float


class Limits(NamedTuple):
    """What a cylinder may be: near which direction, and how far its points lie from it."""

    reference: Array
    max_angle_deg: float
    max_distance_mm: float


class Found(NamedTuple):
    """The most likely trial, the share of points on it, and how many were made."""

    axis: Axis
    mixing: float
    trials: int


def residuals(points: Array, axis: Axis) -> Array:
    """Return the signed distances (n,) of points (n, 3) from the surface, outside positive."""
    return _residuals(points, axis.centre, axis.direction, axis.radius)


def search(
    points: Array,
    limits: Limits,
    trials: int,
    confidence: float,
    generator: np.random.Generator,
) -> Found | None:
    """Return the most likely of at most ``trials`` cylinders; None if none was one.

    A trial is a direction drawn evenly from the cone and the circle through three points
    seen along it.
    """
    middle = np.median(points, axis=0)
    local = points - middle
    # Outliers are as likely anywhere across the cloud; far ones must not widen it.
    reach = np.quantile(np.linalg.norm(local, axis=1), 0.95)
    width = max(2 * float(reach), limits.max_distance_mm)
    half_length = float(np.quantile(np.abs(local @ limits.reference), 0.95))
    directions = draw_directions(limits, trials, generator)
    triples = local[generator.integers(len(points), size=(trials, 3))]
    centres, radii = circles(triples, directions)
    # A larger circle is flatter over the cloud than the maximum distance: as good as a plane.
    flat = width**2 / (8 * limits.max_distance_mm)
    usable = (radii > limits.max_distance_mm) & (radii < flat)
    sigma = limits.max_distance_mm / GAUSSIAN_95
    good = good_directions(limits, half_length)
    least, best, mixing, tried = np.inf, -1, 0.0, 0
    while tried < trials and not _sure(good * mixing**3, tried, confidence):
        batch = tried + np.flatnonzero(usable[tried : tried + BATCH])
        costs, shares = likelihood(
            local, centres[batch], directions[batch], radii[batch], sigma, width
        )
        if len(batch) and costs.min() < least:
            first = int(np.argmin(costs))
            least, best, mixing = float(costs[first]), int(batch[first]), float(shares[first])
        tried = min(tried + BATCH, trials)
    if best < 0:
        return None
    return Found(Axis(centres[best] + middle, directions[best], float(radii[best])), mixing, tried)


def _sure(chance: float, tried: int, confidence: float) -> bool:
    """Return whether a good trial was among them with that confidence."""
    return (1 - chance) ** tried < 1 - confidence


def good_directions(limits: Limits, half_length_mm: float) -> float:
    """Return the share of the cone that keeps both ends of the cloud within the distance."""
    widest = np.radians(limits.max_angle_deg)
    angle = min(limits.max_distance_mm / max(half_length_mm, 1e-9), widest)
    return float((1 - np.cos(angle)) / (1 - np.cos(widest)))


def across(directions: Array) -> tuple[Array, Array]:
    """Return two unit vectors (n, 3) that are normal to each direction and each other."""
    helper = np.eye(3)[np.argmin(np.abs(directions), axis=1)]
    first = np.cross(directions, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(directions, first)


def draw_directions(limits: Limits, count: int, generator: np.random.Generator) -> Array:
    """Return unit vectors (count, 3), even over the cone round the reference."""
    cosine = 1 - generator.random(count) * (1 - np.cos(np.radians(limits.max_angle_deg)))
    sine = np.sqrt(1 - cosine**2)
    turn = generator.uniform(0, 2 * np.pi, count)
    first, second = across(limits.reference[None])
    side = np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second
    return cosine[:, None] * limits.reference + sine[:, None] * side


def circles(triples: Array, directions: Array) -> tuple[Array, Array]:
    """Return centre (n, 3) and radius (n,) of the circles through triples (n, 3, 3).

    The triples are seen along the directions (n, 3); the radius is NaN where they are in line.
    """
    first, second = across(directions)
    u = np.einsum("nki,ni->nk", triples, first)
    v = np.einsum("nki,ni->nk", triples, second)
    du, dv = u[:, 1:] - u[:, :1], v[:, 1:] - v[:, :1]
    square = du**2 + dv**2
    twice_area = 2 * (du[:, 0] * dv[:, 1] - du[:, 1] * dv[:, 0])
    safe = np.where(twice_area == 0, np.nan, twice_area)
    cu = (square[:, 0] * dv[:, 1] - square[:, 1] * dv[:, 0]) / safe
    cv = (square[:, 1] * du[:, 0] - square[:, 0] * du[:, 1]) / safe
    centres = (u[:, 0] + cu)[:, None] * first + (v[:, 0] + cv)[:, None] * second
    return centres, np.hypot(cu, cv)


@njit(cache=True)
def _residuals(points: Array, centre: Array, direction: Array, radius: float) -> Array:
    found = np.empty(len(points))
    for i in range(len(points)):
        x, y, z = points[i, 0] - centre[0], points[i, 1] - centre[1], points[i, 2] - centre[2]
        a = y * direction[2] - z * direction[1]
        b = z * direction[0] - x * direction[2]
        c = x * direction[1] - y * direction[0]
        found[i] = np.sqrt(a * a + b * b + c * c) - radius
    return found


@njit(cache=True)
def likelihood(
    points: Array, centres: Array, directions: Array, radii: Array, sigma: float, width: float
) -> tuple[Array, Array]:
    """Return the negative log likelihood and the mixing coefficient of each cylinder, (m,).

    A distance is Gaussian (sigma) with the probability of the mixing coefficient, else even
    over ``width``; the coefficient is estimated by EM from 1/2 (Torr and Zisserman, Eqs 17,
    18 and their algorithm).
    """
    costs, mixings = np.empty(len(radii)), np.empty(len(radii))
    outlier = 1 / width
    for trial in range(len(radii)):
        distance = _residuals(points, centres[trial], directions[trial], radii[trial])
        inlier = np.exp(-0.5 * (distance / sigma) ** 2) / (np.sqrt(2 * np.pi) * sigma)
        mixing = 0.5
        for _ in range(EM_STEPS):
            total = 0.0
            for value in inlier:
                total += mixing * value / (mixing * value + (1 - mixing) * outlier)
            mixing = total / len(inlier)
        cost = 0.0
        for value in inlier:
            cost -= np.log(mixing * value + (1 - mixing) * outlier)
        costs[trial], mixings[trial] = cost, mixing
    return costs, mixings


def _cost(points: Array, axis: Callable[[Array], Axis], unknown: Array) -> Array:
    return residuals(points, axis(unknown))


def refine(points: Array, start: Axis, limits: Limits) -> Axis:
    """Return the least squares cylinder (soft L1) of its own inliers.

    The inliers are taken anew until axis and radius stay: one round would keep the mark of the
    trial it started from, on a short arc some centimetres of the radius.
    """
    frame = np.concatenate(across(limits.reference[None]))
    widest = np.tan(np.radians(limits.max_angle_deg))
    centre, direction, radius = start

    def axis(unknown: Array) -> Axis:
        # A smooth map of the whole plane into the cone: no bounds are needed.
        tilt = widest * unknown[:2] / np.sqrt(1 + unknown[:2] @ unknown[:2])
        along = limits.reference + tilt @ frame
        place = centre + radius * (unknown[2:4] @ frame)
        return Axis(place, along / np.linalg.norm(along), radius * float(unknown[4]))

    tilt = frame @ direction / (direction @ limits.reference) / widest
    tilt *= min(1.0, 0.9 / max(float(np.linalg.norm(tilt)), 0.9))
    unknown = np.array([*(tilt / np.sqrt(1 - tilt @ tilt)), 0.0, 0.0, 1.0])
    for _ in range(ROUNDS):
        near = np.abs(residuals(points, axis(unknown))) <= limits.max_distance_mm
        if np.count_nonzero(near) < len(unknown):
            break
        before, kept = unknown, points[near]
        unknown = least_squares(
            partial(_cost, kept, axis),
            unknown,
            loss="soft_l1",
            f_scale=limits.max_distance_mm / GAUSSIAN_95,
            max_nfev=20,
        ).x
        if np.abs(unknown - before).max() * radius < SETTLED_MM:
            break
    return axis(unknown)


def covered_arc(points: Array, axis: Axis) -> float:
    """Return the angle in rad that inliers (n, 3) cover, without the few beside the wall."""
    first, second = across(axis.direction[None])
    side = (points - axis.centre) @ np.concatenate([first, second]).T
    angles = np.arctan2(side[:, 1], side[:, 0])
    counts = np.histogram(angles, bins=36, range=(-np.pi, np.pi))[0]
    filled = np.flatnonzero(counts > 0.2 * counts[counts > 0].mean())
    gaps = np.diff(filled, append=filled[0] + 36)
    begin = np.roll(filled, -1)[np.argmax(gaps)]  # behind the widest gap
    turned = (angles - (2 * np.pi * begin / 36 - np.pi)) % (2 * np.pi)
    return float(np.ptp(turned[turned < 2 * np.pi * (37 - gaps.max()) / 36]))


def bend(along: Array, signed: Array, distance: float) -> float:
    """Return by how many mm the surface bends from the middle of its length to the ends.

    Nothing for a cylinder; on a ball, the sagitta of the band within ``distance``.
    """
    near = np.abs(signed) <= distance
    low, high = np.quantile(along[near], [0.02, 0.98])
    place = (along[near] - (low + high) / 2) / max(float(high - low) / 2, 1e-9)
    return float(np.linalg.lstsq(np.vander(place, 3), signed[near])[0][0])
