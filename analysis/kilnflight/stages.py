"""Detection in long recordings, chunk by chunk, kept on disk; what comes first of all steps.

recording -> detections and, if wanted, frame differences

A chunk that is there and whole is not made again; a killed run goes on with the first one
that is missing. `kilnflight.pipeline` makes tracks and flights of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import zarr
from tqdm import tqdm
from zarr.codecs import ZstdCodec

from kilnflight import kiln
from kilnflight.background import BackgroundModel, Median
from kilnflight.checks import InputError
from kilnflight.detection import DoG
from kilnflight.detection.combination import Combination, View
from kilnflight.origins import OfTwin, Origin, scene_of
from kilnflight.project import paths
from kilnflight.project.cache import fingerprint, kept, place
from kilnflight.project.files import clear_parts, make_whole
from kilnflight.project.parallel import Workers
from kilnflight.recording.frames import PictureRecording
from kilnflight.tables import DETECTIONS
from kilnflight.twin import truth

CHUNK = 100  # frames; the median's window, 150 frames, is read anew by every chunk
LONG_CHUNK = 500  # frames, where no differences are kept: the window costs less
TILE = (384, 512)  # of a kept difference, so that a small box is read fast


@dataclass(frozen=True)
class Stretch:
    """Consecutive frames of a recording and the detector that looks at them.

    Parameters
    ----------
    origin
        Of the recording.
    start, stop
        First frame, and the one after the last.
    detector
        The combined detector; SIFT with DBSCAN unless told otherwise.
    chunk
        Frames that are worked on at once.
    differences
        Whether differences to the background are kept beside: 2.8 MB a frame.
    folder
        Where all is kept; data/derived if None.
    background
        What is subtracted.
    """

    origin: Origin
    start: int
    stop: int
    detector: Combination
    chunk: int = CHUNK
    differences: bool = True
    folder: Path | None = None
    background: BackgroundModel = Median()  # noqa: RUF009  frozen

    @property
    def chunks(self) -> list[range]:
        """The frames in pieces of ``chunk``, cut at its multiples."""
        size = self.chunk
        cuts = [self.start, *range(self.start // size * size + size, self.stop, size)]
        return [range(a, b) for a, b in zip(cuts, [*cuts[1:], self.stop], strict=True) if a < b]

    def went_in(self, frames: range) -> dict[str, object]:
        """Return what the detections of some of the frames depend on."""
        detector = repr(self.detector)  # classes and parameters of all its parts
        span, background = [frames.start, frames.stop], repr(self.background)
        given = {**self.origin.went_in(), "frames": span}
        return {**given, "detector": detector, "background": background}

    def table(self, frames: range) -> Path:
        """Return where the detections of a chunk are kept."""
        return place("detections", self.went_in(frames), self.folder)

    def differences_of(self, frames: range) -> Path:
        """Return where the frame differences of a chunk are kept."""
        number = fingerprint(["differences", self.went_in(frames)])
        return (self.folder or paths.derived()) / f"differences-{number}.zarr"

    def has_differences(self, frames: range) -> bool:
        """Return whether the differences of a chunk are there, or not wanted."""
        return not self.differences or self.differences_of(frames).is_dir()

    def has(self, frames: range) -> bool:
        """Return whether a chunk is there: a table without its differences is not whole."""
        return self.table(frames).is_file() and self.has_differences(frames)

    def keep(self, frames: range) -> pd.DataFrame:
        """Return the detections of a chunk, made if they are not there."""
        return kept(
            "detections",
            self.went_in(frames),
            partial(_detect, self, frames),
            self.folder,
            whole=partial(self.has_differences, frames),
        )


def stretch(
    scene: str,
    frames: range,
    threshold: float,
    seed: int = 0,
    background: BackgroundModel | None = None,
) -> Stretch:
    """Return a stretch of a scene for the combined SIFT and DBSCAN with a threshold of DoG.

    The temporal median over 150 frames is subtracted if ``background`` is None.
    """
    detector, origin = Combination(DoG(threshold)), OfTwin(scene, seed)
    subtracted = background or Median()
    return Stretch(origin, frames.start, frames.stop, detector, CHUNK, background=subtracted)


def detections(wanted: Stretch, workers: Workers | None = None) -> pd.DataFrame:
    """Return what the detector finds (`kilnflight.tables.DETECTIONS`); see `detect`."""
    detect([wanted], workers, f"detection in {wanted.origin.name}")
    parts = [wanted.keep(frames) for frames in wanted.chunks]
    return pd.concat([DETECTIONS.empty(), *parts], ignore_index=True)


def detect(
    stretches: Sequence[Stretch], workers: Workers | None = None, label: str = "detection"
) -> None:
    """Detect where that has not been done, with progress; all stretches in one go.

    Parameters
    ----------
    stretches
        Recordings, frames and detectors.
    workers
        One process if None; what is found does not depend on them.
    label
        Of the progress.

    Raises
    ------
    InputError
        If something cannot be read or written, or a worker keeps things elsewhere.
    """
    # workers elsewhere do not know the folder of this project
    pieces = [
        (replace(one, folder=(one.folder or paths.derived()).absolute()), frames)
        for one in stretches
        for frames in one.chunks
    ]
    missing = [piece for piece in pieces if not piece[0].has(piece[1])]
    sizes = [len(frames) for _, frames in missing]
    before = sum(len(frames) for _, frames in pieces) - sum(sizes)
    run = workers if workers is not None else Workers()
    expected = [(*piece, piece[0].table(piece[1])) for piece in missing]
    run(_chunk, expected, sizes, label, before)
    lost = [table for *_, table in expected if not table.is_file()]
    if lost:
        raise InputError(
            f"{lost[0]}: a worker has made this, but not here. Give the workers the same folder "
            "under the same name."
        )


def _chunk(piece: tuple[Stretch, range, Path]) -> None:
    wanted, frames, expected = piece
    if wanted.table(frames) != expected:
        raise InputError(
            f"{wanted.origin.name}: this worker has another version of kilnflight than who asks "
            f"({wanted.table(frames).name}, expected {expected.name}). Install the same one."
        )
    wanted.keep(frames)


def _detect(wanted: Stretch, frames: range) -> pd.DataFrame:
    """Detect in a chunk, and keep the differences: first these, then the table is whole."""
    cv2.setNumThreads(1)
    recording = wanted.origin.recording()
    seen = kiln.views(recording, frames, wanted.background)
    if not wanted.differences:
        return _found(wanted, recording, seen)
    path, found = wanted.differences_of(frames), [DETECTIONS.empty()]
    clear_parts(path)
    image = (recording.attributes.rows, recording.attributes.columns)

    def write(part: Path) -> None:
        found.append(_found(wanted, recording, _keeping(seen, part, len(frames), image)))

    make_whole(path, write)
    return found[-1]


def _found(
    wanted: Stretch, recording: PictureRecording, seen: Iterator[tuple[int, View]]
) -> pd.DataFrame:
    roi = recording.attributes.roi
    found = [wanted.detector(view, roi, t) for t, view in seen]
    return pd.concat([DETECTIONS.empty(), *found], ignore_index=True)


def _keeping(
    seen: Iterator[tuple[int, View]], part: Path, length: int, image: tuple[int, int]
) -> Iterator[tuple[int, View]]:
    """Yield the views and keep the roots of their foregrounds."""
    store = zarr.create_array(
        part,
        shape=(length, *image),
        chunks=(1, *(min(a, b) for a, b in zip(TILE, image, strict=True))),
        dtype="uint8",
        compressors=ZstdCodec(level=1),
    )
    for k, (t, view) in enumerate(seen):
        store[k] = np.rint(np.sqrt(view.foreground)).astype(np.uint8)
        yield t, view


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


__all__ = [
    "CHUNK",
    "LONG_CHUNK",
    "Stretch",
    "detect",
    "detections",
    "fingerprint",
    "kept",
    "place",
    "scene_of",
    "stretch",
    "trajectories",
]
