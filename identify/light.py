"""Fit the simulation's light to what the thesis prints of brightness and size.

    python -m identify.light

fits for some ten minutes, prints the inputs, and compares them with the thesis for
three seeds. `kilnflight.simulated.kiln.light.Optics` has the result, rounded by hand;
notebook 10 shows what it reaches.

The fit reads Otsu's method alone: precision and recall by subset (Table 5.5), recall of
burning and unlit particles (section 5.1.3), radii (Fig. 3.12), and flames that are
overexposed (section 3.1). The background is the simulation's own without particles.
"""

from collections.abc import Iterable
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import minimize

from kilnflight.arrays import Integers, Single
from kilnflight.detection import Otsu
from kilnflight.detection.otsu import flame_mask
from kilnflight.detection.region import inside
from kilnflight.experiments.detection.labelled import class_counts
from kilnflight.publication import claims
from kilnflight.scores import score_detections
from kilnflight.simulated.kiln import scenes
from kilnflight.simulated.kiln.feeding import BURNING, LABELLED, ON_WALL, UNLIT
from kilnflight.simulated.kiln.geometry import FULL_SCALE
from kilnflight.simulated.kiln.light import Optics
from kilnflight.simulated.kiln.scene import SceneView, Twin

SEEDS = (0, 1, 2)
FRAMES = (80,)  # one is enough: all ten labelled ones show nearly the same particles
LARGE_PX = 15.0  # "approximately all particles" are smaller (section 3.3)
CORE = 0.7  # share of a flame's radius within which a pixel is at full scale
# section 5.1.3
UNLIT_RECALL = {"V1": 0.16, "V2": 0.16, "V3": 0.16, "V4": 0.0, "V5": 0.35}
# Deviations that count 1 in the misfit, for each subset
BY_SUBSET = {"precision": 0.02, "recall": 0.04, "recall of the unlit": 0.04}
# Printed value of all subsets, and the deviation that counts 1
TOTALS = {
    "recall in air": (1.0, 0.04),
    "recall on the wall": (0.9, 0.04),
    "mean radius (px)": (7.7, 0.3),
    "share above 15 px": (0.0, 0.02),
    "share of flames overexposed": (1.0, 0.1),
}
FITTED = ("paper", "paper_spread", "flame", "thick_mm", "gas_mm", "flame_softness")
# The median unlit particle must not outshine the wall. Bodies are darker than paper and
# two in five, so that it is the paper below which a sixth of all paper lies.
LARGEST_UNLIT = 0.9
SIXTH = -0.967
Prepared = list[tuple[Twin, Single]]


def prepare(seeds: Iterable[int], names: Iterable[str] = scenes.SUBSETS) -> Prepared:
    """Open scenes of some seeds, each with the median of frames without particles."""
    prepared = []
    for seed in seeds:
        for name in names:
            twin = scenes.open_scene(name, seed)
            empty = [twin.empty(t) for t in range(0, 160, 20)]
            prepared.append((twin, np.median(empty, axis=0).astype(np.float32)))
    return prepared


def with_light(twin: Twin, optics: Optics) -> Twin:
    """Put a recording into another light; flights and walls stay."""
    other = Twin(replace(twin.scene, optics=optics))
    for name in ("life", "_background", "_noise", "_bodies"):
        other.__dict__[name] = getattr(twin, name)
    return other


def _counts(twin: Twin, background: Single, t: int) -> dict[str, Any]:
    """Count detections by Otsu, recalls by class, radii and flames of one frame."""
    view = twin.view(t)
    roi = twin.scene.roi
    marked = view.visible & inside(roi, view.blobs.row, view.blobs.column)
    places = np.column_stack([view.blobs.row, view.blobs.column])[marked]
    spots = Otsu()(_foreground(twin, background, t, view.picture))
    score = score_detections(places, spots[:, :2], roi=roi)
    area = np.bincount(view.pixels.blob[view.shown], minlength=len(marked))[marked]
    radius = np.sqrt(area / np.pi)
    return {
        "tp": score.tp,
        "fp": score.fp,
        "fn": score.fn,
        "radius": radius.sum(),
        "large": np.count_nonzero(radius > LARGE_PX),
        **_count_flames(view),
        **class_counts(score, view.kinds[marked]),
    }


def _foreground(twin: Twin, background: Single, t: int, picture: Single) -> Integers:
    """Subtract the background from a picture with noise; the burner's flame is 0."""
    gray = twin.exposed(t, picture)
    foreground = np.rint(np.maximum(gray - background, 0.0)).astype(np.uint16)
    foreground[flame_mask(gray, twin.scene.interior.flame_roi)] = 0
    return foreground


def _count_flames(view: SceneView) -> dict[str, Any]:
    """Count the visible flames, and those with an overexposed core."""
    flames = np.flatnonzero(view.visible & (view.kinds == BURNING))
    full = view.picture.reshape(-1)[view.pixels.place] >= FULL_SCALE
    cores = view.pixels.blob[full & (view.pixels.radius <= CORE)]
    overexposed = np.count_nonzero(np.isin(flames, cores))
    return {"flames": len(flames), "overexposed": overexposed}


def count(
    prepared: Prepared, optics: Optics, frames: Iterable[int] = FRAMES
) -> pd.DataFrame:
    """Sum counts over frames, one row per seed and subset."""
    rows = []
    for first, background in prepared:
        twin = with_light(first, optics)
        counts = pd.DataFrame([_counts(twin, background, t) for t in frames]).sum()
        name = twin.scene.name.partition("@")[0]
        rows.append({"seed": twin.scene.seed // 1000, "subset": name, **counts})
    return pd.DataFrame(rows)


def _rates(sums: Any) -> dict[str, Any]:
    """Compute the quantities of the fit from sums of counts, one or a row each."""
    marked = sums["tp"] + sums["fn"]
    recall = {
        kind: sums[f"tp_{kind}"] / (sums[f"tp_{kind}"] + sums[f"fn_{kind}"])
        for kind in (BURNING, UNLIT, ON_WALL)
    }
    return {
        "precision": sums["tp"] / (sums["tp"] + sums["fp"]),
        "recall": sums["tp"] / marked,
        "recall of the unlit": recall[UNLIT],
        "recall in air": recall[BURNING],
        "recall on the wall": recall[ON_WALL],
        "mean radius (px)": sums["radius"] / marked,
        "share above 15 px": sums["large"] / marked,
        "share of flames overexposed": sums["overexposed"] / sums["flames"],
    }


def compare(counts: pd.DataFrame) -> pd.DataFrame:
    """Compare the quantities of the fit with print, by subset and in total.

    Returns
    -------
    DataFrame
        ``quantity``, ``subset`` ("all" in total), ``printed``, ``ours`` and ``sd``, the
        deviation that counts 1 in the misfit.
    """
    sums = counts.groupby("subset").sum(numeric_only=True)
    printed = claims.published("table_5.5").set_index("subset")
    printed["recall of the unlit"] = pd.Series(UNLIT_RECALL)
    rows: list[tuple[Any, ...]] = []
    ours = _rates(sums)
    for subset, (name, sd) in product(sums.index, BY_SUBSET.items()):
        known = printed[name][subset]
        rows.append((name, subset, known, ours[name][subset], sd))
    total = _rates(sums.sum())
    for name, (value, sd) in TOTALS.items():
        rows.append((name, "all", value, total[name], sd))
    return pd.DataFrame(rows, columns=["quantity", "subset", "printed", "ours", "sd"])


def report(counts: pd.DataFrame) -> pd.DataFrame:
    """Compare counts with print seed by seed.

    Returns
    -------
    DataFrame
        ``quantity``, ``subset``, ``printed``, and a column for each seed.
    """
    table = compare(counts)[["quantity", "subset", "printed"]]
    for seed, one in counts.groupby("seed"):
        table[f"seed_{seed}"] = compare(one)["ours"]
    return table


def misfit(prepared: Prepared, optics: Optics) -> float:
    """Return the sum of squared deviations from print, in units of ``sd``."""
    unlit = optics.paper * np.exp(SIXTH * optics.paper_spread)
    if unlit > LARGEST_UNLIT or not 0.1 < optics.flame_softness < 1.0:
        return 1e6
    table = compare(count(prepared, optics))
    return float((((table["ours"] - table["printed"]) / table["sd"]) ** 2).sum())


def fit(prepared: Prepared, start: Optics, steps: int) -> tuple[Optics, float]:
    """Find the light of the least misfit by Nelder and Mead.

    Parameters
    ----------
    prepared
        From `prepare`.
    start
        Light from which the search starts; what is not in `FITTED` stays.
    steps
        Largest number of evaluations.

    Returns
    -------
    light : Optics
    misfit : float
    """
    first = np.array([getattr(start, name) for name in FITTED])

    def light(logarithms: Any) -> Optics:
        values = (first * np.exp(logarithms)).tolist()
        return replace(start, **dict(zip(FITTED, values, strict=True)))

    def cost(logarithms: Any) -> float:
        return misfit(prepared, light(logarithms))

    simplex = 0.15 * np.eye(len(FITTED) + 1, len(FITTED), -1)  # the start is first
    options: Any = {
        "maxfev": steps,
        "initial_simplex": simplex,
        "xatol": 0.01,
        "fatol": 0.5,
    }
    best = minimize(cost, simplex[0], method="Nelder-Mead", options=options)
    return light(best.x), float(best.fun)


def main() -> None:
    """Fit the light, and compare it with print on all labelled frames."""
    prepared = prepare(SEEDS)
    optics, off = fit(prepared, Optics(), steps=150)
    fitted = {name: round(getattr(optics, name), 3) for name in FITTED}
    print(f"misfit {off:.1f}: {fitted}")
    print(report(count(prepared, optics, LABELLED)).round(3).to_string())


if __name__ == "__main__":
    main()
