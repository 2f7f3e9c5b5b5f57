"""Recordings: frames of a plenoptic camera, on disk, imported, and in numbers."""
