"""Who is fed and when: handfuls of a campaign, chosen particles of a labelled subset.

Particles are fed by hand (sections 2.1.1 and 5.2.1). The thesis prints the frames and
the trajectories of a window of each campaign (Table 5.15), and the labelled particles
of the subsets (Tables 5.2 and 5.3). Handfuls and mixtures are assumptions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from kilnflight.arrays import Array, Index
from kilnflight.detection.region import inside
from kilnflight.simulated.kiln.fuel import FRACTIONS
from kilnflight.simulated.kiln.geometry import Geometry
from kilnflight.simulated.kiln.laws import LAWS, Flights, fly
from kilnflight.simulated.kiln.life import Life

LABELLED = range(
    75, 85
)  # frames of a subset, with 75 before and after for the backgrounds
LEAD_S = 1.0  # from the begin of the feeding to the first frame
CANDIDATES = 4000  # of a fraction, from which a subset is chosen
BURNING = 2
UNLIT = 3
ON_WALL = 4  # classes of Table 5.1
# Shares of the fractions in each class of a subset; assumption
MIXTURES: dict[int, dict[str, float]] = {
    BURNING: {"paper shred": 0.7, "confetti": 0.3},
    UNLIT: {"wood chip": 0.2, "PE granule": 0.2, "confetti": 0.35, "paper shred": 0.25},
    ON_WALL: {
        "wood chip": 0.35,
        "PE granule": 0.35,
        "confetti": 0.15,
        "paper shred": 0.15,
    },
}


def handfuls(
    count: int, mean: float, duration_s: float, generator: np.random.Generator
) -> Array:
    """Return the times (count,) in s at which particles leave the lance, fed in
    handfuls.
    """
    sizes: list[int] = []
    while sum(sizes) < count:
        sizes.append(int(min(generator.geometric(1 / mean), count - sum(sizes))))
    starts = np.sort(generator.uniform(-LEAD_S, duration_s, len(sizes)))
    lasting = generator.uniform(0.2, 1.0, len(sizes))  # a handful takes so many seconds
    of = np.repeat(np.arange(len(sizes)), sizes)
    return starts[of] + lasting[of] * generator.beta(2.0, 2.0, count)


def feed_campaign(
    kind: tuple[str, float],
    release_s: Array,
    geometry: Geometry,
    share_on: float,
    generator: np.random.Generator,
) -> Life:
    """Return the particles that leave the lance at some times (n,).

    ``kind`` is their fraction and the pressure in bar.
    """
    table = (
        FRACTIONS[kind[0]].draw(len(release_s), generator).assign(release_s=release_s)
    )
    flights = fly(LAWS[kind], len(table), geometry, generator)
    return Life.of(table, flights, geometry, share_on, generator)


def feed_subset(
    counts: Mapping[int, tuple[int, int]],
    times_s: Sequence[float],
    roi: tuple[tuple[float, float], ...],
    geometry: Geometry,
    share_on: float,
    generator: np.random.Generator,
) -> Life:
    """Return the particles of a labelled subset.

    Candidates of all fractions fly by the laws of 4.5 bar, released up to 1 s before
    the middle labelled frame. Of those in each class and in the picture then, as many
    are fed as give at most the printed number of labels in all labelled frames. So who
    burns is an input, and the kiln is that of the campaigns.

    Parameters
    ----------
    counts
        By class of Table 5.1: labels within the region of interest, and outside it.
    times_s
        Times of the labelled frames.
    roi
        Vertices (row, col) of the region of interest.
    """
    tables = []
    parts = []
    middle = len(times_s) // 2
    for name, kind in FRACTIONS.items():
        release_s = times_s[middle] - generator.random(CANDIDATES)
        tables.append(kind.draw(CANDIDATES, generator).assign(release_s=release_s))
        parts.append(fly(LAWS[name, 4.5], CANDIDATES, geometry, generator))
    table = pd.concat(tables, ignore_index=True)
    flights = Flights.joined(parts)
    everyone = Life.of(table, flights, geometry, share_on, generator)
    labels, within = np.zeros((2, len(times_s), len(table)), np.int8)
    for k, time_s in enumerate(times_s):
        moment = everyone.at(time_s)
        row, col = geometry.project(geometry.to_camera(moment.position_m))
        seen = (
            (row >= 0) & (row < geometry.rows) & (col >= 0) & (col < geometry.columns)
        )
        seen &= moment.burning | ~moment.landed  # on the wall only flames are seen
        kinds = np.where(
            moment.landed, ON_WALL, np.where(moment.burning, BURNING, UNLIT)
        )
        labels[k, moment.particle] = kinds * seen
        within[k, moment.particle] = inside(roi, row, col)
    fraction = table["fraction"].to_numpy()
    chosen = list[Index]()
    for label, both in counts.items():
        for near, count in zip((1, 0), both, strict=True):
            there = (labels[middle] == label) & (within[middle] == near)
            owed = 0.0  # labels; those that a fraction cannot show are the next one's
            for name, share in MIXTURES[label].items():
                owed += share * count
                rows = generator.permutation(np.flatnonzero(there & (fraction == name)))
                shown = np.cumsum((labels[:, rows] == label).sum(axis=0))
                taken = int(np.searchsorted(shown, owed))
                chosen.append(rows[:taken])
                owed -= shown[taken - 1] if taken else 0
    rows = np.sort(np.concatenate(chosen))
    fed = (
        everyone.table.iloc[rows]
        .reset_index(drop=True)
        .assign(particle=np.arange(len(rows)))
    )
    return Life(fed, flights.take(rows), share_on)
