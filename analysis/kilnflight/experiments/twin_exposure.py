"""Fit the few inputs of the first twin's picture that are not published.

Run as ``python -m kilnflight.experiments.twin_exposure`` (about an hour); it writes
twin/exposure.json. Only the row of Otsu's method is read: precision and recall of each subset
(Table 5.5), and the recall of non-burning particles that section 5.1.3 states with it
(Fig. 5.5). No other detector, no cloud and no tracking takes part (design: twin.md, rule 2).

Only what Otsu's threshold can feel is free. The flicker of the hot air and the artefacts at
the edges are far below it or outside the region of interest; they stay as assumed.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.background import Median
from kilnflight.background.difference import Frames
from kilnflight.detection import Otsu
from kilnflight.experiments import detection
from kilnflight.experiments.twin_calibration import Search
from kilnflight.project import cache, claims
from kilnflight.scores import rates
from kilnflight.twin.fitted import LIGHT_FILE, LightInputs
from kilnflight.twin.life import Life
from kilnflight.twin.particles import FRACTIONS
from kilnflight.twin.scene import Scene, Twin
from kilnflight.twin.scenes import FRAMES, LABELLED, SUBSETS, subset_scene

EVERY = 7  # frames of a subset that are rendered: 23 for the background, two of them labelled
RENDERED = range(LABELLED.start % EVERY, FRAMES, EVERY)
# Handfuls that show the counts of Table 5.2 with the picture as assumed (twin_mixture.py). In the
# fitted light other sizes do (scenes.py); these are kept so that the fit can be repeated.
FED: dict[str, dict[str, int]] = {
    "V1": {"flying": 182, "unlit": 36, "landed": 54},
    "V2": {"flying": 126, "unlit": 11, "landed": 180},
    "V3": {"flying": 43, "unlit": 12, "landed": 121},
    "V4": {"flying": 287, "unlit": 11, "landed": 225},
    "V5": {"flying": 28, "unlit": 79, "landed": 47},
}
SPREAD = {"precision": 0.02, "recall": 0.05, "unlit": 0.1}  # misfits are in units of these
UNLIT_RECALL = {"V1": 0.16, "V2": 0.16, "V3": 0.16, "V4": 0.0, "V5": 0.35}  # section 5.1.3

# What is conceivable; levels are searched by their logarithm. Two searches were made. The first
# had wall levels up to 30,000 and flames of 8000 to 80,000 above the wall, began at the
# untouched inputs and ended at 22,000 and 24,800 (cost 21.4): nothing that flies overexposed,
# where section 3.1 (case 3) has large burning particles overexposed. The second, this one,
# lets flames reach full scale (flame_reach from 1) and, to leave room, the wall 40,000; the
# untouched inputs lie outside, so it begins anywhere. Its wall level is beyond the first
# limit, and body_s is close to its own. Other detectors had by then been tried on two frames in
# the assumed light only, and had no part in this.
LIMITS = {
    "wall_level": (2000.0, 40_000.0),
    "flame_reach": (1.0, 1.6),
    "irradiance": (0.3, 1.2),
    "share_on": (0.1, 0.6),
    "body_s": (0.1, 1.0),
    "burner_level": (20_000.0, 400_000.0),
    "burner_flicker": (0.02, 0.5),
}
SEARCH = Search(
    LightInputs,
    LIMITS,
    logarithmic=("wall_level", "body_s", "burner_level", "burner_flicker"),
    digits=3,
    seed=55,
    population=6,
    generations=8,
    from_defaults=False,
)


@dataclass(frozen=True)
class SparseMedian:
    """The temporal median of every few frames of a subset."""

    rendered: range = RENDERED

    def __call__(self, frames: Frames, indices: Iterable[int]) -> Iterator[npt.NDArray[np.float32]]:
        """Yield the foreground (rows, cols) of each requested frame, one of them."""
        few = [frames[t] for t in self.rendered]
        return Median(window=len(few))(few, [self.rendered.index(t) for t in indices])


def otsu_targets() -> pd.DataFrame:
    """Return what Otsu's method reached: subset, precision, recall, unlit."""
    table = claims.published("table_5.5").set_index("subset").loc[list(SUBSETS)]
    rates = table[["precision", "recall"]].astype(float)
    return rates.assign(unlit=pd.Series(UNLIT_RECALL)).reset_index()


# Of a background, what costs time and holds in any light
LIGHTLESS = ("_edges", "solid_mm", "flame", "_patterns")


class Inputs(Protocol):
    """Inputs of the picture."""

    def applied(self, scene: Scene) -> Scene:
        """Return a scene with these inputs."""


def relit(twin: Twin, inputs: Inputs) -> Twin:
    """Return a recording in other light; its flights and what costs time are shared."""
    before, scene = twin.scene, inputs.applied(twin.scene)
    wall, old_wall = scene.on_the_wall, before.on_the_wall
    table, known = twin.life.table, twin._background
    sheet = np.array([FRACTIONS[name].sheet for name in table["fraction"]], dtype=bool)
    longer = np.where(sheet, wall.sheet_s / old_wall.sheet_s, wall.body_s / old_wall.body_s)
    table = table.assign(flame_s=table["flame_s"] * longer, flicker_share=wall.share_on)
    background = type(known)(scene.geometry, scene.optics, scene.surroundings, scene.seed)
    brighter = np.float32(scene.optics.wall_level / before.optics.wall_level)
    shared = {name: getattr(known, name) for name in LIGHTLESS if hasattr(known, name)}
    background.__dict__.update(shared, level=known.level * brighter)
    other = Twin(scene)
    other.__dict__.update(
        life=Life(table, twin.life.flights),
        _background=background,
        _noise=twin._noise,
        _wall=twin._wall,  # the cloud's, which takes no part
    )
    return other


def otsu_row(twins: Iterable[Twin], inputs: Inputs, rendered: range = RENDERED) -> pd.DataFrame:
    """Return the rates of Otsu's method on the subsets: the columns of `targets`."""
    frames, median = [t for t in rendered if t in LABELLED], SparseMedian(rendered)
    subsets = (detection.labelled_subset(relit(twin, inputs), frames, median) for twin in twins)
    table = detection.run(subsets, {"Otsu": detection.from_foreground(Otsu())})
    counts = table.groupby("subset", sort=False).sum(numeric_only=True).reset_index()
    row = rates(*(counts[count] for count in detection.COUNTS))[["precision", "recall"]]
    unlit = rates(counts["tp_3"], 0 * counts["fn_3"], counts["fn_3"])["recall"]
    return pd.concat([counts["subset"], row.assign(unlit=unlit)], axis=1)


def cost(row: pd.DataFrame, targets: pd.DataFrame) -> float:
    """Return the sum of squared misfits, in units of `SPREAD`."""
    return float(sum((((row[n] - targets[n]) / s) ** 2).sum() for n, s in SPREAD.items()))


def calibrate(twins: list[Twin]) -> dict[str, object]:
    """Return the content of exposure.json."""
    published = otsu_targets()
    content = SEARCH.content(
        lambda inputs: cost(otsu_row(twins, inputs), published), published.to_dict("records")
    )
    rows = {"inputs_only": LightInputs(), "calibrated": LightInputs(**content["inputs"])}
    for name, inputs in rows.items():
        content[name] = otsu_row(twins, inputs).round(4).to_dict("records")
    return content | {"spread": SPREAD, "frames": f"{len(twins)} subsets, every {EVERY}th frame"}


def read_fit(path: Path = LIGHT_FILE) -> dict[str, Any]:
    """Return the calibration's content; it must have been made for today's targets.

    Raises
    ------
    InputError
        If the file is missing or damaged, or was made for other targets than published.
    """
    rows = otsu_targets().to_dict("records")
    return cache.read_calibration(path, rows, "kilnflight.experiments.twin_exposure")


def main() -> int:
    """Fit, write the file, and print the result."""
    twins = [
        Twin(subset_scene(name, FED[name], k, first=True))
        for k, name in enumerate(SUBSETS, start=1)
    ]
    print(cache.write_calibration(LIGHT_FILE, calibrate(twins)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
