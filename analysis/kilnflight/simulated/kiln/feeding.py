"""Who is fed and when: handfuls of a campaign, chosen particles of a labelled subset.

Particles are fed by hand (sections 2.1.1 and 5.2.1). The thesis prints the frames and
the trajectories of a window of each campaign (Table 5.15), and the labelled particles
of the subsets (Tables 5.2 and 5.3). Handfuls and mixtures are assumptions.
"""

import numpy as np
import pandas as pd

from kilnflight.arrays import Flags, Generator, Integers, Picture
from kilnflight.detection.region import inside
from kilnflight.simulated.kiln.fuel import FRACTIONS
from kilnflight.simulated.kiln.inputs import Scene
from kilnflight.simulated.kiln.laws import LAWS, Flights, fly
from kilnflight.simulated.kiln.life import Life, Moment
from kilnflight.tables import read_beside

# Frames of a subset that are labelled; 75 before and after are for the backgrounds
LABELLED = range(75, 85)
LEAD_S = 1.0  # the feeding begins so long before the first frame
CANDIDATES = 4000  # particles of each fraction from which a subset is chosen
# Classes of Table 5.1
BURNING = 2
UNLIT = 3
ON_WALL = 4
# mixtures.csv has the shares of the fractions in each class of a subset; assumption
MIXTURES = read_beside(__file__, "mixtures.csv", index_col="label")


def feed_campaign(scene: Scene) -> Life:
    """Draw the life of a campaign's particles: fed in handfuls, then flight and fire.

    The order of the draws fixes every simulated recording.
    """
    generator = np.random.default_rng([scene.seed, 0])
    count = scene.count
    sizes: list[int] = []
    while sum(sizes) < count:
        size = int(generator.geometric(1 / scene.handful))
        sizes.append(min(size, count - sum(sizes)))
    duration_s = scene.frames / scene.frame_rate_hz
    starts = np.sort(generator.uniform(-LEAD_S, duration_s, len(sizes)))
    lasting = generator.uniform(0.2, 1.0, len(sizes))  # a handful takes so many seconds
    handful = np.repeat(np.arange(len(sizes)), sizes)
    release_s = starts[handful] + lasting[handful] * generator.beta(2.0, 2.0, count)
    table = FRACTIONS[scene.fraction].draw(count, generator)
    table = table.assign(release_s=release_s)
    law = LAWS[scene.fraction, scene.pressure_bar]
    flights = fly(law, count, scene.geometry, generator)
    return Life.of(table, flights, scene.optics.share_on, generator)


def feed_subset(scene: Scene) -> Life:
    """Draw the particles of a labelled subset.

    Candidates of all fractions fly by the laws of 4.5 bar, released up to 1 s before
    the middle labelled frame. Of those in each class and in the picture then, as many
    are fed as give at most the printed number of labels in all labelled frames. So who
    burns is an input, and the kiln is that of the campaigns.
    """
    generator = np.random.default_rng([scene.seed, 0])
    middle = len(LABELLED) // 2
    everyone = _draw_candidates(LABELLED[middle], scene, generator)
    labels, within = _label(everyone, scene)
    fraction = everyone.table["fraction"].to_numpy()
    chosen = []
    for label, (inner, outer) in scene.labelled:
        shown = (labels == label).sum(axis=0)
        for near, count in ((True, inner), (False, outer)):
            there = (labels[middle] == label) & (within[middle] == near)
            owed = 0.0  # labels; the next fraction shows those that one cannot
            for part in MIXTURES.loc[label].itertuples():
                owed += part.share * count
                rows = np.flatnonzero(there & (fraction == part.fraction))
                rows = generator.permutation(rows)
                total = np.append(0, np.cumsum(shown[rows]))
                taken = np.searchsorted(total[1:], owed)
                owed -= total[taken]
                chosen.append(rows[:taken])
    rows = np.sort(np.concatenate(chosen))
    fed = everyone.table.iloc[rows].assign(particle=np.arange(len(rows)))
    flights = everyone.flights.take(rows)
    return Life(fed.reset_index(drop=True), flights, scene.optics.share_on)


def _draw_candidates(t: int, scene: Scene, generator: Generator) -> Life:
    """Draw particles of all fractions, released up to 1 s before frame ``t``."""
    tables = []
    parts = []
    for name, kind in FRACTIONS.items():
        release_s = t / scene.frame_rate_hz - generator.random(CANDIDATES)
        tables.append(kind.draw(CANDIDATES, generator).assign(release_s=release_s))
        parts.append(fly(LAWS[name, 4.5], CANDIDATES, scene.geometry, generator))
    table = pd.concat(tables, ignore_index=True)
    flights = Flights._make(np.concatenate(each) for each in zip(*parts, strict=True))
    return Life.of(table, flights, scene.optics.share_on, generator)


def _label(life: Life, scene: Scene) -> tuple[Integers, Flags]:
    """Return class (0: not seen) and place of particles in the labelled frames.

    Both are (frames, particles); the second is True within the region of interest.
    """
    geometry = scene.geometry
    labels = np.zeros((len(LABELLED), len(life.table)), np.int8)
    within = np.zeros(labels.shape, bool)
    for k, t in enumerate(LABELLED):
        moment = life.at(t / scene.frame_rate_hz)
        row, col = geometry.project(geometry.to_camera(moment.position_m))
        seen = moment.burning | ~moment.landed  # only flames are seen on the wall
        seen &= (row >= 0) & (row < geometry.rows)
        seen &= (col >= 0) & (col < geometry.columns)
        labels[k, moment.particle] = class_of(moment) * seen
        within[k, moment.particle] = inside(scene.roi, row, col)
    return labels, within


def class_of(moment: Moment) -> Picture:
    """Return the class of particles by Table 5.1 (n,)."""
    in_air = np.where(moment.burning, BURNING, UNLIT)
    return np.where(moment.landed, ON_WALL, in_air).astype(np.uint8)
