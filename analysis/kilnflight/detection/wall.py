r"""The kiln's wall as a cylinder, and the particles in the air.

Sections 3.2 and 5.1.4 of the thesis::

    wall points -> CylinderFit -> Cylinder -> distance_to_axis -> crossing (the threshold)
                                         \-> InAir

The fit is MLESAC (Torr and Zisserman 2000, reference 113 of the thesis).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from kilnflight.checks import (
    InputError,
    check_count,
    check_finite,
    check_inside,
    check_positive,
    check_shape,
)

Array = npt.NDArray[np.float64]
Vector = tuple[float, float, float]

FEWEST_POINTS = 10  # twice the five unknowns of a cylinder
BATCH = 100  # trials between two looks at the confidence
GAUSSIAN_95 = 1.96  # an inlier stays within 1.96 sigma (Torr and Zisserman, 95 %)
ROUNDS = 30  # of least squares, at most
SETTLED_MM = 0.1
EM_STEPS = 5  # Torr and Zisserman: "two or three" suffice
ENDS = (0.02, 0.98)  # quantiles of the places along the axis
SCORED_POINTS = 2000  # enough to compare trials; the refinement takes all


@dataclass(frozen=True)
class Cylinder:
    """A cylinder without ends, with the quality of its fit or None.

    Parameters
    ----------
    centre_mm
        Point of the axis; of a fit, the middle of the inliers along it.
    direction
        Of the axis; any length, kept as a unit vector.
    radius_mm
        Of the wall.
    inliers
        Points within the maximum distance.
    rms_mm
        Root mean square distance of the inliers from the wall.
    """

    centre_mm: Vector
    direction: Vector
    radius_mm: float
    inliers: int | None = None
    rms_mm: float | None = None

    def __post_init__(self) -> None:
        """Refuse a shape that is no cylinder; normalise the direction."""
        check_positive(self.radius_mm, "cylinder: radius_mm")
        centre = check_finite(self.centre_mm, "cylinder: centre_mm")
        check_shape(centre, (3,), "cylinder: centre_mm")
        object.__setattr__(self, "centre_mm", tuple(centre.tolist()))
        direction = _unit(self.direction, "cylinder: direction")
        object.__setattr__(self, "direction", tuple(direction.tolist()))


@dataclass(frozen=True)
class CylinderFit:
    """Fit a cylinder of roughly known axis by MLESAC (section 3.2).

    Notes
    -----
    The thesis prints no parameter of its fit; it names a maximum distance and the z-axis. A trial
    is a direction from the allowed cone and the circle through three points seen along it. The
    camera's depth errors are common to whole patches, so normals estimated from neighbours would
    say nothing. A direction counts as good for the confidence if it keeps the ends of the cloud
    within the maximum distance. Errors of depth shift points along the line of sight, and so the
    axis towards it. Errors of half the ring's length (standard deviations) shift it by about one
    degree.
    """

    max_distance_mm: float = 50.0  # of an inlier from the wall; not printed
    reference: Vector = (0.0, 0.0, 1.0)  # the z-axis, sec. 3.2
    max_angle_deg: float = 5.0  # between axis and reference, below 90; Table 5.12 has 1.7
    trials: int = 1000  # at most
    confidence: float = 0.99  # that a good trial was among them
    min_share: float = 0.5  # of the points, that must be inliers: the wall is the majority

    def __post_init__(self) -> None:
        """Refuse parameters out of range; normalise the reference."""
        check_positive(self.max_distance_mm, "CylinderFit: max_distance_mm")
        reference = _unit(self.reference, "CylinderFit: reference")
        object.__setattr__(self, "reference", tuple(reference.tolist()))
        check_count(self.trials, "CylinderFit: trials")
        for name, high in (("max_angle_deg", 90), ("confidence", 1), ("min_share", 1)):
            check_inside(getattr(self, name), 0, high, f"CylinderFit: {name}")

    def __call__(self, points_mm: npt.ArrayLike, seed: int | np.random.Generator = 0) -> Cylinder:
        """Return the cylinder of a wall's cluster.

        Parameters
        ----------
        points_mm
            (n, 3) x, y, z of the cluster; other points may be among them.
        seed
            Of the trials; the same seed gives the same cylinder.

        Raises
        ------
        InputError
            If the points are not finite, not (n, 3) or fewer than ten, or hold no cylinder:
            too few lie on the best one, or it could be a plane, a ball or a line as well.
        """
        points = np.ascontiguousarray(check_finite(points_mm, "cylinder fit: points"))
        check_shape(points, (None, 3), "cylinder fit: points")
        if len(points) < FEWEST_POINTS:
            raise InputError(
                f"cylinder fit: {len(points)} point(s) do not determine a cylinder; give at "
                f"least {FEWEST_POINTS} points of the wall."
            )
        generator, scored = np.random.default_rng(seed), points
        if len(points) > SCORED_POINTS:
            scored = points[generator.choice(len(points), SCORED_POINTS, replace=False)]
        if (axis := search(scored, self, generator)) is None:
            raise _no_cylinder("its points are in one line or plane")
        return self._checked(points, refine(points, axis, self))

    def _checked(self, points: Array, axis: Axis) -> Cylinder:
        """Return the cylinder with its quality, or raise an `InputError`."""
        signed = residuals(points, axis)
        inliers = int((near := np.abs(signed) <= self.max_distance_mm).sum())
        if inliers < max(self.min_share * len(points), FEWEST_POINTS):
            raise _no_cylinder(
                f"of {len(points)} points {inliers} lie within {self.max_distance_mm:g} mm of the "
                f"best one, fewer than {self.min_share:.0%}"
            )
        along = (points - axis.centre) @ axis.direction
        arc = covered_arc(points[near], axis)
        bend = bending(along, signed, 3 * self.max_distance_mm)
        if not axis.radius > self.max_distance_mm:
            raise _no_cylinder(f"the best one has a radius of {axis.radius:.0f} mm, a line")
        if axis.radius * (1 - np.cos(arc / 2)) < self.max_distance_mm:
            raise _no_cylinder(f"an arc of {np.degrees(arc):.1f} degrees is flat, a plane")
        if abs(bend) > self.max_distance_mm:
            raise _no_cylinder(f"it bends by {abs(bend):.0f} mm along the axis, a ball")
        middle = np.quantile(along[near], ENDS).mean()
        return Cylinder(
            centre_mm=tuple((axis.centre + middle * axis.direction).tolist()),
            direction=tuple(axis.direction.tolist()),
            radius_mm=axis.radius,
            inliers=inliers,
            rms_mm=float(np.sqrt(np.mean(signed[near] ** 2))),
        )


def _no_cylinder(reason: str) -> InputError:
    return InputError(
        f"cylinder fit: no cylinder in the cloud: {reason}. Give the points of the wall, or "
        "change max_distance_mm, reference or max_angle_deg."
    )


def _unit(vector: npt.ArrayLike, where: str) -> Array:
    """Return a vector (3,) of length 1, or raise an `InputError`."""
    array = check_finite(vector, where)
    check_shape(array, (3,), where)
    length = float(np.linalg.norm(array))
    check_positive(length, f"{where}, length")
    return array / length


def distance_to_axis(points_mm: npt.ArrayLike, cylinder: Cylinder) -> Array:
    """Return the distance (n,) in mm of points (n, 3) from the axis.

    Examples
    --------
    >>> distance_to_axis([[3.0, 4.0, 9000.0]], Cylinder((0, 0, 0), (0, 0, 1), 700.0)).tolist()
    [5.0]
    """
    points = np.ascontiguousarray(check_finite(points_mm, "distance to axis: points"))
    if points.size == 0:
        return np.empty(0)
    check_shape(points, (None, 3), "distance to axis: points")
    return residuals(points, Axis(np.array(cylinder.centre_mm), np.array(cylinder.direction), 0.0))


def crossing(in_air_mm: npt.ArrayLike, wall_mm: npt.ArrayLike) -> float:
    """Return the distance in mm where the Gaussians of two sets cross.

    Parameters
    ----------
    in_air_mm, wall_mm
        Distances from the axis of particles in the air and on the wall; two or more each.

    Raises
    ------
    InputError
        If a set has fewer than two different values, the wall's mean is not the larger one,
        or one Gaussian is above the other all the way between the means.

    Notes
    -----
    Section 3.2 takes "expectation and standard deviation of the respective distance" and
    names no number, so both Gaussians have area 1.
    """
    sets = [check_finite(values, "crossing: distances").ravel() for values in (in_air_mm, wall_mm)]
    if any(len(values) < 2 or np.ptp(values) == 0 for values in sets):
        raise InputError(
            f"crossing: {len(sets[0])} and {len(sets[1])} distances; a Gaussian takes at least two "
            "different ones of each kind."
        )
    low, high = (float(values.mean()) for values in sets)
    sigmas = [float(values.std(ddof=1)) for values in sets]
    if not low < high:
        raise InputError(
            f"crossing: particles in the air are {low:.1f} mm from the axis on average, those on "
            f"the wall {high:.1f} mm. Is the order of the arguments right?"
        )
    # Twice the log of the ratio of both Gaussians, a quadratic of the distance.
    first, second = (
        np.array([1.0, -2 * mean, mean**2]) / sigma**2
        for mean, sigma in zip((0.0, high - low), sigmas, strict=True)
    )
    ratio = second - first
    ratio[-1] += 2 * np.log(sigmas[1] / sigmas[0])
    between = [x.real for x in np.roots(ratio) if x.imag == 0 and 0 <= x.real <= high - low]
    if not between:
        raise InputError(
            f"crossing: the Gaussians {low:.1f} +- {sigmas[0]:.1f} mm and {high:.1f} +- "
            f"{sigmas[1]:.1f} mm do not cross between their means; give a threshold instead."
        )
    return low + float(between[0])


@dataclass(frozen=True)
class InAir:
    """Classify points as in the air or on the wall (section 5.1.4)."""

    threshold_mm: float = 800.0  # sec. 5.1.4; the Gaussians of Fig. 3.11 cross at about 760

    def __post_init__(self) -> None:
        """Refuse a threshold that is no distance."""
        check_positive(self.threshold_mm, "InAir: threshold_mm")

    def __call__(self, points_mm: npt.ArrayLike, cylinder: Cylinder) -> npt.NDArray[np.bool_]:
        """Return whether each point (n, 3) is within the threshold.

        A row of three NaN is a detection without 3D. The thesis classifies "only particles
        with 3D information"; such a row is False here and in `on_wall`.
        """
        return _known_distance(points_mm, cylinder) <= self.threshold_mm

    def on_wall(self, points_mm: npt.ArrayLike, cylinder: Cylinder) -> npt.NDArray[np.bool_]:
        """Return whether each point (n, 3) is beyond the threshold."""
        return _known_distance(points_mm, cylinder) > self.threshold_mm


def _known_distance(points_mm: npt.ArrayLike, cylinder: Cylinder) -> Array:
    """Return the distance (n,) of points (n, 3), NaN where unknown."""
    points = np.asarray(points_mm, dtype=np.float64)
    if points.size == 0:
        points = points.reshape(0, 3)
    check_shape(points, (None, 3), "InAir: points")
    known = ~np.isnan(points).all(axis=1)
    distance = np.full(len(points), np.nan)
    distance[known] = distance_to_axis(points[known], cylinder)
    return distance


class Axis(NamedTuple):
    """A cylinder as arrays."""

    centre: Array
    direction: Array
    radius: float


def residuals(points: Array, axis: Axis) -> Array:
    """Return the signed distances (n,) from the surface, outside positive."""
    side = np.cross(points - axis.centre, axis.direction)
    return np.asarray(np.linalg.norm(side, axis=1) - axis.radius)


def search(points: Array, fit: CylinderFit, generator: np.random.Generator) -> Axis | None:
    """Return the most likely cylinder of all trials, or None.

    A trial is a direction drawn evenly from the cone and the circle through three points
    seen along it.
    """
    middle = np.median(points, axis=0)
    local = points - middle
    # Outliers are as likely anywhere across the cloud; far ones must not widen it.
    reach = np.quantile(np.linalg.norm(local, axis=1), 0.95)
    width = max(2 * float(reach), fit.max_distance_mm)
    half_length = float(np.quantile(np.abs(local @ fit.reference), 0.95))
    directions = draw_directions(fit, generator)
    triples = local[generator.integers(len(points), size=(len(directions), 3))]
    centres, radii = circles(triples, directions)
    # A larger circle is flatter over the cloud than the maximum distance: as good as a plane.
    flat = width**2 / (8 * fit.max_distance_mm)
    usable = (radii > fit.max_distance_mm) & (radii < flat)
    sigma = fit.max_distance_mm / GAUSSIAN_95
    good = good_directions(fit, half_length)
    least, best, share, tried = np.inf, -1, 0.0, 0
    while tried < fit.trials and (1 - good * share**3) ** tried >= 1 - fit.confidence:
        batch = tried + np.flatnonzero(usable[tried : tried + BATCH])
        costs, shares = likelihood(
            local, centres[batch], directions[batch], radii[batch], sigma, width
        )
        if len(batch) and costs.min() < least:
            first = int(np.argmin(costs))
            least, best, share = float(costs[first]), int(batch[first]), float(shares[first])
        tried += BATCH
    if best < 0:
        return None
    return Axis(centres[best] + middle, directions[best], float(radii[best]))


def good_directions(fit: CylinderFit, half_length_mm: float) -> float:
    """Return the share of good directions in the cone."""
    widest = np.radians(fit.max_angle_deg)
    angle = min(fit.max_distance_mm / max(half_length_mm, 1e-9), widest)
    return float((1 - np.cos(angle)) / (1 - np.cos(widest)))


def across(direction: Array | Vector) -> Array:
    """Return two unit vectors (2, 3) normal to a vector and each other."""
    along = np.asarray(direction)
    first = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(along, first)])


def draw_directions(fit: CylinderFit, generator: np.random.Generator) -> Array:
    """Return unit vectors (trials, 3) drawn evenly from the cone."""
    widest = np.radians(fit.max_angle_deg)
    cosine = 1 - generator.random(int(fit.trials)) * (1 - np.cos(widest))
    turn = generator.uniform(0, 2 * np.pi, len(cosine))
    side = np.column_stack([np.cos(turn), np.sin(turn)]) @ across(fit.reference)
    return cosine[:, None] * fit.reference + np.sqrt(1 - cosine**2)[:, None] * side


def circles(triples: Array, directions: Array) -> tuple[Array, Array]:
    """Return centres (n, 3) and radii (n,) of circles through triples.

    The triples (n, 3, 3) are seen along the directions (n, 3); those in line have no radius (NaN).
    """
    heights = np.einsum("nki,ni->nk", triples, directions)
    flat = triples - heights[:, :, None] * directions[:, None]
    first, second = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    normal = np.cross(first, second)
    square = (normal**2).sum(axis=1, keepdims=True)
    weighted = (first**2).sum(axis=1, keepdims=True) * second
    weighted -= (second**2).sum(axis=1, keepdims=True) * first
    way = np.cross(weighted, normal) / np.where(square == 0, np.nan, 2 * square)
    return flat[:, 0] + way, np.linalg.norm(way, axis=1)


def likelihood(
    points: Array, centres: Array, directions: Array, radii: Array, sigma: float, width: float
) -> tuple[Array, Array]:
    """Return negative log likelihood and mixing (m,) of each cylinder.

    A distance is Gaussian (sigma) with the probability of the mixing coefficient, else even
    over ``width``. The coefficient is estimated by EM from 1/2 (Torr and Zisserman, Eqs 17,
    18 and their algorithm).
    """
    costs, mixings = np.empty(len(radii)), np.full(len(radii), 0.5)
    for trial, axis in enumerate(map(Axis, centres, directions, radii)):
        distance, mixing = residuals(points, axis) / sigma, 0.5
        inlier = np.exp(-0.5 * distance**2) / (np.sqrt(2 * np.pi) * sigma)
        for _ in range(EM_STEPS):
            share = mixing * inlier
            mixing = float(np.mean(share / (share + (1 - mixing) / width)))
        costs[trial] = -np.log(mixing * inlier + (1 - mixing) / width).sum()
        mixings[trial] = mixing
    return costs, mixings


def refine(points: Array, start: Axis, fit: CylinderFit) -> Axis:
    """Return the cylinder fitted to its inliers by least squares (soft L1).

    The inliers are taken anew until axis and radius stay. One round would keep the mark of the
    trial it started from, on a short arc some centimetres of the radius.
    """
    frame = across(fit.reference)
    widest = np.tan(np.radians(fit.max_angle_deg))
    centre, direction, radius = start

    def axis(unknown: Array) -> Axis:
        # A smooth map of the whole plane into the cone: no bounds are needed.
        tilt = widest * unknown[:2] / np.sqrt(1 + unknown[:2] @ unknown[:2])
        along = fit.reference + tilt @ frame
        place = centre + radius * (unknown[2:4] @ frame)
        return Axis(place, along / np.linalg.norm(along), radius * float(unknown[4]))

    def cost(inliers: Array, unknown: Array) -> Array:
        return residuals(inliers, axis(unknown))

    tilt = frame @ direction / (direction @ fit.reference) / widest
    tilt *= min(1.0, 0.9 / max(float(np.linalg.norm(tilt)), 0.9))
    unknown = np.array([*(tilt / np.sqrt(1 - tilt @ tilt)), 0.0, 0.0, 1.0])
    for _ in range(ROUNDS):
        near = np.abs(residuals(points, axis(unknown))) <= fit.max_distance_mm
        if np.count_nonzero(near) < len(unknown):
            break
        before = unknown
        unknown = least_squares(
            partial(cost, points[near]),
            unknown,
            loss="soft_l1",
            f_scale=fit.max_distance_mm / GAUSSIAN_95,
            max_nfev=20,
        ).x
        if np.abs(unknown - before).max() * radius < SETTLED_MM:
            break
    return axis(unknown)


def covered_arc(points: Array, axis: Axis) -> float:
    """Return the angle in rad that most inliers (n, 3) cover."""
    side = across(axis.direction) @ (points - axis.centre).T
    angles = np.arctan2(side[1], side[0])
    counts = np.histogram(angles, bins=36, range=(-np.pi, np.pi))[0]
    filled = np.flatnonzero(counts > 0.2 * counts[counts > 0].mean())
    gaps = np.diff(filled, append=filled[0] + 36)
    begin = np.roll(filled, -1)[np.argmax(gaps)]  # behind the widest gap
    turned = (angles - (2 * np.pi * begin / 36 - np.pi)) % (2 * np.pi)
    return float(np.ptp(turned[turned < 2 * np.pi * (37 - gaps.max()) / 36]))


def bending(along: Array, signed: Array, distance: float) -> float:
    """Return by how many mm the surface bends from middle to ends.

    It is 0 for a cylinder and, on a ball, the sagitta of the band within ``distance``.
    """
    near = np.abs(signed) <= distance
    low, high = np.quantile(along[near], ENDS)
    place = (along[near] - (low + high) / 2) / max(float(high - low) / 2, 1e-9)
    return float(np.linalg.lstsq(np.vander(place, 3), signed[near])[0][0])
