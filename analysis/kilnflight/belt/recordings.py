"""The authors' data: DEM tracks, recordings of their real sorter, and the velocity in
these.

The DEM tracks are those of the 2020 paper. A DEM file is a zip with one CSV without
header. Rows are time steps of 10 ms. Columns alternate x and y of one particle in
metres, ``nan`` while it is not on the belt.

A recording ``NNN.csv`` (or ``.csv.gz``) has a row per frame: its number, the number of
measured midpoints, and x, y of each in pixels, then NaN.
``NNN_trackHistory_NothingDeleted.csv`` has one pair of columns for each of the authors'
tracks. In the files the belt runs along y; in our tables it runs along x. Frame time
and size of a pixel stand in the models of the same repository
(KIT-ISAS/TrackSort_Neural_Public, branch jakob_master, cv_model.py and main.py).
"""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import NamedTuple
from zipfile import BadZipFile

import numpy as np
import pandas as pd

from kilnflight.arrays import Array, Index, Whole
from kilnflight.checks import InputError
from kilnflight.tables import BELT_TRACKS, MEASURED

TIME_STEP_S = 0.01  # of the public DEM files; the paper itself evaluated at 0.001 s
REAL_FRAME_S = 0.005  # cv_model.py: dt
MM_PER_PX = 0.056  # cv_model.py: "1 Pixel = 0.056 mm"
CAMERA_END_PX = (
    800.0  # main.py: virtual_belt_edge_x_position, from where the authors predict
)
NOZZLES_PX = 1550.0  # main.py: virtual_nozzle_array_x_position; cv_model.py: x_pred_to
MATERIAL_FOLDERS = {"spheres": "Kugeln", "wheat": "Weizen", "cylinders": "Zylinder"}
HISTORY = "_trackHistory_NothingDeleted"
ENDINGS = (".csv", ".csv.gz")

LEAST_PX = 5.0
MOST_PX = 500.0  # per frame; what moves less lies still (dirt); choice
BESIDE_PX = 8.0  # across the belt, by which a particle may move in a frame; choice
BIN_PX = 4.0  # of the distances; choice
AROUND = 0.2  # of the step: what counts to its peak; choice
LEAST_PAIRS = 20  # in the peak; choice
RIVAL = 0.5  # a second peak this high makes the step ambiguous; choice
MAD_TO_SD = 1.4826  # of a normal distribution


def read_dem(path: Path) -> pd.DataFrame:
    """Return the tracks of particles that the authors simulated (2020 paper).

    They used the discrete element method (DEM). A file is a zip with one CSV, or that
    CSV.

    Returns
    -------
    DataFrame
        `kilnflight.tables.BELT_TRACKS` by particle and frame, x and y in mm; particles
        without a single position have no row. ``attrs["particles"]`` is the number of
        particles in the file.

    Raises
    ------
    InputError
        If the file is no zip with one CSV, the number of columns is odd, a cell is no
        number or infinite, or only one of x and y is given.
    """
    cells = _cells(path, header=None)
    frame, particle, x, y = _pairs(cells, path)
    if (
        np.isinf(cells).any()
        or (np.isnan(cells[:, 0::2]) != np.isnan(cells[:, 1::2])).any()
    ):
        raise InputError(
            f"{path.name}: x and y must both be finite, or both nan off the belt."
        )
    columns = (frame, particle, frame * TIME_STEP_S, 1000.0 * x, 1000.0 * y)
    table = pd.DataFrame(dict(zip(BELT_TRACKS.names, columns, strict=True)))
    tracks = table.sort_values(["particle", "frame"], ignore_index=True)
    tracks.attrs["particles"] = cells.shape[1] // 2
    return tracks


def list_recordings(folder: Path) -> dict[str, list[Path]]:
    """Return the files of measured positions in a folder by material, sorted.

    Keys are those of `MATERIAL_FOLDERS` that have files. Of a file that is there packed
    and unpacked, the unpacked one is returned.
    """
    files = {}
    for name, part in MATERIAL_FOLDERS.items():
        every = [
            path
            for ending in reversed(ENDINGS)
            for path in (folder / part).glob(f"*{ending}")
        ]
        by_stem = {_stem(path): path for path in every if HISTORY not in path.name}
        files[name] = [by_stem[stem] for stem in sorted(by_stem)]
    return {name: paths for name, paths in files.items() if paths}


def read_recording(path: Path) -> pd.DataFrame:
    """Return the measured positions of one recording and the authors' track of each.

    Returns
    -------
    DataFrame
        ``frame``, as the file counts (FrameNr); ``x`` along the belt and ``y`` across
        it in px; ``author_track``, the authors' track, -1 where it is in none.

    Raises
    ------
    InputError
        If a file is no table of pairs, or its frame numbers do not ascend.
    """
    cells = _cells(path)
    row, _, across, along = _pairs(cells[:, 2:], path)
    number = cells[:, 0]  # frames may be missing, but never come twice or go back
    if not (
        (number >= 0) & (number % 1 == 0) & (np.diff(number, prepend=-1.0) > 0)
    ).all():
        raise InputError(
            f"{path.name}: FrameNr must be whole numbers that ascend, a row each."
        )
    table = pd.DataFrame(
        {"frame": number.astype(np.int64)[row], "x": along, "y": across}
    )
    beside = [path.with_name(_stem(path) + HISTORY + ending) for ending in ENDINGS]
    history = next((file for file in beside if file.is_file()), None)
    if history is None:
        return table.assign(author_track=-1)
    _, particle, across, along = _pairs(_cells(history), history)
    tracked = pd.DataFrame({"x": along, "y": across, "author_track": particle})
    merged = table.merge(tracked.drop_duplicates(["x", "y"]), on=["x", "y"], how="left")
    return merged.fillna({"author_track": -1}).astype({"author_track": np.int64})


def _stem(path: Path) -> str:
    return path.name.removesuffix(".gz").removesuffix(".csv")


def _cells(path: Path, header: int | None = 0) -> Array:
    """Return the numbers (rows, columns) of a CSV file, packed or not.

    ``header`` is the line of the column names, None if there is none.
    """
    try:
        return pd.read_csv(path, header=header).to_numpy(dtype=np.float64)
    except (
        OSError,
        ValueError,
        EOFError,
        BadZipFile,
        zlib.error,
        RuntimeError,
    ) as error:
        raise InputError(
            f"{path.name}: no table of numbers ({error}); fetch it again."
        ) from error


def _pairs(cells: Array, path: Path) -> tuple[Index, Index, Array, Array]:
    """Return row, pair of columns, and both numbers of each finite pair, (n,) each.

    Columns 2 k and 2 k + 1 of ``cells`` (rows, columns) are pair k, one place or
    particle.
    """
    if cells.shape[1] % 2:
        raise InputError(
            f"{path.name}: {cells.shape[1]} columns of x and y; one is missing."
        )
    pairs = cells.reshape(len(cells), cells.shape[1] // 2, 2)
    row, column = np.nonzero(np.isfinite(pairs).all(axis=2))
    return row, column, *pairs[row, column].T


class BeltVelocity(NamedTuple):
    """Distance that particles move from frame to frame, from pairs of measurements."""

    px_per_frame: float  # median of the pairs in the peak
    spread_px: float  # 1.4826 times their median absolute deviation
    pairs: int  # in the peak
    share_percent: (
        float  # of all measurements but those of the last frame that have such a pair
    )


def estimate_velocity(measured: pd.DataFrame, name: str = "recording") -> BeltVelocity:
    """Return the velocity of particles along the belt, in px per frame.

    No paper prints the velocity on the real belt, and recordings differ. Measurements
    in consecutive frames that lie side by side across the belt are mostly the same
    particle. Their distances along the belt are counted in bins. The highest bin, with
    its neighbours, is the peak; the velocity is the median of the distances within a
    fifth of it. No tracker is needed, so the estimate can be a tracker's input.

    Parameters
    ----------
    measured
        ``frame``, ``x`` along the belt (in which it runs) and ``y`` across it, px.
    name
        Of the recording, for errors.

    Raises
    ------
    InputError
        If fewer than 20 pairs make the peak, or a second peak is half as high.
    """
    measured = MEASURED.check(measured, once=True)
    steps, first = _steps(measured)
    counts, edges = np.histogram(steps, np.arange(LEAST_PX, MOST_PX + BIN_PX, BIN_PX))
    peaks = np.convolve(counts, np.ones(3), mode="same")
    middle = 0.5 * (edges[:-1] + edges[1:])
    highest = int(np.argmax(peaks))
    reach = max(AROUND * middle[highest], 2 * BIN_PX)
    near = np.abs(steps - middle[highest]) <= reach
    apart = np.abs(middle - middle[highest]) > reach + BIN_PX
    rival = np.where(apart, peaks, 0.0).max()
    if near.sum() < LEAST_PAIRS or rival >= RIVAL * peaks[highest]:
        raise InputError(
            f"{name}: {near.sum()} pairs of measurements move by some "
            f"{middle[highest]:.0f} px per frame. At least {LEAST_PAIRS} must, and "
            "twice as many as by any other velocity."
        )
    step = float(np.median(steps[near]))
    spread = MAD_TO_SD * float(np.median(np.abs(steps[near] - step)))
    before_last = int((measured["frame"] < measured["frame"].max()).sum())
    share = 100 * len(np.unique(first[near])) / before_last
    return BeltVelocity(step, spread, int(near.sum()), share)


def _steps(measured: pd.DataFrame) -> tuple[Array, Whole]:
    """Return displacements along the belt in px, and the row in ``measured`` of each
    start, (n,).

    Each measurement is paired with those of the next frame that are at most `BESIDE_PX`
    off across the belt (y) and `LEAST_PX` to `MOST_PX` ahead (x). Most pairs are one
    particle seen twice, so the displacements show the belt's velocity. ``measured`` has
    frame, x and y in px.
    """
    places = measured.reset_index(drop=True)
    after = places.assign(frame=places["frame"] - 1)
    pairs = places.reset_index().merge(after, on="frame", suffixes=("", "_after"))
    along = pairs["x_after"] - pairs["x"]
    across = pairs["y_after"] - pairs["y"]
    beside = (across.abs() <= BESIDE_PX) & along.between(LEAST_PX, MOST_PX)
    return along[beside].to_numpy(np.float64), pairs.loc[beside, "index"].to_numpy(
        np.int64
    )
