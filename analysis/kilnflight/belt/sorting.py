"""What each model makes of a bar of valves: hits and inadvertent ones, by valves, width, time."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pandas as pd

from kilnflight.belt import COMBINATIONS, lateral
from kilnflight.belt.arrival import CVBC, IV
from kilnflight.belt.deviation import predictions
from kilnflight.belt.phase import Observed, PredictionPhase
from kilnflight.belt.separation import ValveBar
from kilnflight.checks import InputError, check_between

# Beside those of Fig. 10: the old, implicit model of a line-scan camera, the same velocity for
# all and straight; and constant velocity without its bias, which Fig. 10 needs not, but a valve.
MODELS = (
    ("IV-Straight", IV(), lateral.Straight()),
    *COMBINATIONS,
    ("CVBC-CV", CVBC(), lateral.CV()),
)


def shares(
    observed: Observed,
    phase: PredictionPhase,
    bars: Iterable[ValveBar],
    seed: int,
    wanted: float = 0.1,
    calibrating: float = 0.01,
) -> pd.DataFrame:
    """Return the share of hit particles and of inadvertent hits for each model and bar.

    Parameters
    ----------
    observed, phase
        From `PredictionPhase.observe`, and the phase itself; valves are at its target.
    bars
        Bars of valves to compare.
    seed
        Of the draw of who calibrates and who is to be blown out.
    wanted
        Share of the particles to be blown out; an assumption, since no paper sorts.
    calibrating
        Share that calibrates the models and is left out, 1 % as in the 2020 paper.

    Returns
    -------
    DataFrame
        ``model``, ``valves``, ``valve_mm`` (width of a jet), ``open_ms``, ``wanted`` and
        ``others`` (particles), ``hit_percent``, ``inadvertent_percent``.

    Raises
    ------
    InputError
        If there are too few particles for either share.
    """
    check_between(wanted, 0, 1, "shares: wanted")
    check_between(calibrating, 0, 1, "shares: calibrating")
    count, rng = len(observed.last), np.random.default_rng(seed)
    calibration = np.zeros(count, dtype=bool)
    calibration[rng.permutation(count)[: int(calibrating * count)]] = True
    others = int((~calibration).sum())
    chosen = np.zeros(others, dtype=bool)
    chosen[rng.permutation(others)[: int(wanted * others)]] = True
    if not (calibration.any() and chosen.any()):
        raise InputError(
            f"shares: of {count} particles {calibrating:.1%} calibrate and {wanted:.1%} of the "
            "rest are blown out; that is less than one. Give more particles or larger shares."
        )
    arrival = observed.arrival[~calibration]
    true = arrival["time_s"].to_numpy(), arrival["y"].to_numpy()
    rows, bars = [], list(bars)
    for name, time, y in predictions(observed, phase, calibration, MODELS):
        for bar in bars:
            blown = bar(chosen, (time, y), true)
            rows.append(
                {
                    "model": name,
                    "valves": bar.valves,
                    "valve_mm": bar.width_mm,
                    "open_ms": 1000 * bar.open_s,
                    "wanted": int(chosen.sum()),
                    "others": int((~chosen).sum()),
                    "hit_percent": 100 * blown.hit_share,
                    "inadvertent_percent": 100 * blown.inadvertent_share,
                }
            )
    return pd.DataFrame(rows)
