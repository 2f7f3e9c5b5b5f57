"""A small table of particles on a belt, for examples and for a first try."""

from dataclasses import replace

import numpy as np
import pandas as pd

from kilnflight.simulated.belt.friction import MATERIALS

PARTICLES = 200  # of each
FED_S = 3.0
RATE_HZ = 200.0
NOISE_MM = 0.1
MISSED = 0.02  # share of particles that a frame does not show


def sample_spots(seed: int = 0) -> pd.DataFrame:
    """Simulate what a camera measures of two materials on one belt.

    Returns
    -------
    DataFrame
        ``time_s``, ``x`` along and ``y`` across the belt in mm, ``class`` 0 or 1, and
        the true ``particle``, below `PARTICLES` of class 0.

    Examples
    --------
    >>> spots = sample_spots()
    >>> spots["particle"].nunique(), spots["time_s"].nunique()
    (400, 671)
    """
    generator = np.random.default_rng(seed)
    tables = []
    for number, name in enumerate(("spheres", "cuboids")):
        belt = replace(
            MATERIALS[name],
            particles=PARTICLES,
            feed_s=FED_S,
            sampling_hz=RATE_HZ,
        )
        table = belt(generator).assign(**{"class": number})
        table["particle"] += number * PARTICLES
        tables.append(table)
    spots = pd.concat(tables)
    spots = spots[generator.random(len(spots)) >= MISSED].copy()
    spots[["x", "y"]] += generator.normal(0.0, NOISE_MM, (len(spots), 2))
    spots = spots.sort_values(["frame", "x"], ignore_index=True)
    return spots[["time_s", "x", "y", "class", "particle"]]
