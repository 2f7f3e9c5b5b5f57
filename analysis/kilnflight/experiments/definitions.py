"""What is meant by dwell time and by space-sliced velocity, drawn on flights (Figs 5.18, 5.20)."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

from kilnflight.checks import InputError
from kilnflight.experiments.deviations import CASES
from kilnflight.flight import BURNT_OUT, LANDED
from kilnflight.ignition import NONE, SEEN
from kilnflight.project.style import COLOURS
from kilnflight.regression import Fit
from kilnflight.slicing import straight_on
from kilnflight.twin.flight import Flights

Array = npt.NDArray[np.float64]
MOMENTS = 60  # of a fitted curve
SUBSCRIPT = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
LANCE: dict[str, Any] = {"marker": "x", "color": COLOURS[1], "ms": 6, "mew": 1.6, "ls": ""}


def case_of(flight: Mapping[str, Any]) -> str | None:
    """Return which of `CASES` a row of `kilnflight.tables.FLIGHTS` is; None: none of them.

    Landed burning and burnt out are shown where ignition was seen, so that it can be drawn.
    """
    if flight["ending"] == LANDED:
        return {SEEN: CASES[1], NONE: CASES[0]}.get(flight["ignition"])
    return CASES[2] if flight["ending"] == BURNT_OUT and flight["ignition"] == SEEN else None


def examples(flights: pd.DataFrame) -> dict[str, dict[str, Any]]:
    """Return of each of `CASES` the flight from the lance with the median dwell time.

    Parameters
    ----------
    flights
        Of all campaigns (`kilnflight.experiments.campaigns.Measured`).

    Returns
    -------
    dict
        Rows of ``flights`` by case; of an even number the shorter of the two in the middle.
        A case that was not measured is missing.
    """
    there = flights[flights["from_lance"]].sort_values("dwell_s", kind="stable")
    found: dict[str, list[dict[str, Any]]] = {case: [] for case in CASES}
    for row in there.to_dict("records"):
        known = {str(name): value for name, value in row.items()}
        found.get(case_of(known) or "", []).append(known)
    return {case: rows[(len(rows) - 1) // 2] for case, rows in found.items() if rows}


def dwell(axes: Axes, fit: Fit, flight: Mapping[str, Any], track: pd.DataFrame) -> None:
    """Draw a flight from the side, from the lance to its end, thick where it burns.

    Past its last detection it flies straight on, as `kilnflight.landing` has it.

    Parameters
    ----------
    axes
        Where to.
    fit
        Its trajectory.
    flight
        Its row of `kilnflight.tables.FLIGHTS`.
    track
        Its detections, for those with depth: ``y``, ``z``.
    """
    known = track.dropna(subset=["y", "z"])
    seen = _from_the_lance(fit, known[["y", "z"]].to_numpy(np.float64))
    axes.plot(*seen.T, ".", color="0.65", ms=2, label="detections")
    lit = flight["t0_s"] + flight["ignition_s"]  # NaN: never
    parts = [(flight["t0_s"], np.fmin(lit, flight["end_s"]), "unlit", "black", 1.0)]
    if lit < flight["end_s"]:
        parts.append((lit, flight["end_s"], "burning", COLOURS[3], 2.6))
    for start, end, name, colour, width in parts:
        way = _from_the_lance(fit, straight_on(fit, np.linspace(start, end, MOMENTS))[:, 1:])
        axes.plot(*way.T, color=colour, lw=width, ls="-", label=name)
    axes.plot(0, 0, **LANCE, label="lance")
    mark = "s" if flight["ending"] == LANDED else "o"
    last = _from_the_lance(fit, straight_on(fit, flight["end_s"])[:, 1:])
    axes.plot(*last.T, mark, ms=5, mfc="white", color="black", label=f"end: {flight['ending']}")
    axes.set(xlabel="depth from the lance (m)", ylabel="height over it (m)")
    axes.text(
        *(0.03, 0.95, f"dwell time {flight['dwell_s']:.2f} s"),
        transform=axes.transAxes,
        va="top",
    )


def _from_the_lance(fit: Fit, places: Array) -> Array:
    """Return depth and height from the lance (n, 2) in m of y and z in mm."""
    down, depth = (places - np.array(fit.exit_point_mm)[1:]).T / 1000.0
    return np.column_stack([-depth, -down])


def slices(axes: Axes, fit: Fit, passed: pd.DataFrame, end_s: float) -> None:
    """Draw when a flight passes which metre, and the velocity between two of them (Eq. 5.8).

    Parameters
    ----------
    axes
        Where to.
    fit
        Its trajectory.
    passed
        Its rows of `kilnflight.tables.SLICES`.
    end_s
        End of the flight on the recording's clock.

    Raises
    ------
    InputError
        If a slice is missing among those in front of the lance.
    """
    front = passed[passed["slice_m"] > 0].sort_values("slice_m")
    far = np.concatenate([[0.0], front["slice_m"].to_numpy(np.float64)])
    lengths = np.diff(far)
    if not len(lengths) or not np.allclose(lengths, lengths[0]):
        raise InputError("slices: not every slice up to the farthest; pass those of one flight.")
    time = np.concatenate([[0.0], np.cumsum(lengths / front["velocity_m_s"].to_numpy(np.float64))])
    moments = np.linspace(fit.t0_s, end_s, MOMENTS)
    depth = _from_the_lance(fit, straight_on(fit, moments)[:, 1:])[:, 0]
    axes.plot(moments - fit.t0_s, depth, color="black", lw=1.2, ls="-", label="trajectory")
    axes.plot(0, 0, **LANCE, label="lance", zorder=3)
    axes.plot(time[1:], far[1:], "o", ms=4, mfc="white", color="black", label="a metre is passed")
    for n, (before, after) in enumerate(pairwise(time), start=1):
        axes.vlines(after, 0, far[n], color="0.6", lw=0.6, ls=":")
        axes.hlines(far[n], 0, after, color="0.6", lw=0.6, ls=":")
        speed = lengths[n - 1] / (after - before)
        axes.annotate(
            f"V{str(n).translate(SUBSCRIPT)} = {speed:.1f} m/s",
            (after, (far[n - 1] + far[n]) / 2),
            xytext=(4, 0),
            textcoords="offset points",
            va="center",
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 1},
        )
    axes.set(xlabel="time from the lance (s)", ylabel="depth from the lance (m)")
    axes.margins(x=0.2)


def from_the_side(
    axes: Axes, flights: Flights, values: Array, limits: npt.ArrayLike, most: int
) -> LineCollection:
    """Draw simulated flights from the side, as dark as a value is low; return what is coloured.

    Parameters
    ----------
    axes
        Where to.
    flights
        Of one fraction.
    values
        (n,) one for each flight, or (n, samples).
    limits
        The two values that are darkest and brightest.
    most
        How many flights are drawn, the first ones.
    """
    paths = flights.position_m[:most, :, [0, 2]].astype(np.float64)
    every = np.broadcast_to(values[:most].reshape(len(paths), -1), paths.shape[:2])
    steps = np.stack([paths[:, :-1], paths[:, 1:]], axis=2)  # (n, samples - 1, 2, 2)
    there = np.isfinite(steps).all(axis=(2, 3))
    lines = LineCollection(list(steps[there]), cmap="viridis", linewidths=0.6, linestyles="-")
    lines.set_array(every[:, :-1][there])
    lines.set_clim(*np.asarray(limits, dtype=np.float64))
    axes.add_collection(lines)
    axes.autoscale_view()
    axes.set(xlabel="from the lance (m)", ylabel="above the kiln's axis (m)")
    return lines
