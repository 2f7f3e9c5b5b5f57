"""Motion models, Kalman filter and 2.5D gate of all tracks at once.

Sections 2.3.1, 2.3.3, 4.1.1 and 4.1.2 of the thesis. A state is one row of an (n, k)
array, its covariance one (k, k) slice of an (n, k, k) array. It lists all positions,
then all velocities (Eq. 4.1), then all accelerations. Lengths are in px and times in
frames; the belt takes mm and s. The control input B u of Eq. 2.42 is 0.

======================  =========  ==================================  ==============
motion                  equation   default of the noise                source
======================  =========  ==================================  ==============
`ConstantVelocity`      4.1-4.5    1 px/frame^1.5, tumbling sheets     thesis, 4.1.1
`ConstantAcceleration`  white      0.3 px/frame^2.5, particles that    belt papers
                        jerk       a belt accelerates                  2016 and 2020
======================  =========  ==================================  ==============

Notes
-----
The thesis prints neither process nor measurement noise. The defaults follow from the
scene: 330 frames/s and about 3 mm per px at the lance make 5 to 30 px/frame. Drag
changes that by a fraction of a px/frame in each frame. The centroid of a tumbling
sheet, lit from the side, jumps by 1 to 3 px. The defaults are not tuned to any result.
"""

import math
from typing import Annotated, Any, NamedTuple

import numpy as np
from scipy.linalg import toeplitz
from scipy.special import gammainc

from kilnflight.arrays import Array, Flags, Integers, Pair
from kilnflight.association import Pairs
from kilnflight.checks import (
    InputError,
    Number,
    Range,
    Settings,
    Unlimited,
    check_number,
)
from kilnflight.compiled import compiled

NO_ROWS: Integers = np.zeros(0, np.intp)


class Motion(Settings):
    """Motion in d dimensions whose highest derivative is constant but for white noise.

    A state has k = d times the number of ``spreads`` entries. The noise is continuous,
    so two steps of one frame equal one step of two frames.

    Parameters
    ----------
    velocity
        (d,) px/frame, of a new track.
    spreads
        Standard deviations of a measurement (px), of a new track's velocity (px/frame)
        and, if given, of its acceleration (px/frame^2).
    noise
        Root of the density of the white noise: px/frame^1.5 of an acceleration,
        px/frame^2.5 of a jerk.
    """

    velocity: tuple[Number, ...]
    spreads: tuple[Number, ...]
    noise: Annotated[float, Range(above=0, most=1e30)]

    def __post_init__(self) -> None:
        names = ("measurement_sd", "velocity_sd", "acceleration_sd")
        spreads = np.array(self.spreads, object, ndmin=1)
        for name, spread in zip(names, spreads, strict=False):
            check_number(spread, f"Motion: {name}", above=0, most=1e30)
        super().__post_init__()
        check_number(len(self.spreads), "Motion: number of spreads", least=2, most=3)
        check_number(len(self.velocity), "Motion: dimensions of velocity", least=1)

    def transition(self, frames: float) -> Array:
        """Return the transition matrix F (k, k) over a number of frames (Eq. 4.4)."""
        powers = [frames**k / math.factorial(k) for k in range(len(self.spreads))]
        block: Any = toeplitz(np.eye(1, len(powers))[0], powers)
        return np.kron(block, np.eye(len(self.velocity)))

    def process_noise(self, frames: float) -> Array:
        """Return the covariance Q (k, k) of the white noise over a number of frames."""
        # Imported late: it imports matplotlib and more.
        from filterpy.common import Q_continuous_white_noise

        return Q_continuous_white_noise(
            dim=len(self.spreads),
            dt=frames,
            spectral_density=self.noise**2,
            block_size=len(self.velocity),
            order_by_dim=False,
        )

    def measurement_noise(self) -> Array:
        """Return the covariance R (d, d) of a measurement in px^2, one for all axes."""
        return self.spreads[0] ** 2 * np.eye(len(self.velocity))

    def initial(self) -> Pair:
        """Return the state (k,) and covariance (k, k) of a new track at the origin."""
        axes = len(self.velocity)
        variance = np.repeat(np.square(self.spreads), axes)
        state = np.zeros(len(variance))
        state[axes : 2 * axes] = self.velocity
        return state, np.diag(variance)


def ConstantVelocity(  # noqa: N802  named as the model
    velocity: tuple[float, ...] = (0.0, 0.0),
    velocity_sd: float = 15.0,
    acceleration_noise: float = 1.0,
    measurement_sd: float = 2.0,
) -> Motion:
    """Return uniform motion with white noise of the acceleration (Eqs 4.1 to 4.5).

    Eq. 4.5 prints no Q. The thesis takes the motion between two frames as uniform
    (section 2.3.1).

    Parameters
    ----------
    velocity
        (d,) px/frame, of a new track.
    velocity_sd
        Standard deviation of a new track's velocity in px/frame; not printed. 30
        px/frame, the fastest, are two of the default.
    acceleration_noise
        Root of the density of the white noise in px/frame^1.5; not printed. The default
        changes the velocity by 1 px/frame in a frame.
    measurement_sd
        Standard deviation of a measurement in px; not printed. The centroid of a
        tumbling sheet jumps by 1 to 3 px.

    Returns
    -------
    Motion
        Model whose state has 2 d numbers: positions, then velocities.

    Examples
    --------
    After two frames a particle at 5 px that moves by 3 px/frame is at 11 px.

    >>> motion = ConstantVelocity(velocity=(3.0,))
    >>> (motion.transition(2) @ [5.0, 3.0]).tolist()
    [11.0, 3.0]
    """
    return Motion(velocity, (measurement_sd, velocity_sd), acceleration_noise)


def ConstantAcceleration(  # noqa: N802  named as the model
    velocity: tuple[float, ...] = (0.0, 0.0),
    velocity_sd: float = 15.0,
    acceleration_sd: float = 1.0,
    jerk_noise: float = 0.3,
    measurement_sd: float = 2.0,
) -> Motion:
    """Return uniform acceleration with white noise of the jerk.

    This is the motion model of the belt papers of 2016 and 2020. A new track has
    acceleration 0.

    Parameters
    ----------
    velocity, velocity_sd, measurement_sd
        As for `ConstantVelocity`.
    acceleration_sd
        Standard deviation of a new track's acceleration in px/frame^2; a fraction of
        the default is usual in the kiln.
    jerk_noise
        Root of the density of the white noise in px/frame^2.5. The default changes the
        acceleration by 0.3 px/frame^2 in a frame.

    Returns
    -------
    Motion
        Model whose state has 3 d numbers: positions, velocities, accelerations.
    """
    return Motion(velocity, (measurement_sd, velocity_sd, acceleration_sd), jerk_noise)


def predict(
    state: Array, covariance: Array, transition: Array, process_noise: Array
) -> Pair:
    """Return the state (n, k) and covariance (n, k, k) of all tracks one step later.

    F and Q, (k, k), are the same for all tracks.

    Notes
    -----
    Eqs 2.44 and 2.45, with B u = 0. Eq. 2.45 prints the prior covariance on its right,
    but the text below it says posterior, and so does Eq. 4.6. The posterior is taken
    here.
    """
    n, k = state.shape
    # One product of all rows takes half the time of one per track. P is symmetric, but
    # for rounding, which `update` makes even.
    half = (covariance.reshape(n * k, k) @ transition.T).reshape(n, k, k).mT
    spread = (half.reshape(n * k, k) @ transition.T).reshape(n, k, k) + process_noise
    return state @ transition.T, spread


def update(
    state: Array, covariance: Array, pairs: Pairs, weights: Array | Flags
) -> Pair:
    """Return the state (n, k) and covariance (n, k, k) after one frame's detections.

    Parameters
    ----------
    state, covariance
        Predictions of n tracks, (n, k) and (n, k, k).
    pairs
        Their gated pairs with the detections.
    weights
        (p,) of the pairs. One pair of weight 1 is the textbook update (Eqs 2.46-2.48).
        Without weights the prediction stays.

    Notes
    -----
    Eqs 2.52-2.56. Eq. 2.55 is taken as printed, by Cholesky's factor L of S. With W' =
    L^-1 H P, the gain is K = W L^-1 and K S K' = W W'. Eq. 2.56 is computed as the
    scatter of the innovations about their mean, "missed" counting as an innovation of
    zero. This is the printed term, as a sum of squares.
    """
    n, d = pairs.expected.shape
    track = pairs.track
    root = pairs.root @ covariance[:, :d]  # W' (n, d, k); H selects positions
    sums = [np.bincount(track, weights * axis, n) for axis in pairs.innovation.T]
    mean = np.array(sums).T
    given = np.bincount(track, weights, n)[:, None, None]  # 1 - the weight of "missed"
    moved = state + np.einsum("ndk,nd->nk", root, mean)  # Eqs 2.46 and 2.52
    spread = covariance - (given * root.mT) @ root  # Eq. 2.54 with 2.55
    if weights.dtype != np.bool_:
        scatter = (1.0 - given) * mean[:, :, None] * mean[:, None]
        apart = pairs.innovation - mean[track]
        squares = weights[:, None, None] * apart[:, :, None] * apart[:, None]
        np.add.at(scatter, track, squares)
        spread += root.mT @ scatter @ root  # Eq. 2.56
    return moved, 0.5 * (spread + spread.mT)


class Detected(NamedTuple):
    """Detections of one frame, m in number and in d dimensions."""

    positions: Array  # (m, d), px; on the belt mm
    depth_mm: Array | None = None  # (m,), NaN: no depth
    points: Array | None = None  # (m,), number of 3D points; NaN: unknown
    frame: int = 0  # its number
    # since the `Detected` before, in the unit of the motion: frames, or s (belt)
    span: float = 1.0
    rows: Integers = NO_ROWS  # (m,), row numbers in the table of detections


class Gate(Settings):
    """Limit the distance of detections from a track (Eq. 4.8).

    The gate is an elliptical cylinder (Fig. 4.2). A pair is inside if its Mahalanobis
    distance in the image and its difference in depth are both strictly below their
    limits. With ``distance`` 0 no pair passes.

    Notes
    -----
    Eq. 4.7 prints the covariance P of the state and the state x itself. A 2D distance
    between a prediction and a detection needs the predicted position. The covariance of
    their difference is S = H P H' + R, as in Eq. 2.50. These two are taken here.

    Neither limit is printed. ``distance`` 4 loses one detection of a thesis-like
    Gaussian track in 3000 (P_G = 0.9997), "a possibly large gating threshold" (4.1.3).
    JPDA's is "smaller than GNN" (section 5.2.3), by how much is not printed.
    ``depth_mm`` is the only step in depth that is printed, z_eps of Table 5.16. It
    holds for a gap of any length, since the error of the depth outweighs the motion. A
    pair without depth on either side is judged in the image alone.

    Parameters
    ----------
    distance
        d_ij,eps, Mahalanobis distance in standard deviations; not printed.
    depth_mm
        d_z,eps, difference in depth in mm; not printed, z_eps of Table 5.16. It may be
        infinite.

    Examples
    --------
    The scatter is 5 px, so the gate ends at 20 px.

    >>> seen = Detected(np.array([[0.0, 19.0], [0.0, 21.0]]))
    >>> pairs = Gate()(np.zeros((1, 2)), 25 * np.eye(2)[None], seen)
    >>> pairs.detection.tolist(), pairs.distance_squared.round(2).tolist()
    ([0], [14.44])
    """

    distance: Annotated[float, Range(least=0, most=1e6)] = 4.0  # areas stay finite
    depth_mm: Unlimited = 1500.0

    def __call__(
        self,
        expected: Array,
        residual: Array,
        detected: Detected,
        depth_mm: Array | None = None,
        points: Array | None = None,
    ) -> Pairs:
        """Return the pairs of n tracks and m detections within the gate.

        A pair whose depth is unknown on either side is judged by its distance in the
        image alone.

        Parameters
        ----------
        expected, residual
            Predicted positions (n, d) in px and residual covariances S (n, d, d) in
            px^2; on the belt in mm and mm^2.
        detected
            The m detections of the frame.
        depth_mm, points
            (n,) last known depth and number of 3D points of each track; NaN: unknown.
            None: unknown for all.

        Returns
        -------
        Pairs
            What associators and `update` need.

        Raises
        ------
        InputError
            If a residual covariance in the plane is singular.
        """
        logs, root = _root(residual)
        if np.isnan(logs).any():
            raise InputError(
                "motion: a residual covariance (S = H P H' + R) is singular. Give the "
                "motion more measurement noise."
            )
        d = expected.shape[1]
        limit = self.distance**2
        # One layout for all numbers of tracks: each other one would be compiled anew.
        places = np.ascontiguousarray(expected), root
        seen = np.ascontiguousarray(detected.positions, np.float64)
        i, j, innovation = _inside(*places, seen, limit)
        if depth_mm is not None and detected.depth_mm is not None:
            step = np.abs(depth_mm[i] - detected.depth_mm[j])
            near = ~(step >= self.depth_mm)  # NaN passes
            i = i[near]
            j = j[near]
            innovation = innovation[near]
        sizes = np.zeros(len(i))
        if points is not None and detected.points is not None:
            sizes = np.nan_to_num(np.abs(points[i] - detected.points[j]))
        ball = np.pi ** (d / 2) / math.gamma(d / 2 + 1)  # volume of the unit ball
        return Pairs(
            track=i,
            detection=j,
            distance_squared=np.einsum("pa,pa->p", innovation, innovation),
            size_difference=sizes,
            innovation=innovation,
            log_determinant=logs,
            gate_area=ball * self.distance**d * np.exp(logs / 2),
            gate_probability=gammainc(d / 2, limit / 2),
            expected=expected,
            residual=residual,
            root=root,
            detections=len(detected.positions),
        )


@compiled
def _root(matrices: Any) -> Any:
    """Return ln |S| (n,) and L^-1 of matrices S = L L' (n, d, d).

    Both are NaN where S is singular. Compiled, three times faster than by numpy for 60
    tracks.
    """
    logs = np.zeros(len(matrices))
    root = np.zeros_like(matrices)
    for i, a in np.ndindex(matrices.shape[:2]):
        # Row a of L^-1: of unit length in S, orthogonal to those above it.
        rest = matrices[i, a, a]
        for b in range(a):
            shared = 0.0
            for c in range(b + 1):
                shared += matrices[i, a, c] * root[i, b, c]
            rest -= shared * shared
            for c in range(b + 1):
                root[i, a, c] -= shared * root[i, b, c]
        if not rest > 0.0:
            rest = np.nan
        logs[i] += math.log(rest)
        root[i, a, a] = 1.0
        root[i, a] /= math.sqrt(rest)
    return logs, root


@compiled
def _inside(expected: Any, root: Any, positions: Any, limit: float) -> Any:
    """Return tracks (p,), detections (p,) and innovations (p, d) of pairs in the gate.

    ``limit`` is the square of its distance. Detections are read in the order of their
    first axis, so only those near a track are tested. If they come in that order, as
    from `track`, none are sorted for each track: that would double the time.
    """
    d = expected.shape[1]
    track = [0 for _ in range(0)]
    detection = [0 for _ in range(0)]
    found = [0.0 for _ in range(0)]
    order = np.argsort(positions[:, 0])
    mixed = (np.diff(order) < 0).any()
    first = positions[order, 0]
    innovation = np.zeros(d)
    for i in range(len(expected)):
        reach = math.sqrt(limit) / root[i, 0, 0]
        begin = np.searchsorted(first, expected[i, 0] - reach)
        end = np.searchsorted(first, expected[i, 0] + reach, side="right")
        near = order[begin:end]
        for j in np.sort(near) if mixed else near:
            square = 0.0
            for a in range(d):
                innovation[a] = 0.0
                for b in range(a + 1):
                    apart = positions[j, b] - expected[i, b]
                    innovation[a] += root[i, a, b] * apart
                square += innovation[a] * innovation[a]
            if square < limit:
                track.append(i)
                detection.append(j)
                found.extend(innovation)
    return np.array(track), np.array(detection), np.array(found).reshape(-1, d)
