"""What is made once and kept: tables under data/derived, under the hash of what went in.

scene -> detections and frame differences, chunk by chunk -> tracking

A table that is there and whole is not made again; a killed run goes on with the first chunk
that is missing. The hash covers the arguments and the code that a table depends on, so a
change of either gives another file; old ones go with `make clean`.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import cv2
import joblib
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import zarr
from tqdm import tqdm
from zarr.codecs import ZstdCodec

from kilnflight import kiln, places
from kilnflight.background import BackgroundModel, Median
from kilnflight.checks import InputError
from kilnflight.combination import Combination
from kilnflight.detection import DoG
from kilnflight.files import locked, make_whole, write_whole
from kilnflight.tables import DETECTIONS
from kilnflight.twin import truth
from kilnflight.twin.prepared import prepared_scene
from kilnflight.twin.scene import Twin

CHUNK = 100  # frames; the median's window, 150 frames, is read anew by every chunk
TILE = (384, 512)  # of a kept difference, so that a small box is read fast
# Code that the tables depend on, within the package; a folder stands for all of its files.
CODE = (
    *("background", "camera.py", "combination.py", "correspondence.py", "cylinder.py"),
    *("detection", "evidence.py", "flame.py", "frames.py", "kiln.py", "matching.py"),
    *("mlesac.py", "peaks.py", "scores/counts.py", "scores/detections.py", "stages.py"),
    *("tables.py", "tallies.py", "trial.py", "twin"),
)


def fingerprint(content: object) -> str:
    """Return twelve digits that stand for the arguments and the code."""
    package = Path(__file__).parent
    digest = hashlib.sha256(json.dumps(content, sort_keys=True, default=repr).encode())
    for name in CODE:
        one = package / name
        files = sorted(one.rglob("*")) if one.is_dir() else [one]
        for file in files:
            if file.suffix in (".py", ".json"):
                digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


def place(name: str, went_in: Mapping[str, object]) -> Path:
    """Return the file that a table is kept in."""
    return places.derived() / f"{name}-{fingerprint([name, dict(went_in)])}.parquet"


def kept(
    name: str, went_in: Mapping[str, object], make: Callable[[], pd.DataFrame]
) -> pd.DataFrame:
    """Return a table from data/derived, or make it and keep it there.

    Parameters
    ----------
    name
        Of the kind of table, the first part of the file's name.
    went_in
        All that it depends on besides the code; kept in the file.
    make
        Called if there is no such file.
    """
    path = place(name, went_in)
    path.parent.mkdir(parents=True, exist_ok=True)
    with locked(path.with_suffix(".lock")):
        if not path.is_file():
            _keep(path, went_in, make())
    try:
        return pd.read_parquet(path)
    except (OSError, pa.ArrowException) as error:
        raise InputError(
            f"{path}: cannot be read ({error}). Delete it; it is made again."
        ) from error


def _keep(path: Path, went_in: Mapping[str, object], made: pd.DataFrame) -> None:
    table = pa.Table.from_pandas(made, preserve_index=False)
    said = json.dumps(dict(went_in), sort_keys=True, default=repr).encode()
    table = table.replace_schema_metadata({**(table.schema.metadata or {}), b"went_in": said})
    buffer = io.BytesIO()
    pq.write_table(table, buffer)
    write_whole(path, buffer.getvalue())


@dataclass(frozen=True)
class Stretch:
    """Consecutive frames of a scene and the detector that looks at them.

    Parameters
    ----------
    scene
        Name for `kilnflight.twin.scenes.open_scene`.
    seed
        Of the scene.
    start, stop
        First frame, and the one after the last.
    detector
        The combined detector; SIFT with DBSCAN unless told otherwise.
    background
        What is subtracted.
    """

    scene: str
    seed: int
    start: int
    stop: int
    detector: Combination
    background: BackgroundModel

    @property
    def chunks(self) -> list[range]:
        """The frames in pieces of `CHUNK`, cut at its multiples."""
        cuts = [self.start, *range(self.start // CHUNK * CHUNK + CHUNK, self.stop, CHUNK)]
        return [range(a, b) for a, b in zip(cuts, [*cuts[1:], self.stop], strict=True) if a < b]

    def went_in(self, frames: range) -> dict[str, object]:
        """Return what the detections of some of the frames depend on."""
        detector = repr(self.detector)  # classes and parameters of all its parts
        span, background = [frames.start, frames.stop], repr(self.background)
        given = {"scene": self.scene, "seed": self.seed, "frames": span}
        return {**given, "detector": detector, "background": background}

    def folder(self, frames: range) -> Path:
        """Return where the frame differences of a chunk are kept."""
        number = fingerprint(["differences", self.went_in(frames)])
        return places.derived() / f"differences-{number}.zarr"


def stretch(
    scene: str,
    frames: range,
    threshold: float,
    seed: int = 0,
    background: BackgroundModel | None = None,
) -> Stretch:
    """Return a stretch for the combined SIFT and DBSCAN with a threshold of DoG.

    The temporal median over 150 frames is subtracted if ``background`` is None.
    """
    detector, subtracted = Combination(DoG(threshold)), background or Median()
    return Stretch(scene, seed, frames.start, frames.stop, detector, subtracted)


def detections(wanted: Stretch, jobs: int = 1) -> pd.DataFrame:
    """Return what the detector finds (`kilnflight.tables.DETECTIONS`), with progress.

    The differences to the background are kept beside, for `Differences`.

    Parameters
    ----------
    wanted
        Scene, frames and detector.
    jobs
        Processes on this machine; the result does not depend on it. For a cluster, call this
        within ``joblib.parallel_config(backend="dask")``.
    """
    one = joblib.delayed(partial(_chunk, wanted))
    run = joblib.Parallel(n_jobs=min(jobs, len(wanted.chunks)) or 1, return_as="generator")
    bar = tqdm(
        run(one(frames) for frames in wanted.chunks),
        desc=f"detection in {wanted.scene}",
        total=len(wanted.chunks),
        unit="chunk",
        disable=None,
    )
    return pd.concat([DETECTIONS.empty(), *bar], ignore_index=True)


def _chunk(wanted: Stretch, frames: range) -> pd.DataFrame:
    went_in = wanted.went_in(frames)
    if not wanted.folder(frames).is_dir():  # a table without its differences is not whole
        place("detections", went_in).unlink(missing_ok=True)
    return kept("detections", went_in, partial(_detect, wanted, frames))


def _detect(wanted: Stretch, frames: range) -> pd.DataFrame:
    """Detect in a chunk, and keep the differences: first these, then the table is whole."""
    cv2.setNumThreads(1)
    recording = scene_of(wanted.scene, wanted.seed)
    known = recording.attributes
    image = (known.rows, known.columns)
    found = [DETECTIONS.empty()]

    def write(part: Path) -> None:
        store = zarr.create_array(
            part,
            shape=(len(frames), *image),
            chunks=(1, *(min(a, b) for a, b in zip(TILE, image, strict=True))),
            dtype="uint8",
            compressors=ZstdCodec(level=1),
        )
        for k, (t, view) in enumerate(kiln.views(recording, frames, wanted.background)):
            store[k] = np.rint(np.sqrt(view.foreground)).astype(np.uint8)
            found.append(wanted.detector(view, known.roi, t))

    make_whole(wanted.folder(frames), write)
    return pd.concat(found, ignore_index=True)


@lru_cache(maxsize=2)
def scene_of(name: str, seed: int) -> Twin:
    """Return a scene; its flights are worked out once for all chunks of a process."""
    return prepared_scene(name, seed)


def trajectories(scene: str, frames: range, seed: int = 0, shortest: int = 5) -> pd.DataFrame:
    """Return the true trajectories of a stretch, as a person would follow them (section 5.2.1).

    Parameters
    ----------
    scene, frames, seed
        The stretch.
    shortest
        Positions that a trajectory has at least: "for some time" is all that was printed.

    Returns
    -------
    DataFrame
        `kilnflight.twin.truth.sightings` of particles in the air, where they can be seen and
        are in the region of interest.
    """
    went_in = {"scene": scene, "seed": seed, "frames": [frames.start, frames.stop]}

    def make() -> pd.DataFrame:
        twin = scene_of(scene, seed)
        return truth.marked(twin, tqdm(frames, desc=f"truth of {scene}", disable=None))

    marked = kept("truth", went_in, make)
    flying = marked[marked["label"] != 4]
    long = flying.groupby("particle")["frame"].transform("size") >= shortest
    return flying[long].reset_index(drop=True)
