"""HOTA and MOTA: how well tracks keep their particle.

Both count the positions there are; gaps are not bridged. A pair is a true position and
another one of its frame within the gate, alike by 1 - distance / gate.
"""

import numpy as np
from scipy.spatial import KDTree

from kilnflight.arrays import Array, Index, Numbers, Whole
from kilnflight.association import assign

Positions = tuple[Whole, Array, Index]  # frames (n,) ascending, points (n, d), tracks
KEPT = 1e3  # a pair of before is worth more than all others of a frame
TIE = 1e-9  # smaller differences are rounding


def identities(true: Positions, other: Positions, gate: float) -> Numbers:
    """Return HOTA and MOTA by name.

    HOTA (Luiten et al., Int. J. Comput. Vis. 129, 2021) is the mean over the thresholds
    0.05 to 0.95 of alike. Its pairs are chosen by how well their tracks fit in all
    frames.
    """
    frames, points, i = true
    others, places, j = other
    # Positions of two frames are no pair: they are farther apart than the gate.
    first = KDTree(np.column_stack([points, 2 * gate * frames]))
    second = KDTree(np.column_stack([places, 2 * gate * others]))
    near = first.sparse_distance_matrix(second, gate, output_type="ndarray")
    near = np.sort(near[near["v"] < gate], order=["i", "j"])
    row = near["i"]
    column = near["j"]
    alike = 1 - near["v"] / gate
    size = np.bincount(i)[i[row]] + np.bincount(j)[j[column]]
    pair = np.unique(i[row] * len(j) + j[column], return_inverse=True)[1]
    rivals = np.bincount(row, alike)[row] + np.bincount(column, alike)[column]
    common = np.bincount(pair, alike / (rivals - alike))[pair]
    worth = alike * common / (size - common)
    taken = assign(row, column, -worth, np.zeros(len(i)))
    scores = []
    for least in np.arange(1, 20) / 20:
        hit = taken & (alike > least - TIE)
        hits = np.bincount(pair, hit)[pair]
        shared = (hits / (size - hits))[hit].sum()
        scores.append(np.sqrt(shared / (len(i) + len(j) - hit.sum())))
    gained = _gained(frames[row], i[row], j[column], alike)
    mota = 1 - (len(i) + len(j) - gained) / len(i)
    return {"hota": float(np.mean(scores)), "mota": mota}


def _gained(frame: Whole, true: Index, other: Index, alike: Array) -> int:
    """Return by how much the pairs (p,) of MOTA reduce its errors.

    MOTA (Bernardin and Stiefelhagen, J. Image Video Process. 2008): a pair stays as
    long as it is near; the others of a frame are those most alike. Of the positions
    that are missed or false a pair takes two away; a switch is an error more.
    """
    partner = np.full(true.max(initial=-1) + 1, -1)
    gained = 0
    for rows in np.split(np.arange(len(frame)), np.flatnonzero(np.diff(frame)) + 1):
        i = true[rows]
        j = other[rows]
        worth = alike[rows] + KEPT * (partner[i] == j)
        taken = assign(i, j, -worth, np.zeros(len(partner)))
        i = i[taken]
        j = j[taken]
        gained += 2 * len(i) - int(np.sum((partner[i] >= 0) & (partner[i] != j)))
        partner[i] = j
    return gained
