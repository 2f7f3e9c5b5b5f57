"""How a particle moves between two frames: constant velocity, constant acceleration.

A motion model hands the Kalman filter its matrices. The state of a particle in d
dimensions lists all positions first, then all velocities (Eq. 4.1), then all
accelerations; lengths are in px and times in frames. The control input B u of Eq. 2.42
is nought throughout: nothing steers the particles.

======================  =========  ==================================  ==============
model                   equation   default of the noise                source
======================  =========  ==================================  ==============
`ConstantVelocity`      4.1-4.5    1 px/frame^1.5, sheets that tumble  thesis, 4.1.1
`ConstantAcceleration`  white      0.3 px/frame^2.5, particles that    belt papers
                        jerk       a belt brings up to its speed       2016 and 2020
======================  =========  ==================================  ==============

Notes
-----
Neither process nor measurement noise is printed in the thesis. The defaults follow from
the scene: 330 frames/s and some 3 mm per px at the lance's distance make 5 to 30 px/frame,
drag takes a fraction of a px/frame from that in each frame, and the centroid of a tumbling
sheet that is lit from the side jumps by 1 to 3 px. They are not tuned to any result.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from kilnflight.checks import InputError, check_between, check_finite, check_positive, check_shape

Array = npt.NDArray[np.float64]

LARGEST = 1e30  # px and frames; squares stay numbers, and nothing that is seen comes near
LONGEST = 2.0**64  # frames, more than lie between any two whole numbers of 8 bytes


class Motion(Protocol):
    """What the tracker asks of a motion model; d dimensions, k numbers per state."""

    def transition(self, frames: float) -> Array:
        """Return F (k, k) over a number of frames."""

    def process_noise(self, frames: float) -> Array:
        """Return Q (k, k) over a number of frames."""

    def measurement(self) -> Array:
        """Return H (d, k): the positions of a state."""

    def measurement_noise(self) -> Array:
        """Return R (d, d)."""

    def initial(self, positions: Array) -> tuple[Array, Array]:
        """Return states (n, k) and covariances (n, k, k) of particles seen once, at (n, d)."""


@dataclass(frozen=True)
class ConstantVelocity:
    """Uniform motion, disturbed by white noise of the acceleration (Eqs 4.1-4.5, thesis).

    Notes
    -----
    Eq. 4.5 prints no Q. The noise is taken as continuous, so that two steps of one frame
    and one step of two frames are the same: a gap needs no frame that is not there.
    """

    velocity: tuple[float, ...] = (0.0, 0.0)  # px/frame, of a new track; one per dimension
    velocity_sd: float = 15.0  # px/frame: 30 px/frame, the fastest, are two of it
    acceleration_noise: float = 1.0  # px/frame^1.5: velocity changes by 1 px/frame in a frame
    measurement_sd: float = 2.0  # px: centroid of a tumbling sheet, 1 to 3

    def __post_init__(self) -> None:
        """Refuse what is no number of px and frames."""
        _check(self.velocity, "ConstantVelocity")
        _check_size(self.velocity_sd, "ConstantVelocity: velocity_sd")
        _check_size(self.acceleration_noise, "ConstantVelocity: acceleration_noise")
        _check_size(self.measurement_sd, "ConstantVelocity: measurement_sd")

    def transition(self, frames: float) -> Array:
        """Return F of Eq. 4.4 over a number of frames, (2 d, 2 d)."""
        t = _span(frames, "transition: frames")
        return _each_axis([[1, t], [0, 1]], len(self.velocity))

    def process_noise(self, frames: float) -> Array:
        """Return Q, the white noise integrated over a number of frames, (2 d, 2 d)."""
        t = _span(frames, "process_noise: frames")
        block = [[t**3 / 3, t**2 / 2], [t**2 / 2, t]]
        return self.acceleration_noise**2 * _each_axis(block, len(self.velocity))

    def measurement(self) -> Array:
        """Return H of section 4.1.4, (d, 2 d): positions are seen, velocities are not."""
        return _each_axis([[1, 0]], len(self.velocity))

    def measurement_noise(self) -> Array:
        """Return R (d, d), the same for each axis."""
        return self.measurement_sd**2 * np.eye(len(self.velocity))

    def initial(self, positions: Array) -> tuple[Array, Array]:
        """Return states (n, 2 d) and covariances (n, 2 d, 2 d) of particles seen once."""
        return _seen_once(positions, self.velocity, (self.measurement_sd, self.velocity_sd))


@dataclass(frozen=True)
class ConstantAcceleration:
    """Uniform acceleration, disturbed by white noise of the jerk (belt, 2016 and 2020 papers).

    A new track has no acceleration, give or take ``acceleration_sd``.
    """

    velocity: tuple[float, ...] = (0.0, 0.0)  # px/frame, of a new track; one per dimension
    velocity_sd: float = 15.0  # px/frame, as for constant velocity
    acceleration_sd: float = 1.0  # px/frame^2: a fraction is usual in the kiln
    jerk_noise: float = 0.3  # px/frame^2.5: acceleration changes by 0.3 px/frame^2 in a frame
    measurement_sd: float = 2.0  # px, as for constant velocity

    def __post_init__(self) -> None:
        """Refuse what is no number of px and frames."""
        _check(self.velocity, "ConstantAcceleration")
        _check_size(self.velocity_sd, "ConstantAcceleration: velocity_sd")
        _check_size(self.acceleration_sd, "ConstantAcceleration: acceleration_sd")
        _check_size(self.jerk_noise, "ConstantAcceleration: jerk_noise")
        _check_size(self.measurement_sd, "ConstantAcceleration: measurement_sd")

    def transition(self, frames: float) -> Array:
        """Return F over a number of frames, (3 d, 3 d)."""
        t = _span(frames, "transition: frames")
        return _each_axis([[1, t, t**2 / 2], [0, 1, t], [0, 0, 1]], len(self.velocity))

    def process_noise(self, frames: float) -> Array:
        """Return Q, the white noise integrated over a number of frames, (3 d, 3 d)."""
        t = _span(frames, "process_noise: frames")
        block = [
            [t**5 / 20, t**4 / 8, t**3 / 6],
            [t**4 / 8, t**3 / 3, t**2 / 2],
            [t**3 / 6, t**2 / 2, t],
        ]
        return self.jerk_noise**2 * _each_axis(block, len(self.velocity))

    def measurement(self) -> Array:
        """Return H (d, 3 d): only positions are seen."""
        return _each_axis([[1, 0, 0]], len(self.velocity))

    def measurement_noise(self) -> Array:
        """Return R (d, d), the same for each axis."""
        return self.measurement_sd**2 * np.eye(len(self.velocity))

    def initial(self, positions: Array) -> tuple[Array, Array]:
        """Return states (n, 3 d) and covariances (n, 3 d, 3 d) of particles seen once."""
        spreads = (self.measurement_sd, self.velocity_sd, self.acceleration_sd)
        return _seen_once(positions, self.velocity, spreads)


def _check(velocity: tuple[float, ...], where: str) -> None:
    numbers = check_finite(velocity, f"{where}: velocity")
    check_shape(numbers, (None,), f"{where}: velocity, one number per dimension")
    if not len(numbers):
        raise InputError(f"{where}: velocity is empty; give one number per dimension.")
    if np.abs(numbers).max() > LARGEST:
        raise InputError(f"{where}: velocity {velocity!r} is beyond {LARGEST:g} px/frame.")


def _check_size(value: float, where: str) -> None:
    check_positive(value, where)
    check_between(value, 0, LARGEST, where)


def _span(frames: float, where: str) -> float:
    """Return a number of frames whose powers are numbers, too."""
    check_between(frames, 0, LONGEST, where)
    return float(frames)


def _each_axis(block: list[list[float]], dimensions: int) -> Array:
    """Return ``block``, the matrix of one axis, for all axes side by side."""
    (rows, columns), axis = np.shape(block), np.arange(dimensions)
    matrix = np.zeros((rows, dimensions, columns, dimensions))
    matrix[:, axis, :, axis] = block
    return matrix.reshape(rows * dimensions, columns * dimensions)


def _seen_once(
    positions: Array, velocity: tuple[float, ...], spreads: tuple[float, ...]
) -> tuple[Array, Array]:
    """Return states and covariances; ``spreads``: of position, velocity and so on."""
    dimensions, count = len(velocity), len(positions)
    check_shape(positions, (None, dimensions), "positions of new tracks")
    state = np.zeros((count, dimensions * len(spreads)))
    state[:, :dimensions] = positions
    state[:, dimensions : 2 * dimensions] = velocity
    variance = np.repeat(np.square(spreads), dimensions)
    return state, np.repeat(np.diag(variance)[None], count, axis=0)


MOTIONS: tuple[Motion, ...] = (ConstantVelocity(), ConstantAcceleration())
