"""Faults of whole runs: what a run leaves behind when its surroundings are wrong.

Each function takes a folder and a generator of random numbers. It returns whether the
run ended as it should; an error of bad input is as good.
"""

import contextlib
import io
import os
import shutil
from pathlib import Path
from unittest import mock

import numpy as np
import pandas as pd

import kilnflight
from kilnflight.checks import InputError
from kilnflight.film.run import WRITTEN
from kilnflight.recording.files import open_any

ROW, COL = np.indices((24, 32))
MANIFEST = {
    "name": '"a"',
    "frame_rate_hz": "100.0",
    "um_per_px": "2.0",
    "fraction": '"sand"',
    "classes": "{ 0 = 0, 1 = 2 }",
    "origin": "0",
    "invalid": "0",
    "unit": '"mm"',
    "y": '"up"',
    "order": '"row col"',
}
OTHERS = {  # what an entry of the manifest is corrected to
    "name": '"b"',
    "frame_rate_hz": "50.0",
    "um_per_px": "3.0",
    "fraction": '"chips"',
    "classes": "{ 0 = 0, 1 = 3 }",
    "origin": "1",
    "invalid": "5000",
    "unit": '"m"',
    "y": '"down"',
    "order": '"col row"',
}


def spots(places, noise=0.0, seed=0):
    """Return a film of spots; places are (frames, particles, 2)."""
    rng = np.random.default_rng(seed)
    film = [rng.normal(50, noise, ROW.shape) for _ in places]
    for picture, here in zip(film, places, strict=True):
        for row, col in here:
            picture += 150 * np.exp(-((ROW - row) ** 2 + (COL - col) ** 2) / 8)
    return np.rint(film).clip(0, 255).astype(np.uint8)


def moving(particles, frames=6, step=(0.0, 2.0)):
    """Return the places of particles that move alike."""
    first = np.array([(6.0, 6.0), (17.0, 10.0), (12.0, 16.0)])[:particles]
    return first + np.arange(frames)[:, None, None] * np.array(step)


def run(film, folder, **options):
    """Run a film with settings that need little time; return its tables."""
    settings = {"threshold": 5, "background": "none"} | options
    with contextlib.redirect_stdout(io.StringIO()):
        return kilnflight.run(film, folder, **settings)


def content(folder):
    """Return the bytes of all files of a folder by name."""
    found = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in found}


def write_manifest(path, entries):
    """Write a manifest of grey values, points and labels of three frames."""
    path.parent.mkdir(exist_ok=True)
    told = {key: f"{key} = {value}\n" for key, value in entries.items()}
    for kind in ("gray", "xyz", "labels"):
        (path.parent / kind).mkdir(exist_ok=True)
    for t, picture in enumerate(spots(moving(2, 3))):
        np.save(path.parent / f"gray/{t}.npy", picture)
        np.save(path.parent / f"labels/{t}.npy", (picture > 99).astype(np.uint8))
        points = [(5, 6, 10.0, 20.0, 5000.0), (7, 9, -10.0, 30.0, 6000.0)]
        np.save(path.parent / f"xyz/{t}.npy", np.array(points) + t)
    head = "".join(told[key] for key in [*MANIFEST][:4])
    of_points = "".join(
        told[key] for key in ("origin", "invalid", "unit", "y", "order")
    )
    path.write_text(
        f'{head}[gray]\npattern = "gray/{{frame}}.npy"\n'
        f'[coordinates]\npattern = "xyz/{{frame}}.npy"\nform = "points"\n{of_points}'
        f'[labels]\npattern = "labels/{{frame}}.npy"\n{told["classes"]}'
    )


def edited(folder, rng):
    """Correct the manifest or a file between two runs."""
    path = folder / "set/film.toml"
    write_manifest(path, MANIFEST)
    run(path, folder / "first")
    known = open_any(path).content()
    key = rng.choice([*OTHERS, "gray", "xyz", "labels"])
    if key in OTHERS:
        write_manifest(path, MANIFEST | {key: OTHERS[key]})
    else:
        file = path.parent / f"{key}/1.npy"
        about = file.stat()
        values = np.load(file)
        values[0, 0] += 1
        np.save(file, values)
        os.utime(file, ns=(about.st_atime_ns, about.st_mtime_ns))
    if open_any(path).content() == known:
        return False
    run(path, folder / "first")  # refused: it has the run of another film
    return False


def degenerate(folder, rng):
    """Run a film with little or nothing in it; all tables are there."""
    frames = int(rng.integers(1, 9))
    step = rng.choice([0.0, 1.0, 2.0], 2)
    films = [
        spots(moving(0, frames)),
        spots(moving(int(rng.integers(1, 4)), frames, step)),
        spots(moving(int(rng.integers(1, 4)), frames, step), noise=2.0),
        np.full((frames, 24, 32), rng.integers(256), np.uint8),
        np.tile(np.indices((24, 32)).sum(axis=0) % 2 * 255, (frames, 1, 1)),
        np.eye(frames, 24 * 32).reshape(frames, 24, 32),
        rng.integers(0, 2, (frames, 24, 32)) * 65535.0,
    ]
    options = {"background": rng.choice(["median", "none"])}
    if rng.random() < 0.5:
        options["threshold"] = None
    film = films[rng.integers(len(films))]
    tables = run(film, folder / "to", **options)
    names = {"detections.parquet", "tracks.parquet", "tracks.csv", "summary.csv"}
    names |= {"detections.png", "tracks.png", "lengths-and-speeds.png"}
    stored = pd.read_parquet(folder / "to/tracks.parquet")
    return names <= {*content(folder / "to")} and stored.equals(tables["tracks"])


def foreign(folder, rng):
    """Run into a folder with a file of somebody else, who keeps it."""
    name = rng.choice([*WRITTEN, "notes.txt", "parts.csv"])
    target = folder / "to"
    target.mkdir()
    (target / name).write_bytes(b"mine")
    try:
        run(spots(moving(2)), target)
    except InputError:
        return [*content(target).values()] == [b"mine"]
    return name not in WRITTEN and (target / name).read_bytes() == b"mine"


def flipped(folder, rng):
    """Flip a bit of what a run keeps, and run again."""
    target = folder / "to"
    film = spots(moving(2))
    run(film, target)
    right = content(target)
    name = rng.choice(sorted(file for file in right if file.startswith("parts")))
    wrong = bytearray(right[name])
    if wrong:
        wrong[rng.integers(len(wrong))] ^= 1 << rng.integers(8)
    (target / name).write_bytes(wrong)
    run(film, target)
    again = content(target)
    return all(again[file] == right[file] for file in right if "/" not in file)


def failed(folder, rng):
    """Let an operation fail, once, and run again."""
    target = folder / "to"
    film = spots(moving(2, 3))
    run(film, target)
    right = content(target)
    shutil.rmtree(target)
    error, place, name = list(OPERATIONS.values())[rng.integers(len(OPERATIONS))]
    failing = Failing(getattr(place, name), int(rng.integers(1, 60)), error)
    failing_once = mock.patch.object(place, name, lambda *a, **o: failing(*a, **o))
    with contextlib.suppress(InputError, OSError, MemoryError), failing_once:
        run(film, target)
    run(film, target)
    return content(target) == right


class Failing:
    """An operation that fails once, when it is called for the ``n``-th time."""

    def __init__(self, call, n, error):
        self.call, self.n, self.error = call, n, error

    def __call__(self, *arguments, **options):
        counts = self.call.__name__ == "replace"
        if self.call.__name__ == "open":
            counts = "w" in f"{arguments[1:]}{options}"
        if self.call.__name__ == "mkdir":
            counts = not os.path.exists(arguments[0])
        self.n -= counts
        if counts and self.n == 0:
            raise self.error
        return self.call(*arguments, **options)


# What fails, and where it is called: by pathlib, tempfile and zarr.
FULL = OSError(28, "No space left on device")
OPERATIONS = {
    "write": (FULL, Path, "open"),
    "replace": (FULL, os, "replace"),
    "mkdir": (FULL, os, "mkdir"),
    "memory": (MemoryError(), Path, "open"),
}
FAULTS = {
    "edits between two runs": edited,
    "degenerate films": degenerate,
    "files of others in the target": foreign,
    "bits flipped": flipped,
    "operations that fail": failed,
}
