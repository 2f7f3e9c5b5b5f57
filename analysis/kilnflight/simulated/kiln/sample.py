"""A small film with known truth, for examples and first tries."""

from functools import cache
from typing import NamedTuple

import numpy as np
import pandas as pd

from kilnflight.recording.frames import Gray
from kilnflight.simulated.kiln import scenes, truth

SCENE = "V1@small"  # burning papers, at a quarter of the camera's rows and columns
FRAMES = range(75, 91)
COLUMNS = ["frame", "particle", "row", "col", "radius_px"]


class SampleFilm(NamedTuple):
    """A film of the simulated kiln, and where its particles are."""

    frames: Gray  # (16, 384, 512) grey values
    truth: pd.DataFrame  # `COLUMNS` in px, frames counted from 0


@cache
def sample_film() -> SampleFilm:
    """Simulate a film of 16 frames in which papers fly and burn.

    It is made once in a process, within seconds.

    Returns
    -------
    SampleFilm
        ``frames``, an array (16, 384, 512), and ``truth``, a table of the particles
        that an eye would see: frame, particle, row, col, radius_px.

    Examples
    --------
    >>> film = sample_film()
    >>> film.frames.shape
    (16, 384, 512)
    >>> film.truth["particle"].nunique()
    133
    """
    twin = scenes.open_scene(SCENE)
    frames = np.stack([twin.gray(t) for t in FRAMES])
    frames.flags.writeable = False  # it is shared
    seen = pd.concat([truth.sightings(twin, t) for t in FRAMES], ignore_index=True)
    seen = seen[seen["visible"]].reset_index(drop=True)
    seen["frame"] -= seen["frame"].min()
    return SampleFilm(frames=frames, truth=seen[COLUMNS])
