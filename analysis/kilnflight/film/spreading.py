"""Steps and mean square displacement of tracks; no truth is needed."""

import numpy as np
import pandas as pd

from kilnflight.arrays import Array

LONGEST_LAG = 100  # frames
PAIRS = 30  # fewer displacements make no mean
PLACE = ["particle", "frame", "row", "col"]


def square_displacements(tracks: pd.DataFrame) -> pd.DataFrame:
    """Average the square displacements by lag, after the common drift is taken off.

    Parameters
    ----------
    tracks
        Columns particle, frame, row, col (px); every row in a track.

    Returns
    -------
    DataFrame
        lag (frames), square_px2, pairs: up to a quarter of the frames and
        `LONGEST_LAG`.

    Examples
    --------
    >>> import kilnflight
    >>> film = kilnflight.sample_film()
    >>> displacements = kilnflight.square_displacements(film.truth)
    >>> displacements["lag"].tolist()
    [1, 2, 3, 4]
    """
    placed = tracks.sort_values(["particle", "frame"])[PLACE]
    drift = _drift(placed)
    places = placed[["row", "col"]].to_numpy() - drift.loc[placed["frame"]].to_numpy()
    moved = placed.assign(row=places[:, 0], col=places[:, 1])
    rows = []
    for lag in range(1, min(LONGEST_LAG, len(drift) // 4) + 1):
        later = moved.assign(frame=moved["frame"] + lag)
        both = moved.merge(later, on=["particle", "frame"])
        if len(both) < PAIRS:
            break
        down = both["row_x"] - both["row_y"]
        right = both["col_x"] - both["col_y"]
        rows.append((lag, (down**2 + right**2).mean(), len(both)))
    return pd.DataFrame(rows, columns=["lag", "square_px2", "pairs"])


def _drift(placed: pd.DataFrame) -> pd.DataFrame:
    """Return row and col (px) of the common way by frame, interpolated over gaps."""
    steps = placed.diff()
    single = (steps["particle"] == 0) & (steps["frame"] == 1)
    drift = steps[single].groupby(placed["frame"][single])[["row", "col"]].mean()
    frames = np.unique(placed["frame"].to_numpy(np.int64))
    drift = drift.reindex(frames).interpolate(limit_direction="both").fillna(0.0)
    return drift.mul(np.diff(frames, prepend=frames[:1]), axis=0).cumsum()


def diffusion(displacements: pd.DataFrame, lags: int = 10) -> tuple[float, float]:
    """Fit diffusion to mean square displacements.

    Parameters
    ----------
    displacements
        From `square_displacements`.
    lags
        Number of the first lags that are fitted by 4 D lag + 4 error^2, by least
        squares.

    Returns
    -------
    tuple
        D in px^2 a frame, and the square of the error of a position in px^2; noise can
        make it negative.

    Examples
    --------
    >>> import pandas as pd
    >>> walked = pd.DataFrame({"lag": [1, 2, 3], "square_px2": [3.0, 5.0, 7.0]})
    >>> [round(value, 6) for value in diffusion(walked)]
    [0.5, 0.25]
    """
    first = displacements.head(lags)
    line = np.polynomial.Polynomial.fit(first["lag"], first["square_px2"], 1)
    offset, slope = line.convert().coef
    return float(slope) / 4, float(offset) / 4


def speeds(tracks: pd.DataFrame) -> Array:
    """Return the speed (n,) in px/frame of each step.

    Parameters
    ----------
    tracks
        Columns particle, frame, row, col (px).
    """
    steps = tracks.sort_values(["particle", "frame"])[PLACE].diff()
    steps = steps[steps["particle"] == 0]
    return np.asarray(np.hypot(steps["row"], steps["col"]) / steps["frame"])


def followed(tracks: pd.DataFrame) -> pd.DataFrame:
    """Return the detections (column particle) that are in tracks of two or more."""
    return tracks[(tracks["particle"] >= 0) & tracks.duplicated("particle", keep=False)]
