"""Where a recording comes from, so that every process can open it for itself."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Protocol

from kilnflight.recording import storage
from kilnflight.recording.frames import PictureRecording
from kilnflight.recording.store import StoredRecording, open_recording
from kilnflight.twin.prepared import prepared_scene
from kilnflight.twin.scene import Twin


class Origin(Protocol):
    """What every origin offers; small, and sent to other processes as it is."""

    @property
    def name(self) -> str:
        """The name for people."""

    def recording(self) -> PictureRecording:
        """Open the recording; once in each process."""

    def went_in(self) -> dict[str, object]:
        """Return what tells it from any other recording."""


@dataclass(frozen=True)
class OfTwin:
    """A scene of the twin: its name for `kilnflight.twin.scenes.open_scene`, and the seed."""

    name: str
    seed: int = 0

    def recording(self) -> Twin:
        """Return the twin."""
        return scene_of(self.name, self.seed)

    def went_in(self) -> dict[str, object]:
        """Return scene and seed."""
        return {"scene": self.name, "seed": self.seed}


@dataclass(frozen=True)
class OnDisk:
    """A recording on disk.

    Parameters
    ----------
    name
        Of the recording.
    folder
        Where it is now.
    content
        From `storage.content`; wherever the recording lies, its tables are known.
    """

    name: str
    folder: Path
    content: str

    def recording(self) -> StoredRecording:
        """Return the recording."""
        return _opened(self.folder)

    def went_in(self) -> dict[str, object]:
        """Return name and content; the folder does not matter."""
        return {"recording": self.name, "content": self.content}


def stored(folder: Path | str) -> OnDisk:
    """Return the origin of a recording on disk; errors as for `open_recording`."""
    recording = open_recording(folder)
    content = storage.content(recording.path, len(recording))
    return OnDisk(recording.attributes.name, recording.path.resolve(), content)


@lru_cache(maxsize=2)
def scene_of(name: str, seed: int) -> Twin:
    """Return a scene; its flights are worked out once for all chunks of a process."""
    return prepared_scene(name, seed)


@lru_cache(maxsize=2)
def _opened(folder: Path) -> StoredRecording:
    return open_recording(folder)
