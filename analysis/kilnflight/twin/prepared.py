"""Scenes opened with what costs time before the first frame worked out once and kept.

Flights, walls and the pixels with depth depend on the scene alone; working them out takes
some seconds, which every notebook would spend again. They are kept in data/derived under the
hash of the scene and of the twin's code; with them a frame is the same to the bit.
"""

from __future__ import annotations

import hashlib
import pickle
from functools import lru_cache
from pathlib import Path

import numpy as np

from kilnflight.checks import InputError
from kilnflight.project import paths
from kilnflight.project.files import locked, write_whole
from kilnflight.twin.scene import Twin
from kilnflight.twin.scenes import open_scene

WORKED_OUT = ("life", "_bodies", "_wall")  # of the recording; of its background the level


def prepared_scene(name: str, seed: int | None = None) -> Twin:
    """Return the recording of a scene, as `kilnflight.twin.scenes.open_scene` does, sooner.

    Raises
    ------
    InputError
        As `open_scene`, or if what was kept cannot be read.
    """
    twin = open_scene(name, seed)
    path = place(twin)
    path.parent.mkdir(parents=True, exist_ok=True)
    with locked(path.with_suffix(".lock")):
        if not path.is_file():
            worked_out = {part: getattr(twin, part) for part in WORKED_OUT}
            made = (worked_out, twin._background.level)
            write_whole(path, pickle.dumps(made, pickle.HIGHEST_PROTOCOL))
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


def place(twin: Twin) -> Path:
    """Return the file that a scene's flights and walls are kept in."""
    digest = hashlib.sha256(f"{twin.scene!r} {np.__version__} {_code()}".encode()).hexdigest()
    return paths.derived() / f"scene-{digest[:12]}.pickle"


@lru_cache(maxsize=1)
def _code() -> str:
    """Return a hash of the twin's code and inputs, as this process has them."""
    digest = hashlib.sha256()
    for file in sorted(Path(__file__).parent.iterdir()):
        if file.suffix in (".py", ".json"):
            digest.update(file.read_bytes())
    return digest.hexdigest()
