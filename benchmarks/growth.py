"""How time and memory grow with frames, points and detections, and with Dask workers.

Each measurement is a process of its own: ``python benchmarks/growth.py frames 300``
prints what it found as JSON. ``tables`` makes figures/growth.csv of them, without
absolute times, and figures/scale-out.csv, a model of more workers.
"""

from __future__ import annotations

import json
import logging
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
from bench_clustering import PARTICLES, WALL, surface
from bench_kiln import AROUND, SCENE, THRESHOLD, WANTED
from bench_tracking import recording
from measure import share_of_links

from kilnflight import chain
from kilnflight.__main__ import main
from kilnflight.detection import DoG
from kilnflight.detection.combination import Combination
from kilnflight.film.preparation import chunk_frames
from kilnflight.recording.frames import Attributes, Frame
from kilnflight.recording.store import open_recording, write_recording
from kilnflight.simulated.kiln.scenes import open_scene
from kilnflight.store.parallel import Workers
from kilnflight.tracking.tracker import track
from kilnflight.tracklets import postprocess

SIZES = {
    "frames": (100, 300, 1000, 3000),
    "points": (50_000, 200_000, 1_000_000),
    "detections": (60, 600, 6_000),  # a frame
    "workers": (1, 2),
}
HELD = 32
FILM = 400  # frames held; frames of the film for Dask
SHORT = 16  # frames of the film that compiles
MODELLED = {"frames": (3000, 100_000), "workers": (2, 8, 16, 32, 64)}
NETWORK = 1e9  # bytes/s at which workers read their frames, an assumption
DETECTOR = Combination(DoG(THRESHOLD))


@dataclass(frozen=True)
class Replay:
    """Some frames of the twin, shown again and again; each reader gets a copy, as from
    a disk.
    """

    frames: tuple[Frame, ...]
    attributes: Attributes
    length: int

    def __len__(self) -> int:
        return self.length

    def frame(self, t: int) -> Frame:
        time_s = t / self.attributes.frame_rate_hz
        return replace(self.frames[t % HELD], index=t, time_s=time_s, gray=self.gray(t))

    def gray(self, t: int) -> np.ndarray:
        return self.frames[t % HELD].gray.copy()


def replay(length: int) -> Replay:
    """Return frames 60 to 91 of subset V1, full size, as often as needed."""
    twin = open_scene("V1")
    return Replay(
        tuple(twin.frame(60 + t) for t in range(HELD)), twin.attributes, length
    )


def seconds(run: Callable[[], object]) -> float:
    """Return how long it takes."""
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


def frames(count: int) -> dict[str, float]:
    """Return the seconds from frames to tracks."""
    film = replay(count)
    chain.detect_frames(film, [9], DETECTOR)  # compiles

    def tracks() -> object:
        return postprocess(track(chain.detect_frames(film, range(count), DETECTOR)))

    return {"seconds": seconds(tracks)}


def points(count: int) -> dict[str, float]:
    """Return the seconds of both passes of DBSCAN over a wall that grows with its
    points.
    """
    cloud = surface(count)
    WALL(cloud), PARTICLES(cloud)
    return {
        "seconds": min(
            seconds(lambda: (WALL(cloud), PARTICLES(cloud))) for _ in range(5)
        )
    }


def detections(count: int) -> dict[str, float]:
    """Return the seconds to link 20 frames, all of the same size, and the share of
    right links.
    """
    table = recording(20, count)
    right = share_of_links(table, track(table)["particle"].to_numpy())
    return {
        "seconds": min(seconds(lambda: track(table)) for _ in range(3)),
        "right_links": right,
    }


def workers(count: int) -> dict[str, float]:
    """Return the seconds of ``kilnflight run --scheduler`` with ``count`` workers.

    Also the share of the command's time in which they detect, and the number of workers
    that read `NETWORK` bytes/s together. Each chunk also reads the pictures of the
    median's window. One worker also gives the inputs of `scale_out`.
    """
    from distributed import LocalCluster

    twin = open_scene(SCENE)
    start = WANTED.start
    with tempfile.TemporaryDirectory() as name:
        for length in (SHORT, FILM):
            film = Path(name, f"{length}.zarr")
            write_recording(twin, film, range(start, start + length))
        whole, pictures = (  # bytes a frame
            sum(path.stat().st_size for path in there.rglob("*") if path.is_file())
            / FILM
            for there in (film, film / "gray")
        )
        with (
            LocalCluster(
                n_workers=count,
                threads_per_worker=1,
                dashboard_address=None,
                silence_logs=logging.CRITICAL,
            ) as cluster,
            redirect_stdout(sys.stderr),
        ):
            last = [
                "--threshold",
                str(THRESHOLD),
                "--scheduler",
                cluster.scheduler_address,
            ]

            def run(length: int) -> None:
                main(
                    [
                        "run",
                        f"{name}/{length}.zarr",
                        "--to",
                        f"{name}/found-{length}",
                        *last,
                    ]
                )

            def rest(length: int) -> float:  # again, but for the detections
                for part in Path(name, f"found-{length}", "parts").glob(
                    "[!d]*.parquet"
                ):
                    part.unlink()
                return seconds(lambda: run(length))

            run(SHORT)  # compiles
            spent = seconds(lambda: run(FILM))
            parts = Path(name, f"found-{FILM}", "parts")
            chunks = len(list(parts.glob("d*.parquet")))
            unshared = rest(FILM)
            shared = spent - unshared
            inputs = {}
            if count == 1:
                each = (unshared - rest(SHORT)) / (FILM - SHORT)
                inputs = detection_s(film) | {"rest": each}
                inputs["start"] = unshared - FILM * each
    moved = whole * FILM + pictures * 150 * chunks
    busy = (
        round(shared / (moved / NETWORK)) if count == 1 else np.nan
    )  # more slow each other
    found = {"shared_percent": round(100 * shared / spent), "workers_at_1_gb_s": busy}
    return found | {"seconds": spent, "inputs": inputs}


def detection_s(film: Path) -> dict[str, float]:
    """Return the seconds of a frame and of a chunk's window, one process."""
    stored = open_recording(film)
    short, long = (
        min(
            seconds(
                lambda last=last: chain.detect_frames(
                    stored, range(AROUND, last), DETECTOR
                )
            )
            for _ in range(3)
        )
        for last in (AROUND + 32, AROUND + 128)
    )
    each = (long - short) / 96
    return {"frame": each, "window": short - 32 * each}


def scale_out(inputs: dict[str, float]) -> pd.DataFrame:
    """Return the speed-up over one worker that a model expects.

    ``inputs`` are measured seconds: of detection in a frame, of a chunk's window, of
    the rest in a frame, which one process does, and of the start. Workers take chunk
    after chunk; network and disk are left out.
    """

    def spent(frames: int, workers: int) -> tuple[int, float]:
        chunk = int(chunk_frames(frames, Workers(workers))["frames"].iloc[0])
        rounds = np.ceil(np.ceil(frames / chunk) / workers)
        detection = rounds * (chunk * inputs["frame"] + inputs["window"])
        return chunk, inputs["start"] + frames * inputs["rest"] + detection

    rows = []
    for frames in MODELLED["frames"]:
        for workers in MODELLED["workers"]:
            chunk, time_s = spent(frames, workers)
            speed_up = spent(frames, 1)[1] / time_s
            rows.append((frames, workers, chunk, round(speed_up, 1)))
    return pd.DataFrame(
        rows, columns=["frames", "workers", "chunk_frames", "speed_up"]
    ).assign(
        detection_ms=round(1000 * inputs["frame"], 1),
        window_ms=round(1000 * inputs["window"]),
        rest_ms=round(1000 * inputs["rest"], 2),
        start_s=round(inputs["start"], 1),
    )


def tables() -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return time for one frame, point or detection by that of the smallest size.

    The second table is `scale_out`.
    """
    rows = []
    inputs: dict[str, float] = {}
    first = 1.0
    for unit, sizes in SIZES.items():
        for size in sizes:
            command = [sys.executable, __file__, unit, str(size)]
            done = subprocess.run(
                command, stdout=subprocess.PIPE, text=True, check=True
            )
            row = {"unit": unit, "size": size} | json.loads(done.stdout)
            print(f"{unit}, {size}: {row['seconds']:.3g} s", flush=True)
            inputs |= row.pop("inputs", {})
            each = row.pop("seconds") / (1 if unit == "workers" else size)
            first = each if size == sizes[0] else first
            if unit == "workers":  # their memory is not that of this process
                row |= {"speed_up": round(first / each, 2), "peak_memory_mib": np.nan}
            else:
                row["relative_time"] = round(each / first, 2)
            rows.append(row)
    columns = [
        "unit",
        "size",
        "relative_time",
        "peak_memory_mib",
        "right_links",
        "speed_up",
    ]
    columns += ["shared_percent", "workers_at_1_gb_s"]
    return pd.DataFrame(rows)[columns], scale_out(inputs)


if __name__ == "__main__":
    cv2.setNumThreads(1)
    found = globals()[sys.argv[1]](int(sys.argv[2]))
    # of this program alone: ru_maxrss begins with the peak of the one that started it
    peak = re.findall(r"VmHWM:\s+(\d+)", Path("/proc/self/status").read_text())[0]
    found["right_links"] = round(found.get("right_links", np.nan), 3)
    print(json.dumps(found | {"peak_memory_mib": round(int(peak) / 1024, -1)}))
