"""Identify r of Eq. 2.28 and the clutter by the total row of SIFT in Table 5.6.

Neither is printed. Both change the F1 of SIFT and its false detections, and these two
numbers identify them; so the row tests nothing.

    python -m identify.sift_row

tries all `EDGES` and `CLUTTER` on the 50 labelled frames, in half an hour, and writes
data/reference/sift_row.csv, the best first.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import cast

import numpy as np
import pandas as pd
from tqdm import tqdm

from kilnflight.detection import DoG
from kilnflight.detection.combination import Combination
from kilnflight.experiments import errata
from kilnflight.experiments.detection import labelled
from kilnflight.experiments.detection.summaries import beside_published, with_total
from kilnflight.simulated.kiln.scene import Twin
from kilnflight.store import paths
from kilnflight.store.cache import write_whole

EDGES = (10.0, 20.0, 25.0, 30.0, 35.0, 40.0, 50.0)  # r
CLUTTER = (1500.0, 2000.0, 2500.0, 3000.0)  # mean grey value of a spot


def with_clutter(subset: labelled.Subset, gray: float) -> labelled.Subset:
    """Give a labelled subset clutter of another strength in grey values."""
    scene = cast(Twin, subset.recording).scene
    twin = Twin(replace(scene, interior=replace(scene.interior, clutter_gray=gray)))
    return labelled.Subset.of(twin, subset.frames, subset.background)


def edge_table(
    subsets: list[labelled.Subset], scale: str, edges: Iterable[float]
) -> pd.DataFrame:
    """Tabulate Table 5.6 of SIFT for each r of Eq. 2.28, beside print.

    Its total row identifies r, and with it the clutter of the simulation.

    Returns
    -------
    DataFrame
        ``edge``, the columns of `with_total` and `beside_published`, and ``misfit``:
        both deviations from print as one length, F1 in hundredths, false detections in
        standard deviations of their number (print has ten frames a subset).
    """
    parts = []
    for edge in edges:
        rule = Combination(DoG(edge=edge))
        found = labelled.score_at_chosen(subsets, scale, rule)
        parts.append(found.assign(edge=edge))
    table = with_total(pd.concat(parts), ["edge", "threshold", "subset"])
    table = beside_published(table, "table_5.6")
    printed = errata.printed_rates("5.6")["FP"].astype(float)
    more = 2 * (np.sqrt(table["fp"]) - np.sqrt(table["subset"].map(printed)))
    off = 100 * (table["f1"] - table["f1_published"])
    return table.assign(misfit=np.hypot(off, more))


def identify(subsets: Iterable[labelled.Subset]) -> pd.DataFrame:
    """Tabulate the total row of Table 5.6 for `EDGES` and `CLUTTER`, the best first.

    Columns are ``clutter_gray`` and those of `edge_table`.
    """
    parts = []
    for gray in tqdm(CLUTTER, "strengths of clutter", disable=None):
        cluttered = [with_clutter(subset, gray) for subset in subsets]
        table = edge_table(cluttered, "full", EDGES)
        parts.append(table[table["subset"] == "Total"].assign(clutter_gray=gray))
    return pd.concat(parts).sort_values("misfit", kind="stable", ignore_index=True)


def main() -> None:
    """Identify r and clutter on the published simulation; print and keep all pairs."""
    table = identify(labelled.labelled_subsets("full"))
    table = table[["edge", "clutter_gray", "tp", "fp", "fn", "f1", "misfit"]].round(4)
    write_whole(paths.reference() / "sift_row.csv", table.to_csv(index=False).encode())
    print(table.to_string())


if __name__ == "__main__":
    main()
