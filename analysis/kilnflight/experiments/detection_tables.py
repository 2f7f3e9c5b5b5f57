"""Tables of the detection experiment (thesis, sections 5.1.2 to 5.1.4).

tables of `detection` -> rates by subset and class beside the publication -> frames drawn anew
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from itertools import product

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.checks import InputError
from kilnflight.detection import Polygon
from kilnflight.detection.wall import Cylinder, fit_cylinder
from kilnflight.experiments.detection import COUNTS, TABLES, sum_counts
from kilnflight.project import claims
from kilnflight.scores import count_in_air, rates, score_detections
from kilnflight.scores.intervals import DRAWS
from kilnflight.twin import truth
from kilnflight.twin.camera import Geometry

# Parameters in the tables of clusterers
PARAMETERS = {"dbscan": ["minPts", "epsilon_mm"], "mo": ["R"], "qcc": ["K", "alpha"]}
RATES = ["precision", "recall", "f1"]


def with_total(table: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Return `sum_counts` by subset, and below them those of all subsets, "Total"."""
    total = sum_counts(table.assign(subset="Total"), [name for name in by if name != "threshold"])
    return pd.concat([sum_counts(table, by), total], ignore_index=True)


def beside_published(table: pd.DataFrame, name: str) -> pd.DataFrame:
    """Return rates beside those of a table of the thesis, by ``subset`` or ``method``."""
    printed = claims.published(name).rename(columns={"test_set": "subset"})
    keys = [key for key in ("subset", "method") if key in printed]
    printed = printed[[*keys, *RATES]].rename(columns={rate: f"{rate}_published" for rate in RATES})
    return table.merge(printed, how="left", on=keys)


def class_recall(table: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Return the recall of each class: ``by``, ``label``, ``tp``, ``fn``, ``recall``, ``kind``."""
    groups, parts = table.groupby(by, sort=False), []
    for label, kind in truth.CLASSES.items():
        counts = groups[[f"tp_{label}", f"fn_{label}"]].sum().set_axis(["tp", "fn"], axis=1)
        counts.insert(0, "label", label)
        recall = counts["tp"] / (counts["tp"] + counts["fn"])  # NaN where none is marked
        parts.append(counts.assign(recall=recall, kind=kind).reset_index())
    return pd.concat(parts, ignore_index=True)


def cluster_table(attempts: pd.DataFrame, family: str) -> pd.DataFrame:
    """Return `with_total` of a family's settings, with the published rates in the total.

    ``attempts`` is of `detection.compare_clusterers`, ``family`` one of `detection.TABLES`.
    """
    table = with_total(attempts[attempts["family"] == family], ["row", "subset"])
    settings = claims.published(TABLES[family]).loc[table.pop("row")].reset_index(drop=True)
    printed = settings[RATES].where(table["subset"] == "Total").add_suffix("_published")
    return pd.concat([settings[PARAMETERS[family]], table, printed], axis=1)


def classification_table(
    marked: pd.DataFrame,
    spots: pd.DataFrame,
    thresholds: Mapping[str, float],
    roi: Polygon | None,
) -> pd.DataFrame:
    """Return the rates of spots classified as in the air (Tables 5.13 and 5.14).

    Parameters
    ----------
    marked
        Of `detection.positions`; particles without a distance from the axis are left out.
    spots
        Detections of `detection.positions`; for Table 5.13 the marked particles themselves.
    thresholds
        By name: largest distance in mm of a spot in the air.
    roi
        As of `score_detections`.

    Returns
    -------
    DataFrame
        ``threshold``, ``threshold_mm``, ``subset`` (and "Total"), ``tp``, ``fp``, ``fn``,
        ``precision``, ``recall``, ``f1``.
    """
    frames, rows = [], []
    for (subset, frame), particles in marked.groupby(["subset", "frame"], sort=False):
        found = spots[(spots["subset"] == subset) & (spots["frame"] == frame)]
        score = score_detections(particles[["row", "col"]], found[["row", "col"]], roi=roi)
        flying = (particles["label"] != 4) & particles["distance_mm"].notna()
        frames.append((subset, flying, found["distance_mm"], score))
    for (name, level), (subset, flying, distance, score) in product(thresholds.items(), frames):
        row = {"threshold": name, "threshold_mm": level, "subset": subset}
        rows.append(row | count_in_air(score, flying, distance <= level))
    table = pd.DataFrame(rows)
    keys = ["threshold", "threshold_mm", "subset"]
    both = pd.concat([table, table.assign(subset="Total")]).groupby(keys, sort=False)
    counts = both[list(COUNTS)].sum().reset_index()
    return pd.concat([counts, rates(*(counts[count] for count in COUNTS))], axis=1)


def cylinder_table(
    walls: Mapping[str, npt.NDArray[np.float64]], seed: int, geometry: Geometry
) -> tuple[Cylinder, pd.DataFrame]:
    """Fit a cylinder to each subset's wall points (n, 3) in mm.

    Returns
    -------
    first : Cylinder
        Of the first subset.
    table : DataFrame
        The cylinders beside the true one and Table 5.12. Cells are empty where most points of the
        largest cluster lie on no cylinder.
    """
    fits: dict[str, Cylinder] = {}
    for name, points in walls.items():
        try:
            fits[name] = fit_cylinder(points, seed)
        except InputError:
            if not fits:
                raise
    rows = [asdict(fit) for fit in fits.values()]
    table = pd.DataFrame(rows, index=list(fits))[["radius_mm", "inliers", "rms_mm"]]
    along = [abs(np.dot(fit.direction, geometry.axes[0])) for fit in fits.values()]
    table.insert(1, "direction_off_deg", np.degrees(np.arccos(np.minimum(along, 1.0))))
    table = table.astype({"inliers": "Int64"}).reindex(list(walls))
    printed = claims.published("table_5.12").set_index("quantity")["value_mm"]["Radius"]
    table.insert(1, "radius_true_mm", geometry.kiln_radius_mm)
    table.insert(2, "radius_published_mm", float(printed))
    return next(iter(fits.values())), table.rename_axis("subset").reset_index()


def resampled_rates(table: pd.DataFrame, seed: int, draws: int = DRAWS) -> dict[str, pd.DataFrame]:
    """Return precision, recall and F1 over draws of frames, (draws, methods) each.

    Frames of ``table`` (of `detection.run`) are drawn with replacement within each subset, the
    same for all methods, so that differences are paired. There are no draws if a subset has one
    frame: drawn again it is always itself, which would look like certainty.
    """
    generator, sums = np.random.default_rng(seed), []
    if table.groupby("subset")["frame"].nunique().min() < 2:
        draws = 0
    for _, rows in table.groupby("subset", sort=False):
        wide = rows.pivot(index="frame", columns="method", values=list(COUNTS))
        picked = generator.integers(len(wide), size=(draws, len(wide)))
        sums.append(pd.DataFrame(wide.to_numpy()[picked].sum(axis=1), columns=wide.columns))
    total = sum(sums[1:], start=sums[0])
    tp, fp, fn = (pd.DataFrame(total[count]) for count in COUNTS)
    return {
        "precision": tp / (tp + fp).clip(lower=1),
        "recall": tp / (tp + fn).clip(lower=1),
        "f1": 2 * tp / (2 * tp + fp + fn).clip(lower=1),
    }


def f1_with_intervals(table: pd.DataFrame, published: pd.Series, seed: int) -> pd.DataFrame:
    """Return each method's F1 with its 95 % interval over draws of frames.

    By ``method``: ``f1``, ``f1_low``, ``f1_high`` (NaN with one frame per subset),
    ``f1_in_pixels``, ``f1_published`` (NaN where ``published`` has none).
    """
    total = sum_counts(table, ["method"]).set_index("method")
    draws = resampled_rates(table, seed)["f1"]
    low, high = draws[total.index].quantile([0.025, 0.975]).to_numpy()
    f1 = total[["f1"]].assign(f1_low=low, f1_high=high, f1_in_pixels=total["f1_in_pixels"])
    return f1.assign(f1_published=published)
