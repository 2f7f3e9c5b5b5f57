"""What a valve does for one particle, after Figs 4 and 5 of the 2020 paper.

Fig. 4 sketches eight nozzles: the right valve at the right time, a wrong valve, a wrong time. Fig.
5 sketches how the reference is made: a straight line between the last observation before the edge
and the first one after it. Both are drawn here from tracks. How long a valve is open is not
printed; it is ours.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from kilnflight.belt.evaluation import predictions
from kilnflight.belt.phase import Observed, PredictionPhase
from kilnflight.checks import InputError
from kilnflight.project.style import COLOURS, PAGE_MM, canvas

NOZZLES, WIDTH_MM = 8, 180.0  # Fig. 4; the belt's width, section 3
OPEN_MS = 4.0  # a sphere of 5 mm passes in 3.5 ms at 1.4 m/s; our choice
PANELS = {"optimal": "right valve and time", "Straight": "wrong valve", "CV-CV": "wrong time"}


def decisions(observed: Observed, phase: PredictionPhase, seed: int) -> pd.DataFrame:
    """Return what valves are told of one particle: optimally, by Straight and by CV-CV.

    The particle is the first whose valve Straight gets wrong and CV-CV right. Straight has no
    time of its own (section 4.2) and is given the true one, as in Fig. 4b.

    Returns
    -------
    DataFrame
        Index: the keys of `PANELS`. ``nozzle`` from 0, ``y_mm``, and ``opens_ms`` and
        ``closes_ms`` after the particle's true arrival.

    Raises
    ------
    InputError
        If there is no such particle.
    """
    count = len(observed.last)
    calibration = np.zeros(count, dtype=bool)
    size = max(1, count // 100)
    calibration[np.random.default_rng(seed).choice(count, size, replace=False)] = True
    arrival = observed.arrival[~calibration]
    told = {"optimal": (arrival["time_s"].to_numpy(), arrival["y"].to_numpy())}
    told |= {name: (t, y) for name, t, y in predictions(observed, phase, calibration)}
    nozzle = {name: np.floor(y / (WIDTH_MM / NOZZLES)) for name, (_, y) in told.items()}
    wrong = (nozzle["Straight"] != nozzle["optimal"]) & (nozzle["CV-CV"] == nozzle["optimal"])
    if not wrong.any():
        raise InputError("no particle for which Straight takes a wrong valve; use more particles.")
    one = int(np.argmax(wrong))
    rows = []
    for name in PANELS:
        given = "optimal" if name == "Straight" else name
        late_ms = 1000.0 * float(told[given][0][one] - told["optimal"][0][one])
        ends = (late_ms - OPEN_MS / 2, late_ms + OPEN_MS / 2)
        rows.append((name, int(nozzle[name][one]), float(told[name][1][one]), *ends))
    names = ["decision", "nozzle", "y_mm", "opens_ms", "closes_ms"]
    return pd.DataFrame(rows, columns=names).set_index("decision")


def draw_decisions(table: pd.DataFrame) -> Figure:
    """Draw the nozzles over time, the particle, and what each decision opens (Fig. 4)."""
    picture, (panels,) = canvas(1, len(PANELS), width_mm=PAGE_MM, height_mm=60, sharey=True)
    pitch, true = WIDTH_MM / NOZZLES, table.loc["optimal"]
    late = float(table["closes_ms"].max())
    for axes, (name, title) in zip(panels, PANELS.items(), strict=True):
        row = dict(table.loc[name])
        hatch = "" if name == "optimal" else "///"
        colour = COLOURS[2] if name == "optimal" else COLOURS[1]
        opens, closes, nozzle = (float(row[key]) for key in ("opens_ms", "closes_ms", "nozzle"))
        corner, duration = (opens, pitch * nozzle), closes - opens
        box = Rectangle(
            corner, duration, pitch, facecolor=colour, alpha=0.5, hatch=hatch, edgecolor="0.2"
        )
        axes.add_patch(box)
        for border in range(NOZZLES + 1):
            axes.axhline(pitch * border, color="0.7", lw=0.5, ls="-")
        axes.plot(0.0, true["y_mm"], "o", color="0.1", ms=5)
        near = table["nozzle"].to_numpy() * pitch
        axes.set(title=f"{title} ({name})", xlabel="time after the arrival (ms)")
        axes.set(ylim=(near.min() - pitch, near.max() + 2 * pitch), xlim=(-6, late + 3))
    panels[0].set_ylabel("y across the belt (mm)")
    panels[0].text(0.03, 0.93, "simulated", transform=panels[0].transAxes)
    return picture


def crossing(track: pd.DataFrame, target_mm: float) -> pd.DataFrame:
    """Return the observations around the target and the crossing between them (Fig. 5).

    Parameters
    ----------
    track
        Of one particle: ``x``, ``y`` (mm), ``time_s``, ascending in time.

    Returns
    -------
    DataFrame
        Index: ``before``, ``crossing``, ``after``; ``x_mm``, ``y_mm``, ``time_ms``.

    Raises
    ------
    InputError
        If the particle is not seen on both sides of the target.
    """
    before, after = track[track["x"] < target_mm].tail(1), track[track["x"] >= target_mm].head(1)
    if before.empty or after.empty:
        raise InputError(f"the particle is not seen on both sides of {target_mm:g} mm.")
    ends = pd.concat([before, after])[["x", "y", "time_s"]].to_numpy(np.float64)
    share = (target_mm - ends[0, 0]) / (ends[1, 0] - ends[0, 0])
    rows = np.stack([ends[0], ends[0] + share * (ends[1] - ends[0]), ends[1]])
    rows[:, 2] *= 1000.0
    names = pd.Index(["before", "crossing", "after"], name="point")
    return pd.DataFrame(rows, names, ["x_mm", "y_mm", "time_ms"])


def draw_crossing(points: pd.DataFrame, target_mm: float) -> Figure:
    """Draw both observations, the line between them and the crossing."""
    picture, ((axes,),) = canvas(width_mm=PAGE_MM / 2, height_mm=60)
    axes.axvline(target_mm, color="0.5", lw=1.0, ls="--", label="target")
    axes.plot(points["x_mm"], points["y_mm"], "-", color="0.4")
    looks = {"before": ("o", "0.6"), "after": ("o", "0.1"), "crossing": ("x", COLOURS[1])}
    for name, (mark, colour) in looks.items():
        row = points.loc[name]
        text = f"{name}, {row['time_ms'] - points['time_ms'].iloc[0]:.2f} ms"
        axes.plot(row["x_mm"], row["y_mm"], mark, color=colour, ms=7, label=text, ls="none")
    axes.set(xlabel="x along the belt (mm)", ylabel="y across the belt (mm)")
    axes.text(0.03, 0.05, "simulated", transform=axes.transAxes)
    axes.legend()
    return picture
