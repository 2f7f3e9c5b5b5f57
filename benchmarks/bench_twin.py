"""The twin's rendering: against one particle at a time, and over long recordings."""

from __future__ import annotations

import resource
import subprocess
import sys
import time

import numpy as np
import pandas as pd
from measure import Row, compare

from kilnflight.project import figures
from kilnflight.twin import picture as drawing
from kilnflight.twin import scenes
from kilnflight.twin.scene import Twin

LENGTHS = (100, 1000, 3000)


def one_by_one(picture: np.ndarray, blobs: drawing.Blobs) -> np.ndarray:
    """Draw each particle over the whole picture, as one writes it first."""
    row, column = np.indices(picture.shape, dtype=np.float32)
    for k in range(len(blobs.row)):
        y, x = row - blobs.row[k], column - blobs.column[k]
        inverse = np.linalg.inv(blobs.spread_px2[k])
        square = inverse[0, 0] * y * y + 2 * inverse[0, 1] * x * y + inverse[1, 1] * x * x
        radius = np.sqrt(np.clip(square, 0, 9))
        profile = blobs.dilution[k] / (1 + np.exp((radius - 1) / blobs.softness[k]))
        profile[square >= 2.56] = 0
        level = blobs.brightness[k]
        picture = picture + (level - (1 - blobs.passes[k]) * picture) * profile
    return picture


def rows() -> list[Row]:
    """Return the comparison of drawing the particles of one frame of V1."""
    twin = scenes.open_scene("V1")
    twin.frame(80)  # what is made once per scene
    view, geometry = twin.view(80), twin.scene.geometry
    keep = slice(0, 20)  # the peer takes seconds for twenty
    blobs = drawing.Blobs._make(part[keep] for part in view.blobs)
    empty = np.full((geometry.rows, geometry.columns), 4000.0, dtype=np.float32)

    def ours() -> np.ndarray:
        picture = empty.copy()
        pixels = drawing.cover(blobs, geometry.rows, geometry.columns)
        drawing.paint(picture, blobs, pixels, twin.scene.optics)
        return picture

    close = np.abs(ours() - one_by_one(empty, blobs)) < 0.02 * 4000
    assert close.mean() > 0.999  # overlapping particles blend in another order
    what = ("drawing 20 particles into a frame", "particles", 20, "one particle at a time")
    return [compare(what, ours, lambda: one_by_one(empty, blobs), repeats=2)]


def render(frames: int) -> None:
    """Render frames of a campaign and print seconds and peak memory (run in a process)."""
    twin: Twin = scenes.open_scene("confetti-4.5-bar")
    twin.frame(0)
    start = time.perf_counter()
    for t in range(frames):
        twin.frame(t)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(time.perf_counter() - start, peak)


def save() -> None:
    """Save speed and peak memory against the number of frames."""
    table = []
    for frames in LENGTHS:
        command = [sys.executable, __file__, str(frames)]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        seconds, peak = map(float, done.stdout.split())
        table.append((frames, seconds, frames / seconds, peak))
        print(f"rendering {frames} frames: {frames / seconds:.1f} frames/s, peak {peak:.0f} MiB")
    columns = ["frames", "seconds", "frames_per_s", "peak_mib"]
    caption = (
        "Rendering of the twin at full resolution with point cloud and labels, one process: speed "
        "and peak memory against the number of frames."
    )
    origin = figures.trace("benchmarks/bench_twin", {"scale": "full"}, mark="")
    figures.save(
        "benchmark-rendering",
        pd.DataFrame(table, columns=columns),
        caption=caption,
        provenance=origin,
    )


if __name__ == "__main__":
    import cv2

    cv2.setNumThreads(1)
    render(int(sys.argv[1]))
