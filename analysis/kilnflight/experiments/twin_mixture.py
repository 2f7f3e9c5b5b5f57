"""The twin's particles beside Tables 5.2 and 5.3, and how much to feed for the counts.

Run as ``python -m kilnflight.experiments.twin_mixture``, with subsets behind it for some of them.
The sizes of the three handfuls of a subset (`kilnflight.twin.scenes.HANDFULS`) are found from what
a large handful of each shows; the printed sizes are copied into `kilnflight.twin.scenes.SIZES` by
hand. A few tens of particles make chance large, so more sizes near them are tried by hand until no
class is off by more than 10 %. Only the feed is found here; no label is ever placed by hand.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from itertools import count, product

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.optimize import nnls

from kilnflight.project import claims
from kilnflight.twin import truth
from kilnflight.twin.camera import FULL_SCALE
from kilnflight.twin.scene import Scene, SceneView, Twin
from kilnflight.twin.scenes import HANDFULS, LABELLED, SUBSETS, second, subset_scene

CLOSE = 0.08  # a class count off by less is close enough; the rule is 10 % (design)
LARGE = 300  # particles of the handful that shows how many sightings a particle yields

Counts = npt.NDArray[np.float64]


def published_counts(subset: str) -> Counts:
    """Return burning in air, non-burning in air, burning on the wall of Table 5.2."""
    return claims.published("table_5.2")[subset].to_numpy(dtype=np.float64)[:3]


def labelled_particles(twins: Mapping[str, Twin], frames: int) -> pd.DataFrame:
    """Return what a person labels in the first frames: visible `truth.sightings` by subset."""
    pairs = product(twins.items(), LABELLED[:frames])
    parts = [truth.sightings(twin, t).assign(subset=name) for (name, twin), t in pairs]
    return pd.concat(parts).query("visible")


def count_table(labelled: pd.DataFrame, frames: int) -> pd.DataFrame:
    """Return labelled particles of ten frames by class and subset, beside Table 5.2.

    ``labelled`` is of `labelled_particles`, with that many ``frames``.
    """
    counts = labelled.pivot_table("row", "label", "subset", "count", fill_value=0) * 10 / frames
    published = claims.published("table_5.2")[list(counts)].iloc[:3].set_axis(counts.index)
    table = pd.concat({"twin": counts.round(0), "published": published}, names=["source"])
    table.insert(0, "class", table.index.get_level_values("label").map(truth.CLASSES))
    return table.reset_index()


def share_table(labelled: pd.DataFrame) -> pd.DataFrame:
    """Return how many labelled particles have depth and lie in the region of interest.

    ``labelled`` is of `labelled_particles`. By class, in percent of its particles, beside Tables
    5.2 and 5.3: ``has_depth_percent``, ``in_roi_percent``, ``published_depth_percent``,
    ``published_roi_percent``.
    """
    shares = labelled.groupby("label")[["has_depth", "in_roi"]].mean().mul(100).round(1)
    shares = shares.add_suffix("_percent")
    shares.insert(0, "class", shares.index.map(truth.CLASSES))
    for kind, name in {"depth": "5.2", "roi": "5.3"}.items():
        printed = claims.published(f"table_{name}").filter(like="percentage").iloc[:3, 0]
        shares[f"published_{kind}_percent"] = printed.str.rstrip("%").astype(float).to_numpy()
    return shares.reset_index()


def burning_table(twins: Mapping[str, Twin], frames: int) -> pd.DataFrame:
    """Return how many of what is labelled as burning in the air have a flame, by subset.

    Returns
    -------
    DataFrame
        ``subset``, ``burning_in_air`` (sightings in the first frames), ``char_percent`` (glowing,
        without a flame), ``flame_over_wall`` and ``char_over_wall`` (median grey value in the
        middle of a particle, up to full scale, over that of the wall).
    """
    rows = []
    for name, twin in twins.items():
        wall, seen = twin.scene.optics.at_wall, []
        for t in LABELLED[:frames]:
            view = twin.view(t)
            glowing, sharp = twin.life.glowing(view.moment), view.blobs.dilution
            level = sharp * view.blobs.brightness / wall + (1 - sharp)
            level = np.minimum(level, FULL_SCALE / wall)  # as the camera sees it
            values = pd.DataFrame({"char": glowing, "level": level})
            seen.append(values[_labelled(twin, view) & (view.kinds == 2)])
        table = pd.concat(seen)
        level = table.groupby("char")["level"].median()
        row = {"subset": name, "burning_in_air": len(table)}
        row |= {"char_percent": 100.0 * table["char"].mean()}
        row |= {"flame_over_wall": level.get(False), "char_over_wall": level.get(True)}
        rows.append(row)
    return pd.DataFrame(rows)


def counted(twin: Twin) -> Counts:
    """Return the visible particles of the labelled frames by class, summed, (3,)."""
    total = np.zeros(3)
    for t in LABELLED:
        view = twin.view(t)
        total += np.bincount(view.kinds[_labelled(twin, view)], minlength=5)[2:5]
    return total


def _labelled(twin: Twin, view: SceneView) -> npt.NDArray[np.bool_]:
    """Return which particles of a view a person labels: visible, their middle in the picture."""
    place, row, column = twin.scene.geometry, view.blobs.row, view.blobs.column
    inside = (row >= -0.5) & (row <= place.rows - 0.5)
    inside &= (column >= -0.5) & (column <= place.columns - 0.5)
    return view.visible & inside


def solve(
    name: str,
    seed: int,
    rounds: int = 8,
    tries: int = 6,
    varied: Callable[[Scene], Scene] = second,
) -> dict[str, int]:
    """Return the handfuls whose labelled frames count as Table 5.2 does.

    ``varied`` is what the twin makes of the scene.

    Large handfuls show how many sightings a particle of each yields; least squares without
    negative sizes gives the sizes; a few rounds correct for chance, and `refine` searches near
    the best.
    """
    published = published_counts(name)
    off: dict[tuple[int, ...], float] = {}

    def shown(sizes: dict[str, int]) -> Counts:
        return counted(Twin(varied(subset_scene(name, sizes, seed))))

    def measure(sizes: tuple[int, ...]) -> Counts:
        counts = shown(dict(zip(HANDFULS, sizes, strict=True)))
        off[sizes] = float(np.max(np.abs(counts / published - 1)))
        return counts

    yields = np.stack([shown({kind: LARGE}) / LARGE for kind in HANDFULS], axis=1)
    sizes, _ = nnls(yields, published)
    for _ in range(rounds):
        whole = tuple(map(int, np.round(sizes)))
        step, *_ = np.linalg.lstsq(yields, published - measure(whole), rcond=None)
        if off[whole] <= CLOSE:
            break
        sizes = np.maximum(sizes + 0.7 * step, 0.0)
    return dict(zip(HANDFULS, refine(off, measure, tries), strict=True))


def refine(
    off: dict[tuple[int, ...], float], measure: Callable[[tuple[int, ...]], object], tries: int
) -> tuple[int, ...]:
    """Return the least-off sizes, after trying neighbours of the best in turn.

    Parameters
    ----------
    off
        The largest relative difference of a class count by sizes; ``measure`` adds to it.
    measure
        Called with sizes that are not in ``off`` yet.
    tries
        At most this many; it stops earlier where no class is off by `CLOSE`.
    """

    def best() -> tuple[int, ...]:
        return min(off, key=lambda sizes: (off[sizes], sizes))

    for _ in range(tries):
        centre = best()
        if off[centre] <= CLOSE:
            break
        measure(next(sizes for sizes in neighbours(centre) if sizes not in off))
    return best()


def neighbours(sizes: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
    """Yield other sizes, one changed at a time, nearest first."""
    for step in count(1):
        for place, sign in product(range(len(sizes)), (1, -1)):
            changed = list(sizes)
            changed[place] = max(changed[place] + sign * step, 0)
            yield tuple(changed)


def main(*names: str) -> int:
    """Print the handfuls of every subset, and the counts they show beside Table 5.2."""
    for name in names or SUBSETS:
        number = SUBSETS.index(name) + 1
        sizes = solve(name, number, varied=second)
        counts = counted(Twin(second(subset_scene(name, sizes, number)))).astype(int)
        published = published_counts(name).astype(int)
        print(f"{name}: {sizes} shows {counts}, published {published}", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main(*sys.argv[1:]))
