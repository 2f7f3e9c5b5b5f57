"""Recordings: frames of a plenoptic camera, on disk, imported, and in numbers."""

from kilnflight.recording.frames import Attributes, Frame
from kilnflight.recording.store import open_recording

__all__ = ["Attributes", "Frame", "open_recording"]
