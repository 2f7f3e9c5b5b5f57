"""The simulated sorter: a slide, a belt, and how bodies touch (2016 and 2020 papers).

slide -> bodies on the belt, 0.2 ms at a time -> positions 1000 times a second
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from kilnflight.belt.batch import Batch
from kilnflight.belt.bulk import Bulk
from kilnflight.belt.conveyor import Conveyor
from kilnflight.belt.physics import Contacts, check_step
from kilnflight.belt.slide import Slide
from kilnflight.checks import check_count
from kilnflight.tables import BELT_BODIES


@dataclass(frozen=True)
class Sorter:
    """A slide, a belt, and how bodies touch each other and the belt."""

    contacts: Contacts = field(default_factory=Contacts)
    slide: Slide = field(default_factory=Slide)
    conveyor: Conveyor = field(default_factory=Conveyor)

    def __post_init__(self) -> None:
        """Refuse a time step that is too long for the contacts."""
        check_step(self.contacts, self.conveyor.step_s)

    def __call__(self, bulk: Bulk, count: int, generator: np.random.Generator) -> pd.DataFrame:
        """Simulate ``count`` particles; `kilnflight.tables.BELT_BODIES` from frame 0.

        Raises
        ------
        InputError
            If a particle does not reach the edge, or the simulation becomes unstable.
        """
        check_count(count, "Sorter: count", least=0)
        if not count:
            return BELT_BODIES.empty()
        fed = self.slide(bulk, count, self.conveyor.width_mm, generator)
        return Batch(self.conveyor, self.contacts, bulk, fed, generator.random(count)).table()
