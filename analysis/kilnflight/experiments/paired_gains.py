"""What a variant of tracking gains over another one, on the same true tracks, with intervals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import pandas as pd

from kilnflight.experiments.tracking import Window
from kilnflight.experiments.tracking_scores import (
    MEASURES,
    READINGS,
    Scored,
    mean_difference,
    measures_of,
    score_reading,
    scored,
)

Variant = Callable[[Window], pd.DataFrame]  # the tracks of a window
GAINS = ("alpha", "beta")  # measures whose gains have intervals
MEAN = "mean of fractions"


def compare(
    windows: Sequence[Window], variants: Mapping[str, Variant], seed: int = 0
) -> pd.DataFrame:
    """Return the measures of variants, and what each gains over the first one.

    Parameters
    ----------
    windows
        With truth and lance.
    variants
        By name, the first is what all others are compared with.
    seed
        Of the bootstrap.

    Returns
    -------
    DataFrame
        ``variant``, ``reading``, ``fraction`` (`MEAN`: of all), ``true_tracks``, the four
        measures, and for alpha and beta the gain over the first variant with its 95 % interval
        (``_gain``, ``_gain_low``, ``_gain_high``), bootstrap over true tracks. A fraction
        without a true track in a reading is left out of it.
    """
    cells: dict[tuple[str, str], list[Scored]] = {}
    for place, window in enumerate(windows):
        for number, (name, variant) in enumerate(variants.items()):
            tracks = variant(window)
            for reading in READINGS:
                score = score_reading(reading, window.truth, tracks, window.lance)
                cell = scored((window.fraction, name, "with", reading), score, (place, number))
                if score is not None:
                    cells.setdefault((reading, name), []).append(cell)
    first, rows = next(iter(variants)), []
    for (reading, name), found in cells.items():
        pairs = list(zip(found, cells[reading, first], strict=True))
        for fraction, part in [
            *((cell.key[0], [(cell, base)]) for cell, base in pairs),
            (MEAN, pairs),
        ]:
            rows.append({"variant": name, "reading": reading, "fraction": fraction} | _row(part))
    return pd.DataFrame(rows)


def _row(pairs: Sequence[tuple[Scored, Scored]]) -> dict[str, object]:
    """Return the mean measures of the first of each pair, and their gains over the second."""
    means = pd.DataFrame([measures_of(cell.score) for cell, _ in pairs])[list(MEASURES)].mean()
    count = sum(len(cell.score.true_tracks) for cell, _ in pairs if cell.score is not None)
    row: dict[str, object] = {"true_tracks": count}
    row |= {name: means[name] for name in MEASURES}
    for measure in GAINS:
        one = mean_difference(pairs, [measure])
        ends = one.estimate, *np.clip([one.low, one.high], -1.0, 1.0)
        names = (f"{measure}_gain", f"{measure}_gain_low", f"{measure}_gain_high")
        row |= dict(zip(names, ends, strict=True))
    return row
