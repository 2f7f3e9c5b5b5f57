"""Whole pictures of the flights of campaigns, after Figs 5.18 to 5.26."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from kilnflight.experiments.accuracy import CASES, REPLACED_STEPS
from kilnflight.experiments.campaigns import (
    KEYS,
    CampaignKey,
    Measurement,
    fits_from_lance,
    of_campaign,
)
from kilnflight.experiments.confidence import Values
from kilnflight.experiments.plots import (
    draw_dwell_time,
    draw_from_the_side,
    draw_grouped_boxes,
    draw_published,
    draw_space_slices,
    examples,
)
from kilnflight.experiments.space import draw_curves, draw_flown_paths
from kilnflight.flight import kept
from kilnflight.project.style import (
    COLOURS,
    HATCHES,
    LINES,
    MARKERS,
    PAGE_MM,
    PUBLISHED,
    PUBLISHED_BAR,
    canvas,
    draw_boxes,
)
from kilnflight.regression import fits
from kilnflight.scores.flights import METRES, box, ignition_histogram
from kilnflight.twin.flight import ENDS, Flights
from kilnflight.twin.particles import FRACTIONS

Array = npt.NDArray[np.float64]
TOPS = {"velocity": 18.0, "remaining": 105.0}  # of the axes: m/s above all true medians, %
ALL = 0.95  # s: where the share that ignites at any time is drawn
LABELS = {"velocity": "median velocity (m/s)", "remaining": "remaining particles (%)"}


def draw_longest_slices(tables: Measurement) -> tuple[Figure, pd.DataFrame, str]:
    """Draw the space slices of the flight detected over most metres.

    Its slices and its name come with the picture.

    An empty picture if no metre was passed.
    """
    picture, grid = canvas(1, 1, width_mm=PAGE_MM, height_mm=75)
    front = tables.slices[tables.slices["slice_m"] > 0]
    lengths = front.groupby([*KEYS, "particle"])["observed"].agg(["sum", "size"]).reset_index()
    longest = lengths.sort_values(["sum", "size"], kind="stable").tail(1)
    if longest.empty:
        return picture, front.head(0), "flight (no metre was passed)"
    fraction, bar, particle = longest[[*KEYS, "particle"]].iloc[0]
    trajectory, flight, passed = _of_particle(tables[1:], (fraction, bar), particle)
    draw_space_slices(grid[0, 0], fits(trajectory)[particle], passed, flight["end_s"].iloc[0])
    grid[0, 0].legend(*grid[0, 0].get_legend_handles_labels(), loc="upper left")
    return picture, passed, f"{fraction} at {bar} bar"


def _of_particle(
    tables: Iterable[pd.DataFrame], key: CampaignKey, particle: int
) -> list[pd.DataFrame]:
    """Return the rows of a particle of a campaign in each table."""
    parts = [of_campaign(table, key) for table in tables]
    return [part[part["particle"] == particle].drop(columns=KEYS) for part in parts]


def draw_velocity_boxes(
    sources: Mapping[str, Values],
    keys: Sequence[CampaignKey],
    bounds: pd.DataFrame | None = None,
) -> Figure:
    """Draw box plots of the velocity within each metre, a panel for each campaign.

    Parameters
    ----------
    sources
        Results of the campaigns by their source, such as "true" and "measured".
    keys
        The campaigns, two a row.
    bounds
        Published bounds with ``outcome``, ``low``, ``high`` beside fraction and pressure.
    """
    rows = max(-(-len(keys) // 2), 1)
    size: dict[str, Any] = {"width_mm": PAGE_MM, "height_mm": 55 * rows}
    picture, grid = canvas(rows, 2, **size, sharex=True, sharey=True)
    metres = [f"{metre - 1}-{metre} m" for metre in METRES]
    for axes, key in zip(grid.flat, keys, strict=False):
        groups = {name: list(values[key].velocity_m_s.T) for name, values in sources.items()}
        draw_grouped_boxes(axes, groups, metres)
        axes.set(title=f"{key[0]}, {key[1]} bar", ylim=(-2, 25))  # numbers below 0
        if bounds is not None:
            at = bounds["outcome"].str.extract(r"velocity (\d)")[0].astype(float)
            draw_published(axes, of_campaign(bounds.assign(at=at).dropna(subset="at"), key))
    for axes in grid[:, 0]:
        axes.set_ylabel("velocity in depth (m/s)")
    grid[0, 0].legend(*grid[0, 0].get_legend_handles_labels())
    return picture


def draw_dwell_boxes(sources: Mapping[str, Values], keys: Sequence[CampaignKey]) -> Figure:
    """Draw box plots of dwell times by fraction, a panel for each pressure that was measured.

    Parameters
    ----------
    sources
        By their names; of complete flights.
    keys
        The campaigns.
    """
    names, bars = list(dict.fromkeys(name for name, _ in keys)), sorted({bar for _, bar in keys})
    picture, grid = canvas(1, len(bars), width_mm=PAGE_MM, height_mm=80, sharey=True)
    for axes, bar in zip(grid[0], bars, strict=True):
        groups = {
            source: [values[name, bar].dwell_s for name in names]
            for source, values in sources.items()
        }
        draw_grouped_boxes(axes, groups, names)
        if bar == 4.5:
            axes.axhspan(0.3, 0.5, color=PUBLISHED["color"], alpha=0.15, label="published medians")
        axes.set(title=f"{bar} bar", ylim=(-0.1, 1.5))
        _say_if_empty(axes, sum(len(each) for group in groups.values() for each in group))
    grid[0, 0].set_ylabel("dwell time (s)")
    picture.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return picture


def _say_if_empty(axes: Axes, number: int) -> None:
    """Write into a panel without flights that there are none."""
    if not number:
        text = "no complete flight in these frames"
        axes.text(0.5, 0.85, text, transform=axes.transAxes, ha="center", color="0.3")


def draw_still_flying(curves: pd.DataFrame, keys: Sequence[CampaignKey]) -> Figure:
    """Draw the share that still flies by time: a column per fraction, a row per pressure.

    The orange bar marks where the text has all medians at 4.5 bar.

    Parameters
    ----------
    curves
        `kilnflight.experiments.dwell.curves`; the last source has its interval shaded.
    keys
        The campaigns.
    """
    names, bars = list(dict.fromkeys(name for name, _ in keys)), sorted({bar for _, bar in keys})
    sources = list(dict.fromkeys(curves["source"]))
    size: dict[str, Any] = {"width_mm": PAGE_MM, "height_mm": 20 + 42 * len(bars)}
    picture, grid = canvas(len(bars), len(names), **size, sharex=True, sharey=True)
    for axes, (bar, name) in zip(grid.flat, product(bars, names), strict=True):
        rows = of_campaign(curves, (name, bar)).set_index("source")
        for k, source in enumerate(sources):
            part = rows[rows.index == source]
            look = {"color": COLOURS[k], "ls": (":", "--", "-")[k], "lw": 1.1}
            axes.step(part["time_s"], part["flying"], where="post", label=source, **look)
        if sources:
            part = part.dropna()
            shade = {"color": COLOURS[len(sources) - 1], "alpha": 0.2, "lw": 0, "step": "post"}
            axes.fill_between(part["time_s"], part["low"], part["high"], **shade)
        if bar == 4.5:
            axes.hlines(0.5, 0.3, 0.5, **{**PUBLISHED_BAR, "label": "published medians"})
        axes.set(title=f"{name}, {bar} bar", xlim=(0, 1.2), ylim=(0, 1.03))
        _say_if_empty(axes, len(rows))
    for axes in grid[:, 0]:
        axes.set_ylabel("share still flying")
    for axes in grid[-1]:
        axes.set_xlabel("time from the lance (s)")
    picture.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return picture


def draw_dwell_cases(tables: Measurement) -> tuple[Figure, pd.DataFrame]:
    """Draw the cases of Fig. 5.18 on measured `examples`; return their flights too."""
    picture, grid = canvas(1, 3, width_mm=PAGE_MM, height_mm=62, sharey=True)
    flights = examples(kept(tables.flights))
    handles: dict[str, Artist] = {}
    for axes, letter, case in zip(grid[0], "abc", CASES, strict=True):
        title = f"({letter}) {case}"
        if case in flights:
            flight = flights[case]
            key = flight["fraction"], flight["pressure_bar"]
            track, trajectory = _of_particle(tables[:2], key, flight["particle"])
            draw_dwell_time(axes, fits(trajectory)[flight["particle"]], flight, track)
            title += f": {key[0]}, {key[1]} bar"
        axes.set(title=title if case in flights else f"{title}: none measured")
        handles |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    for axes in grid[0, 1:]:
        axes.set_ylabel("")
    picture.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=6)
    columns = [*KEYS, "particle", "t0_s", "ignition_s", "end_s", "dwell_s", "ending"]
    return picture, pd.DataFrame(list(flights.values()), columns=columns)


def draw_ignition_bars(
    kinds: Mapping[str, Values], keys: Sequence[CampaignKey], printed: pd.DataFrame
) -> tuple[Figure, pd.DataFrame]:
    """Draw histograms of ignition times in steps of 0.1 s, a panel for each campaign.

    Parameters
    ----------
    kinds
        Values of the campaigns by their kind, side by side.
    keys
        The campaigns, two a row.
    printed
        `kilnflight.experiments.statements.statements`, for the share within 0.1 s.
    """
    picture, grid = canvas(2, 2, width_mm=PAGE_MM, height_mm=110, sharex=True)
    bounds = printed.assign(
        at=printed["outcome"].map({"ignited < 0.1 s (%)": 0.05, "ignited (%)": ALL})
    )
    width, tables = 0.09 / len(kinds), {}
    for axes, key in zip(grid.flat, keys, strict=False):
        for k, (kind, values) in enumerate(kinds.items()):
            bins = tables[kind, *key] = ignition_histogram(values[key].ignition_s)
            look = {"hatch": HATCHES[k], "color": ("white", "0.7", COLOURS[6])[k]}
            at = np.array([*bins["from_s"] + 0.05, ALL]) + width * (k - (len(kinds) - 1) / 2)
            heights = [*bins["percent"], bins["percent"].sum()]
            axes.bar(at, heights, width, ec="black", lw=0.5, label=kind, **look)
        draw_published(axes, of_campaign(bounds.dropna(subset="at"), key))
        axes.set(title=f"{key[0]}, {key[1]} bar", ylabel="% of all particles")
    for axes in grid[1]:
        axes.set_xlabel("time from the lance (s)")
        axes.set_xticks([0, 0.2, 0.4, 0.6, 0.75, ALL], ["0", "0.2", "0.4", "0.6", "later", "any"])
    grid[0, 0].legend(*grid[0, 0].get_legend_handles_labels())
    return picture, pd.concat(tables, names=["kind", *KEYS]).reset_index(["kind", *KEYS])


def draw_budget_steps(budget: pd.DataFrame) -> Figure:
    """Draw bias and spread of the `accuracy.error_budget`, means over both pressures."""
    names = budget["fraction"].unique()
    labels = {"dwell_s": "dwell time (s)", "velocity_m_s": "velocity 0-1 m (m/s)"}
    labels |= {"ignition_s": "ignition time (s)"}
    picture, grid = canvas(3, 1, width_mm=PAGE_MM, height_mm=150, sharex=True)
    groups = budget.groupby(["replaced_step", "fraction"])
    for axes, (quantity, label) in zip(grid[:, 0], labels.items(), strict=True):
        bias, spread = (
            groups[f"{quantity}_{kind}"].mean().unstack() for kind in ("bias", "spread")
        )
        for k, step in enumerate(REPLACED_STEPS):
            place = np.arange(len(names)) + 0.11 * (k - 3.5)
            look = {"color": [*COLOURS, "0.5"][k], "marker": [*MARKERS, "*"][k], "ms": 3}
            axes.errorbar(
                place, bias.loc[step], yerr=spread.loc[step], ls="", lw=0.8, label=step, **look
            )
        axes.axhline(0, color="0.6", lw=0.6, ls="-")
        axes.set(ylabel=label, xticks=range(len(names)), xticklabels=names)
    picture.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return picture


def draw_measures_by_order(by_order: pd.DataFrame) -> Figure:
    """Draw the four measures of fits over the order, a line for each axis.

    Fig. 4.23 of the thesis.
    """
    picture, grid = canvas(2, 2, width_mm=PAGE_MM, height_mm=100, sharex=True)
    titles = {"rmse_mm": "RMSE (mm)", "mape_percent": "MAPE (%)"}
    titles |= {"r2": "R²", "r2_adjusted": "adjusted R²"}
    for axes, (name, title) in zip(grid.flat, titles.items(), strict=True):
        for k, (axis, part) in enumerate(by_order.groupby("axis")):
            axes.plot(part["order"], part[name], ls=LINES[k], marker=MARKERS[k], label=axis)
        axes.set(ylabel=title, yscale="log" if name == "rmse_mm" else "linear")
    for axes in grid[1]:
        axes.set_xlabel("order of the polynomials")
    grid[1, 0].sharey(grid[1, 1])
    grid[0, 0].yaxis.set_major_formatter("{x:g}")
    grid[0, 0].legend(*grid[0, 0].get_legend_handles_labels(), title="axis")
    return picture


def draw_fits_in_space(
    tables: Measurement, keys: Sequence[CampaignKey], most: int
) -> tuple[Figure, pd.DataFrame]:
    """Draw the first trajectories of some campaigns in space, and their detections.

    Above with the detections as lines, below as points by grey value.
    """
    picture = plt.figure(figsize=(PAGE_MM / 25.4, 110 / 25.4), layout="none")
    picture.subplots_adjust(-0.05, 0.05, 0.97, 0.97, wspace=0.0, hspace=0.12)
    parts = [tables.tracks.head(0)]
    for k, key in enumerate(keys):
        fitted, tracks = fits_from_lance(tables, key, most)
        parts.append(tracks.sort_values("particle", kind="stable"))
        for row, gray in enumerate((False, True)):
            axes = picture.add_subplot(2, 2, 1 + k + 2 * row, projection="3d")
            each = [track for _, track in tracks.groupby("particle")]
            draw_curves(axes, list(fitted.values()), each, gray)
            axes.view_init(elev=15, azim=-65)
            title = "grey values" if gray else "detections (thin) and fits"
            axes.set_title(f"{key[0]}, {title}", y=0.98)
    columns = ["fraction", "particle", "frame", "x", "y", "z", "gray"]
    return picture, pd.concat(parts, ignore_index=True)[columns]


def draw_simulated_paths(
    flown: Mapping[str, Flights], values: Mapping[str, Array], most: int, label: str, bar: float
) -> Figure:
    """Draw simulated flights from the side, coloured by a value, panel by fraction."""
    picture, grid = canvas(2, 2, width_mm=PAGE_MM, height_mm=95, sharex=True, sharey=True)
    every = np.concatenate([each.ravel() for each in values.values()])
    limits = np.nanquantile(every, [0.05, 0.95])
    for axes, name in zip(grid.flat, flown, strict=False):
        lines = draw_from_the_side(axes, flown[name], values[name], limits, most)
        axes.set_title(f"{name}, {bar} bar")
        axes.label_outer()
    picture.colorbar(lines, ax=grid, label=label, extend="both")
    return picture


def draw_simulated_in_space(
    flown: Mapping[str, Flights], most: int, bar: float
) -> tuple[Figure, pd.DataFrame]:
    """Draw simulated flights of the first and third fraction in space (Fig. A.5).

    How many of all ``particles`` of each ``fraction`` have which ``end`` comes with the picture.
    """
    picture = plt.figure(figsize=(PAGE_MM / 25.4, 70 / 25.4))
    for k, name in enumerate(list(flown)[::2][:2]):
        axes = picture.add_subplot(1, 2, k + 1, projection="3d")
        draw_flown_paths(axes, flown[name], most)
        axes.set_title(f"{name}, {bar} bar")
    ends = [
        (name, ENDS[end], count)
        for name, each in flown.items()
        for end, count in zip(*np.unique(each.end, return_counts=True), strict=True)
    ]
    return picture, pd.DataFrame(ends, columns=["fraction", "end", "particles"])


def simulated_ends(flown: Mapping[str, Flights], most: int) -> pd.DataFrame:
    """Return when (s) and how far along the kiln from the lance (m) the first flights end.

    By fraction. Negative: gas that goes back drew the particle behind the lance's mouth.
    """
    parts = {
        name: pd.DataFrame({"end_s": each.end_s, "along_kiln_m": each.end_position_m[:, 0]})[:most]
        for name, each in flown.items()
    }
    return pd.concat(parts, names=["fraction", "flight"]).reset_index()


def simulated_velocities(simulated: Values, most: int) -> pd.DataFrame:
    """Return the velocity in each metre (Eq. 5.8) of the first flights of each fraction."""
    parts = {
        name: pd.DataFrame(each.velocity_m_s[:most], columns=METRES)
        for (name, _), each in simulated.items()
    }
    table = pd.concat(parts, names=["fraction", "flight"]).reset_index()
    names = {"var_name": "metre", "value_name": "velocity_m_s"}
    long = table.melt(["fraction", "flight"], **names, ignore_index=False)
    return long.sort_index(kind="stable")


def draw_dwell_by_source(sources: Mapping[str, Values]) -> tuple[Figure, pd.DataFrame]:
    """Draw dwell times by fraction and source; return the numbers of the boxes, too."""
    keys = list(next(iter(sources.values())))
    rows = [
        {"source": source, "fraction": key[0]} | box(values[key].dwell_s)
        for source, values in sources.items()
        for key in keys
    ]
    return draw_dwell_boxes(sources, keys), pd.DataFrame(rows)


def draw_along_the_way(table: pd.DataFrame, versions: Sequence[str]) -> Figure:
    """Draw velocity and remaining share along the way, a row for each, by fraction.

    Parameters
    ----------
    table
        `kilnflight.experiments.statements.along_the_way`; published bounds become broad bars.
    versions
        First the dotted, then the solid version, then a dashed one, if any; no more are drawn.
    """
    names = [name for name in FRACTIONS if (table["fraction"] == name).any()]
    quantities = sorted(table["quantity"].unique(), reverse=True)
    size: dict[str, Any] = {"width_mm": PAGE_MM, "height_mm": 20 + 40 * len(quantities)}
    picture, grid = canvas(len(quantities), len(names), **size, sharex=True)
    for axes, (quantity, name) in zip(grid.flat, product(quantities, names), strict=True):
        top = TOPS[quantity]
        panel = table[(table["quantity"] == quantity) & (table["fraction"] == name)]
        axes.set(title=name, ylim=(0, top), xlim=(0, 5.3))
        looks = {4.5: ("black", "o", -0.08), 5.0: (COLOURS[6], "s", 0.08)}
        for bar, (colour, mark, aside) in looks.items():
            rows = panel[panel["pressure_bar"] == bar].set_index("version")
            for version, line in zip(versions, (":", "-", "--"), strict=False):
                part = rows[rows.index == version]
                look = {"label": f"{version}, {bar} bar", "color": colour, "ls": line}
                axes.plot(part["distance_m"], part["value"], marker=mark, lw=1, ms=2.5, **look)
            ends = rows[rows.index == "published"].fillna({"low": 0, "high": top})
            side = "left" if aside < 0 else "right"
            wide = {**PUBLISHED_BAR, "label": f"published, {bar} bar ({side})"}
            pad, at = 0.012 * top, ends["distance_m"] + aside
            axes.vlines(at, ends["low"] - pad, ends["high"] + pad, **wide)
    for panels, quantity in zip(grid, quantities, strict=True):
        panels[0].set_ylabel(LABELS[quantity])
    for axes in grid[-1]:
        axes.set_xlabel("from the lance (m)")
    picture.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return picture


def draw_true_dwell(table: pd.DataFrame) -> Figure:
    """Draw dwell times as boxes: rows are ``version``, columns pressures."""
    versions = table["version"].unique()
    size: dict[str, Any] = {"width_mm": PAGE_MM, "height_mm": 55 * len(versions)}
    picture, grid = canvas(len(versions), 2, **size, sharey=True)
    for panels, version in zip(grid, versions, strict=True):
        panels[0].set_ylabel("dwell time (s)")
        for axes, bar in zip(panels, (4.5, 5.0), strict=True):
            rows = table[(table["version"] == version) & (table["pressure_bar"] == bar)]
            if bar == 4.5:
                axes.axhspan(0.3, 0.5, color=PUBLISHED["color"], alpha=0.15)
            draw_boxes(axes, rows)
            names = list(rows["fraction"])
            axes.set(title=f"{version}, {bar} bar", xticks=range(len(names)), xticklabels=names)
    return picture


def draw_facts(table: pd.DataFrame, versions: Sequence[str]) -> Figure:
    """Draw which facts hold: a row for each campaign, a column for each fact, a mark by version.

    ``table`` is of `twin_statements.side_by_side`. Filled: all sentences hold; half: some; open
    and crossed: none. Of several sentences the numbers stand below.
    """
    keys = list(table[KEYS].drop_duplicates().itertuples(index=False, name=None))
    facts = list(table["fact"].drop_duplicates())
    picture, grid = canvas(1, 1, width_mm=PAGE_MM, height_mm=25 + 9 * len(keys))
    axes, across = grid[0, 0], 0.8 / len(versions)
    for k, version in enumerate(versions):
        look: dict[str, Any] = {"marker": MARKERS[k], "ms": 7, "mec": "black", "ls": "none"}
        look |= {"color": COLOURS[(2, 3, 5)[k % 3]], "markerfacecoloralt": "white"}
        axes.plot([], [], label=version, **look)
        known = table.dropna(subset=f"{version}_holds")
        held = known.groupby([*KEYS, "fact"])[f"{version}_holds"].agg(["sum", "size"]).astype(int)
        for (name, bar, fact), (good, size) in zip(held.index, held.to_numpy(), strict=True):
            x = facts.index(fact) + (k - (len(versions) - 1) / 2) * across
            y, some = keys.index((name, bar)), 0 < good < size
            fill = "left" if some else "full" if good else "none"
            axes.plot(x, y, fillstyle=fill, **look)
            if not good:
                axes.plot(x, y, "x", color="black", ms=4, mew=0.8)
            if size > 1:
                axes.annotate(f"{good}/{size}", (x, y + 0.42), ha="center", va="center", size=5)
    axes.set_xticks(range(len(facts)), facts)
    axes.set_yticks(range(len(keys)), [f"{name}, {bar} bar" for name, bar in keys])
    axes.set(xlim=(-0.5, len(facts) - 0.5), ylim=(len(keys) - 0.3, -0.5))
    axes.vlines(np.arange(1, len(facts)) - 0.5, -0.5, len(keys), color="0.8", lw=0.6, ls="-")
    axes.tick_params(length=0)
    picture.legend(loc="outside upper center", ncols=len(versions))
    return picture
