"""One stored frame of full size, read as ours and as a user would have stored it otherwise."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import tifffile
from measure import Row, compare

from kilnflight.recording.store import Attributes, Frame, write_recording

SIZE = (1536, 2048)
POINTS = (50_000, 200_000, 400_000)


@dataclass(frozen=True)
class Noise:
    """Frames as hard to compress as real ones: a smooth wall with noise, scattered points."""

    points: int

    @property
    def attributes(self) -> Attributes:
        return Attributes("noise", 330.0, *SIZE)

    def __len__(self) -> int:
        return 1

    def frame(self, t: int) -> Frame:
        rng = np.random.default_rng(t)
        wall = 6000 + 2000 * np.sin(np.arange(SIZE[0]) / 300)[:, None]
        gray = (wall + rng.normal(0, 80, SIZE)).astype(np.uint16)
        flat = np.sort(rng.choice(gray.size, self.points, replace=False))
        pixels = np.column_stack(np.divmod(flat, SIZE[1])).astype(np.int32)
        xyz = rng.normal(6000, 1000, (self.points, 3)).astype(np.float32)
        labels = np.zeros(SIZE, np.uint8)
        for row, col in rng.integers(0, SIZE[0] - 15, (110, 2)):
            labels[row : row + 15, col : col + 15] = 3
        return Frame(t, 0.0, gray, pixels, xyz, labels)


def read_npz(path: Path) -> Frame:
    with np.load(path) as archive:
        return Frame(0, 0.0, *(archive[name] for name in ("gray", "pixels", "xyz", "labels")))


def read_tiff_and_csv(folder: Path) -> Frame:
    table = pd.read_csv(folder / "points.csv")
    return Frame(
        0,
        0.0,
        tifffile.imread(folder / "gray.tif"),
        table[["row", "col"]].to_numpy(np.int32),
        table[["x", "y", "z"]].to_numpy(np.float32),
        tifffile.imread(folder / "labels.tif"),
    )


def write_peers(frame: Frame, folder: Path) -> None:
    arrays = {name: getattr(frame, name) for name in ("gray", "pixels", "xyz", "labels")}
    np.savez_compressed(folder / "frame.npz", **arrays)
    tifffile.imwrite(folder / "gray.tif", frame.gray)
    tifffile.imwrite(folder / "labels.tif", frame.labels)
    table = pd.DataFrame(frame.pixels, columns=["row", "col"])
    table[["x", "y", "z"]] = frame.xyz
    table.to_csv(folder / "points.csv", index=False)


def rows() -> list[Row]:
    """Return every comparison, the results checked to be equal."""
    found = []
    for points in POINTS:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            stored = write_recording(Noise(points), folder / "ours.zarr")
            write_peers(Noise(points).frame(0), folder)
            peers = {
                "a compressed .npz per frame": lambda: read_npz(folder / "frame.npz"),  # noqa: B023
                "16-bit TIFF and CSV points": lambda: read_tiff_and_csv(folder),  # noqa: B023
            }
            for peer, read in peers.items():
                for part in ("gray", "pixels", "xyz", "labels"):
                    np.testing.assert_array_equal(
                        getattr(read(), part), getattr(stored.frame(0), part)
                    )
                found.append(
                    compare(
                        ("reading a stored frame of 1536 x 2048", "points", points, peer),
                        lambda: stored.frame(0),  # noqa: B023 - called before the loop goes on
                        read,
                        repeats=7,
                    )
                )
    return found
