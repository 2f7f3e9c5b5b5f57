"""Detections and foregrounds of a window of frames, stored together.

Post-processing needs sums of the foregrounds for the texture energies of tracklets (Eq.
4.24).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pandas import DataFrame

from kilnflight import chain
from kilnflight.arrays import Gray
from kilnflight.background import BackgroundModel
from kilnflight.detection.combination import Combination
from kilnflight.simulated.kiln.scenes import TwinSource
from kilnflight.store.cache import CachedTable, clear_parts, make_whole
from kilnflight.tables import DETECTIONS


@dataclass(frozen=True)
class StoredDifferences:
    """Detections and foregrounds of some frames, sliced like an array.

    A foreground is the difference of a frame from its background, in grey values.
    Square roots are stored, rounded to one byte. For 10,000 grey values the error is
    100 at most, less than the noise there. Call `make` before any foreground is read.
    """

    source: TwinSource
    frames: range
    detector: Combination
    background: BackgroundModel

    @property
    def table(self) -> CachedTable:
        """Cached detections of the frames; making it writes the foregrounds as well."""
        return CachedTable("window", self._detect, depends_on=vars(self))

    @property
    def path(self) -> Path:
        """File of square roots (frames, rows, cols), one byte each, 3 MB a frame."""
        return self.table.path.with_suffix(".roots")

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of the frame after the last one, rows and columns."""
        return self.frames.stop, *self.source.recording().attributes.size

    def make(self) -> None:
        """Make the detections and foregrounds, unless both exist."""
        if not self.path.is_file():
            self.table.path.unlink(missing_ok=True)
        self.table()

    def _detect(self) -> DataFrame:
        """Return the detections of all frames, and write the foregrounds."""
        recording = self.source.recording()
        parts = []

        def write(path: Path) -> None:
            with path.open("wb") as file:
                for t, view in chain.views(recording, self.frames, self.background):
                    roots = np.sqrt(view.foreground).round().clip(0, 255)
                    file.write(roots.astype(np.uint8).data)
                    parts.append(self.detector(view, recording.attributes.roi, frame=t))

        clear_parts(self.path)
        make_whole(self.path, write)
        return DETECTIONS.join(parts)

    def __getitem__(self, box: tuple[slice, slice, slice]) -> Gray:
        """Return the foregrounds (frames, rows, cols) in a box.

        ``box`` slices frames, rows and columns. Frames need a start and a stop,
        numbered as in the recording; those that are not stored are left out.
        """
        frames, rows, cols = box
        start = max(frames.start - self.frames.start, 0)
        stop = max(frames.stop - self.frames.start, 0)
        shape = (len(self.frames), *self.shape[1:])
        stored = np.memmap(self.path, np.uint8, "r", shape=shape)
        return np.square(stored[start:stop, rows, cols], dtype=np.uint16)
