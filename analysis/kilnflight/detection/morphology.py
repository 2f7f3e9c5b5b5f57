"""Clusters by dilation of a grid of cells (thesis, section 2.2.5)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit
from scipy.spatial import cKDTree

from kilnflight.checks import check_count
from kilnflight.detection.dbscan import (
    NOISE,
    advance,
    check_points_mm,
    numbered_by_first_point,
    root_of,
    unite,
)


@dataclass(frozen=True)
class MorphologicalClustering:
    """Cluster points by dilating a grid of cells (Eqs 2.31 to 2.36).

    Each axis of the cloud is stretched to [0, grid] and rounded, halves up (Eqs 2.32, 2.33).
    The occupied cells make domains, a cell touching its 26 neighbours (Eq. 2.34), and are
    dilated by a cube of 3 x 3 x 3 cells; domains that are then connected are one cluster.
    With the size rule, domains of fewer cells than the mean domain are dropped before
    (Eq. 2.35); each point of one takes the cluster of the nearest point of the others, by
    Euclidean distance in the stretched cloud (Eq. 2.36). So there is no noise.

    Parameters
    ----------
    grid
        R, steps of the grid along each axis. More steps keep apart what is closer.
    dilations
        How often the grid is dilated; None: until a dilation leaves the number of domains
        as it was.
    size_rule
        Whether Eq. 2.35 is applied.

    Raises
    ------
    InputError
        If ``grid`` is no whole number from 1 or ``dilations`` none from 0.

    Notes
    -----
    Readings. (1) Eq. 2.32 divides by max(p); the text of 5.1.3 wants each axis in [0, 1], so the
    extent max(p) - min(p) divides. (2) Section 2.2.5 stops at "the number of clusters", which is
    not known before; 5.1.3 stops when the number of domains "remains unchanged". That rule is
    ``dilations=None``. Of hundreds of domains some always merge, so it leaves a frame a few
    clusters, where Table 5.9 counts 52 to 287 per image. Wang's abstract (the source of the
    method) also names a largest number of iterations, which the thesis does not print. One
    dilation is the least that the method has. (3) Eq. 2.35 is part of Wang's general method in
    2.2.5. Section 5.1.3, which tells what was run on the frames, names grid, dilation, labels
    and nearest domain, but no size, so the rule is off. Where it is on, T_s is taken of the grid
    as it is. It is described after the dilation, where the wall sets the mean.

    For the combined method, section 5.1.3 removes the wall with R = 100 and takes R = 400
    for the rest. Sources: section 2.2.5 and Table 5.9, thesis.
    """

    grid: int = 150  # cells, best F1 of Table 5.9
    dilations: int | None = 1  # not printed
    size_rule: bool = False  # section 5.1.3 names none

    def __post_init__(self) -> None:
        """Refuse a grid without cells and a negative number of dilations."""
        check_count(self.grid, "MorphologicalClustering: grid")
        if self.dilations is not None:
            check_count(self.dilations, "MorphologicalClustering: dilations", 0)

    def __call__(self, points: npt.ArrayLike) -> npt.NDArray[np.intp]:
        """Return the cluster of each point (n, 3) in mm.

        Clusters are numbered in the order of their first point.

        Raises
        ------
        InputError
            If the points are not (n, 3) finite numbers.
        """
        cloud = check_points_mm(points, "MorphologicalClustering: points")
        if len(cloud) == 0:
            return np.empty(0, dtype=np.intp)
        # each axis for itself: along narrow rows numpy is slow
        low, high = (np.array([edge(axis) for axis in cloud.T]) for edge in (np.min, np.max))
        extent, grid = high - low, int(self.grid)
        stretched = grid * ((cloud - low) / np.where(extent > 0, extent, 1.0))  # Eq. 2.32
        steps = np.floor(stretched + 0.5).astype(np.intp)
        keys = np.ravel_multi_index(tuple(steps.T), 3 * (grid + 1,))
        occupied, cell = np.unique(keys, return_inverse=True)
        cells = np.column_stack(np.unravel_index(occupied, 3 * (grid + 1,)))
        domains = _joined(cells, 1)  # Eq. 2.34
        sizes = np.bincount(domains)
        large = np.full(len(domains), not self.size_rule)
        large |= sizes[domains] * len(sizes) >= len(domains)  # Eq. 2.35
        clusters = np.full(len(domains), NOISE)
        clusters[large] = _dilated(cells[large], self.dilations)
        labels = clusters[cell]
        known = labels >= 0
        if not known.all():  # Eq. 2.36
            # an unbalanced tree is built in half the time and searched faster from outside
            tree = cKDTree(stretched[known], 32, balanced_tree=False, compact_nodes=False)
            labels[~known] = labels[known][tree.query(stretched[~known])[1]]
        return numbered_by_first_point(labels)


def _joined(cells: npt.NDArray[np.intp], reach: int) -> npt.NDArray[np.intp]:
    """Return the domain of each cell (n, 3), the cells by row and column and layer.

    Cells that are at most ``reach`` apart along every axis share a domain.
    """
    # so many cells stay empty after each row and layer that no step leads into the next one
    side = int(cells.max(initial=0)) + 1 + reach
    return np.asarray(_domains(cells @ np.array([side**2, side, 1]), side, reach))


@njit(cache=True)
def _domains(keys: Any, side: int, reach: int) -> Any:
    """Return the domain of each cell by its number; numbers ascend.

    Cells that reach one another along a row are united first. So of a part of another row only
    those are united that the cell before them does not reach.
    """
    parents = np.arange(len(keys))
    for layer in range(reach + 1):
        for row in range(-reach if layer else 0, reach + 1):
            step, first = (layer * side + row) * side, 0
            for cell in range(len(keys)):
                low = keys[cell] + (step - reach if step else 1)
                first = advance(keys, first, low)
                other, before = first, low - 2 * reach
                while other < len(keys) and keys[other] <= keys[cell] + step + reach:
                    if keys[other] - before > reach:
                        unite(parents, cell, other)
                    before = keys[other]
                    other += 1
    numbers, count = np.empty(len(keys), np.intp), 0
    for cell in range(len(keys)):
        root = root_of(parents, cell)  # the first cell of its domain
        numbers[cell] = count if root == cell else numbers[root]
        count += root == cell
    return numbers


def _dilated(cells: npt.NDArray[np.intp], dilations: int | None) -> npt.NDArray[np.intp]:
    """Return the cluster of each cell after the dilations.

    Two cells whose steps along every axis are at most 2 k + 1 touch after k dilations, so
    that nothing need be dilated. The edge of the grid changes nothing in this.
    """
    if dilations is not None:
        return _joined(cells, 2 * int(dilations) + 1)
    before, reach, clusters = 0, 3, _joined(cells, 1)
    while clusters.max() != before:
        before, clusters, reach = clusters.max(), _joined(cells, reach), reach + 2
    return clusters
