r"""The kiln's wall as a cylinder, and the particles in the air.

Sections 3.2 and 5.1.4 of the thesis::

    wall points -> fit_cylinder -> Cylinder -> distance_to_axis -> crossing: threshold
                                          \-> InAir

The fit is MLESAC (Torr and Zisserman 2000, reference 113 of the thesis).
"""

from functools import partial

import numpy as np
from scipy.optimize import least_squares

from kilnflight.arrays import Array, ArrayLike, Flags, Generator, Pair
from kilnflight.checks import (
    CountFrom0,
    InputError,
    NotNegative,
    Number,
    Positive,
    Settings,
    check_finite,
    check_number,
)

# The thesis limits the distance of inliers and gives the z-axis (section 3.2), without
# numbers.
MAX_DISTANCE_MM = 50.0  # largest distance of an inlier
MAX_ANGLE_DEG = 5.0  # largest angle of axis and z; Table 5.12 has 1.7
TRIALS = 1000  # most trials
CONFIDENCE = 0.99  # that a good trial was among them
MIN_SHARE = 0.5  # least share of inliers: the wall is the majority
FEWEST_POINTS = 10  # twice the five unknowns of a cylinder
_Z = np.array([0.0, 0.0, 1.0])
_ACROSS = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
_WIDEST = np.radians(MAX_ANGLE_DEG)
# 95 % of the inliers stay within 1.96 sigma (Torr and Zisserman).
_SIGMA_MM = MAX_DISTANCE_MM / 1.96
_BATCH = 100  # trials between two tests of the confidence
_SCORED_POINTS = 2000  # enough to compare trials; the refinement takes all


class Cylinder(Settings):
    """An infinite cylinder, the kiln's wall, with the quality of its fit.

    Parameters
    ----------
    centre_mm
        Point x, y, z of the axis; of a fit, the middle of the inliers along it.
    direction
        Direction of the axis; any length but 0.
    radius_mm
        Distance of the wall from the axis.
    inliers
        Number of fitted points within `MAX_DISTANCE_MM` of the wall; None: not fitted.
    rms_mm
        Root mean square distance of the inliers from the wall; None: not fitted.

    Examples
    --------
    The wall of Table 5.12:

    >>> centre = (74.275, 495.0013, 9257.7)
    >>> wall = Cylinder(centre, (21.6677, -41.4764, 1533.6), radius_mm=772.1827)
    >>> distance_to_axis([(74.275, 0.0, 9257.7)], wall).round(1).tolist()  # mm
    [494.8]
    """

    centre_mm: tuple[Number, Number, Number]
    direction: tuple[Number, Number, Number]
    radius_mm: Positive
    inliers: CountFrom0 | None = None
    rms_mm: NotNegative | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        length = np.linalg.norm(self.direction)
        check_number(length, "Cylinder: length of direction", above=0)


def fit_cylinder(points_mm: ArrayLike, seed: int | Generator = 0) -> Cylinder:
    """Fit a cylinder along z to the wall's cluster by MLESAC (section 3.2).

    Parameters
    ----------
    points_mm
        (n, 3) x, y, z of the cluster; other points may be among them.
    seed
        Seed of the trials; the same one gives the same cylinder.

    Returns
    -------
    Cylinder
        With a unit direction, along +z, and the quality of the fit.

    Raises
    ------
    InputError
        If the points are not finite, not (n, 3) or fewer than `FEWEST_POINTS`, or if
        fewer than `MIN_SHARE` of them lie on the best cylinder.

    Notes
    -----
    A trial is a direction from the cone round z and the circle through three points
    seen along it. The camera's depth errors are common to whole patches, so normals
    estimated from neighbours would be wrong. Errors of depth shift points along the
    line of sight, and so the axis towards it: errors of half the ring's length
    (standard deviations) by about one degree.

    Examples
    --------
    >>> angle, z = np.meshgrid(np.linspace(0, 3, 40), np.linspace(8000, 9000, 20))
    >>> wall = np.stack([770 * np.cos(angle), 770 * np.sin(angle), z], axis=-1)
    >>> found = fit_cylinder(wall.reshape(-1, 3))
    >>> round(found.radius_mm), found.inliers
    (770, 800)
    """
    points = check_finite(points_mm, "fit_cylinder: points_mm", (None, 3))
    check_number(len(points), "fit_cylinder: number of points_mm", least=FEWEST_POINTS)
    generator = np.random.default_rng(seed)
    scored = points
    if len(points) > _SCORED_POINTS:
        scored = points[generator.choice(len(points), _SCORED_POINTS, replace=False)]
    trial = _search(scored, generator)
    if trial is None:
        raise InputError("fit_cylinder: points_mm lie in one line or plane along z.")
    centre, direction, radius = _refine(points, *trial)
    signed = _residuals(points, centre, direction, radius)
    near = np.abs(signed) <= MAX_DISTANCE_MM
    if near.sum() < max(MIN_SHARE * len(points), FEWEST_POINTS):
        raise InputError(
            f"fit_cylinder: points_mm hold no cylinder: {near.sum()} of {len(points)} "
            f"lie within {MAX_DISTANCE_MM:g} mm of the best one. Give the points of "
            "the wall."
        )
    middle = np.quantile(((points - centre) @ direction)[near], (0.02, 0.98)).mean()
    return Cylinder(
        centre_mm=tuple((centre + middle * direction).tolist()),
        direction=tuple(direction.tolist()),
        radius_mm=radius,
        inliers=int(near.sum()),
        rms_mm=float(np.sqrt(np.mean(signed[near] ** 2))),
    )


def distance_to_axis(points_mm: ArrayLike, cylinder: Cylinder) -> Array:
    """Return the distance (n,) in mm of points (n, 3) from the axis.

    Examples
    --------
    >>> wall = Cylinder((0, 0, 0), (0, 0, 1), radius_mm=700.0)
    >>> distance_to_axis([[3.0, 4.0, 9000.0]], wall).tolist()
    [5.0]
    """
    points = check_finite(points_mm, "distance_to_axis: points_mm", (None, 3))
    direction = np.array(cylinder.direction, np.float64)
    direction /= np.linalg.norm(direction)
    return _residuals(points, np.asarray(cylinder.centre_mm), direction, 0.0)


def crossing(in_air_mm: ArrayLike, wall_mm: ArrayLike) -> float:
    """Return the distance in mm at which the Gaussians of two sets cross.

    It is the threshold between particles in the air and on the wall (section 3.2, Fig.
    3.11).

    Parameters
    ----------
    in_air_mm, wall_mm
        Distances from the axis, (n,) and (m,), of particles in the air and on the wall;
        two or more each.

    Raises
    ------
    InputError
        If a set has fewer than two different values, the wall's mean is not the larger
        one, or one Gaussian is above the other all the way between the means.

    Notes
    -----
    Section 3.2 takes "expectation and standard deviation of the respective distance"
    and names no number, so both Gaussians have area 1.
    """
    air = check_finite(in_air_mm, "crossing: in_air_mm", (None,))
    wall = check_finite(wall_mm, "crossing: wall_mm", (None,))
    if min(np.unique(air).size, np.unique(wall).size) < 2:
        raise InputError(
            "crossing: in_air_mm and wall_mm must hold two different values each."
        )
    low = air.mean()
    high = wall.mean()
    narrow = air.std(ddof=1)
    wide = wall.std(ddof=1)
    apart = high - low
    # Twice the log of the ratio of both Gaussians, a quadratic of the distance.
    ratio = np.array([1.0, -2 * apart, apart**2]) / wide**2
    ratio -= np.array([1.0, 0.0, 0.0]) / narrow**2
    ratio[-1] += 2 * np.log(wide / narrow)
    between = [x.real for x in np.roots(ratio) if x.imag == 0 and 0 <= x.real <= apart]
    if not between:
        raise InputError(
            f"crossing: the Gaussians of in_air_mm, {low:.1f} +- {narrow:.1f} mm, and "
            f"wall_mm, {high:.1f} +- {wide:.1f} mm, do not cross between ascending "
            "means."
        )
    return float(low + between[0])


class InAir(Settings):
    """Classify points by their distance from the axis (section 5.1.4).

    Up to ``threshold_mm`` they are in the air, beyond it on the wall. `crossing` finds
    a threshold.

    Parameters
    ----------
    threshold_mm
        Distance from the axis (section 5.1.4). The Gaussians of Fig. 3.11 cross at
        about 760 mm.

    Examples
    --------
    >>> wall = Cylinder((0, 0, 0), (0, 0, 1), radius_mm=772.0)
    >>> InAir()([[300, 0, 6000], [0, 810, 6000]], wall).tolist()
    [True, False]
    """

    threshold_mm: Positive = 800.0

    def __call__(self, points_mm: ArrayLike, cylinder: Cylinder) -> Flags:
        """Return whether each point (n, 3), in mm, is within the threshold, (n,).

        A row of three NaN is a detection without 3D. The thesis classifies "only
        particles with 3D information"; such a row is False here and in `on_wall`.
        """
        return _known_distance(points_mm, cylinder) <= self.threshold_mm

    def on_wall(self, points_mm: ArrayLike, cylinder: Cylinder) -> Flags:
        """Return whether each point (n, 3), in mm, is beyond the threshold, (n,)."""
        return _known_distance(points_mm, cylinder) > self.threshold_mm


def _known_distance(points_mm: ArrayLike, cylinder: Cylinder) -> Array:
    """Return the distance (n,) in mm of points (n, 3) from the axis; NaN if unknown."""
    points = check_finite(points_mm, "InAir: points_mm", (None, 3), gaps=True)
    known = ~np.isnan(points).all(axis=1)
    distance = np.full(len(points), np.nan)
    distance[known] = distance_to_axis(points[known], cylinder)
    return distance


def _residuals(points: Array, centre: Array, direction: Array, radius: float) -> Array:
    """Return the signed distances (n,) of points (n, 3) from a cylinder.

    Outside they are positive. All lengths are in mm; ``centre`` (3,) is on the axis and
    ``direction`` (3,) is a unit vector.
    """
    side = np.cross(points - centre, direction)
    return np.linalg.norm(side, axis=1) - radius


def _search(points: Array, generator: Generator) -> tuple[Array, Array, float] | None:
    """Return centre (3,), direction (3,) and radius of the most likely trial, in mm.

    ``points`` are (n, 3) in mm. A trial is one of `TRIALS` drawn directions with the
    circle through three drawn points. None if no trial has a usable radius.
    """
    middle = np.median(points, axis=0)
    local = points - middle
    # Outliers are as likely anywhere across the cloud; far ones must not widen it.
    reach = np.quantile(np.linalg.norm(local, axis=1), 0.95)
    width = max(2 * reach, MAX_DISTANCE_MM)
    # Unit vectors, even over the cone round z.
    cosine = 1 - generator.random(TRIALS) * (1 - np.cos(_WIDEST))
    turn = generator.uniform(0, 2 * np.pi, TRIALS)
    sine = np.sqrt(1 - cosine**2)
    directions = np.column_stack([-sine * np.sin(turn), sine * np.cos(turn), cosine])
    triples = local[generator.integers(len(points), size=(TRIALS, 3))]
    centres, radii = circles(triples, directions)
    # A larger circle is flatter over the cloud than the maximum distance: as good as a
    # plane.
    flat = width**2 / (8 * MAX_DISTANCE_MM)
    usable = (radii > MAX_DISTANCE_MM) & (radii < flat)
    # Share of the directions that keep the ends of the cloud within the maximum
    # distance. A trial is good with this probability, times that of three inliers.
    half_length = max(np.quantile(np.abs(local[:, 2]), 0.95), 1e-9)
    good = (1 - np.cos(min(MAX_DISTANCE_MM / half_length, _WIDEST))) / (
        1 - np.cos(_WIDEST)
    )
    least = np.inf
    best = -1
    share = 0.0
    tried = 0
    while tried < TRIALS and (1 - good * share**3) ** tried >= 1 - CONFIDENCE:
        batch = tried + np.flatnonzero(usable[tried : tried + _BATCH])
        costs, shares = likelihood(
            local, centres[batch], directions[batch], radii[batch], width
        )
        if len(batch) and costs.min() < least:
            first = np.argmin(costs)
            least = costs[first]
            best = batch[first]
            share = shares[first]
        tried += _BATCH
    if best < 0:
        return None
    return centres[best] + middle, directions[best], float(radii[best])


def circles(triples: Array, directions: Array) -> Pair:
    """Return centres (n, 3) and radii (n,) in mm of circles through triples.

    The triples (n, 3, 3) are projected along the directions (n, 3), unit vectors, onto
    a plane through the origin. Triples in line have no circle (NaN).
    """
    heights = np.einsum("nki,ni->nk", triples, directions)
    flat = triples - heights[:, :, None] * directions[:, None]
    first = flat[:, 1] - flat[:, 0]
    second = flat[:, 2] - flat[:, 0]
    normal = np.cross(first, second)
    square = (normal**2).sum(axis=1, keepdims=True)
    weighted = (first**2).sum(axis=1, keepdims=True) * second
    weighted -= (second**2).sum(axis=1, keepdims=True) * first
    way = np.cross(weighted, normal) / np.where(square == 0, np.nan, 2 * square)
    return flat[:, 0] + way, np.linalg.norm(way, axis=1)


def likelihood(
    points: Array, centres: Array, directions: Array, radii: Array, width: float
) -> Pair:
    """Return negative log likelihood and share of inliers (m,) of m cylinders.

    Parameters
    ----------
    points
        (n, 3) mm.
    centres, directions, radii
        (m, 3) in mm, (m, 3) unit vectors and (m,) in mm.
    width
        Length in mm over which the distances of outliers are uniform.

    Notes
    -----
    The distance of an inlier from the wall is Gaussian. The share of inliers is the
    mixing coefficient of both, estimated by EM from 1/2 (Torr and Zisserman, Eqs 17, 18
    and their algorithm).
    """
    costs = np.empty(len(radii))
    mixings = np.full(len(radii), 0.5)
    for trial, cylinder in enumerate(zip(centres, directions, radii, strict=True)):
        distance = _residuals(points, *cylinder) / _SIGMA_MM
        mixing = 0.5
        inlier = np.exp(-0.5 * distance**2) / (np.sqrt(2 * np.pi) * _SIGMA_MM)
        for _ in range(5):  # Torr and Zisserman: "two or three" suffice
            share = mixing * inlier
            mixing = np.mean(share / (share + (1 - mixing) / width))
        costs[trial] = -np.log(mixing * inlier + (1 - mixing) / width).sum()
        mixings[trial] = mixing
    return costs, mixings


def _refine(
    points: Array, centre: Array, direction: Array, radius: float
) -> tuple[Array, Array, float]:
    """Return centre (3,), direction (3,) and radius fitted to the inliers.

    The fit is least squares with soft L1. ``points`` are (n, 3) in mm; the start is a
    trial of `_search`. The inliers are chosen anew until axis and radius stay. A single
    round would depend on the trial, on a short arc by some centimetres of the radius.
    """
    widest = np.tan(_WIDEST)

    # The five unknowns: tilt of the axis (2), its offset across z (2) and radius, both
    # in radii.
    def cylinder(unknown: Array) -> tuple[Array, Array, float]:
        # A smooth map of the whole plane into the cone: no bounds are needed.
        tilt = widest * unknown[:2] / np.sqrt(1 + unknown[:2] @ unknown[:2])
        along = _Z + tilt @ _ACROSS
        place = centre + radius * (unknown[2:4] @ _ACROSS)
        return place, along / np.linalg.norm(along), radius * float(unknown[4])

    def cost(inliers: Array, unknown: Array) -> Array:
        return _residuals(inliers, *cylinder(unknown))

    # The inverse of that map has no value at the border of the cone, so the start is
    # inside it.
    tilt = _ACROSS @ direction / direction[2] / widest
    tilt *= min(1.0, 0.9 / max(float(np.linalg.norm(tilt)), 0.9))
    unknown = np.array([*(tilt / np.sqrt(1 - tilt @ tilt)), 0.0, 0.0, 1.0])
    for _ in range(30):
        near = np.abs(cost(points, unknown)) <= MAX_DISTANCE_MM
        if np.count_nonzero(near) < len(unknown):
            break
        before = unknown
        fit = partial(least_squares, partial(cost, points[near]))
        unknown = fit(unknown, loss="soft_l1", f_scale=_SIGMA_MM, max_nfev=20).x
        if np.abs(unknown - before).max() * radius < 0.1:  # mm
            break
    return cylinder(unknown)
