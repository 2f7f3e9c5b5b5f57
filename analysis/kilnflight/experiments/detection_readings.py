"""Readings that the thesis leaves open, side by side.

What is subtracted (section 2.2.1), what 45 px are (section 3.3), and where morphological
clustering ends (sections 2.2.5 and 5.1.3).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import pandas as pd

from kilnflight.background import StopsAtZero
from kilnflight.background.difference import WindowModel
from kilnflight.checks import InputError
from kilnflight.detection import MorphologicalClustering
from kilnflight.experiments.detection import GATES, Subset, run, sum_counts
from kilnflight.experiments.detection_methods import from_cloud
from kilnflight.project import claims

ABSOLUTE, STOPS = "absolute", "stops at zero"  # column ``reading``
DIFFERENCES = ("absolute differences", "differences that stop at zero")
DISTANCES = ("45 px as a distance", "45 px as a diameter")


def stopping_at_zero(subsets: Iterable[Subset]) -> list[Subset]:
    """Return subsets whose differences from the background stop at zero.

    See `kilnflight.background.StopsAtZero`.
    """
    other = []
    for subset in subsets:
        if not isinstance(subset.background, WindowModel):
            raise InputError(f"{subset.name}: {subset.background!r} cannot stop at zero.")
        other.append(subset._replace(background=StopsAtZero(subset.background), cache={}))
    return other


def as_diameter(attempts: pd.DataFrame) -> pd.DataFrame:
    """Return a table of `detection.run` whose counts take 45 px as a diameter."""
    (suffix,) = (name for name in GATES if name)
    near = attempts.filter(regex=f"{suffix}$").rename(columns=lambda name: name[: -len(suffix)])
    return attempts.assign(**near)


def reading_last(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table with the column ``reading`` as its last one, absolute differences first."""
    order = [name for name in table if name != "reading"]
    return table[[*order, "reading"]].sort_values("reading", kind="stable", ignore_index=True)


def beside(
    verdicts: Iterable[claims.Verdict], others: Iterable[claims.Verdict], held: str, other: str
) -> list[claims.Verdict]:
    """Return verdicts whose reasons say what another reading of the text gives.

    What is not reproduced in one reading only is so because of a choice that no work prints.

    Parameters
    ----------
    verdicts
        In the reading that stands in the column ``verdict``.
    others
        Of the same claims in the other reading; claims that do not hang on it are missing.
    held, other
        Names of both readings.
    """
    by_id, both = {verdict.id: verdict for verdict in others}, []
    for verdict in verdicts:
        second = by_id.get(verdict.id)
        undecided = verdict.verdict == claims.NOT_DECIDABLE
        if second is None or (undecided and second == verdict):  # it hangs on no reading
            both.append(verdict)
            continue
        alike = second.verdict == verdict.verdict
        words = "the same" if alike else f"{second.verdict} ({second.measured})"
        told, because = verdict.reason.split("; "), verdict.because
        if verdict.verdict == claims.NOT_REPRODUCED and not alike:  # computed, not judged
            told, because = [part for part in told if part != claims.JUDGED], "method"
        told += [f"this is with {held}", f"with {other} it is {words}"]
        both.append(replace(verdict, reason="; ".join(filter(None, told)), because=because))
    return both


def morphology_readings(subsets: list[Subset], grid: int = 150) -> pd.DataFrame:
    """Return counts of morphological clustering by number of dilations and size rule.

    ``grid`` is R, by default of the best row of Table 5.9, thesis.
    """
    ends = {"none": 0, "once (this work)": 1, "twice": 2, "until unchanged": None}
    methods = {
        (name, size_rule): from_cloud(MorphologicalClustering(grid, end, size_rule))
        for size_rule in (False, True)
        for name, end in ends.items()
    }
    table = sum_counts(run(subsets, methods), ["method"])
    names = pd.DataFrame(table.pop("method").tolist(), columns=["dilations", "size_rule"])
    published = claims.published("table_5.9").set_index("R")["f1"][grid]
    return pd.concat([names, table.assign(f1_published=published)], axis=1)
