"""Clusters by dilation of a grid of cells (thesis, section 2.2.5)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit
from scipy.spatial import cKDTree

from kilnflight.checks import check_count
from kilnflight.detection.cells import (
    NOISE,
    Cells,
    advance,
    check_points,
    number_by_first_point,
    roots,
    rows_around,
    sort_into_cells,
    unite,
)


@dataclass(frozen=True)
class MorphologicalClustering:
    """Clusters that are connected domains of a dilated grid (Eqs 2.31-2.36).

    Each axis of the cloud is stretched to [0, grid] and rounded, halves up (Eqs 2.32, 2.33).
    The occupied cells make domains, a cell touching its 26 neighbours (Eq. 2.34). Domains
    of fewer cells than the mean domain are dropped (Eq. 2.35). The rest is dilated by a
    cube of 3 x 3 x 3 cells; domains that are then connected are one cluster. Each point of
    a dropped domain takes the cluster of the nearest point of the others, by Euclidean
    distance in the stretched cloud (Eq. 2.36). So there is no noise.

    Parameters
    ----------
    grid
        R, steps of the grid along each axis. More steps keep apart what is closer.
    dilations
        How often the grid is dilated; None: until a dilation leaves the number of domains
        as it was.

    Raises
    ------
    InputError
        If ``grid`` is no whole number from 1 or ``dilations`` none from 0.

    Notes
    -----
    Readings. (1) Eq. 2.32 divides by max(p); the text of 5.1.3 wants each axis in [0, 1],
    so the extent max(p) - min(p) divides. (2) Section 2.2.5 stops at "the number of
    clusters", which nobody knows; 5.1.3 stops when the number of domains "remains
    unchanged". Of hundreds of domains some always merge, so that rule, which is
    ``dilations=None``, leaves a frame a few clusters, where Table 5.9 counts 52 to 287 per
    image. Wang's abstract (the source of the method) also names a largest number of
    iterations, which the thesis does not print. One dilation is the least that the method
    has. (3) T_s is described after the dilation. There a single point counts 27 cells and
    the wall sets the mean, so that all but the wall would go; it is taken of the grid as
    it is, where crumbs set the mean.

    For the combined method, section 5.1.3 removes the wall with R = 100 and takes R = 400
    for the rest. Sources: section 2.2.5 and Table 5.9, thesis.
    """

    grid: int = 150  # cells, best F1 of Table 5.9
    dilations: int | None = 1  # not printed

    def __post_init__(self) -> None:
        """Refuse a grid without cells and a negative number of dilations."""
        check_count(self.grid, "MorphologicalClustering: grid")
        if self.dilations is not None:
            check_count(self.dilations, "MorphologicalClustering: dilations", 0)

    def __call__(self, points: npt.ArrayLike) -> npt.NDArray[np.intp]:
        """Return the cluster of each of (n, 3) points in mm, numbered by their first point.

        Raises
        ------
        InputError
            If the points are not (n, 3) finite numbers.
        """
        cloud = check_points(points, "MorphologicalClustering: points")
        if len(cloud) == 0:
            return np.empty(0, dtype=np.intp)
        where = "MorphologicalClustering: points"
        stretched = _stretch(cloud, int(self.grid))
        reach = int(self.grid) if self.dilations is None else 2 * int(self.dilations) + 1
        cells = sort_into_cells(np.floor(stretched + 0.5), 1.0, reach, where)
        domains = np.arange(len(cells.keys))
        _join(cells.keys, rows_around(cells.layer, cells.row, 1), domains, 1)
        domains = roots(domains)
        sizes = np.bincount(domains)
        large = sizes[domains] * np.count_nonzero(sizes) >= len(domains)  # Eq. 2.35
        clusters = np.full(len(domains), NOISE)
        clusters[large] = _dilate(cells, large, domains, self.dilations)
        seeds = number_by_first_point(_of_points(cells, clusters), len(domains))
        return number_by_first_point(_nearest(stretched, seeds), len(domains))


@njit(cache=True)
def _stretch(cloud: Any, grid: int) -> Any:
    """Return the cloud with each axis in [0, grid] (Eq. 2.32); an axis without extent is 0."""
    stretched = np.empty_like(cloud)
    for axis in range(cloud.shape[1]):
        low = high = cloud[0, axis]
        for i in range(len(cloud)):
            low, high = min(low, cloud[i, axis]), max(high, cloud[i, axis])
        extent = high - low if high > low else 1.0
        for i in range(len(cloud)):
            stretched[i, axis] = grid * ((cloud[i, axis] - low) / extent)
    return stretched


@njit(cache=True)
def _join(keys: Any, steps: Any, parents: Any, reach: int) -> int:
    """Unite cells at most ``reach`` apart along every axis; return how often.

    ``steps`` are those of `rows_around`.
    """
    steps = steps[steps >= 0]  # along the other half the other cell finds this one
    first = np.zeros(len(steps), np.int64)
    united = 0
    for cell in range(len(keys)):
        for r in range(len(steps)):
            first[r] = advance(keys, first[r], max(keys[cell] + steps[r] - reach, keys[cell] + 1))
            other = first[r]
            while other < len(keys) and keys[other] <= keys[cell] + steps[r] + reach:
                united += unite(parents, cell, other)
                other += 1
    return united


def _dilate(
    cells: Cells,
    large: npt.NDArray[np.bool_],
    domains: npt.NDArray[np.int64],
    dilations: int | None,
) -> npt.NDArray[np.int64]:
    """Return the cluster of each cell of a large domain after the dilations.

    Two cells whose steps along every axis are at most 2 k + 1 touch after k dilations, so
    that nothing need be dilated. The edge of the grid changes nothing in this.
    """
    clusters = (np.cumsum(large) - 1)[domains[large]]
    keys = cells.keys[large]
    if dilations is not None:
        reach = 2 * int(dilations) + 1
        _join(keys, rows_around(cells.layer, cells.row, reach), clusters, reach)
    else:
        reach = 3
        while _join(keys, rows_around(cells.layer, cells.row, reach), clusters, reach):
            reach += 2
    return roots(clusters)


@njit(cache=True)
def _of_points(cells: Cells, clusters: Any) -> Any:
    """Return the cluster of each point of the caller's cloud from those of the cells."""
    found = np.empty(len(cells.order), np.int64)
    for cell in range(len(clusters)):
        for i in range(cells.starts[cell], cells.starts[cell + 1]):
            found[cells.order[i]] = clusters[cell]
    return found


def _nearest(
    stretched: npt.NDArray[np.float64], seeds: npt.NDArray[np.intp]
) -> npt.NDArray[np.intp]:
    """Return the cluster of each point, that of the nearest seed where it has none."""
    found = seeds.copy()
    homeless = seeds < 0
    if not homeless.any():
        return found
    # an unbalanced tree is built in half the time and searched far faster from points outside
    tree = cKDTree(stretched[~homeless], 32, balanced_tree=False, compact_nodes=False)
    found[homeless] = seeds[~homeless][tree.query(stretched[homeless])[1]]
    return found
