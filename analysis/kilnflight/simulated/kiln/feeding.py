"""Who is fed and when: handfuls of a campaign, chosen particles of a labelled subset.

Particles are fed by hand (sections 2.1.1 and 5.2.1). The thesis prints the frames and
the trajectories of a window of each campaign (Table 5.15), and the labelled particles
of the subsets (Tables 5.2 and 5.3). Handfuls and mixtures are assumptions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from kilnflight.arrays import Array, Flags, Integers, Picture
from kilnflight.detection.region import inside
from kilnflight.simulated.kiln.fuel import FRACTIONS
from kilnflight.simulated.kiln.geometry import Geometry
from kilnflight.simulated.kiln.laws import LAWS, Flights, fly
from kilnflight.simulated.kiln.life import Life, Moment

# Frames of a subset that are labelled; 75 before and after are for the backgrounds
LABELLED = range(75, 85)
LEAD_S = 1.0  # the feeding begins so long before the first frame
CANDIDATES = 4000  # particles of each fraction from which a subset is chosen
# Classes of Table 5.1
BURNING = 2
UNLIT = 3
ON_WALL = 4
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
    """Draw the times (count,) in s at which particles leave the lance, in handfuls.

    Parameters
    ----------
    count
        Number of particles.
    mean
        Mean number of particles in a handful.
    duration_s
        Length of the recording in s.
    generator
        Draws sizes and times.
    """
    sizes: list[int] = []
    while sum(sizes) < count:
        sizes.append(min(int(generator.geometric(1 / mean)), count - sum(sizes)))
    starts = np.sort(generator.uniform(-LEAD_S, duration_s, len(sizes)))
    lasting = generator.uniform(0.2, 1.0, len(sizes))  # a handful takes so many seconds
    handful = np.repeat(np.arange(len(sizes)), sizes)
    return starts[handful] + lasting[handful] * generator.beta(2.0, 2.0, count)


def feed_campaign(
    run: tuple[str, float],
    release_s: Array,
    geometry: Geometry,
    share_on: float,
    generator: np.random.Generator,
) -> Life:
    """Return the particles of a campaign.

    Parameters
    ----------
    run
        Fraction, and pressure in bar.
    release_s
        When each particle leaves the lance (n,), in s from the first frame.
    geometry
        Of kiln and camera.
    share_on
        Share of the time in which a flame on the wall is there.
    generator
        Draws the particles.
    """
    count = len(release_s)
    table = FRACTIONS[run[0]].draw(count, generator).assign(release_s=release_s)
    flights = fly(LAWS[run], count, geometry, generator)
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
    geometry
        Of kiln and camera.
    share_on
        Share of the time in which a flame on the wall is there.
    generator
        Draws the particles.
    """
    middle = len(times_s) // 2
    everyone = _draw_candidates(times_s[middle], geometry, share_on, generator)
    labels, within = _label(everyone, times_s, roi, geometry)
    fraction = everyone.table["fraction"].to_numpy()
    chosen = []
    for label, (inner, outer) in counts.items():
        shown = (labels == label).sum(axis=0)
        for near, count in ((True, inner), (False, outer)):
            there = (labels[middle] == label) & (within[middle] == near)
            owed = 0.0  # labels; the next fraction shows those that one cannot
            for name, share in MIXTURES[label].items():
                owed += share * count
                rows = np.flatnonzero(there & (fraction == name))
                rows = generator.permutation(rows)
                total = np.append(0, np.cumsum(shown[rows]))
                taken = np.searchsorted(total[1:], owed)
                owed -= total[taken]
                chosen.append(rows[:taken])
    rows = np.sort(np.concatenate(chosen))
    fed = everyone.table.iloc[rows].assign(particle=np.arange(len(rows)))
    return Life(fed.reset_index(drop=True), everyone.flights.take(rows), share_on)


def _draw_candidates(
    latest_s: float,
    geometry: Geometry,
    share_on: float,
    generator: np.random.Generator,
) -> Life:
    """Draw particles of all fractions, released up to 1 s before a time."""
    tables = []
    flights = []
    for name, kind in FRACTIONS.items():
        release_s = latest_s - generator.random(CANDIDATES)
        tables.append(kind.draw(CANDIDATES, generator).assign(release_s=release_s))
        flights.append(fly(LAWS[name, 4.5], CANDIDATES, geometry, generator))
    table = pd.concat(tables, ignore_index=True)
    return Life.of(table, Flights.joined(flights), geometry, share_on, generator)


def _label(
    life: Life,
    times_s: Sequence[float],
    roi: tuple[tuple[float, float], ...],
    geometry: Geometry,
) -> tuple[Integers, Flags]:
    """Return class (0: not seen) and place of particles at some times.

    Both are (times, particles); the second is True within the region of interest.
    """
    labels = np.zeros((len(times_s), len(life.table)), np.int8)
    within = np.zeros(labels.shape, np.bool_)
    for k, time_s in enumerate(times_s):
        moment = life.at(time_s)
        row, col = geometry.project(geometry.to_camera(moment.position_m))
        seen = moment.burning | ~moment.landed  # only flames are seen on the wall
        seen &= (row >= 0) & (row < geometry.rows)
        seen &= (col >= 0) & (col < geometry.columns)
        labels[k, moment.particle] = class_of(moment) * seen
        within[k, moment.particle] = inside(roi, row, col)
    return labels, within


def class_of(moment: Moment) -> Picture:
    """Return the class of particles by Table 5.1 (n,)."""
    in_air = np.where(moment.burning, BURNING, UNLIT)
    return np.where(moment.landed, ON_WALL, in_air).astype(np.uint8)
