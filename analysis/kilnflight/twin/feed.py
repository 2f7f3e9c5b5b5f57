"""What is fed and when: by hand, in bursts (thesis, sections 2.1.1 and 5.2.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kilnflight.checks import InputError, check_positive
from kilnflight.twin.fractions import Fraction, Particles
from kilnflight.twin.fractions import fraction as named_fraction

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Burst:
    """A handful: particles of one fraction that leave the lance one after the other."""

    fraction: str
    count: int
    start_s: float  # of the first frame is 0; what flies in it was fed before
    duration_s: float = 0.4  # a handful takes 0.2 to 1 s; assumption

    def __post_init__(self) -> None:
        """Refuse an unknown fraction, a negative count or no duration."""
        named_fraction(self.fraction)
        check_positive(self.duration_s, "Burst: duration_s")
        if self.count < 0:
            raise InputError(f"Burst: count {self.count} is below 0.")

    def release(self, generator: np.random.Generator) -> tuple[Particles, Array]:
        """Return the particles and when each leaves the lance, in s, ascending."""
        particles = named_fraction(self.fraction).draw(self.count, generator)
        times = self.start_s + self.duration_s * generator.beta(2.0, 2.0, self.count)
        return particles, np.sort(times)


def by_hand(
    fraction: Fraction,
    count: int,
    duration_s: float,
    generator: np.random.Generator,
    handful: float = 6.0,
    lead_s: float = 1.0,
) -> tuple[Burst, ...]:
    """Return bursts that feed ``count`` particles over a run.

    Parameters
    ----------
    fraction
        What is fed.
    count
        Particles in all; the last burst takes the rest.
    duration_s
        Length of the run.
    generator
        Of sizes and times.
    handful
        Mean number of particles in a burst (geometric distribution); assumption. With 15,
        tried first, a window of Table 5.15 could be empty, which the thesis's were not.
    lead_s
        How long before the first frame the feeding begins.
    """
    sizes: list[int] = []
    while sum(sizes) < count:
        sizes.append(int(min(generator.geometric(1 / handful), count - sum(sizes))))
    starts = np.sort(generator.uniform(-lead_s, duration_s, len(sizes)))
    lengths = generator.uniform(0.2, 1.0, len(sizes))
    return tuple(
        Burst(fraction.name, size, float(start), float(length))
        for size, start, length in zip(sizes, starts, lengths, strict=True)
    )
