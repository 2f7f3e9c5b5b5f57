"""The four fractions: sizes of single particles.

The thesis shows the fractions beside a scale (Fig. 2.7) and prints no sizes. The ranges
are those of handbooks and products, as the comment says; sizes are drawn uniformly from
them. fuel.csv has a fraction a row.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pandas as pd

from kilnflight.arrays import Flags, Generator, Two
from kilnflight.tables import read_beside

Range = Two
_SIZES = ["length_mm", "width_mm", "thickness_mm"]


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
    sheet: bool
    round: bool

    def draw(self, count: int, generator: Generator) -> pd.DataFrame:
        """Draw a table of particles: their ``fraction`` and sizes in mm."""
        low, high = np.array([self.length_mm, self.width_mm, self.thickness_mm]).T
        sizes = generator.uniform(low, high, (count, 3))
        if self.round:
            sizes[:, 1] = sizes[:, 0]
        table = pd.DataFrame(sizes, columns=_SIZES)
        table.insert(0, "fraction", self.name)
        return table


# Sizes of wood are those of Fig. 2.7. A hole punch and a cross-cut shredder make the
# papers, of office paper. Data sheets have those of LDPE and HDPE granules.
_TABLE = read_beside(__file__, "fuel.csv")
_TABLE[_SIZES] = _TABLE[_SIZES].map(lambda text: tuple(map(float, text.split())))
FRACTIONS = {row["name"]: Fraction(**row) for row in _TABLE.to_dict("records")}


def are_sheets(fractions: Iterable[str]) -> Flags:
    """Return which particles are of paper, by their fractions."""
    return np.array([FRACTIONS[name].sheet for name in fractions], bool)
