"""The belt experiment from tracks to deviations: the only place where it is written out.

tracks -> observe -> (count) -> compare the models -> one table per question
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
import pandas as pd
from tqdm import tqdm

from kilnflight.belt.dem import read_dem
from kilnflight.belt.deviation import Deviations, Evaluation, over_draws
from kilnflight.belt.friction import MATERIALS
from kilnflight.belt.phase import Observed, PredictionPhase

AUTHORS = "authors-dem"
OWN = "own-simulation"
DATA_SETS = tuple(MATERIALS)

Key = tuple[str, str]  # source, data set


def load_tracks(files: Mapping[str, Path], seed: int) -> dict[Key, pd.DataFrame]:
    """Return the tracks of every source and data set: what there is, and our simulation.

    Parameters
    ----------
    files
        The authors' files by data set, from `kilnflight.belt.dem.find_dem`; may be empty.
    seed
        Of our simulation.
    """
    tracks = {(AUTHORS, name): read_dem(files[name]) for name in DATA_SETS if name in files}
    for number, (name, simulation) in enumerate(MATERIALS.items()):
        tracks[OWN, name] = simulation(np.random.default_rng([seed, number]))
    return tracks


def count_particles(
    tracks: Mapping[Key, pd.DataFrame], observed: Mapping[Key, Observed]
) -> pd.DataFrame:
    """Return how many particles each data set has, how many count, and why others do not."""
    rows = []
    for (source, data_set), table in tracks.items():
        one = observed[source, data_set]
        seen = table["particle"].nunique()
        listed = table.attrs.get("particles", seen)
        reasons = {"never on the belt": listed - seen, **one.left_out}
        row = {"source": source, "data_set": data_set, "particles": listed}
        rows.append({**row, "evaluated": len(one.last), **reasons})
    return pd.DataFrame(rows)


def compare(
    observed: Mapping[Key, Observed],
    phase: PredictionPhase,
    evaluation: Evaluation,
    deviations: Deviations,
    seed: int,
) -> pd.DataFrame:
    """Return the deviations of every model on every data set, one row per draw.

    Returns
    -------
    DataFrame
        Columns ``source``, ``data_set``, and those of `Evaluation`.
    """
    parts = []
    for (source, data_set), one in tqdm(observed.items(), desc="data sets", disable=None):
        draws = evaluation(one, phase, deviations, seed)
        draws.insert(0, "source", source)
        draws.insert(1, "data_set", data_set)
        parts.append(draws)
    return pd.concat(parts, ignore_index=True)


def vary_target(
    tracks: Mapping[Key, pd.DataFrame],
    targets_mm: Iterable[float],
    evaluation: Evaluation,
    deviations: Deviations,
    seed: int,
) -> pd.DataFrame:
    """Return the deviations for several targets, the length of the phase kept.

    Where the target lies is our choice (the public tracks end at the belt's edge); what a
    verdict owes to it shows here.

    Returns
    -------
    DataFrame
        ``target_mm`` and the columns of `kilnflight.belt.deviation.over_draws`.
    """
    length = PredictionPhase().target_mm - PredictionPhase().start_mm
    parts = []
    for target in targets_mm:
        phase = PredictionPhase(target - length, target)
        observed = {key: phase.observe(one) for key, one in tracks.items()}
        table = over_draws(compare(observed, phase, evaluation, deviations, seed))
        table.insert(0, "target_mm", target)
        parts.append(table)
    return pd.concat(parts, ignore_index=True)
