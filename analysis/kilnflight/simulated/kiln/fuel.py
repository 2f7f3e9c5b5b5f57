"""The four fractions: sizes of single particles.

The thesis shows the fractions beside a scale (Fig. 2.7) and prints no sizes. The ranges
are those of handbooks and products, as the comments say; sizes are drawn uniformly from
them.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pandas as pd

from kilnflight.arrays import Flags

Range = tuple[float, float]


@dataclass(frozen=True)
class Fraction:
    """Sizes of the particles of a fraction.

    Parameters
    ----------
    name
        As the thesis has it.
    length_mm, width_mm, thickness_mm
        Smallest and largest size in mm.
    sheet
        The particles are of paper: they flutter and may ignite in flight.
    round
        They are as wide as they are long.
    """

    name: str
    length_mm: Range
    width_mm: Range
    thickness_mm: Range
    sheet: bool = False
    round: bool = False

    def draw(self, count: int, generator: np.random.Generator) -> pd.DataFrame:
        """Draw a table of particles: their ``fraction`` and sizes in mm."""
        low, high = np.array([self.length_mm, self.width_mm, self.thickness_mm]).T
        sizes = generator.uniform(low, high, (count, 3))
        if self.round:
            sizes[:, 1] = sizes[:, 0]
        table = pd.DataFrame(sizes, columns=["length_mm", "width_mm", "thickness_mm"])
        table.insert(0, "fraction", self.name)
        return table


_KINDS = (
    # The sizes are those of Fig. 2.7.
    Fraction(
        name="wood chip",
        length_mm=(8.0, 18.0),
        width_mm=(4.0, 10.0),
        thickness_mm=(1.2, 3.0),
    ),
    # A hole punch makes these discs of office paper.
    Fraction(
        name="confetti",
        length_mm=(5.0, 6.0),
        width_mm=(5.0, 6.0),
        thickness_mm=(0.095, 0.105),
        sheet=True,
        round=True,
    ),
    # A cross-cut shredder makes these of office paper.
    Fraction(
        name="paper shred",
        length_mm=(20.0, 45.0),
        width_mm=(4.0, 8.0),
        thickness_mm=(0.095, 0.105),
        sheet=True,
    ),
    # Data sheets give these sizes for LDPE and HDPE granules.
    Fraction(
        name="PE granule",
        length_mm=(3.0, 4.8),
        width_mm=(3.0, 4.8),
        thickness_mm=(3.0, 4.8),
        round=True,
    ),
)
FRACTIONS = {kind.name: kind for kind in _KINDS}


def are_sheets(fractions: Iterable[str]) -> Flags:
    """Return which particles are of paper, by their fractions."""
    return np.array([FRACTIONS[name].sheet for name in fractions], dtype=np.bool_)
