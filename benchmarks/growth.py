"""How time and memory grow with frames, points and detections, and with Dask workers.

Each measurement is a process of its own: ``python benchmarks/growth.py frames 300`` prints seconds
and the peak of memory. ``table`` makes figures/growth.csv of them, without absolute times.
"""

from __future__ import annotations

import logging
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from bench_clustering import PARTICLES, WALL, surface
from bench_tracking import recording

from kilnflight import kiln
from kilnflight.detection import DoG
from kilnflight.detection.combination import Combination
from kilnflight.project.parallel import Workers
from kilnflight.recording.frames import Attributes, Frame
from kilnflight.recording.store import open_recording, write_recording
from kilnflight.tracking.tracker import track
from kilnflight.tracklets import postprocess
from kilnflight.twin.scenes import open_scene

SIZES = {
    "frames": (100, 300, 1000, 3000),
    "points": (50_000, 200_000, 1_000_000),
    "detections": (60, 600, 6_000),  # a frame
    "workers": (1, 2),
}
HELD, CHUNK, PIECES = 32, 100, 4  # frames held; frames of a chunk, and chunks, for Dask
NETWORK = 1e9  # bytes/s at which workers read their frames, an assumption
DETECTOR = Combination(DoG(283.0))


@dataclass(frozen=True)
class Replay:
    """Some frames of the twin, held in memory and shown again and again."""

    frames: tuple[Frame, ...]
    attributes: Attributes
    length: int

    def __len__(self) -> int:
        return self.length

    def frame(self, t: int) -> Frame:
        return replace(self.frames[t % HELD], index=t, time_s=t / self.attributes.frame_rate_hz)

    def gray(self, t: int) -> np.ndarray:
        return self.frames[t % HELD].gray


def replay(length: int) -> Replay:
    """Return frames 60 to 91 of subset V1, full size, as often as needed."""
    twin = open_scene("V1")
    return Replay(tuple(twin.frame(60 + t) for t in range(HELD)), twin.attributes, length)


def seconds(run: Callable[[], object]) -> float:
    """Return how long it takes."""
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


def frames(count: int) -> float:
    """Return the seconds from frames to tracks."""
    film = replay(count)
    kiln.detect_frames(film, [9], DETECTOR)  # compiles
    return seconds(lambda: postprocess(track(kiln.detect_frames(film, range(count), DETECTOR))))


def points(count: int) -> float:
    """Return the seconds of both passes of DBSCAN over a wall that grows with its points."""
    cloud = surface(count)
    WALL(cloud), PARTICLES(cloud)
    return min(seconds(lambda: (WALL(cloud), PARTICLES(cloud))) for _ in range(5))


def detections(count: int) -> float:
    """Return the seconds to link 20 frames, all of the same size."""
    table = recording(20, count)
    track(table)
    return min(seconds(lambda: track(table)) for _ in range(3))


@dataclass(frozen=True)
class Chunk:
    """Detection in some frames of a stored recording, called by a worker."""

    folder: Path
    length: int

    def __call__(self, start: int) -> None:
        stored = open_recording(self.folder / "film.zarr")
        table = kiln.detect_frames(stored, range(start, start + self.length), DETECTOR)
        table.to_parquet(self.folder / f"{start}.parquet")


def workers(count: int) -> float:
    """Return the seconds of a chunk of 100 frames when so many workers share some.

    It also prints how many workers the scheduler, and a network of `NETWORK`, keep at work.
    """
    from distributed import Client, LocalCluster

    with tempfile.TemporaryDirectory() as name:
        folder, pieces = Path(name), [CHUNK * k for k in range(PIECES)]
        write_recording(replay(CHUNK * PIECES), folder / "film.zarr")
        moved = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) / PIECES
        with LocalCluster(
            n_workers=count,
            threads_per_worker=1,
            dashboard_address=None,
            silence_logs=logging.CRITICAL,
        ) as cluster:
            finish = Workers(scheduler=cluster.scheduler_address)
            finish(Chunk(folder, 2), pieces, [2] * PIECES, "compiles")
            make = Chunk(folder, CHUNK)
            whole = seconds(lambda: finish(make, pieces, [CHUNK] * PIECES, "chunks"))
            with Client(cluster) as client:
                idle = seconds(lambda: client.gather(client.map(abs, range(-2000, 0)))) / 2000
    each = whole * count / PIECES
    print(each / idle, each / (moved / NETWORK))
    return whole / PIECES


def table() -> pd.DataFrame:
    """Return time for one frame, point, detection or chunk by that of the smallest size."""
    rows, first = [], 1.0
    for unit, sizes in SIZES.items():
        for size in sizes:
            command = [sys.executable, __file__, unit, str(size)]
            done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
            *kept, spent, peak = map(float, done.stdout.split())
            each = spent if unit == "workers" else spent / size
            first = each if size == sizes[0] else first
            memory = np.nan if unit == "workers" else peak  # theirs is not that of this process
            rows.append((unit, size, each / first, memory, *(kept or 2 * [np.nan])))
            print(
                f"{unit}, {size}: {spent:.2f} s, {each / first:.2f} of the first each", flush=True
            )
    columns = [
        "unit",
        "size",
        "time_of_one",
        "peak_mib",
        "workers_by_scheduler",
        "workers_by_network",
    ]
    return pd.DataFrame(rows, columns=columns).round(
        {"peak_mib": -1, **dict.fromkeys(columns[4:], 0)}
    )


if __name__ == "__main__":
    spent = globals()[sys.argv[1]](int(sys.argv[2]))
    # of this program alone: ru_maxrss begins with the peak of the one that started it
    print(
        spent, int(re.findall(r"VmHWM:\s+(\d+)", Path("/proc/self/status").read_text())[0]) / 1024
    )
