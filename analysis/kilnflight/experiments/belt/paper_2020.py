"""Compare the models of the 2020 paper on tracks, and their differences with chance.

tracks -> `PHASE.observe` -> `compare_models` -> `compare_orders` -> `holds`, a claim's
answer

The paper prints no numbers and names no measure. "Worst because of its bias" asks for
the mean absolute error (MAE), the boxes of Figs 9 and 10 show the interquartile range
(IQR). So an order of models holds if both measures show it beyond chance, and fails if
both contradict it.
"""

from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from pandas import DataFrame, Series
from scipy.interpolate import CubicSpline

from kilnflight.arrays import Array, Tables, Texts
from kilnflight.belt.models import BELT_VELOCITY_MM_S
from kilnflight.belt.phase import (
    SUMMARY,
    Deviations,
    Observed,
    PredictionPhase,
    draw_particles,
    evaluate,
)
from kilnflight.belt.recordings import list_recordings, read_dem
from kilnflight.checks import InputError
from kilnflight.publication import claims, data, style
from kilnflight.simulated.belt.friction import MATERIALS
from kilnflight.store import paths

# Sources of tracks, and the first line of a page on each.
AUTHORS = "authors-dem"
OWN = "own-simulation"
INPUT = {
    AUTHORS: "**Input**: the authors' simulated (DEM) tracks at 100 Hz.",
    OWN: "**Own simulation**, a friction model: the authors' tracks are not here "
    "(`make data`).",
}
DATA_SETS = tuple(MATERIALS)
# Draws of calibration particles, replicates of the bootstrap, and the number of
# particles that enter first, of each material (none given: all), by scale.
CALIBRATION_DRAWS = {"quick": 5, "standard": 50, "full": 1000}
REPLICATES = {"quick": 100, "standard": 400, "full": 1000}
PARTICLES = {"quick": 1000}
_CALIBRATIONS = 20  # draws that the replicates of a bootstrap share
PHASE = PredictionPhase()
FAST_HZ = 1000.0  # rate of the paper's own tracks (section 5)
JITTER_MM = 2e-5  # less than the last digit of the public tracks; choice B3
_MEASURES = {"MAE": "mae", "IQR": "iqr"}
_IN_UNITS = "median|q25|q75|iqr|mae|whisker|excess"  # columns in ms or mm begin so

Sets = Mapping[str, Observed]  # last observations and arrivals by data set
# Models that should deviate less, and models that should deviate more, by claim.
Orders = Mapping[str, Sequence[tuple[Texts, Texts]]]


def find_dem() -> dict[str, Path]:
    """Return the authors' DEM file of each material, empty if none was fetched.

    Returns
    -------
    dict
        Path by material: spheres, cuboids, cylinders; checksums are verified.

    Raises
    ------
    InputError
        If a file is damaged, or some but not all are there.
    """
    files = {name: data.find(file) for name, file in data.BELT_DEM.items()}
    there = {name: path for name, path in files.items() if path is not None}
    if there and len(there) < len(files):
        missing = ", ".join(sorted(set(files) - set(there)))
        raise InputError(
            f"the authors' DEM tracks of {missing} are missing; run make data."
        )
    return there


def find_recordings() -> dict[str, list[Path]]:
    """Return the files of measured positions by material, empty if there are none.

    The folder is ``KILNFLIGHT_RECORDINGS``, else ``belt_recordings`` beside the
    authors' other data. Files in the latter must be the published ones (SHA-256), as
    ``make data`` puts them.

    Raises
    ------
    InputError
        If the folder of the variable has none, or a file beside the authors' other data
        is not the published one.
    """
    folder = paths.recordings()
    published = paths.external() / data.RECORDINGS_FOLDER
    files = list_recordings(folder)
    if folder != published and not files:
        raise InputError(f"KILNFLIGHT_RECORDINGS is {folder}, which has no recording.")
    if folder == published:
        for name in data.RECORDINGS:
            for path in (published.parent / name, published.parent / f"{name}.gz"):
                if path.is_file():
                    data.check(path, name)
    return files


def load_tracks(files: Mapping[str, Path], seed: int, particles: int | None) -> Tables:
    """Return the tracks by material, the authors' or the friction model's.

    Parameters
    ----------
    files
        The authors' files by material, from `find_dem`; empty: the friction model
        (`kilnflight.simulated.belt.friction`) takes their place.
    seed
        Seed of the friction model.
    particles
        Number of particles of each material, the first to enter; None: all.

    Returns
    -------
    dict
        `kilnflight.tables.BELT_TRACKS` at 100 Hz by material.
    """
    tracks = {}
    for number, (name, friction) in enumerate(MATERIALS.items()):
        if files:
            tracks[name] = read_dem(files[name])
        else:
            generator = np.random.default_rng([seed, number])
            tracks[name] = friction(generator)
        if particles is not None:
            tracks[name] = first_to_enter(tracks[name], particles)
    return tracks


def first_to_enter(tracks: DataFrame, particles: int) -> DataFrame:
    """Return the tracks of the first ``particles`` that enter, of one material."""
    entered = tracks.groupby("particle")["frame"].min().sort_values(kind="stable")
    first = tracks["particle"].isin(entered.index[:particles])
    return tracks[first].reset_index(drop=True)


def resample(tracks: DataFrame, rate_hz: float) -> DataFrame:
    """Return tracks at another sampling rate, by a cubic spline per particle.

    The authors evaluated at 1000 Hz and published their tracks at 100 Hz. The camera of
    the 2016 paper needs 200 frames/s. A spline adds no motion between the published
    positions.

    Parameters
    ----------
    tracks
        `kilnflight.tables.BELT_TRACKS` without gaps, which would be interpolated; at
        least two positions per particle.
    rate_hz
        Frames per second of the result; frame 0 is at 0 s.

    Returns
    -------
    DataFrame
        `kilnflight.tables.BELT_TRACKS`, each particle from its first to its last
        position.
    """
    table = tracks.sort_values(["particle", "frame"], kind="stable")
    columns = table[["time_s", "x", "y"]].to_numpy(float)
    particles, starts = np.unique(table["particle"].to_numpy(), return_index=True)
    frames = []
    places = []
    for part in np.split(columns, starts[1:]):
        time = part[:, 0]
        first = np.ceil(time[0] * rate_hz - 1e-6)
        last = np.floor(time[-1] * rate_hz + 1e-6)
        frames.append(np.arange(first, last + 1, dtype=np.int64))
        places.append(CubicSpline(time, part[:, 1:])(frames[-1] / rate_hz))
    table = DataFrame({"frame": np.concatenate(frames)})
    table["particle"] = np.repeat(particles, list(map(len, frames)))
    table["time_s"] = table["frame"] / rate_hz
    table[["x", "y"]] = np.concatenate(places)
    return table


def resample_observed(tracks: Tables, observed: Sets) -> Tables:
    """Return the tracks of observed particles at the paper's 1000 Hz, by data set."""
    fast = {}
    for name, table in tracks.items():
        kept = table["particle"].isin(observed[name].last["particle"])
        fast[name] = resample(table[kept], FAST_HZ)
    return fast


def shake(tracks: Tables, seed: int) -> Tables:
    """Return tracks by data set with normal noise of `JITTER_MM` on each position."""
    generator = np.random.default_rng(seed)
    shaken = {}
    for name, table in tracks.items():
        noise = generator.normal(0.0, JITTER_MM, (len(table), 2))
        shaken[name] = table.assign(**(table[["x", "y"]] + noise))
    return shaken


def step_velocities(tracks: DataFrame) -> DataFrame:
    """Return velocities between consecutive frames, one row per pair, in mm/s.

    Figs 7 and 8 of the 2020 paper show them along the belt.

    Parameters
    ----------
    tracks
        `kilnflight.tables.BELT_TRACKS`. Index labels must be unique, since columns are
        joined by them.

    Returns
    -------
    DataFrame
        ``particle``; ``x``, the midpoint of both positions in mm; ``velocity_x_mm_s``,
        ``velocity_y_mm_s``. Pairs across a gap in the frames are left out.
    """
    table = tracks.sort_values(["particle", "frame"], kind="stable")
    step = table.diff()
    velocity = step[["x", "y"]].div(step["time_s"], axis=0).add_prefix("velocity_")
    middle = table[["particle"]].assign(x=table["x"] - step["x"] / 2)
    steps = middle.join(velocity.add_suffix("_mm_s"))
    return steps[(step["particle"] == 0) & (step["frame"] == 1)].reset_index(drop=True)


def velocities_at(steps: DataFrame, column: str, x_mm: Array) -> Array:
    """Return velocities (particles, places) in mm/s at places along the belt.

    ``column`` of ``steps`` (from `step_velocities`) is interpolated linearly at
    ``x_mm`` (places,), NaN outside a particle's positions (section 4.1). The x of a
    particle must ascend. The mean over particles is the curve of Fig. 7.
    """
    rows = [
        np.interp(x_mm, track["x"], track[column], left=np.nan, right=np.nan)
        for _, track in steps.groupby("particle", sort=False)
    ]
    return np.array(rows, float)


def compare_models(
    observed: Sets,
    phase: PredictionPhase,
    deviations: Deviations,
    draws: int,
    seed: int,
) -> DataFrame:
    """Return the deviations of all models, one row per data set and model.

    Figs 9 and 10 of the 2020 paper show them as boxes.

    Parameters
    ----------
    observed
        Last observations and arrivals by data set, from `PredictionPhase.observe`.
    phase
        Start and target of the prediction.
    deviations
        `kilnflight.belt.phase.arrival_deviations` (ms) or `lateral_deviations` (mm).
    draws, seed
        Number and seed of the draws of calibration particles.

    Returns
    -------
    DataFrame
        ``data_set``, ``model`` and `kilnflight.belt.phase.SUMMARY` in ms or mm, medians
        over the draws. 95 % of the draws lie between ``iqr_low`` and ``iqr_high``,
        ``mae_low`` and ``mae_high``.
    """
    parts = {
        name: evaluate(part, phase, deviations, draws, seed)
        for name, part in observed.items()
    }
    every = pd.concat(parts, names=["data_set"])
    grouped = every.groupby(["data_set", "model"], sort=False)
    table = grouped[SUMMARY].median().astype({"n": int, "unpredicted": int})
    for end, share in (("low", 0.025), ("high", 0.975)):
        table[[f"iqr_{end}", f"mae_{end}"]] = grouped[["iqr", "mae"]].quantile(share)
    return table.reset_index()


def beyond_belt(observed: Sets, phase: PredictionPhase) -> Series:
    """Return the share in percent that CA predicts to be faster than the belt.

    At the last observation or at the target of ``phase`` (Eq. 5); a Series by data set.
    """
    shares = {}
    for name, each in observed.items():
        speed = each.last["velocity_x_mm_s"]
        gain = each.last["acceleration_x_mm_s2"]
        square = speed**2 + 2 * gain * (phase.target_mm - each.last["x"])
        fastest = np.maximum(speed, np.sqrt(square.clip(lower=0.0)))
        shares[name] = 100 * (fastest > BELT_VELOCITY_MM_S).mean()
    return Series(shares)


def with_unit(table: DataFrame, unit: str) -> DataFrame:
    """Return a table with ``unit`` (ms or mm) added to names of deviations."""
    named = table.columns[table.columns.str.match(_IN_UNITS)]
    return table.rename(columns={name: f"{name}_{unit}" for name in named})


def compare_orders(
    observed: Sets,
    phase: PredictionPhase,
    deviations: Deviations,
    orders: Mapping[str, Orders],
    scale: str,
    seed: int,
) -> DataFrame:
    """Return by how much models deviate more than others, with 95 % intervals.

    Intervals are over particles (bootstrap). `holds` reads the answers to the 2020
    paper's claims from this table.

    Parameters
    ----------
    observed, phase, deviations, seed
        As in `compare_models`.
    orders
        By data set, then by id of a claim: pairs of models that should deviate less
        and models that should deviate more.
    scale
        "quick", "standard" or "full"; sets `CALIBRATION_DRAWS` and `REPLICATES`.

    Returns
    -------
    DataFrame
        One row per order and measure: ``id``, ``data_set``, ``measure`` (MAE or IQR),
        ``lower`` and ``higher`` (names of models, joined by spaces); ``excess``, the
        smallest deviation of ``higher`` minus the largest of ``lower`` in ms or mm,
        with its ends ``excess_low`` and ``excess_high``.
    """
    rows = []
    draws = min(CALIBRATION_DRAWS[scale], _CALIBRATIONS)
    for data_set, part in observed.items():
        table = compare_models({data_set: part}, phase, deviations, draws, seed)
        table = table.set_index("model")
        samples = bootstrap(part, phase, deviations, REPLICATES[scale], seed)
        for claim, pairs in orders[data_set].items():
            for (lower, higher), (measure, column) in product(pairs, _MEASURES.items()):
                sample = _excess(samples[measure], lower, higher)
                low, high = sample.quantile([0.025, 0.975]).round(12)
                rows.append(
                    {
                        "id": claim,
                        "data_set": data_set,
                        "measure": measure,
                        "lower": " ".join(lower),
                        "higher": " ".join(higher),
                        "excess": _excess(table[[column]].T, lower, higher).item(),
                        "excess_low": low,
                        "excess_high": high,
                    }
                )
    return DataFrame(rows)


def _excess(deviations: DataFrame, lower: Texts, higher: Texts) -> Series:
    """Return the smallest of ``higher`` minus the largest of ``lower``, by row.

    ``deviations`` has a column per model.
    """
    return deviations[[*higher]].min(axis=1) - deviations[[*lower]].max(axis=1)


def bootstrap(
    observed: Observed,
    phase: PredictionPhase,
    deviations: Deviations,
    replicates: int,
    seed: int,
) -> Tables:
    """Return MAE and IQR of all models in bootstrap replicates over particles.

    Models are calibrated with 1 % of the particles (section 5), in up to
    `_CALIBRATIONS` draws. Each replicate takes one calibration and draws the other
    particles with replacement. They are the same for all models, so differences between
    models are paired.

    Returns
    -------
    dict
        "MAE" and "IQR": (replicates, models) in the unit of ``deviations``, a column
        per model.
    """
    generator = np.random.default_rng(seed)
    count = len(observed.last)
    draws = []
    for _ in range(min(_CALIBRATIONS, replicates)):
        calibration = draw_particles(count, max(1, count // 100), generator)
        draws.append(dict(deviations(observed, phase, calibration)))
    values = [np.column_stack(list(draw.values())) for draw in draws]
    samples = []
    for replicate in range(replicates):
        of_draw = values[replicate % len(draws)]
        drawn = of_draw[generator.integers(0, len(of_draw), len(of_draw))]
        quantile = np.quantile
        # NumPy takes all columns at once if none holds NaN, which is much faster.
        if np.isnan(drawn).any():
            quantile = np.nanquantile
        spread = np.subtract(*quantile(drawn, [0.75, 0.25], axis=0))
        samples.append([np.nanmean(np.abs(drawn), axis=0), spread])
    by_measure = zip(_MEASURES, np.stack(samples, axis=1), strict=True)
    return {
        name: DataFrame(sample, columns=list(draws[0])) for name, sample in by_measure
    }


def holds(
    pairs: DataFrame, claim: str, by: Iterable[str] = ("MAE", "IQR")
) -> list[bool | None]:
    """Return whether each order of a claim holds, one answer per data set and order.

    Parameters
    ----------
    pairs
        From `compare_orders`; its rows give the sequence of the answers.
    claim
        Id of the claim.
    by
        Measures that must agree.

    Returns
    -------
    list
        True if the 95 % intervals of all measures lie above 0, False if all lie below
        0, else None.
    """
    chosen = pairs[(pairs["id"] == claim) & pairs["measure"].isin(by)]
    orders = chosen.groupby(["data_set", "lower", "higher"], sort=False)
    ends = orders.agg({"excess_low": "min", "excess_high": "max"})
    return [claims.beyond(low, high) for low, high in ends.to_numpy()]


def draw_deviations(
    summaries: DataFrame,
    rows: str,
    labels: Mapping[str, str],
    height_mm: float,
    rotation: float,
) -> Figure:
    """Draw box plots of deviations by model, after Figs 9 and 10 of the 2020 paper.

    Parameters
    ----------
    summaries
        From `compare_models`, with the column ``rows``; a box per row.
    rows
        Column whose values are the rows of panels; ``data_set`` gives the columns of
        panels.
    labels
        Label of the vertical axis by value of that column.
    height_mm
        Height of the figure.
    rotation
        Angle of the models' names in degrees.
    """
    sets = summaries["data_set"].unique()
    picture, grid = style.canvas(
        len(labels), len(sets), width_mm=style.PAGE_MM, height_mm=height_mm
    )
    for panels, (row, label) in zip(grid, labels.items(), strict=True):
        of_row = summaries[summaries[rows] == row]
        for axes, data_set in zip(panels, sets, strict=True):
            chosen = of_row[of_row["data_set"] == data_set]
            axes.axhline(0, color="0.6", lw=0.6, ls="-")
            style.draw_boxes(axes, chosen)
            axes.set_xticks(range(len(chosen)), chosen["model"], rotation=rotation)
            axes.set(title=data_set)
        panels[0].set_ylabel(label)
    return picture
