"""Tracklets of one particle are connected or merged (thesis, section 4.2.3)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from kilnflight.checks import check_at_least, check_kind, check_limit
from kilnflight.tracklets.criteria import Weights
from kilnflight.tracklets.eliminate import Elimination
from kilnflight.tracklets.joining import Feature, join, limits_of, refuse
from kilnflight.tracklets.laws import Differences, LevelEdge
from kilnflight.tracklets.matching import DualNearest, Matching
from kilnflight.tracklets.outliers import OutlierRemoval


@dataclass(frozen=True)
class Costs:
    """Weights of Eq. 4.24, thesis."""

    angle: float = 2.0  # 1/degree, a, Table 5.16
    change: float = 2.0  # frame/px, b, Table 5.16
    depth: float = 0.1  # frame/mm, c, Table 5.16
    gap: float = 1.0  # 1/frame, d, Table 5.16
    overlap: float = 2.0  # 1/frame, e, Table 5.16
    feature: float = 1e11  # grey values, f, Table 5.16

    def __post_init__(self) -> None:
        """Refuse weights that are negative or not finite."""
        for name in ("angle", "change", "depth", "gap", "overlap", "feature"):
            check_at_least(getattr(self, name), 0, f"Costs: {name}")

    def weights(self) -> Weights:
        """Return a to e, the weights of what needs no picture."""
        values = (self.angle, self.change, self.depth, self.gap, self.overlap)
        return Weights(*(float(value) for value in values))


@dataclass(frozen=True)
class Connection:
    """Connect tracklets over a gap, merge those that overlap, the cheapest first.

    Called with a track table and, for the last term of the cost, the `Differences` of its
    recording. A merged frame keeps one row, that of the earlier tracklet (of the later
    where only that has a depth), with the mean row, col, x, y and z; the other row gets
    particle -1 and keeps its own place.

    Notes
    -----
    Readings. (1) Eq. 4.21 holds case by case; with its "or" every pair would pass. (2) Of
    two tracklets the one that starts first is the earlier; of two that start together the
    one that ends first. The later one must end after the earlier one (Fig. 4.9); one within
    another continues nothing and is left to `Fusion`. (3) A tracklet with fewer than three
    points gives what it has to the connected part; one common frame counts as one
    point, the mean; of two that overlap without a common frame, the points before
    and after the overlap count. (4) The terms of Eq. 4.24 are means over the connected part,
    0 without a value; d weighs the gap and e the overlap, as printed (the sentence after
    it and Table 5.16 agree). (5) Without ``differences`` the last term is left out; f
    belongs to the energies of the thesis, of order 1e8 (Fig. 4.13). (6) A tracklet is joined
    once per iteration (`DualNearest`). (7) Eq. 4.18 spares a jump straight ahead, however
    far, so nothing but the cost limits the length of a connection. Source: Eqs 4.21 to 4.25
    and Fig. 4.14, thesis.
    """

    gap: float = 15.0  # frames, t_eps connect, Table 5.16
    overlap: float = 5.0  # common frames, kn_eps merge, Table 5.16
    depth: float = 1500.0  # mm/frame, z_eps, Table 5.16
    outliers: OutlierRemoval = field(default_factory=OutlierRemoval)  # Eq. 4.18
    false: Elimination = field(default_factory=Elimination)  # Eq. 4.15 without duration
    costs: Costs = field(default_factory=Costs)
    feature: LevelEdge = field(default_factory=LevelEdge)
    matching: Matching = field(default_factory=DualNearest)

    def __post_init__(self) -> None:
        """Refuse negative limits, and parts that are of another kind."""
        for name in ("gap", "overlap", "depth"):
            check_limit(getattr(self, name), f"Connection: {name}")
        check_kind(self.costs, Costs, "Connection: costs")
        refuse(self, self.outliers, self.false, self.feature, self.matching)

    def __call__(
        self, tracks: pd.DataFrame, differences: Differences | None = None
    ) -> pd.DataFrame:
        """Return the table with tracklets joined.

        Raises
        ------
        InputError
            If the table is none of tracks (`kilnflight.tracklets.paths.read_paths`), or
            ``differences`` returns no finite numbers.
        """
        limits = limits_of(self, gap=self.gap, overlap=self.overlap, distance=np.inf, nested=False)
        feature = Feature(self.costs.feature, self.feature, differences)
        return join(tracks, limits, self.costs.weights(), feature, self.matching)
