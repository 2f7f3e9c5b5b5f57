"""Trajectories of one particle that run side by side are fused (thesis, section 4.2.4)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from kilnflight.checks import check_kind, check_limit
from kilnflight.tracklets.connect import Costs
from kilnflight.tracklets.eliminate import Elimination
from kilnflight.tracklets.joining import Feature, join, limits_of, refuse
from kilnflight.tracklets.laws import Differences, LevelEdge
from kilnflight.tracklets.matching import DualNearest, Matching
from kilnflight.tracklets.outliers import OutlierRemoval

WITHOUT_TIME = Costs(gap=0.0, overlap=0.0)


@dataclass(frozen=True)
class Fusion:
    """Fuse trajectories that overlap in time, however long, the cheapest first.

    As `Connection` but for the limit on common frames and the terms for gap and overlap.

    Notes
    -----
    Readings. (1) The text sets no limit to the distance of two trajectories. The connected
    part then bounds it only by the velocity of the jump from one to the other: over 40
    common frames, 200 px are 5 px/frame, and neighbours would be fused. So
    their mean distance in the common frames must not exceed ``distance``, and there must
    be such frames. Its value is the "epsilon = 10 pixel" that Table 5.16 lists without a
    place in chapter 4.2; it may as well be the gate of Eq. 5.1, which has no other value.
    (2) A trajectory within another may be fused: duplicates are often shorter. (3) Points,
    rows and depths are treated as in `Connection`. Source: section 4.2.4, thesis.
    """

    distance: float = 10.0  # px, epsilon, Table 5.16 (see Notes)
    depth: float = 1500.0  # mm/frame, z_eps, Table 5.16
    outliers: OutlierRemoval = field(default_factory=OutlierRemoval)  # Eq. 4.18
    false: Elimination = field(default_factory=Elimination)  # Eq. 4.15 without duration
    costs: Costs = WITHOUT_TIME  # section 4.2.4 omits the terms for gap and overlap
    feature: LevelEdge = field(default_factory=LevelEdge)
    matching: Matching = field(default_factory=DualNearest)

    def __post_init__(self) -> None:
        """Refuse negative limits, and parts that are of another kind."""
        check_limit(self.distance, "Fusion: distance")
        check_limit(self.depth, "Fusion: depth")
        check_kind(self.costs, Costs, "Fusion: costs")
        refuse(self, self.outliers, self.false, self.feature, self.matching)

    def __call__(
        self, tracks: pd.DataFrame, differences: Differences | None = None
    ) -> pd.DataFrame:
        """Return the table with trajectories fused.

        Raises
        ------
        InputError
            If the table is none of tracks (`kilnflight.tracklets.paths.read_paths`), or
            ``differences`` returns no finite numbers.
        """
        limits = limits_of(self, gap=0.0, overlap=np.inf, distance=self.distance, nested=True)
        feature = Feature(self.costs.feature, self.feature, differences)
        return join(tracks, limits, self.costs.weights(), feature, self.matching)
