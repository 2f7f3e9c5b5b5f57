"""Track tables -> regressed trajectories, as fits and as a table (thesis, section 4.3)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.checks import (
    InputError,
    check_columns,
    check_finite,
    check_positive,
    check_shape,
    check_whole,
    known_numbers,
)
from kilnflight.regression.fit import Array, Fit
from kilnflight.regression.polynomials import Regression
from kilnflight.tables import AXES, HIGHEST_ORDER, TRAJECTORIES

FITTED, NO_DEPTH, TOO_FEW = "fitted", "no depth", "too few points"
MEASURES = ("rmse_{}_mm", "mape_{}_percent", "r2_{}", "r2_adjusted_{}")


class Path(NamedTuple):
    """The points of one track that have a place in space, by ascending time."""

    particle: int
    time_s: Array  # (n,)
    places_mm: Array  # (n, 3)


def regress(
    track: pd.DataFrame,
    exit_point: npt.ArrayLike,
    frame_rate_hz: float | None = None,
    parameters: Regression | None = None,
) -> Fit:
    """Return the regressed trajectory of one track.

    Parameters
    ----------
    track
        One row per detection in any order: ``x``, ``y``, ``z`` in mm, NaN where there is no
        depth (such rows are left out), and ``frame``, or ``time_s`` if no frame rate is
        given.
    exit_point
        (3,) the lance's exit in mm.
    parameters
        What regresses; None: `Regression` as published.

    Raises
    ------
    InputError
        If the track cannot be regressed: no depth, too few points, two at one time, more
        than one particle, or values that are no numbers.
    """
    parameters = Regression() if parameters is None else parameters
    check_columns(track, AXES, "track")
    if "particle" in track.columns and len(track["particle"].unique()) > 1:
        raise InputError("track: more than one particle; call regress_all.")
    alone = track.assign(particle=0)
    for path in _paths(alone, frame_rate_hz, "track"):
        if len(path.time_s) == 0:
            raise InputError("track: no depth, x, y and z are missing everywhere. Leave it out.")
        return parameters(path.time_s, path.places_mm, exit_point)
    raise InputError("track: no points. Leave empty tracks out.")


def regress_all(
    tracks: pd.DataFrame,
    exit_point: npt.ArrayLike,
    frame_rate_hz: float | None = None,
    parameters: Regression | None = None,
) -> pd.DataFrame:
    """Return `kilnflight.tables.TRAJECTORIES`, one row per particle by ascending number.

    The arguments are those of `regress`, with whole numbers in the column ``particle``;
    rows of particle -1 belong to no track. What cannot be regressed keeps its row: the
    column ``outcome`` says why, and what is not known is NaN, orders 0.

    Raises
    ------
    InputError
        If a column is missing or no numbers, or a particle is in two places at one time.
    """
    parameters = Regression() if parameters is None else parameters
    if parameters.highest > HIGHEST_ORDER:
        raise InputError(f"regress_all: the table ends at order {HIGHEST_ORDER}; use regress.")
    exit_mm = check_finite(exit_point, "exit_point")
    check_shape(exit_mm, (3,), "exit_point")
    rows = [_row(path, exit_mm, parameters) for path in _paths(tracks, frame_rate_hz, "tracks")]
    if not rows:
        return TRAJECTORIES.empty()
    kinds: dict[str, Any] = {column.name: column.kind for column in TRAJECTORIES.columns}
    table = pd.DataFrame(rows, columns=TRAJECTORIES.names).astype(kinds)
    return TRAJECTORIES.check(table)


def fits(trajectories: pd.DataFrame) -> dict[int, Fit]:
    """Return the `Fit` of every fitted particle of a table of `regress_all`."""
    table = TRAJECTORIES.check(trajectories)
    fitted = table[table["outcome"] == FITTED]
    return {row["particle"]: _fit(row) for row in fitted.to_dict("records")}


def order_measures(
    tracks: pd.DataFrame,
    exit_point: npt.ArrayLike,
    frame_rate_hz: float | None = None,
    orders: Iterable[int] = range(2, 8),
    parameters: Regression | None = None,
) -> pd.DataFrame:
    """Return the measures of each track under fixed orders, the same for all axes (Fig. 4.23).

    Tracks with too few points for the highest of the orders are left out under all, so
    that every order is measured on the same tracks.

    Returns
    -------
    Columns particle, order, axis, rmse_mm, mape_percent, r2, r2_adjusted.
    """
    parameters = Regression() if parameters is None else parameters
    fixed = [replace(parameters, lowest=k, highest=k) for k in orders]
    fewest = max((one.fewest for one in fixed), default=0)
    names = ["particle", "order", "axis", "rmse_mm", "mape_percent", "r2", "r2_adjusted"]
    rows = [
        (path.particle, one.lowest, axis, *values)
        for path in _paths(tracks, frame_rate_hz, "tracks")
        if len(path.time_s) >= fewest
        for one in fixed
        for axis, *values in _measured(one(path.time_s, path.places_mm, exit_point))
    ]
    kinds = dict.fromkeys(names, float) | {"particle": int, "order": int, "axis": str}
    return pd.DataFrame(rows, columns=names).astype(kinds)


def _measured(fit: Fit) -> Iterator[tuple[str, float, float, float, float]]:
    """Yield the axis and its four measures."""
    yield from zip(AXES, fit.rmse_mm, fit.mape_percent, fit.r2, fit.r2_adjusted, strict=True)


def _paths(tracks: pd.DataFrame, frame_rate_hz: float | None, where: str) -> Iterator[Path]:
    """Yield the tracks of a table by ascending number, whatever the order of its rows."""
    clock = "time_s" if frame_rate_hz is None else "frame"
    check_columns(tracks, ("particle", clock, *AXES), where)
    particle = check_whole(tracks["particle"], f"{where}: column particle")
    if frame_rate_hz is None:
        time = check_finite(tracks[clock].to_numpy(), f"{where}: column time_s")
    else:
        check_positive(frame_rate_hz, "frame_rate_hz")
        time = check_whole(tracks[clock], f"{where}: column frame") / frame_rate_hz
    places = np.stack([known_numbers(tracks[a], f"{where}: column {a}") for a in AXES], axis=1)
    if np.isinf(places).any():
        row = tracks.index[int(np.argwhere(np.isinf(places))[0, 0])]
        raise InputError(f"{where}: a place is infinite in row {row}. Use NaN where it is unknown.")
    rank = np.lexsort((time, particle))
    rank = rank[particle[rank] >= 0]
    particle, time, places = particle[rank], time[rank], places[rank]
    _check_once(particle, time, where)
    names, starts = np.unique(particle, return_index=True)
    for name, first, end in zip(names, starts, np.append(starts, len(rank))[1:], strict=True):
        known = first + np.flatnonzero(np.isfinite(places[first:end]).all(axis=1))
        yield Path(int(name), time[known], places[known])


def _check_once(particle: npt.NDArray[np.int64], time: Array, where: str) -> None:
    """Raise an `InputError` if a particle has two rows at one time; sorted by both."""
    twice = np.flatnonzero((np.diff(particle) == 0) & (np.diff(time) == 0))
    if len(twice):
        raise InputError(
            f"{where}: two rows of particle {particle[twice[0]]} at {time[twice[0]]:.9g} s. A "
            "particle is at one place at a time; keep one, or give it another number or -1."
        )


def _row(path: Path, exit_mm: Array, parameters: Regression) -> dict[str, object]:
    """Return the row of one track in the table."""
    points = len(path.time_s)
    row: dict[str, object] = {
        column.name: np.nan if column.kind is float else 0 for column in TRAJECTORIES.columns
    }
    row |= {"particle": path.particle, "points": points}
    row |= {f"exit_{a}": value for a, value in zip(AXES, exit_mm.tolist(), strict=True)}
    if not points:
        return row | {"outcome": NO_DEPTH}
    row |= {"first_s": path.time_s[0], "last_s": path.time_s[-1]}
    if points < parameters.fewest:
        return row | {"outcome": TOO_FEW}
    fit = parameters(path.time_s, path.places_mm, exit_mm)
    earliest, latest = fit.t0_range_s
    row |= {"outcome": FITTED, "t0_s": fit.t0_s, "t0_at_bound": fit.t0_at_bound}
    row |= {"t0_earliest_s": earliest, "t0_latest_s": latest}
    for axis, order, factors in zip(AXES, fit.orders, fit.coefficients, strict=True):
        padded = [*factors, *[0.0] * (HIGHEST_ORDER - order)]
        row[f"order_{axis}"] = order
        row |= {f"coefficient_{axis}_{k + 1}": factor for k, factor in enumerate(padded)}
    for axis, *values in _measured(fit):
        row |= {name.format(axis): v for name, v in zip(MEASURES, values, strict=True)}
    return row


def _fit(row: dict[Any, Any]) -> Fit:
    """Return the fit that a row of the table stands for."""

    def three(name: str) -> Any:
        return tuple(row[name.format(axis)] for axis in AXES)

    orders = three("order_{}")
    factors = tuple(
        tuple(row[f"coefficient_{axis}_{k}"] for k in range(1, order + 1))
        for axis, order in zip(AXES, orders, strict=True)
    )
    return Fit(
        three("exit_{}"),
        row["t0_s"],
        row["t0_at_bound"],
        (row["t0_earliest_s"], row["t0_latest_s"]),
        orders,
        factors,
        row["first_s"],
        row["last_s"],
        row["points"],
        *(three(name) for name in MEASURES),
    )
