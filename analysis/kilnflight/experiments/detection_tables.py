"""Tables of the detection experiment (sections 5.1.2 to 5.1.4), and what its frames can resolve.

tables of `detection` -> rates by subset and class beside the publication -> frames drawn anew
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.checks import InputError
from kilnflight.detection import Polygon
from kilnflight.detection.wall import Cylinder, CylinderFit, crossing
from kilnflight.experiments.detection import COUNTS, GATES, TABLES, Subset, sum_counts
from kilnflight.project import claims
from kilnflight.scores import count_in_air, rates, score_detections
from kilnflight.scores.detections import GATE_PX, FrameScore
from kilnflight.scores.intervals import Bootstrap, percentiles
from kilnflight.twin import truth
from kilnflight.twin.camera import Geometry

# Parameters in the tables of clusterers, and the row whose recall section 5.1.3 discusses.
PARAMETERS = {"dbscan": ["minPts", "epsilon_mm"], "mo": ["R"], "qcc": ["K", "alpha"]}
RATES = ["precision", "recall", "f1"]
ANALYSED = {"dbscan": 5, "mo": 1, "qcc": 2}
ABSOLUTE, STOPS = "absolute", "stops at zero"  # column ``reading``, of differences
DRAWS = Bootstrap().draws
NOT_DRAWN = "no interval: one frame per subset"
ANY_DISTANCE_MM = 10_000.0  # from the kiln's axis: no particle is as far


def with_total(table: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Return `sum_counts` by subset, and below them those of all subsets, "Total"."""
    total = sum_counts(table.assign(subset="Total"), [name for name in by if name != "threshold"])
    return pd.concat([sum_counts(table, by), total], ignore_index=True)


def beside_published(table: pd.DataFrame, name: str) -> pd.DataFrame:
    """Return counts with the published rates, from a table of the thesis, where it prints them.

    Rows belong together by the columns that both have, such as ``subset`` or ``method``.
    """
    printed = claims.published(name).rename(columns={"test_set": "subset"})
    keys = [key for key in ("subset", "method") if key in printed]
    rates = [rate for rate in RATES if rate in table]
    printed = printed[[*keys, *rates]].rename(columns={rate: f"{rate}_published" for rate in rates})
    return table.merge(printed, how="left", on=keys)


def sum_with_unlit(table: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Return `sum_counts` without times, and ``recall_non_burning``, that of class 3."""
    unlit = class_recall(table, by).query("label == 3")[[*by, "recall"]]
    unlit = unlit.rename(columns={"recall": "recall_non_burning"})
    return sum_counts(table, by).drop(columns="seconds_per_image").merge(unlit)


def class_recall(table: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Return the recall of each class: ``by``, ``label``, ``tp``, ``fn``, ``recall``, ``kind``."""
    groups, parts = table.groupby(by, sort=False), []
    for label, kind in truth.CLASSES.items():
        counts = groups[[f"tp_{label}", f"fn_{label}"]].sum().set_axis(["tp", "fn"], axis=1)
        counts.insert(0, "label", label)
        recall = counts["tp"] / (counts["tp"] + counts["fn"])  # NaN where none is marked
        parts.append(counts.assign(recall=recall, kind=kind).reset_index())
    return pd.concat(parts, ignore_index=True)


def recall_by_class(attempts: pd.DataFrame) -> pd.DataFrame:
    """Return the recall of each class in a column, by method in the order of `run`."""
    recall = class_recall(attempts, ["method"])
    by_class = recall.pivot(index="method", columns="label", values="recall")
    by_class.columns = ["burning_in_air", "non_burning_in_air", "burning_on_wall"]
    return by_class.loc[attempts["method"].unique()].reset_index()


def analysed_recall(attempts: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Return `class_recall` with the settings that the thesis analyses."""
    return class_recall(attempts[attempts["row"] == attempts["family"].map(ANALYSED)], by)


def chosen_sift(attempts: pd.DataFrame, times: pd.DataFrame) -> pd.DataFrame:
    """Return SIFT with each subset's chosen threshold and the time that it takes.

    ``attempts`` is of `detection.compare_pictures`, ``times`` of `detection.time_thresholds`.
    """
    sift = attempts[attempts["chosen"] & (attempts["method"] == "SIFT")]
    seconds = times.groupby(["subset", "threshold"])["seconds"].median()
    return sift.drop(columns="seconds").join(seconds, on=["subset", "threshold"])


def time_table(times: pd.DataFrame) -> pd.DataFrame:
    """Return Table 5.7 with ``measured_s``, the medians of `detection.time_thresholds`."""
    printed = claims.published("table_5.7").rename(columns={"dog_local_max": "threshold"})
    seconds = times.groupby("threshold")["seconds"].median()
    return printed.assign(measured_s=printed["threshold"].map(seconds))


def background_traces(
    subset: Subset, t: int, backgrounds: Mapping[str, npt.NDArray[Any]], clean: npt.NDArray[Any]
) -> dict[str, float]:
    """Return how far backgrounds of frame t are from ``clean``, the scene without any particle.

    Root mean square in grey values over pixels that hold a particle in one of the frames
    around, but not now.
    """
    marked = np.any([subset.instances(k) >= 0 for k in range(t - 25, t + 26, 5)], axis=0)
    trace = marked & ~(subset.instances(t) >= 0)
    return {
        name: float(np.sqrt(np.mean((image - clean)[trace] ** 2)))
        for name, image in backgrounds.items()
    }


def cluster_table(attempts: pd.DataFrame, family: str) -> pd.DataFrame:
    """Return `with_total` of a family's settings, with the published rates in the total.

    ``attempts`` is of `detection.compare_clusterers`, ``family`` one of `detection.TABLES`.
    """
    table = with_total(attempts[attempts["family"] == family], ["row", "subset"])
    settings = claims.published(TABLES[family]).loc[table.pop("row")].reset_index(drop=True)
    printed = settings[RATES].where(table["subset"] == "Total").add_suffix("_published")
    return pd.concat([settings[PARAMETERS[family]], table, printed], axis=1)


def cluster_totals(tables: Mapping[str, pd.DataFrame]) -> dict[str, pd.DataFrame]:
    """Return the rows of `cluster_table` that sum over all subsets, by family."""
    return {name: table[table["subset"] == "Total"] for name, table in tables.items()}


def as_diameter(attempts: pd.DataFrame) -> pd.DataFrame:
    """Return a table of `detection.run` whose counts take 45 px as a diameter."""
    (suffix,) = (name for name in GATES if name)
    near = attempts.filter(regex=f"{suffix}$").rename(columns=lambda name: name[: -len(suffix)])
    return attempts.assign(**near)


def reading_last(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table with the column ``reading`` as its last one, absolute differences first."""
    order = [name for name in table if name != "reading"]
    return table[[*order, "reading"]].sort_values("reading", kind="stable", ignore_index=True)


def _paired(
    marked: pd.DataFrame, spots: pd.DataFrame, roi: Polygon | None, gate: float = GATE_PX
) -> Iterator[tuple[str, pd.DataFrame, pd.DataFrame, FrameScore]]:
    """Yield subset, particles, detections and their pairs, of each frame of `positions`."""
    for (subset, frame), particles in marked.groupby(["subset", "frame"], sort=False):
        found = spots[(spots["subset"] == subset) & (spots["frame"] == frame)]
        score = score_detections(particles[["row", "col"]], found[["row", "col"]], gate, roi)
        yield str(subset), particles, found, score


def precision_by_case(
    marked: pd.DataFrame, detected: pd.DataFrame, roi: Polygon | None
) -> pd.DataFrame:
    """Return how many detections of each case are paired with a marked particle.

    Columns: ``case``, ``detections``, ``right``, ``precision``. ``marked`` and ``detected`` are of
    `detection.positions`.
    """
    parts = [
        found[["case"]].assign(right=np.isin(np.arange(len(found)), score.pairs[:, 1]))
        for _, _, found, score in _paired(marked, detected, roi)
    ]
    counts = pd.concat(parts).groupby("case")["right"].agg(detections="size", right="sum")
    return counts.assign(precision=counts["right"] / counts["detections"]).reset_index()


def classification_table(
    marked: pd.DataFrame,
    spots: pd.DataFrame,
    thresholds: Mapping[str, float],
    roi: Polygon | None,
    gate: float = GATE_PX,
) -> pd.DataFrame:
    """Return how well spots are classified as in the air (Tables 5.13 and 5.14).

    Parameters
    ----------
    marked
        Of `detection.positions`; what has no distance from the axis is not considered.
    spots
        Detections of `detection.positions`; for Table 5.13 the marked particles themselves.
    thresholds
        By name: up to which distance in mm a spot is in the air.
    roi, gate
        As of `score_detections`.

    Returns
    -------
    DataFrame
        ``threshold``, ``threshold_mm``, ``subset`` (and "Total"), ``tp``, ``fp``, ``fn``,
        ``precision``, ``recall``, ``f1``.
    """
    rows, frames = [], list(_paired(marked, spots, roi, gate))
    for (name, level), (subset, particles, found, score) in product(thresholds.items(), frames):
        flying = (particles["label"] != 4) & particles["distance_mm"].notna()
        row = {"threshold": name, "threshold_mm": level, "subset": subset}
        rows.append(row | count_in_air(score, flying, found["distance_mm"] <= level))
    table = pd.DataFrame(rows)
    keys = ["threshold", "threshold_mm", "subset"]
    both = pd.concat([table, table.assign(subset="Total")]).groupby(keys, sort=False)
    counts = both[list(COUNTS)].sum().reset_index()
    return pd.concat([counts, rates(*(counts[count] for count in COUNTS))], axis=1)


def published_radius_mm() -> float:
    """Return the radius of the fitted cylinder as printed in Table 5.12."""
    printed = claims.published("table_5.12").set_index("quantity")["value_mm"]
    return float(printed["Radius"])


def fitted_walls(
    walls: Mapping[str, npt.NDArray[np.float64]], seed: int
) -> dict[str, Cylinder | None]:
    """Return the cylinder in each subset's wall points, None where they hold none.

    The largest cluster may be a strip of the floor near the camera, as flat as a plane. Why it is
    refused is printed.

    Raises
    ------
    InputError
        If the first subset has none: its cylinder serves all.
    """
    fits: dict[str, Cylinder | None] = {}
    for name, points in walls.items():
        try:
            fits[name] = CylinderFit()(points, seed)
        except InputError as error:
            if not fits:
                raise InputError(f"{name}, whose wall serves all subsets: {error}") from error
            print(f"{name}: {error}")
            fits[name] = None
    return fits


def cylinder_table(fits: Mapping[str, Cylinder | None], geometry: Geometry) -> pd.DataFrame:
    """Return the fitted cylinder of each subset beside the true one and Table 5.12.

    Of a subset without one (`fitted_walls`), what is measured is empty.
    """
    along = [
        abs(np.dot(fit.direction, geometry.axes[0])) if fit else np.nan for fit in fits.values()
    ]
    names = ["radius_mm", "inliers", "rms_mm"]
    rows = [asdict(fit) if fit else dict.fromkeys(names) for fit in fits.values()]
    table = pd.DataFrame(rows)[names].astype(
        {"radius_mm": float, "inliers": "Int64", "rms_mm": float}
    )
    table.insert(0, "subset", list(fits))
    table.insert(2, "radius_true_mm", geometry.kiln_radius_mm)
    table.insert(3, "radius_published_mm", published_radius_mm())
    table.insert(4, "direction_off_deg", np.degrees(np.arccos(np.minimum(along, 1.0))))
    return table


def axis_thresholds(placed: pd.DataFrame) -> dict[str, float]:
    """Return up to which distance from the axis in mm a particle is in the air, by name.

    Where the Gaussians of both kinds cross, that plus 40 mm, and the printed 800 mm. The last one
    calls all that there is in the air: what the others must beat. ``placed`` holds ``label`` and
    ``distance_mm`` of marked particles with 3D.
    """
    on_wall, distance = placed["label"] == 4, placed["distance_mm"]
    crossing_mm = crossing(distance[~on_wall], distance[on_wall])
    thresholds = {"crossing_plus_40": crossing_mm + 40.0, "crossing": crossing_mm}
    return {**thresholds, "printed_800": 800.0, "all_in_air": ANY_DISTANCE_MM}


def resampled(
    table: pd.DataFrame, columns: Sequence[str], seed: int, draws: int = DRAWS
) -> pd.DataFrame:
    """Return sums over draws of frames with replacement, within each subset.

    All methods of ``table`` (of `detection.run`) see the same draws, so that differences are
    paired. A row per draw; columns by subset, count and method. No row at all if a subset has
    one frame: drawn again it is always itself, which would look like certainty.
    """
    generator, sums = np.random.default_rng(seed), {}
    if table.groupby("subset")["frame"].nunique().min() < 2:
        draws = 0
    for subset, rows in table.groupby("subset", sort=False):
        wide = rows.pivot(index="frame", columns="method", values=list(columns))
        if wide.isna().to_numpy().any():
            raise InputError("resampled: a method lacks a frame; give all methods all frames.")
        picked = generator.integers(len(wide), size=(draws, len(wide)))
        sums[subset] = pd.DataFrame(wide.to_numpy()[picked].sum(axis=1), columns=wide.columns)
    return pd.concat(sums, axis=1)


def resampled_rates(table: pd.DataFrame, seed: int, draws: int = DRAWS) -> dict[str, pd.DataFrame]:
    """Return precision, recall and F1 over draws as of `resampled`, (draws, methods) each."""
    sums = resampled(table, COUNTS, seed, draws).T.groupby(level=[1, 2], sort=False).sum().T
    tp, fp, fn = (pd.DataFrame(sums[count]) for count in COUNTS)
    return {
        "precision": tp / (tp + fp).clip(lower=1),
        "recall": tp / (tp + fn).clip(lower=1),
        "f1": 2 * tp / (2 * tp + fp + fn).clip(lower=1),
    }


def subset_draws(
    table: pd.DataFrame, method: str, columns: Sequence[str], seed: int
) -> list[pd.DataFrame]:
    """Return counts of a method in each subset over draws, (draws, subsets) each."""
    sums = resampled(table, columns, seed)
    parts = (sums.xs((column, method), axis=1, level=(1, 2)) for column in columns)
    return [pd.DataFrame(part) for part in parts]


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


def f1_beside_published(attempts: pd.DataFrame, seed: int) -> pd.DataFrame:
    """Return `f1_with_intervals` beside Table 5.11, also ``f1_published_recomputed``.

    That is the F1 of the printed counts.
    """
    printed = claims.published("table_5.11").set_index("method")
    f1 = f1_with_intervals(attempts, printed["f1"], seed)
    recomputed = 2 * printed["TP"] / (2 * printed["TP"] + printed["FP"] + printed["FN"])
    return f1.assign(f1_published_recomputed=recomputed)


def listed(values: Mapping[str, float] | pd.Series) -> str:
    """Return named numbers as a list.

    Examples
    --------
    >>> listed({"V1": 500, "V2": 0.913})
    'V1 500, V2 0.91'
    """
    return ", ".join(f"{name} {value:.{0 if value >= 1 else 2}f}" for name, value in values.items())


def interval(values: npt.ArrayLike, what: str = "") -> str:
    """Return the 95 % interval of draws in words, behind ``what`` it is of; "" without draws.

    Examples
    --------
    >>> interval([0.1, 0.1, 0.1])
    '95 % [+0.100, +0.100]'
    """
    if not np.size(values):
        return ""
    low, high = percentiles(values)
    return f"{what} 95 % [{low:+.3f}, {high:+.3f}]".lstrip()


def share(holds: npt.ArrayLike, what: str = "") -> str:
    """Return in how many draws a condition, ``what``, holds, in words; "" without draws.

    Examples
    --------
    >>> share([True, True, False, True])
    'in 75% of the draws of frames'
    """
    if not np.size(holds):
        return ""
    return f"{what} in {np.mean(np.asarray(holds, dtype=bool)):.0%} of the draws of frames".lstrip()
