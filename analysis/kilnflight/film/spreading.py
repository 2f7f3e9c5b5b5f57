"""Steps and mean square displacement of tracks; no truth is needed."""

import numpy as np
import pandas as pd

from kilnflight.arrays import Array

LONGEST_LAG = 100  # frames
PAIRS = 30  # fewer displacements make no mean


def square_displacements(tracks: pd.DataFrame) -> pd.DataFrame:
    """Return the mean square displacement by lag, after the common drift is taken off.

    Parameters
    ----------
    tracks
        Columns particle, frame, row, col (px); every row in a track.

    Returns
    -------
    DataFrame
        lag (frames), square_px2, pairs: up to a quarter of the frames and
        `LONGEST_LAG`.
    """
    placed = tracks.sort_values(["particle", "frame"])[
        ["particle", "frame", "row", "col"]
    ]
    steps = placed.diff()
    single = (steps["particle"] == 0) & (steps["frame"] == 1)
    drift = steps[single].groupby(placed["frame"][single])[["row", "col"]].mean()
    frames = np.unique(placed["frame"].to_numpy(np.int64))
    drift = (
        drift.reindex(frames).interpolate(limit_direction="both").fillna(0.0)
    )  # over gaps
    drift = drift.mul(np.diff(frames, prepend=frames[:1]), axis=0).cumsum()
    places = placed[["row", "col"]].to_numpy() - drift.loc[placed["frame"]].to_numpy()
    moved = placed.assign(row=places[:, 0], col=places[:, 1])
    rows = []
    for lag in range(1, min(LONGEST_LAG, len(frames) // 4) + 1):
        both = moved.merge(
            moved.assign(frame=moved["frame"] + lag), on=["particle", "frame"]
        )
        if len(both) < PAIRS:
            break
        square = (both["row_x"] - both["row_y"]) ** 2 + (
            both["col_x"] - both["col_y"]
        ) ** 2
        rows.append((lag, square.mean(), len(both)))
    return pd.DataFrame(rows, columns=["lag", "square_px2", "pairs"])


def diffusion(displacements: pd.DataFrame, lags: int = 10) -> tuple[float, float]:
    """Return D in px^2 a frame and the square of the error of a position in px^2.

    The first ``lags`` of `square_displacements` are fitted by 4 D lag + 4 error^2, by
    least squares; noise can make the second one negative.
    """
    first = displacements.head(lags)
    offset, slope = (
        np.polynomial.Polynomial.fit(first["lag"], first["square_px2"], 1)
        .convert()
        .coef
    )
    return float(slope) / 4, float(offset) / 4


def speeds(tracks: pd.DataFrame) -> Array:
    """Return the speed (n,) in px/frame of each step; columns particle, frame, row,
    col.
    """
    ordered = tracks.sort_values(["particle", "frame"])[
        ["particle", "frame", "row", "col"]
    ].diff()
    steps = ordered[ordered["particle"] == 0]
    return np.asarray(np.hypot(steps["row"], steps["col"]) / steps["frame"])


def followed(tracks: pd.DataFrame) -> pd.DataFrame:
    """Return the detections (column particle) that are in tracks of two or more."""
    return tracks[(tracks["particle"] >= 0) & tracks.duplicated("particle", keep=False)]
