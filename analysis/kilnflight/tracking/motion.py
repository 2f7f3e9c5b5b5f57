"""Motion models: constant velocity and constant acceleration.

A motion model hands the Kalman filter its matrices. The state of a particle in d
dimensions lists all positions first, then all velocities (Eq. 4.1), then all
accelerations. Lengths are in px and times in frames. The control input B u of Eq. 2.42
is zero throughout: nothing steers the particles.

======================  =========  ==================================  ==============
model                   equation   default of the noise                source
======================  =========  ==================================  ==============
`ConstantVelocity`      4.1-4.5    1 px/frame^1.5, sheets that tumble  thesis, 4.1.1
`ConstantAcceleration`  white      0.3 px/frame^2.5, particles that    belt papers
                        jerk       a belt brings up to its speed       2016 and 2020
======================  =========  ==================================  ==============

Notes
-----
Neither process nor measurement noise is printed in the thesis. The defaults follow from the scene:
330 frames/s and some 3 mm per px at the lance's distance make 5 to 30 px/frame. Drag takes a
fraction of a px/frame from that in each frame. The centroid of a tumbling sheet that is lit from
the side jumps by 1 to 3 px. They are not tuned to any result.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from math import factorial
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from filterpy.common import Q_continuous_white_noise
from scipy.linalg import toeplitz

from kilnflight.checks import InputError, check_between, check_finite, check_positive, check_shape

Array = npt.NDArray[np.float64]

LARGEST = 1e30  # px and frames; squares stay numbers, and no particle comes near
LONGEST = 2.0**64  # frames, more than lie between any two whole numbers of 8 bytes


class Motion(Protocol):
    """A motion model in d dimensions with k numbers per state."""

    def transition(self, frames: float) -> Array:
        """Return F (k, k) over a number of frames."""

    def process_noise(self, frames: float) -> Array:
        """Return Q (k, k) over a number of frames."""

    def measurement(self) -> Array:
        """Return H (d, k): the positions of a state."""

    def measurement_noise(self) -> Array:
        """Return R (d, d)."""

    def initial(self, positions: Array) -> tuple[Array, Array]:
        """Return states (n, k) and covariances (n, k, k) of new tracks."""


class _Steady(ABC):
    """Motion whose highest derivative is constant but for white noise.

    The noise is taken as continuous, so that two steps of one frame and one step of two
    frames are the same. A gap needs no frame that is not there.
    """

    velocity: Any

    @property
    @abstractmethod
    def _spreads(self) -> tuple[float, ...]:
        """Return a new track's standard deviations: position, velocity, ..."""

    @property
    @abstractmethod
    def _noise(self) -> float:
        """Return the root of the density of the white noise."""

    def __post_init__(self) -> None:
        """Refuse parameters that are no finite numbers of px and frames."""
        where = type(self).__name__
        numbers = check_finite(self.velocity, f"{where}: velocity")
        check_shape(numbers, (None,), f"{where}: velocity, one number per dimension")
        if not len(numbers):
            raise InputError(f"{where}: velocity is empty; give one number per dimension.")
        if np.abs(numbers).max() > LARGEST:
            raise InputError(
                f"{where}: velocity {self.velocity!r} is beyond {LARGEST:g} px/frame. Correct it."
            )
        for field in fields(self)[1:]:  # type: ignore[arg-type]
            check_positive(getattr(self, field.name), f"{where}: {field.name}")
            check_between(getattr(self, field.name), 0, LARGEST, f"{where}: {field.name}")

    def transition(self, frames: float) -> Array:
        """Return F (k, k) over a number of frames (Eq. 4.4)."""
        check_between(frames, 0, LONGEST, "transition: frames")
        powers = [frames**k / factorial(k) for k in range(len(self._spreads))]
        block = toeplitz(np.eye(1, len(powers))[0], powers)
        return np.asarray(np.kron(block, np.eye(len(self.velocity))), dtype=np.float64)

    def process_noise(self, frames: float) -> Array:
        """Return Q (k, k), the white noise over a number of frames."""
        check_between(frames, 0, LONGEST, "process_noise: frames")
        order, axes, density = len(self._spreads), len(self.velocity), self._noise**2
        noise = Q_continuous_white_noise(order, float(frames), density, axes, order_by_dim=False)
        return np.asarray(noise, dtype=np.float64)

    def measurement(self) -> Array:
        """Return H (d, k) of section 4.1.4, which picks the positions."""
        axes = len(self.velocity)
        return np.eye(axes, axes * len(self._spreads))

    def measurement_noise(self) -> Array:
        """Return R (d, d), the same for each axis."""
        return self._spreads[0] ** 2 * np.eye(len(self.velocity))

    def initial(self, positions: Array) -> tuple[Array, Array]:
        """Return states (n, k) and covariances (n, k, k) of new tracks."""
        axes, count = len(self.velocity), len(positions)
        check_shape(positions, (None, axes), "positions of new tracks")
        variance = np.repeat(np.square(self._spreads), axes)
        state = np.zeros((count, len(variance)))
        state[:, :axes], state[:, axes : 2 * axes] = positions, self.velocity
        return state, np.repeat(np.diag(variance)[None], count, axis=0)


@dataclass(frozen=True)
class ConstantVelocity(_Steady):
    """Uniform motion, disturbed by white noise of the acceleration.

    Eqs 4.1 to 4.5 of the thesis; Eq. 4.5 prints no Q.
    """

    velocity: tuple[float, ...] = (0.0, 0.0)  # px/frame, of a new track; one per dimension
    velocity_sd: float = 15.0  # px/frame: 30 px/frame, the fastest, are two of it
    acceleration_noise: float = 1.0  # px/frame^1.5: velocity changes by 1 px/frame in a frame
    measurement_sd: float = 2.0  # px: centroid of a tumbling sheet, 1 to 3

    @property
    def _spreads(self) -> tuple[float, ...]:
        return self.measurement_sd, self.velocity_sd

    @property
    def _noise(self) -> float:
        return self.acceleration_noise


@dataclass(frozen=True)
class ConstantAcceleration(_Steady):
    """Uniform acceleration, disturbed by white noise of the jerk.

    The belt's motion, 2016 and 2020 papers. A new track has no acceleration, give or take
    ``acceleration_sd``.
    """

    velocity: tuple[float, ...] = (0.0, 0.0)  # px/frame, of a new track; one per dimension
    velocity_sd: float = 15.0  # px/frame, as for constant velocity
    acceleration_sd: float = 1.0  # px/frame^2: a fraction is usual in the kiln
    jerk_noise: float = 0.3  # px/frame^2.5: acceleration changes by 0.3 px/frame^2 in a frame
    measurement_sd: float = 2.0  # px, as for constant velocity

    @property
    def _spreads(self) -> tuple[float, ...]:
        return self.measurement_sd, self.velocity_sd, self.acceleration_sd

    @property
    def _noise(self) -> float:
        return self.jerk_noise


MOTIONS: tuple[Motion, ...] = (ConstantVelocity(), ConstantAcceleration())
