"""Flights inside the kiln, coloured by fraction: a picture from the side, and a view that turns.

Places are in the kiln's coordinates: metres from the lance towards the camera, across as the
camera sees it, and up from the axis.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.figure import Figure

from kilnflight.experiments.campaigns import Measurement, campaign_keys, fits_from_lance
from kilnflight.project.style import COLOURS, PAGE_MM, canvas
from kilnflight.twin.camera import Geometry
from kilnflight.twin.fitted import second_kiln
from kilnflight.twin.flight import Flights

Array = npt.NDArray[np.float64]
PLOTLY = "application/vnd.plotly.v1+json"  # Jupyter draws it, and so does the site
PLACES = ["from_lance_m", "across_m", "up_m"]
LABELS = ("from the lance (m)", "across (m)", "above the kiln's axis (m)")
SAMPLES = 30  # of a flight that is drawn
RINGS = 48  # corners of the circle that stands for the kiln's cross-section
GREY, DARK = "#999999", "#444444"


def within(path_m: Array, geometry: Geometry) -> Array:
    """Return a path (n, 3) up to where it first leaves the kiln, or has no place."""
    along, across, up = path_m.T
    inside = np.hypot(across, up) <= geometry.kiln_radius_mm / 1000.0
    inside &= (geometry.inlet_m <= along) & (along <= geometry.outlet_m)
    return path_m[: len(path_m) if inside.all() else int(np.argmin(inside))]


def fitted_paths(tables: Measurement, bar: float, most: int) -> dict[str, list[Array]]:
    """Return the first trajectories from the lance of each fraction, places (n, 3)."""
    keys = [key for key in campaign_keys(tables.flights) if key[1] == bar]
    found, geometry = {}, second_kiln().geometry
    for key in keys:
        fits, _ = fits_from_lance(tables, key, most)
        times = [np.linspace(fit.t0, fit.last_s, SAMPLES) for fit in fits.values()]
        paths = [fit(time) for fit, time in zip(fits.values(), times, strict=True)]
        found[key[0]] = [geometry.to_kiln(path) for path in paths]
    return found


def simulated_paths(flown: Mapping[str, Flights], most: int) -> dict[str, list[Array]]:
    """Return the first simulated flights of each fraction, places (n, 3)."""
    found = {}
    for name, flights in flown.items():
        paths = [path[np.isfinite(path).all(axis=1)] for path in flights.position_m[:most]]
        steps = [np.linspace(0, len(path) - 1, SAMPLES).round().astype(int) for path in paths]
        found[name] = [
            path[step].astype(np.float64) for path, step in zip(paths, steps, strict=True)
        ]
    return found


@dataclass(frozen=True)
class Inside:
    """Flights inside the kiln.

    Parameters
    ----------
    paths
        By fraction, places (n, 3) in m; what leaves the kiln is not drawn.
    mark
        What the data are, in a word inside the picture.
    geometry, elevation_deg
        Of kiln and lance; by default those of the second look.
    """

    paths: Mapping[str, list[Array]]
    mark: str
    geometry: Geometry = field(default_factory=lambda: second_kiln().geometry)
    elevation_deg: float = field(default_factory=lambda: second_kiln().flight.launch_elevation_deg)

    def table(self) -> pd.DataFrame:
        """Return what is drawn: ``fraction``, ``flight`` from 1, and `PLACES`."""
        parts = [
            pd.DataFrame(np.round(within(path, self.geometry), 3), columns=PLACES).assign(
                fraction=name, flight=number
            )
            for name, paths in self.paths.items()
            for number, path in enumerate(paths, 1)
        ]
        empty = pd.DataFrame(columns=["fraction", "flight", *PLACES])
        return pd.concat([empty, *parts], ignore_index=True) if parts else empty

    def picture(self) -> Figure:
        """Draw the flights from the side, the camera at the left, and as the camera looks."""
        picture, grid = canvas(1, 2, width_mm=PAGE_MM, height_mm=62, width_ratios=(2.4, 1))
        table = self.table()
        for axes, columns in zip(grid[0], (PLACES[::2], PLACES[1:]), strict=True):
            for line in self.outline():
                drawn = pd.DataFrame(line, columns=PLACES)[columns].to_numpy().T
                axes.plot(*drawn, color=GREY, lw=0.6, ls="-", zorder=1)
            for k, name in enumerate(self.paths):
                ways = gaps(table[table["fraction"] == name])[columns].to_numpy(np.float64).T
                axes.plot(*ways, color=COLOURS[1 + k], lw=0.5, ls="-", label=name)
            lance = self.lance()[:, [PLACES.index(column) for column in columns]].T
            axes.plot(*lance, color=DARK, lw=2.2, ls="-", marker="o", ms=2.5)
            axes.set(xlabel=LABELS[PLACES.index(columns[0])], ylabel=LABELS[2])
        side, along = grid[0]
        side.invert_xaxis()
        side.set_title("from the side; the camera is at the left")
        along.set(title="as the camera looks", aspect="equal", ylabel="")
        legend = picture.legend(
            *side.get_legend_handles_labels(), loc="outside lower left", ncols=4
        )
        for handle in legend.get_lines():
            handle.set_linewidth(2)
        return picture

    def outline(self) -> list[Array]:
        """Return the kiln's edges: circles at inlet and outlet, and lines along it."""
        radius = self.geometry.kiln_radius_mm / 1000.0
        ends = (self.geometry.inlet_m, self.geometry.outlet_m)
        turn = np.linspace(0.0, 2.0 * np.pi, RINGS + 1)
        ring = radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        rings = [np.column_stack([np.full(RINGS + 1, end), ring]) for end in ends]
        return [
            *rings,
            *(np.stack(pair) for pair in zip(*(each[:-1:12] for each in rings), strict=True)),
        ]

    def lance(self) -> Array:
        """Return both ends of the lance, (2, 3), from the inlet plate to its outlet."""
        exit_m, rise = self.geometry.lance_m, np.tan(np.deg2rad(self.elevation_deg))
        behind = self.geometry.inlet_m - exit_m[0]
        return np.stack([exit_m + behind * np.array([1.0, 0.0, rise]), exit_m])

    def _repr_mimebundle_(self, **_: Any) -> dict[str, Any]:
        """Return the view that turns, as plotly reads it."""
        return {PLOTLY: self.view(), "text/plain": "flights inside the kiln, to be turned"}

    def view(self) -> dict[str, Any]:
        """Return lines and layout of a view that turns; a click in its legend hides a fraction."""
        table = self.table()
        still = {"showlegend": False, "hoverinfo": "skip"}
        edges = pd.concat([gaps(pd.DataFrame(line, columns=PLACES)) for line in self.outline()])
        lance = pd.DataFrame(self.lance(), columns=PLACES)
        lines = [
            _line(edges, GREY, 2, **still),
            _line(lance, DARK, 10, name="lance", hoverinfo="name", showlegend=False),
        ]
        for k, name in enumerate(self.paths):
            ways = gaps(table[table["fraction"] == name])
            lines.append(_line(ways, COLOURS[1 + k], 3, name=name, hoverinfo="name"))
        axes = {
            f"{axis}axis": {"title": {"text": label}, "nticks": 5}
            for axis, label in zip("xyz", LABELS, strict=True)
        }
        # At +y one sees the camera's end of the kiln, where x grows, at the left.
        camera = {"eye": {"x": 0.3, "y": 2.3, "z": 0.45}, "center": {"x": 0, "y": 0, "z": -0.1}}
        aspect = {"aspectmode": "manual", "aspectratio": {"x": 2.4, "y": 0.8, "z": 0.8}}
        scene = axes | aspect | {"camera": camera, "dragmode": "turntable"}
        word = {
            "text": self.mark,
            "xref": "paper",
            "yref": "paper",
            "x": 0,
            "y": 1,
            "showarrow": False,
        }
        layout = {
            "scene": scene, "margin": {"l": 0, "r": 0, "b": 0, "t": 0},
            "legend": {"orientation": "h", "x": 0, "y": 0}, "annotations": [word],
        }  # fmt: skip
        return {
            "data": lines,
            "layout": layout,
            "config": {"responsive": True, "displaylogo": False},
        }


def gaps(table: pd.DataFrame) -> pd.DataFrame:
    """Return places with an empty row after each flight, which breaks the line."""
    if "flight" not in table:
        table = table.assign(flight=1)
    rows = [
        pd.concat([each[PLACES], each[PLACES].tail(1) * np.nan])
        for _, each in table.groupby("flight")
    ]
    return pd.concat(rows) if rows else table[PLACES]


def _line(table: pd.DataFrame, colour: str, width: float, **words: Any) -> dict[str, Any]:
    places = {
        axis: [None if np.isnan(value) else round(float(value), 3) for value in table[column]]
        for axis, column in zip("xyz", PLACES, strict=True)
    }
    return {
        "type": "scatter3d",
        "mode": "lines",
        **places,
        "line": {"color": colour, "width": width},
    } | words
