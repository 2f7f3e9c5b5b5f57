"""Steps, mean square displacements and diffusion of tracks; no truth is needed."""

from typing import NamedTuple

import numpy as np
import pandas as pd
from pandas import DataFrame
from scipy.optimize import least_squares

from kilnflight.arrays import Array
from kilnflight.checks import check_flags, check_number
from kilnflight.tables import SQUARES, TRACKED, in_tracks

LONGEST_LAG = 100  # frames
ALONE = 0.25  # share of positions with others in their frame; drift shows from it on
LEAST_PX2 = 1e-12  # no error is taken smaller


def square_displacements(
    tracks: DataFrame, each: bool = False, drift: bool = True
) -> DataFrame:
    """Average the square displacements by lag, of all tracks or of each.

    Parameters
    ----------
    tracks
        Columns particle (-1: in no track), frame, row, col or y, x (px).
    each
        Whether to average each track on its own.
    drift
        Whether to take the common drift off. None is taken off a lone particle, which
        tells nothing of it.

    Returns
    -------
    DataFrame
        lag (frames), square_px2, its standard error error_px2, and pairs, the number of
        displacements; with ``each`` first particle. Lags go up to a quarter of the
        frames and to `LONGEST_LAG`, as long as the error is below half of the value.

    Raises
    ------
    InputError
        If a column is missing or not made of such numbers, or a particle is twice in a
        frame.

    Notes
    -----
    A pair of positions counts by its own lag, also across a gap. The drift of a pair is
    the mean displacement of the n particles that are seen in both of its frames. As the
    particle is one of them, the square counts as 1 - 1/n. A pair without another
    particle does not count. Alone are particles with another one in less than a quarter
    of their frames.

    Pairs of a track that overlap in time are not independent. The error is that of a
    walk: m pairs of a lag count as ``3 m lag / (2 lag^2 + 1)`` (Qian, Sheetz and Elson,
    Biophys. J. 60, 1991). Particles that differ scatter more.

    Examples
    --------
    >>> import kilnflight
    >>> film = kilnflight.sample_film()
    >>> displacements = kilnflight.square_displacements(film.truth)
    >>> displacements["lag"].tolist()
    [1, 2, 3, 4]
    """
    check_flags("square_displacements: each and drift", each, drift)
    placed = in_tracks(tracks, "square_displacements: tracks")
    drift &= placed.duplicated("frame", keep=False).mean() > ALONE
    longest = np.clip(placed["frame"].nunique() // 4, 1, LONGEST_LAG)
    parts = [_squares(placed, lag, drift) for lag in range(1, longest + 1)]
    keys = ["lag"]
    if each:
        keys = ["particle", "lag"]
    table = pd.concat(parts).groupby(keys).sum().reset_index()
    lag = table["lag"]
    table["square_px2"] /= table["free"]
    share = np.sqrt((2 * lag**2 + 1) / (3 * lag * table["free"]))
    table["error_px2"] = table["square_px2"] * share
    return table.loc[share <= 0.5, [*keys, "square_px2", "error_px2", "pairs"]]


def _squares(placed: DataFrame, lag: int, drift: bool) -> DataFrame:
    """Return square_px2, pairs and free of each particle, sums over its pairs of a lag.

    ``free`` is the number of pairs but for what the drift takes.
    """
    later = placed.assign(frame=placed["frame"] + lag)
    both = placed.merge(later, on=["particle", "frame"]).assign(lag=lag, free=1.0)
    steps = both.filter(like="_x") - both.filter(like="_y").to_numpy()
    if drift:
        together = steps.groupby(both["frame"])
        steps -= together.transform("mean")
        both["free"] -= 1 / together["row_x"].transform("size")
    both["square_px2"] = (steps**2).sum(axis=1)
    both["pairs"] = both["free"] > 0
    return both.groupby(["particle", "lag"])[["square_px2", "pairs", "free"]].sum()


class Spreading(NamedTuple):
    """Diffusion that mean square displacements show."""

    diffusion: float  # D, px^2 a frame
    position_error_px2: float  # square of the error of a position, per axis
    diffusion_error: float  # standard error of D
    exponent: float  # of the lag: 1 for diffusion, 2 for flight; NaN: D may be 0


def fit_spreading(displacements: DataFrame, lags: int = 10) -> Spreading:
    """Fit a line and a power of the lag to mean square displacements.

    Parameters
    ----------
    displacements
        From `square_displacements`; of one track if of each.
    lags
        Number of the first lags that are fitted: the line 4 D lag + 4 error^2, and the
        power c lag^exponent + 4 error^2 with an error^2 of its own, not below 0.

    Returns
    -------
    Spreading
        D with its standard error, the exponent, and the square of the error of a
        position, which noise can make negative.

    Raises
    ------
    InputError
        If there are fewer than three lags, their number is not whole, or a value is not
        finite.

    Notes
    -----
    Both are least squares, weighted by the errors. Lags share steps, so their errors go
    together; the error of D allows for it.

    Examples
    --------
    >>> walked = pd.DataFrame({"lag": [1, 2, 3], "square_px2": [3.0, 5.0, 7.0]})
    >>> fit = fit_spreading(walked.assign(error_px2=0.5))
    >>> round(fit.diffusion, 6), round(fit.exponent, 6)
    (0.5, 1.0)
    """
    most = check_number(lags, "fit_spreading: lags", least=3, whole=True)
    first = SQUARES.check(displacements).head(most)
    check_number(len(first), "fit_spreading: number of lags", least=3)
    lag, square, error = first.to_numpy(float).T
    error = np.maximum(error, LEAST_PX2)
    # The line is a sum of the squares; their errors go together, as lags share steps.
    line = np.polyfit(lag, np.eye(len(lag)), 1, w=1 / error)
    walk, offset = (line @ square / 4).tolist()
    walk_error = float(abs(line[0] @ error)) / 4
    exponent = np.nan
    if walk > 2 * walk_error:

        def missed(power: Array) -> Array:
            return (power[0] * lag ** power[1] + power[2] - square) / error

        power = least_squares(missed, [walk, 1.0, 0.0], bounds=(0.0, np.inf))
        exponent = float(power.x[1])
    return Spreading(
        diffusion=walk,
        position_error_px2=offset,
        diffusion_error=walk_error,
        exponent=exponent,
    )


def speeds(tracks: DataFrame) -> Array:
    """Return the speed (n,) in px/frame of each step.

    Parameters
    ----------
    tracks
        Columns particle, frame, row, col (px).
    """
    steps = tracks.sort_values(["particle", "frame"])[TRACKED.names].diff()
    steps = steps[steps["particle"] == 0]
    return np.asarray(np.hypot(steps["row"], steps["col"]) / steps["frame"])


def followed(tracks: DataFrame) -> DataFrame:
    """Return the detections (column particle) that are in tracks of two or more."""
    return tracks[(tracks["particle"] >= 0) & tracks.duplicated("particle", keep=False)]
