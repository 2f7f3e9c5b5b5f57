"""The fit of the simulation's light to Otsu's row of Table 5.5 and its recall by class.

Nothing else of any detector is looked at. `fit` was run once; its result stands in
`kilnflight.twin.light.Optics`, rounded by hand.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import minimize

from kilnflight.arrays import Array, Single
from kilnflight.detection import Otsu
from kilnflight.detection.otsu import flame_mask
from kilnflight.project import claims
from kilnflight.scores import score_detections
from kilnflight.twin import scenes, truth
from kilnflight.twin.light import Optics
from kilnflight.twin.scene import Twin

FITTED = ("unlit", "unlit_spread", "flame", "thick_mm", "gas_mm")
FRAMES = (77, 82)  # of each subset, as spare ones as the ten labelled ones show
CLASSES = {2: 1.0, 4: 0.9}  # recall that section 5.1.3 and Fig. 5.5 give for flames: air, wall
RATE_SD, RECALL_SD = 0.02, 0.04  # of precision and recall: weights of the misfit
LARGEST_UNLIT = 0.9  # of the median unlit level: it must not outshine the wall


def prepare(seeds: Iterable[int]) -> list[tuple[Twin, Single]]:
    """Return the subsets of some seeds, each with its background: a median without particles."""
    twins = [scenes.cached_scene(name, seed) for seed in seeds for name in scenes.SUBSETS]
    return [
        (twin, np.median([twin.empty(t) for t in range(0, 160, 20)], axis=0).astype(np.float32))
        for twin in twins
    ]


def with_light(twin: Twin, optics: Optics) -> Twin:
    """Return a recording in another light; flights and walls stay."""
    other = Twin(replace(twin.scene, optics=optics))
    kept = ("life", "_background", "_noise", "_bodies", "_wall")
    other.__dict__.update({name: getattr(twin, name) for name in kept})
    return other


def rates(prepared: Iterable[tuple[Twin, Single]], optics: Optics) -> tuple[Array, Array]:
    """Return precision and recall by subset (5, 2) of Otsu, and recall by class of `CLASSES`."""
    counts, classes = np.zeros((5, 3)), np.zeros((len(CLASSES), 2))
    for first, background in prepared:
        twin, k = with_light(first, optics), scenes.SUBSETS.index(first.scene.name)
        roi, rectangle = twin.attributes.roi, twin.scene.surroundings.flame_roi
        for t in FRAMES:
            gray, marked = twin.gray(t), truth.marked(twin, [t])
            foreground = np.maximum(gray - background, 0.0)
            foreground[flame_mask(gray, rectangle)] = 0.0
            spots = Otsu()(foreground)[:, :2]
            score = score_detections(marked[["row", "col"]].to_numpy(), spots, roi=roi)
            counts[k] += score.tp, score.fp, score.fn
            label = marked["label"].to_numpy()
            for row, kind in enumerate(CLASSES):
                found = (label[score.pairs[:, 0]] == kind).sum()
                classes[row] += found, found + (label[score.missed] == kind).sum()
    tp, fp, fn = counts.T
    return np.stack([tp / (tp + fp), tp / (tp + fn)], axis=1), classes[:, 0] / classes[:, 1]


def misfit(prepared: Iterable[tuple[Twin, Single]], optics: Optics) -> float:
    """Return the sum of squared deviations from print over `RATE_SD` and `RECALL_SD`."""
    if optics.unlit > LARGEST_UNLIT or min(optics.thick_mm, optics.gas_mm) < 0.5:
        return 1e6
    printed = claims.published("table_5.5").set_index("subset").loc[list(scenes.SUBSETS)]
    ours, classes = rates(prepared, optics)
    off = (ours - printed[["precision", "recall"]].to_numpy(float)) / (RATE_SD, RECALL_SD)
    return float(np.sum(off**2) + np.sum(((classes - [*CLASSES.values()]) / RECALL_SD) ** 2))


def fit(seeds: Iterable[int] = (0, 1, 2), steps: int = 200) -> Optics:
    """Return the light of the least misfit found by Nelder and Mead from the present one."""
    prepared, start = prepare(seeds), Optics()
    first = np.array([getattr(start, name) for name in FITTED])

    def cost(shares: Any) -> float:
        values = dict(zip(FITTED, (first * np.exp(shares)).tolist(), strict=True))
        return misfit(prepared, replace(start, **values))

    simplex = np.vstack([np.zeros(5), 0.15 * np.eye(5)])
    options: Any = {"maxfev": steps, "initial_simplex": simplex, "xatol": 0.01, "fatol": 0.5}
    best = minimize(cost, np.zeros(5), method="Nelder-Mead", options=options)
    return replace(start, **dict(zip(FITTED, (first * np.exp(best.x)).tolist(), strict=True)))
