r"""The kiln's wall as a cylinder, and who is in the air (thesis, sections 3.2 and 5.1.4).

::

    wall points -> CylinderFit -> Cylinder -> distance_to_axis -> crossing (the threshold)
                                         \-> InAir
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kilnflight.checks import InputError, check_finite, check_positive, check_shape
from kilnflight.detection import mlesac

Array = npt.NDArray[np.float64]
Vector = tuple[float, float, float]

FEWEST_POINTS = 10  # twice the five unknowns of a cylinder
SCORED_POINTS = 2000  # enough to compare trials; the refinement takes all


@dataclass(frozen=True)
class Cylinder:
    """A cylinder without ends and, where it was fitted, how well (else None).

    Parameters
    ----------
    centre_mm
        Point of the axis; of a fit, the middle of the inliers along it.
    direction
        Of the axis; any length, kept as a unit vector. Table 5.12 prints the vector from
        end to end of the inliers, here ``length_mm`` times ``direction``.
    radius_mm
        Of the wall.
    angle_deg
        Between axis and reference; close to the limit the cloud says little about the axis.
    length_mm, arc_deg
        Extent of the inliers along the axis (2nd to 98th percentile) and around it.
    inliers, points
        Points within the maximum distance, and all.
    rms_mm
        Root mean square distance of the inliers from the wall.
    mixing
        Share of points on the wall, as the likelihood has it (EM), before refinement.
    trials
        Cylinders that were compared.
    """

    centre_mm: Vector
    direction: Vector
    radius_mm: float
    angle_deg: float | None = None
    length_mm: float | None = None
    arc_deg: float | None = None
    inliers: int | None = None
    points: int | None = None
    rms_mm: float | None = None
    mixing: float | None = None
    trials: int | None = None

    def __post_init__(self) -> None:
        """Refuse what is no cylinder; make the direction a unit vector."""
        check_positive(self.radius_mm, "cylinder: radius_mm")
        centre = check_finite(self.centre_mm, "cylinder: centre_mm")
        check_shape(centre, (3,), "cylinder: centre_mm")
        object.__setattr__(self, "centre_mm", tuple(centre.tolist()))
        direction = _unit(self.direction, "cylinder: direction")
        object.__setattr__(self, "direction", tuple(direction.tolist()))


@dataclass(frozen=True)
class CylinderFit:
    """MLESAC fit of a cylinder whose axis is roughly known (section 3.2, thesis).

    Notes
    -----
    The thesis prints no parameter of its fit; it names a maximum distance and the z-axis.
    A trial is a direction from the allowed cone and the circle through three points seen
    along it: the camera's depth errors are common to whole patches, so normals estimated
    from neighbours, as others take them, would say nothing. A direction counts as good for
    the confidence if it keeps the ends of the cloud within the maximum distance. Errors of
    depth shift points along the line of sight and so draw the axis towards it: by about one
    degree where they are half as large as the ring is long (standard deviations).
    """

    max_distance_mm: float = 50.0  # of an inlier from the wall; not printed
    reference: Vector = (0.0, 0.0, 1.0)  # the z-axis, sec. 3.2
    max_angle_deg: float = 5.0  # between axis and reference, below 90; Table 5.12 has 1.7
    trials: int = 1000  # at most
    confidence: float = 0.99  # that a good trial was among them
    min_share: float = 0.5  # of the points, that must be inliers: the wall is the majority
    refine: bool = True  # least squares (soft L1) of the geometric distances of inliers

    def __post_init__(self) -> None:
        """Refuse parameters out of range."""
        check_positive(self.max_distance_mm, "CylinderFit: max_distance_mm")
        _unit(self.reference, "CylinderFit: reference")
        for name, high in (("max_angle_deg", 90), ("confidence", 1), ("min_share", 1)):
            if not 0 < getattr(self, name) < high:
                raise InputError(
                    f"CylinderFit: {name} is {getattr(self, name)}; take one between 0 and {high}."
                )
        if not isinstance(self.trials, int) or self.trials < 1:
            raise InputError(f"CylinderFit: trials is {self.trials!r}; take a whole number from 1.")

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
            too few lie on the best one, or it cannot be told from a plane, a ball or a line.
        """
        points = np.ascontiguousarray(check_finite(points_mm, "cylinder fit: points"))
        check_shape(points, (None, 3), "cylinder fit: points")
        if len(points) < FEWEST_POINTS:
            raise InputError(
                f"cylinder fit: {len(points)} point(s) do not determine a cylinder; give at "
                f"least {FEWEST_POINTS} points of the wall."
            )
        generator = np.random.default_rng(seed)
        scored = points
        if len(points) > SCORED_POINTS:
            scored = points[generator.choice(len(points), SCORED_POINTS, replace=False)]
        reference = _unit(self.reference, "CylinderFit: reference")
        limits = mlesac.Limits(reference, self.max_angle_deg, self.max_distance_mm)
        found = mlesac.search(scored, limits, self.trials, self.confidence, generator)
        if found is None:
            raise _no_cylinder("its points are in one line or plane")
        axis = mlesac.refine(points, found.axis, limits) if self.refine else found.axis
        return self._judged(points, axis, reference, found)

    def _judged(
        self, points: Array, axis: mlesac.Axis, reference: Array, found: mlesac.Found
    ) -> Cylinder:
        """Return the cylinder with its quality, or raise where the cloud holds none."""
        signed = mlesac.residuals(points, axis)
        near = np.abs(signed) <= self.max_distance_mm
        inliers = int(np.count_nonzero(near))
        if inliers < max(self.min_share * len(points), FEWEST_POINTS):
            raise _no_cylinder(
                f"of {len(points)} points {inliers} lie within {self.max_distance_mm:g} mm of the "
                f"best one, fewer than {self.min_share:.0%}"
            )
        along = (points - axis.centre) @ axis.direction
        arc = mlesac.covered_arc(points[near], axis)
        bend = mlesac.bend(along, signed, 3 * self.max_distance_mm)
        if not axis.radius > self.max_distance_mm:
            raise _no_cylinder(f"the best one has a radius of {axis.radius:.0f} mm, a line")
        if axis.radius * (1 - np.cos(arc / 2)) < self.max_distance_mm:
            raise _no_cylinder(f"an arc of {np.degrees(arc):.1f} degrees is flat, a plane")
        if abs(bend) > self.max_distance_mm:
            raise _no_cylinder(f"it bends by {abs(bend):.0f} mm along the axis, a ball")
        low, high = np.quantile(along[near], [0.02, 0.98])
        x, y, z = (axis.centre + (low + high) / 2 * axis.direction).tolist()
        cosine = min(float(axis.direction @ reference), 1.0)
        return Cylinder(
            centre_mm=(x, y, z),
            direction=tuple(axis.direction.tolist()),
            radius_mm=axis.radius,
            angle_deg=float(np.degrees(np.arccos(cosine))),
            length_mm=float(high - low),
            arc_deg=float(np.degrees(arc)),
            inliers=inliers,
            points=len(points),
            rms_mm=float(np.sqrt(np.mean(signed[near] ** 2))),
            mixing=found.mixing,
            trials=found.trials,
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
    """Return the Euclidean distance (n,) in mm of points (n, 3) from the axis (section 3.2).

    Examples
    --------
    >>> distance_to_axis([[3.0, 4.0, 9000.0]], Cylinder((0, 0, 0), (0, 0, 1), 700.0)).tolist()
    [5.0]
    """
    points = np.ascontiguousarray(check_finite(points_mm, "distance to axis: points"))
    if points.size == 0:
        return np.empty(0)
    check_shape(points, (None, 3), "distance to axis: points")
    return mlesac.residuals(
        points, mlesac.Axis(np.array(cylinder.centre_mm), np.array(cylinder.direction), 0.0)
    )


def crossing(in_air_mm: npt.ArrayLike, wall_mm: npt.ArrayLike, *, by_number: bool = False) -> float:
    """Return where the Gaussians of two sets of distances cross between their means, in mm.

    Parameters
    ----------
    in_air_mm, wall_mm
        Distances from the axis of particles in the air and on the wall; two or more each.
    by_number
        Whether each Gaussian is as high as its set has particles.

    Raises
    ------
    InputError
        If a set has fewer than two different values, the wall's mean is not the larger one,
        or one Gaussian is above the other all the way between the means.

    Notes
    -----
    Section 3.2 takes "expectation and standard deviation of the respective distance" and
    names no number, so both Gaussians have area 1; the axis of Fig. 3.11 counts particles,
    which ``by_number`` follows.
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
    weights = [len(values) if by_number else 1 for values in sets]
    # Twice the log of the ratio of both Gaussians, a quadratic of the distance.
    first, second = (
        np.array([1.0, -2 * mean, mean**2]) / sigma**2
        for mean, sigma in zip((0.0, high - low), sigmas, strict=True)
    )
    ratio = second - first
    ratio[-1] += 2 * np.log(weights[0] * sigmas[1] / (weights[1] * sigmas[0]))
    between = [x.real for x in np.roots(ratio) if x.imag == 0 and 0 <= x.real <= high - low]
    if not between:
        raise InputError(
            f"crossing: the Gaussians {low:.1f} +- {sigmas[0]:.1f} mm and {high:.1f} +- "
            f"{sigmas[1]:.1f} mm do not cross between their means; give a threshold instead."
        )
    return low + float(between[0])


@dataclass(frozen=True)
class InAir:
    """In the air or on the wall, by the distance from the axis (sections 3.2 and 5.1.4)."""

    threshold_mm: float = 800.0  # sec. 5.1.4; the Gaussians of Fig. 3.11 cross at about 760

    def __post_init__(self) -> None:
        """Refuse a threshold that is no distance."""
        check_positive(self.threshold_mm, "InAir: threshold_mm")

    def __call__(self, points_mm: npt.ArrayLike, cylinder: Cylinder) -> npt.NDArray[np.bool_]:
        """Return which points (n, 3) are in the air, (n,): not beyond the threshold.

        A row of three NaN is a detection without 3D. The thesis classifies "only particles
        with 3D information"; such a row is False here and in `on_wall`.
        """
        distance, known = self._distance(points_mm, cylinder)
        return known & (distance <= self.threshold_mm)

    def on_wall(self, points_mm: npt.ArrayLike, cylinder: Cylinder) -> npt.NDArray[np.bool_]:
        """Return which points (n, 3) are on the wall, (n,); False without 3D."""
        distance, known = self._distance(points_mm, cylinder)
        return known & (distance > self.threshold_mm)

    @staticmethod
    def _distance(
        points_mm: npt.ArrayLike, cylinder: Cylinder
    ) -> tuple[Array, npt.NDArray[np.bool_]]:
        points = np.asarray(points_mm, dtype=np.float64)
        if points.size == 0:
            points = points.reshape(0, 3)
        check_shape(points, (None, 3), "InAir: points")
        known = np.asarray(~np.isnan(points).all(axis=1))
        distance = np.zeros(len(points))
        distance[known] = distance_to_axis(points[known], cylinder)
        return distance, known
