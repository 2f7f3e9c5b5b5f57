"""Clusterings as the thesis defines them, without the speed (sections 2.2.5 and
2.2.6).
"""

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

CUBE = np.ones((3, 3, 3))


def renumbered(labels):
    """Labels numbered by their first point; noise stays -1."""
    numbers = {-1: -1}
    return np.array(
        [numbers.setdefault(label, len(numbers) - 1) for label in np.asarray(labels)]
    )


def morphology(points, grid):
    """Eqs 2.32 to 2.34 on a full grid with one dilation and no rule of sizes
    (5.1.3).
    """
    shifted = points - points.min(axis=0)
    extent = shifted.max(axis=0)
    stretched = grid * (shifted / np.where(extent > 0, extent, 1.0))
    cell = tuple(np.floor(stretched + 0.5).astype(int).T)
    occupied = np.zeros((grid + 1,) * 3, bool)
    occupied[cell] = True
    return renumbered(
        ndimage.label(ndimage.binary_dilation(occupied, CUBE), CUBE)[0][cell]
    )


def neighbors_by_sorting(points, k):
    """The k nearest others, equally distant ones in the order of the cloud; small
    clouds.
    """
    squares = sum((axis[:, None] - axis) ** 2 for axis in points.T)
    np.fill_diagonal(squares, -1.0)  # the point itself comes first
    return np.argsort(squares, axis=1, kind="stable")[:, 1 : k + 1]


def merged(clusters, most):
    """The centre that stands for each centre once no clusters share more than
    ``most``.
    """
    stands, changed = {center: center for center in clusters}, True
    while changed:
        changed, at, shared = False, {}, {}
        for center, members in clusters.items():
            for point in members:
                at.setdefault(point, []).append(center)
        for here in at.values():
            for i, one in enumerate(here):
                for other in here[:i]:
                    shared[other, one] = shared.get((other, one), 0) + 1
        for (one, other), count in shared.items():
            a, b = stands[one], stands[other]
            if count > most and a != b:
                changed = True
                clusters[a] |= clusters.pop(b)
                stands = {c: a if s == b else s for c, s in stands.items()}
    return stands


def quasi_centers(points, k, alpha, knn=None):
    """Eqs 2.37 to 2.41 with sets; without ``knn`` distances must differ."""
    if len(points) <= k:
        return np.full(len(points), -1)
    knn = cKDTree(points).query(points, k + 1)[1][:, 1:] if knn is None else knn
    sparsity = ((points - points[knn[:, -1]]) ** 2).sum(axis=1)
    near = sparsity[knn]
    sparse = [
        set(row[s >= own]) for row, s, own in zip(knn, near, sparsity, strict=True)
    ]
    for i, j in np.argwhere(near == sparsity[:, None]):
        sparse[knn[i, j]].add(i)
    center = np.ones(len(points), bool)
    center[knn[near > sparsity[:, None]]] = False
    clusters = {}
    for start in np.flatnonzero(center):
        todo, members = [start], {start}
        while todo:
            new = sparse[todo.pop()] - members
            members |= new
            todo += new
        clusters[start] = members
    stands = merged(clusters, alpha * k)
    inside = [[] for _ in points]
    for one, members in clusters.items():
        for point in members:
            inside[point].append(one)
    labels = np.empty(len(points), int)
    for i in np.argsort(sparsity, kind="stable"):
        exemplar = knn[i][np.lexsort((knn[i], near[i]))[0]]
        one = inside[i][0] if len(inside[i]) == 1 else labels[exemplar]
        labels[i] = stands[i] if center[i] else one
    labels[np.bincount(labels)[labels] < k] = -1
    return renumbered(labels)
