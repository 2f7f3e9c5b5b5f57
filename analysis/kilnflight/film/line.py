"""A sorter's belt of one's own: from a table of particles to predictions and hits.

spots -> tracks of the whole belt -> calibration with the first particles -> sorter,
frame by frame, that sees the belt up to where the prediction begins -> hits

Where the camera does not see the valves, there is nothing to calibrate with or to
compare with, and predictions are those of a saved calibration or of constant velocity.
"""

import tomllib
import warnings
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from pandas import DataFrame, Series
from pandas.util import hash_pandas_object

from kilnflight.arrays import Facts, Tables
from kilnflight.belt.camera import Area
from kilnflight.belt.models import (
    ARRIVAL_MODELS,
    BELT_EDGE_MM,
    BELT_START_MM,
    BELT_VELOCITY_MM_S,
    BELT_WIDTH_MM,
    IA,
    LATERAL_MODELS,
    Predictor,
    Ratio,
)
from kilnflight.belt.online import ValveSchedule, sort_spots
from kilnflight.belt.tracker import Appearance, BeltTracker, constant_velocity
from kilnflight.belt.valves import ValveBar
from kilnflight.checks import (
    Count,
    InputError,
    Number,
    Positive,
    Settings,
    check_columns,
    check_finite,
    check_number,
    check_whole,
)
from kilnflight.film.pictures import png
from kilnflight.film.report import Printed
from kilnflight.publication import style
from kilnflight.recording.frames import count_frames
from kilnflight.recording.track_files import csv_of, read_columns
from kilnflight.store.results import claimed, publish
from kilnflight.tables import BELT_ARRIVAL

LEAST_CALIBRATING = 10  # fewer do not give a median
SIZE_S = 0.001  # that a particle takes, in windows by deviations; choice
JUDGED = [
    ("time_s", "arrived_s", "time_sd_s"),
    ("y_mm", "arrived_y_mm", "y_sd_mm"),
]
CALIBRATING = 40  # particles: 37 to 44 in the 2020 paper, section 5
WRITTEN = (
    "tracks.parquet",
    "predictions.parquet",
    "hits.csv",
    "summary.csv",
    "calibration.toml",
    "arrivals.png",
)
MODELS: Facts = {"arrival": ARRIVAL_MODELS, "lateral": LATERAL_MODELS}


class Line(Settings):
    """A belt and its camera.

    Parameters
    ----------
    start_mm, until_mm, valves_mm
        Places x along the belt: where particles come into view, where the prediction
        begins, and the valves.
    width_mm
        Limit of y, across the belt, from 0.
    belt_mm_s
        Velocity of the belt.
    mm_per_px
        Millimetres in a unit of x and y: 1 if they are in mm.
    rate_hz
        Frames per second; None: as the time stamps say.
    spread_mm
        Standard deviation of a measured place.
    acceleration_mm_s2
        How fast velocities change: `kilnflight.belt.tracker.constant_velocity`.
    windows_ms
        Times that a valve is open.
    valves
        Their number over the width.
    """

    start_mm: Number = BELT_START_MM
    until_mm: Number = BELT_EDGE_MM - 150.0
    valves_mm: Number = BELT_EDGE_MM
    width_mm: Positive = BELT_WIDTH_MM
    belt_mm_s: Positive = BELT_VELOCITY_MM_S
    mm_per_px: Positive = 1.0
    rate_hz: Positive | None = None
    spread_mm: Positive = 0.127
    acceleration_mm_s2: Positive = 5000.0
    windows_ms: tuple[Positive, ...] = (2.0, 5.0, 10.0)
    valves: Count = 32

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (self.start_mm < self.until_mm < self.valves_mm and self.windows_ms):
            raise InputError(
                f"start, until, valves must ascend, with a window at least: {self}."
            )

    def tracker(self, end_mm: float, frame_s: float) -> BeltTracker:
        """Return the tracker of the belt up to x = ``end_mm``."""
        area = Area(self.start_mm, end_mm, self.width_mm)
        appearance = Appearance(area, entry_mm=self.belt_mm_s * frame_s)
        motion = constant_velocity(
            self.spread_mm, self.acceleration_mm_s2, self.belt_mm_s
        )
        return BeltTracker(motion, appearance, frame_s)

    def measured(self, spots: DataFrame) -> tuple[DataFrame, float, float]:
        """Return frame, x, y (mm), class of each particle, and two times in s.

        They are those from frame to frame, and of frame 0.

        Parameters
        ----------
        spots
            ``time_s``, or ``frame`` with `rate_hz`; ``x``, ``y``; perhaps ``class``.

        Raises
        ------
        InputError
            If a column is missing, a time stamp or class is no number, or there is one
            frame only. Particles without a place are left out.
        """
        clock = "frame" if self.rate_hz else "time_s"
        check_columns(spots, [clock, "x", "y"], "spots (frame: with rate_hz)")
        stamps = check_finite(spots[clock], f"spots: column {clock}")
        rate_hz = self.rate_hz or 1.0
        frames, _ = count_frames(stamps)
        table = DataFrame({"frame": frames})
        table["frame"] -= table["frame"].min()
        last = table["frame"].max()
        check_number(last, "spots: frames after the first", least=1)
        spots = DataFrame({"class": -1}, spots.index).assign(**spots)
        table["class"] = check_whole(spots["class"].fillna(-1), "spots: class")
        for name in ("x", "y"):
            table[name] = check_finite(spots[name], f"spots: {name}", gaps=True)
        table[["x", "y"]] *= self.mm_per_px
        kept = table.dropna().drop_duplicates(["frame", "x", "y"])
        if len(kept) < len(table):
            warnings.warn(
                f"{len(table) - len(kept)} of {len(table)} particles have no place, or "
                "that of another. They are left out.",
                stacklevel=2,
            )
        table = kept.sort_values("frame", kind="stable", ignore_index=True)
        frame_s = float(np.ptp(stamps)) / last / rate_hz
        return table, frame_s, float(stamps.min()) / rate_hz


_LINE = Line()


def predict_line(
    spots: DataFrame, line: Line, predictor: Predictor | None = None
) -> tuple[dict[str, DataFrame], Predictor]:
    """Track particles on a belt, predict their arrivals and count hits.

    Parameters
    ----------
    spots
        As for `Line.measured`.
    line
        Belt and camera.
    predictor
        Calibrated models; None: IA and Ratio, calibrated with the first particles that
        are seen up to the valves.

    Returns
    -------
    tables, predictor
        ``tracks``: `kilnflight.tables.BELT_STATES` of the whole belt. ``predictions``:
        particle, time_s, y_mm, time_sd_s, y_sd_mm, class, as a sorter knows them;
        arrived_s, arrived_y_mm, as the camera saw them; calibrates, 1 or 0. ``hits``:
        class that is blown out, window_ms (0: by two standard deviations), particles of
        that class that arrive and do not calibrate, hit_percent of them, wrong_percent
        of those of other classes; air_ms for each that is blown out. And the models.

    Warns
    -----
    UserWarning
        What `kilnflight.belt.watch` finds; if nothing calibrates.
    """
    table, frame_s, start_s = line.measured(spots)
    end_mm = max(line.valves_mm, table["x"].max())
    followed = line.tracker(end_mm, frame_s)(table[["frame", "x", "y"]])
    last, arrival = _observed(followed.states, table, line, frame_s)
    first = last["time_s"].rank(method="first") <= CALIBRATING
    if predictor is None:
        predictor = Predictor(target_mm=line.valves_mm)
        if first.sum() >= LEAST_CALIBRATING:
            models = replace(predictor, arrival=IA(), lateral=Ratio())
            predictor = models.calibrated(last[first], arrival[first])
        else:
            warnings.warn(
                f"{first.sum()} particles are seen up to the valves: constant "
                "velocity, not calibrated",
                stacklevel=2,
            )
    if predictor.target_mm != line.valves_mm:
        raise InputError(
            f"calibration: its valves are at {predictor.target_mm} mm, the line's at "
            f"{line.valves_mm}. Give that place, or calibrate."
        )
    predicted = _sorted(table, predictor, line.tracker(line.until_mm, frame_s))
    of_row = followed.states[followed.states["row"] >= 0].set_index("row")["particle"]
    start = table["frame"].searchsorted(predicted["frame"])
    predicted["particle"] = of_row.reindex(start + predicted["row"]).to_numpy()
    arrival = arrival.rename(columns={"time_s": "arrived_s", "y": "arrived_y_mm"})
    arrived = arrival.assign(calibrates=first.astype(int))
    arrived = arrived.drop(columns="velocity_y_mm_s")
    predictions = predicted[
        ["particle", "time_s", "y", "time_sd_s", "y_sd_mm", "class"]
    ].merge(arrived, "left", "particle")
    predictions[["time_s", "arrived_s"]] += start_s
    tables = {
        "tracks": followed.states,
        "predictions": predictions.rename(columns={"y": "y_mm"}),
        "hits": _hits(predictions, line),
    }
    return tables, predictor


def _sorted(table: DataFrame, predictor: Predictor, tracker: BeltTracker) -> DataFrame:
    """Return what a sorter predicts that gets a table frame by frame."""
    rows: Any = table.groupby("frame")[["x", "y", "class"]]
    frames = ((number, places.to_numpy(float)) for number, places in rows)
    bar = ValveBar(belt_mm=tracker.appearance.area.width_mm)
    # As a clock, float stands still: it returns 0.0.
    sorter = sort_spots(frames, predictor, ValveSchedule(bar), tracker, clock=float)
    predicted = pd.concat([DataFrame(each.predicted) for each in sorter])
    if predicted.empty:
        raise InputError(
            "spots: no particle is followed to the prediction. Look at unit, axes and "
            "times."
        )
    return predicted


def _observed(
    states: DataFrame, table: DataFrame, line: Line, frame_s: float
) -> tuple[DataFrame, DataFrame]:
    """Return the last states before the prediction, and the arrivals, of particles.

    A particle that is seen within a frame's way of the valves arrives by its velocity
    from there.
    """
    seen = states[(states["row"] >= 0) & (states["valid"] == 1)]
    seen = seen.assign(time_s=frame_s * seen["frame"])
    x, y = table[["x", "y"]].to_numpy()[seen["row"]].T
    last = seen[x < line.until_mm].drop_duplicates("particle", keep="last")
    away = line.valves_mm - x
    wait = away / seen["velocity_x_mm_s"]
    arrival = seen.assign(
        time_s=seen["time_s"] + wait,
        y=y + wait * seen["velocity_y_mm_s"],
        away=np.abs(away),
    )
    arrival = arrival[arrival["away"] <= line.belt_mm_s * frame_s]
    arrival = arrival.sort_values("away", kind="stable").drop_duplicates("particle")
    last = last.merge(arrival[["particle"]])
    return last, last[["particle"]].merge(arrival[BELT_ARRIVAL.names])


def _hits(predicted: DataFrame, line: Line) -> DataFrame:
    """Return the shares that are hit and the air used, by class and window."""
    judged = predicted["calibrates"] == 0
    bar = ValveBar(line.valves, line.width_mm)
    bars = {ms: replace(bar, open_s=ms / 1000.0) for ms in line.windows_ms}
    bars = {0.0: replace(bar, open_s=SIZE_S, deviations=2.0)} | bars
    kinds = sorted(set(predicted["class"]))
    arrived = predicted[["arrived_s", "arrived_y_mm"]].to_numpy().T
    rows = []
    for kind, (window_ms, each) in product(kinds, bars.items()):
        chosen = predicted["class"] == kind
        events = each.events(predicted[chosen])
        hit = Series(each.hits(events, *arrived))
        rows.append(
            {
                "class": kind,
                "window_ms": window_ms,
                "particles": (judged & chosen).sum(),
                "hit_percent": 100.0 * hit[judged & chosen].mean(),
                "wrong_percent": 100.0 * hit[judged & ~chosen].mean(),
                "air_ms": 1000.0 * (events[2] - events[1]).sum() / chosen.sum(),
            }
        )
    return DataFrame(rows)


def calibration_text(predictor: Predictor) -> bytes:
    """Return a calibration as TOML; models that have none are refused."""
    stated: Facts = dict(vars(predictor))
    for kind in MODELS:
        model = stated[kind]
        model.check_calibrated()
        stated |= {kind: f'"{model.name}"', **vars(model)}
    lines = [f"{name} = {value}\n" for name, value in stated.items()]
    return "".join(lines).encode()


def read_calibration(path: Path | str) -> Predictor:
    """Read a calibration.toml; an `InputError` if it is something else."""
    try:
        given = tomllib.loads(Path(path).read_text("utf-8"))
        for kind, models in MODELS.items():
            model = {model.name: model for model in models}[given[kind]]
            own = {name: given.pop(name) for name in vars(model)}
            given[kind] = replace(model, **own)
        return Predictor(**given)
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{path}: no calibration ({error}). Calibrate again."
        ) from error


def plot_arrivals(predictions: DataFrame) -> Figure:
    """Draw how far the predicted times are from the arrivals."""
    figure, ((axes,),) = style.canvas(width_mm=style.PAGE_MM)
    seen = predictions[predictions["calibrates"] == 0]
    late_ms = 1000.0 * (seen["time_s"] - seen["arrived_s"])
    axes.plot(seen["arrived_s"], late_ms, ".")
    axes.set(xlabel="time of arrival (s)", ylabel="predicted - observed time (ms)")
    return figure


def run_belt(
    source: DataFrame | Path | str,
    target: Path | str,
    line: Line = _LINE,
    calibration: Path | str | None = None,
) -> Tables:
    """Run `predict_line` on a table, print what was found and write all tables.

    Parameters
    ----------
    source
        Table, or its CSV or Parquet file.
    target
        Folder of tracks.parquet, predictions.parquet, hits.csv, summary.csv,
        arrivals.png and calibration.toml.
    line
        Belt and camera.
    calibration
        File of a calibration; None: the first particles calibrate.

    Returns
    -------
    dict
        Tables by name.

    Raises
    ------
    InputError
        If something cannot be read or written, or the table does not fit.
    """
    target = Path(target)
    spots = source
    if not isinstance(spots, DataFrame):
        spots = read_columns(Path(spots), "time_s or frame, x, y")
    predictor = read_calibration(calibration) if calibration else None
    rows = hash_pandas_object(spots, index=False)
    with claimed(target, WRITTEN, f"{rows.sum():x}"):
        tables, predictor = predict_line(spots, line, predictor)
    found = _summary(tables, predictor)
    tables["summary"] = DataFrame(found.items(), columns=["what", "value"])
    contents = {
        "calibration.toml": calibration_text(predictor),
        "arrivals.png": png(plot_arrivals(tables["predictions"])),
    }
    for name in ("tracks", "predictions"):
        content = tables[name].to_parquet(index=False, write_page_checksum=True)
        contents[f"{name}.parquet"] = content
    for name in ("hits", "summary"):
        contents[f"{name}.csv"] = csv_of(tables[name]).encode()
    publish(contents.items(), target, WRITTEN)
    Printed().extend([*found.items(), ("written to", f"{target}")])
    print(tables["hits"].round(1).to_string(index=False))
    return tables


def _summary(tables: Tables, predictor: Predictor) -> Facts:
    """Return what was found."""
    predictions = tables["predictions"]
    found: Facts = {
        "predictions": len(predictions),
        "of these seen at the valves": predictions["arrived_s"].count(),
        "models": f"{predictor.arrival}, {predictor.lateral}",
    }
    seen = predictions[predictions["calibrates"] == 0]
    for name, true, spread in JUDGED:
        off = (seen[name] - seen[true]).abs()
        found[f"{name}, half within"] = f"{off.median():.3g}"
        within = (off < 2 * seen[spread]).mean()
        found[f"{name}, in 2 deviations"] = f"{100 * within:.0f} %"
    return found
