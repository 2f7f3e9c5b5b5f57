"""The belt itself: where it lies, how fast it runs, how it is simulated and sampled."""

from __future__ import annotations

from dataclasses import dataclass

from kilnflight.belt.arrival import BELT_VELOCITY_MM_S
from kilnflight.checks import InputError, check_positive


@dataclass(frozen=True)
class Conveyor:
    """A belt between two walls.

    Coordinates are those of the authors' files: the belt runs from 388 to 788 mm. Beyond the
    edge a particle flies on with the velocity it left with; nothing touches it there.
    """

    speed_mm_s: float = BELT_VELOCITY_MM_S  # sec. IV (2016), sec. 4 (2020)
    width_mm: float = 180.0  # sec. 3 (2020)
    start_mm: float = 388.0  # the authors' files
    edge_mm: float = 788.0  # 40 cm further (sec. IV, 2016)
    end_mm: float = 800.0  # of the tracks, so that observations follow the edge
    sampling_hz: float = 1000.0  # both papers
    step_s: float = 0.0002  # the 2020 paper's DEM has 0.0001; see benchmarks/bench_sorter.py
    patience_s: float = 3.0  # a particle that takes longer to the edge is told

    def __post_init__(self) -> None:
        """Refuse what cannot be simulated."""
        for name in ("speed_mm_s", "width_mm", "sampling_hz", "step_s", "patience_s"):
            check_positive(getattr(self, name), f"Conveyor: {name}")
        if not self.start_mm < self.edge_mm <= self.end_mm:
            raise InputError(
                f"Conveyor: the belt runs from {self.start_mm} to {self.edge_mm} mm and tracks "
                f"end at {self.end_mm} mm; these must ascend."
            )
        steps = 1.0 / (self.sampling_hz * self.step_s)
        if abs(steps - round(steps)) > 1e-6 or steps < 0.5:
            raise InputError(
                f"Conveyor: one sample at {self.sampling_hz} Hz is no whole number of steps of "
                f"{self.step_s} s."
            )

    @property
    def steps(self) -> int:
        """Time steps from one sample to the next."""
        return round(1.0 / (self.sampling_hz * self.step_s))
