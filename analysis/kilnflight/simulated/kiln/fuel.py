"""The four fractions: sizes of single particles.

The thesis shows the fractions beside a scale (Fig. 2.7) and prints no sizes. The ranges
are those of handbooks and products, as the comments say; sizes are drawn uniformly from
them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from kilnflight.checks import InputError

Range = tuple[float, float]


@dataclass(frozen=True)
class Fraction:
    """Sizes of the particles of a fraction, in mm."""

    name: str
    length_mm: Range
    width_mm: Range
    thickness_mm: Range
    sheet: bool  # of paper: flutters, and may ignite in flight
    round: bool = False  # as wide as long

    def draw(self, count: int, generator: np.random.Generator) -> pd.DataFrame:
        """Return ``fraction``, ``length_mm``, ``width_mm``, ``thickness_mm`` of
        particles.
        """
        low, high = np.array([self.length_mm, self.width_mm, self.thickness_mm]).T
        sizes = generator.uniform(low, high, (count, 3))
        if self.round:
            sizes[:, 1] = sizes[:, 0]
        table = pd.DataFrame(sizes, columns=["length_mm", "width_mm", "thickness_mm"])
        table.insert(0, "fraction", self.name)
        return table


FRACTIONS: dict[str, Fraction] = {
    kind.name: kind
    for kind in (
        # sizes by Fig. 2.7
        Fraction("wood chip", (8.0, 18.0), (4.0, 10.0), (1.2, 3.0), sheet=False),
        # discs of a hole punch, office paper
        Fraction(
            "confetti", (5.0, 6.0), (5.0, 6.0), (0.095, 0.105), sheet=True, round=True
        ),
        # cross-cut shredder, office paper
        Fraction("paper shred", (20.0, 45.0), (4.0, 8.0), (0.095, 0.105), sheet=True),
        # LDPE and HDPE granules (data sheets)
        Fraction(
            "PE granule", (3.0, 4.8), (3.0, 4.8), (3.0, 4.8), sheet=False, round=True
        ),
    )
}


def find_fraction(name: str) -> Fraction:
    """Return a fraction by its name in the thesis."""
    if name not in FRACTIONS:
        raise InputError(f"fraction {name!r}: there are {', '.join(FRACTIONS)}.")
    return FRACTIONS[name]
