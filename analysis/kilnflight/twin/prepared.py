"""Scenes of the twin with what costs time before the first frame worked out once and cached.

Flights, walls and the pixels with depth depend on the scene alone; working them out takes
some seconds, which every notebook would spend again. They are kept in data/derived under the
hash of the scene and of the twin's code; with them a frame is the same to the bit.
"""

from __future__ import annotations

import hashlib
import pickle
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
from tqdm import tqdm

from kilnflight.checks import InputError
from kilnflight.project import paths
from kilnflight.project.cache import CachedTable, locked, write_whole
from kilnflight.project.closure import code_hash
from kilnflight.twin import truth
from kilnflight.twin.scene import Twin
from kilnflight.twin.scenes import open_scene

WORKED_OUT = ("life", "_bodies", "_wall")  # of the recording; of its background the level


def prepared_scene(name: str, seed: int | None = None) -> Twin:
    """Return the recording of a scene, as `kilnflight.twin.scenes.open_scene` does, sooner.

    Raises
    ------
    InputError
        As `open_scene`, or if the cached file cannot be read.
    """
    twin = open_scene(name, seed)
    path = cached_path(twin)
    path.parent.mkdir(parents=True, exist_ok=True)
    with locked(path.with_suffix(".lock")):
        if not path.is_file():
            worked_out = {part: getattr(twin, part) for part in WORKED_OUT}
            content = (worked_out, twin._background.level)
            write_whole(path, pickle.dumps(content, pickle.HIGHEST_PROTOCOL))
            return twin
    try:
        worked_out, level = pickle.loads(path.read_bytes())
    except (pickle.UnpicklingError, EOFError, ValueError) as error:
        raise InputError(
            f"{path}: cannot be read ({error}). Delete it; it is made again."
        ) from error
    twin.__dict__.update(worked_out)
    twin._background.__dict__["level"] = level
    return twin


def cached_path(twin: Twin) -> Path:
    """Return the file for a scene's flights and walls."""
    text = f"{twin.scene!r} {np.__version__} {code_hash(Twin)}"
    return paths.derived() / f"scene-{hashlib.sha256(text.encode()).hexdigest()[:12]}.pickle"


def true_trajectories(twin: Twin, frames: range, shortest: int = 5) -> pd.DataFrame:
    """Return the true trajectories in some frames, as a person would follow them (sec. 5.2.1).

    Parameters
    ----------
    twin, frames
        The recording and the numbers of its frames.
    shortest
        Positions that a trajectory has at least: "for some time" is all that was printed.

    Returns
    -------
    DataFrame
        `kilnflight.twin.truth.sightings` of particles in the air, where they can be seen and
        are in the region of interest.
    """
    depends_on = {"scene": twin.scene, "frames": [frames.start, frames.stop]}
    marked = CachedTable("truth", partial(_marked, twin, frames), depends_on)()
    flying = marked[marked["label"] != 4]
    long = flying.groupby("particle")["frame"].transform("size") >= shortest
    return flying[long].reset_index(drop=True)


def _marked(twin: Twin, frames: range) -> pd.DataFrame:
    return truth.marked(twin, tqdm(frames, desc=f"truth of {twin.scene.name}", disable=None))
