"""The experiment of the 2020 paper: from tracks to deviations to verdicts.

tracks -> observe -> (count) -> compare the models -> answers to the claims

Notebook 40 asks for the time of arrival, notebook 41 for the lateral position; both do the same.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from tqdm import tqdm

from kilnflight.belt import sorter
from kilnflight.belt.bodies import is_installed
from kilnflight.belt.evaluation import SUMMARY, Deviations, Evaluation, thinned
from kilnflight.belt.friction import MATERIALS
from kilnflight.belt.phase import Observed, PredictionPhase
from kilnflight.belt.recordings import read_dem
from kilnflight.belt.sorter import Sorter, calibrated_sorter
from kilnflight.project import claims

AUTHORS = "authors-dem"
OWN = "own-simulation"
DATA_SETS = tuple(MATERIALS)
# Particles of each material in the simulated sorter, by scale; None: as many as published.
PARTICLES: dict[str, int | None] = {"quick": 120, "standard": 300, "full": None}
# The paper's own place, 150 mm to the edge (sec. 5); for tracks that go on beyond it, as ours.
AT_EDGE = PredictionPhase(638.0, 788.0)

PLOTTED = ["IV", "CVBC", "CA", "CALV", "IA"]  # Fig. 9 leaves CV out for its bias

Key = tuple[str, str]  # source, data set
Answer = dict[str, bool] | pd.Series  # conditions for `kilnflight.project.claims.judge`


def load_tracks(
    files: Mapping[str, Path], seed: int, count: int | None = None, jobs: int = 1
) -> dict[Key, pd.DataFrame]:
    """Return the tracks of every source and data set: the available ones and our simulation.

    Our simulation is the sorter with contacts at 1000 Hz (`kilnflight.belt.sorter`)
    where MuJoCo is installed, otherwise the friction model at 100 Hz.

    Parameters
    ----------
    files
        The authors' files by data set, from `kilnflight.belt.recordings.find_dem`; may be empty.
    seed
        Of our simulation.
    count
        Particles of each material in the sorter with contacts; None: as published. The
        friction model costs next to nothing and always has as many as published.
    jobs
        Processes of the sorter with contacts.
    """
    tracks = {(AUTHORS, name): read_dem(files[name]) for name in DATA_SETS if name in files}
    contacts = is_installed()
    for number, (name, friction) in enumerate(MATERIALS.items()):
        if contacts:
            tracks[OWN, name] = sorter.tracks(name, count, seed, jobs)
        else:
            tracks[OWN, name] = friction(np.random.default_rng([seed, number]))
    return tracks


def describe_own() -> str:
    """Return in words what our simulation is here."""
    if is_installed():
        return "the sorter simulated with all contacts (MuJoCo) at 1000 Hz"
    return "our friction model at 100 Hz, which only assumes how each shape moves"


def describe_input(files: Mapping[str, Path]) -> str:
    """Return in Markdown which tracks decide: the authors' ``files``, or our simulation."""
    own = describe_own()
    if files:
        return f"**Input:** the authors' DEM tracks at 100 Hz decide; beside them stands {own}."
    return f"**Own simulation**, {own}. The authors' tracks are not here; `make data` gets them."


def variants(count: int | None, seed: int, jobs: int = 1) -> dict[Key, pd.DataFrame]:
    """Return our simulation before and after its free values were found, at 100 Hz.

    Returns
    -------
    dict
        Tracks by variant and data set: ``inputs only`` (spheres), ``calibrated`` (all; the
        values were found with spheres), ``along the belt`` (cylinders whose axes are within
        some 20 degrees of the belt's direction instead of any). Without MuJoCo the
        ``friction model`` alone.
    """
    if not is_installed():
        known = load_tracks({}, seed)
        return {("friction model", name): known[OWN, name] for name in DATA_SETS}
    fitted = calibrated_sorter()
    along = replace(fitted, slide=replace(fitted.slide, yaw_spread_deg=20.0))
    sorters: dict[Key, Sorter] = {("inputs only", "spheres"): Sorter()}
    sorters |= {("calibrated", name): fitted for name in DATA_SETS}
    sorters["along the belt", "cylinders"] = along
    return {
        key: thinned(sorter.tracks(key[1], count, seed, jobs, used), 10)
        for key, used in sorters.items()
    }


def misfits(profiles: pd.DataFrame, reference: str) -> pd.DataFrame:
    """Return how far velocity profiles are off, root mean square over the belt.

    Parameters
    ----------
    profiles
        ``variant``, ``data_set`` and the columns of `kilnflight.belt.evaluation.motion_profile`.
    reference
        The variant that the others are held against; without it the table is empty.
    """
    quantities = [name for name in profiles.columns if name.endswith("_m_s")]
    keys = ["data_set", "x_mm"]
    known = profiles.loc[profiles["variant"] == reference, keys + quantities]
    others = profiles[profiles["variant"] != reference]
    others = others.merge(known, on=keys, suffixes=("", "_reference"))
    off = others[["variant", "data_set"]].copy()
    for name in quantities:
        off[name] = (others[name] - others[f"{name}_reference"]) ** 2
    mean = off.groupby(["variant", "data_set"], sort=False)[quantities].mean()
    return mean.pow(0.5).reset_index()


def count_particles(
    tracks: Mapping[Key, pd.DataFrame], observed: Mapping[Key, Observed]
) -> pd.DataFrame:
    """Return how many particles each data set has, how many count, and why others do not."""
    rows = []
    for (source, data_set), table in tracks.items():
        part, visible = observed[source, data_set], table["particle"].nunique()
        listed = table.attrs.get("particles", visible)
        reasons = {"never on the belt": listed - visible, **part.left_out}
        row = {"source": source, "data_set": data_set, "particles": listed}
        rows.append({**row, "evaluated": len(part.last), **reasons})
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
    for (source, data_set), part in tqdm(observed.items(), desc="data sets", disable=None):
        draws = evaluation(part, phase, deviations, seed)
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
        ``target_mm`` and the columns of `over_draws`.
    """
    length = PredictionPhase().target_mm - PredictionPhase().start_mm
    parts = []
    for target in targets_mm:
        phase = PredictionPhase(target - length, target)
        observed = {key: phase.observe(table) for key, table in tracks.items()}
        table = over_draws(compare(observed, phase, evaluation, deviations, seed))
        table.insert(0, "target_mm", target)
        parts.append(table)
    return pd.concat(parts, ignore_index=True)


def vary_rate(
    tracks: Mapping[Key, pd.DataFrame],
    every: Iterable[int],
    evaluation: Evaluation,
    deviations: Deviations,
    seed: int,
    phase: PredictionPhase = AT_EDGE,
) -> pd.DataFrame:
    """Return the deviations for tracks of which only every n-th frame is kept.

    Only particles that are observed at every rate count, the same ones in the same draws: the
    slower the rate, the more have no observation between the edge and the end of the tracks.

    Returns
    -------
    DataFrame
        ``sampling_hz`` and the columns of `over_draws`.
    """
    slower = {n: {key: thinned(table, n) for key, table in tracks.items()} for n in every}
    observed = {
        n: {key: phase.observe(table) for key, table in tables.items()}
        for n, tables in slower.items()
    }
    parts = []
    for n, at_rate in observed.items():
        shared = {
            key: _only(part, [observed[other][key].last["particle"] for other in observed])
            for key, part in at_rate.items()
        }
        table = over_draws(compare(shared, phase, evaluation, deviations, seed))
        rates = {source: _rate(part) for (source, _), part in slower[n].items()}
        table.insert(0, "sampling_hz", table["source"].map(rates))
        parts.append(table)
    return pd.concat(parts, ignore_index=True)


def _only(observed: Observed, names: Iterable[pd.Series]) -> Observed:
    """Keep the particles that are in all series of names."""
    last = observed.last["particle"]
    kept = np.all([last.isin(known) for known in names], axis=0)
    left_out = {**observed.left_out, "not observed at every rate": int((~kept).sum())}
    return Observed(observed.last[kept], observed.arrival[kept], left_out)


def _rate(tracks: pd.DataFrame) -> float:
    """Return the frames per second of tracks."""
    later = tracks[tracks["frame"] > 0]
    return float(np.round((later["frame"] / later["time_s"]).median(), 6))


def over_draws(draws: pd.DataFrame) -> pd.DataFrame:
    """Return the median over the draws of every summary, one row per model.

    Columns other than ``draw`` and `SUMMARY` (model, data set, source) identify a row.
    """
    table = draws.groupby(_identity(draws), sort=False)[SUMMARY].median().reset_index()
    return table.astype({"n": int, "unpredicted": int})


def intervals(draws: pd.DataFrame, quantities: tuple[str, ...] = ("iqr", "mae")) -> pd.DataFrame:
    """Return between which values 95 % of the draws lie.

    Returns
    -------
    DataFrame
        What identifies a row, and for each quantity ``<quantity>_low``, ``<quantity>``
        (the median over the draws) and ``<quantity>_high``.
    """
    grouped = draws.groupby(_identity(draws), sort=False)
    parts = [
        grouped[name].quantile(share).rename(f"{name}{ending}")
        for name in quantities
        for share, ending in ((0.025, "_low"), (0.5, ""), (0.975, "_high"))
    ]
    return pd.concat(parts, axis=1).reset_index()


def _identity(draws: pd.DataFrame) -> list[str]:
    return [name for name in draws.columns if name != "draw" and name not in SUMMARY]


def verdicts_by_rate(
    rated: pd.DataFrame, answers: Callable[[pd.DataFrame], dict[str, Answer]]
) -> pd.DataFrame:
    """Return the verdicts on claims at each sampling rate, as a whole and by data set.

    Parameters
    ----------
    rated
        From `vary_rate`.
    answers
        `arrival_answers` or `lateral_answers`.

    Returns
    -------
    DataFrame
        ``id``, ``data_set`` ("all": as a whole), ``at_100_hz`` and so on, and whether the slowest
        ``differs`` from the fastest (yes, no).
    """
    rows = [
        {"id": claim, "data_set": name, "at": rate, "verdict": claims.judge(claim, part).verdict}
        for rate, table in rated.groupby("sampling_hz")
        for claim, answer in answers(table).items()
        for name, part in {"all": answer, **by_data_set(answer)}.items()
    ]
    wide = pd.DataFrame(rows).set_index(["id", "data_set", "at"])["verdict"].unstack()
    differs = np.where(wide.iloc[:, 0] != wide.iloc[:, -1], "yes", "no")
    return wide.rename(columns="at_{:g}_hz".format).assign(differs=differs).reset_index()


def describe_changes(rated: pd.DataFrame, verdicts: pd.DataFrame) -> str:
    """Return in words which verdicts of `verdicts_by_rate` the sampling rate changes."""
    slowest, fastest = rated["sampling_hz"].agg(["min", "max"])
    if slowest == fastest:
        return "One rate only, nothing to compare"
    changed = verdicts[verdicts["differs"] == "yes"]
    whole = changed.loc[changed["data_set"] == "all", "id"]
    parts = changed[changed["data_set"] != "all"]
    alone = [f"{row.id} for {row.data_set}" for row in parts.itertuples()]
    return (
        f"From {slowest:.0f} to {fastest:.0f} Hz {', '.join(whole) or 'no claim'} changes its "
        f"verdict on the own simulation, and of single data sets {', '.join(alone) or 'none'}"
    )


def verdicts_by_source(
    deviations: pd.DataFrame,
    rated: pd.DataFrame,
    answers: Callable[[pd.DataFrame], dict[str, Answer]],
) -> pd.DataFrame:
    """Return the verdicts on claims by other sources, and by our simulation at every rate.

    Parameters
    ----------
    deviations, rated
        From `over_draws` and from `vary_rate`.
    answers
        `arrival_answers` or `lateral_answers`.

    Returns
    -------
    DataFrame
        ``source``, ``sampling_hz``, ``id``, ``verdict``, ``measured``.
    """
    others = deviations[deviations["source"] != OWN].assign(sampling_hz=100.0)
    rows = []
    for parts in (others, rated[rated["source"] == OWN]):
        for (source, rate), table in parts.groupby(["source", "sampling_hz"]):
            for claim, answer in answers(table).items():
                verdict = claims.judge(claim, answer)
                row = (source, rate, claim, verdict.verdict, verdict.measured)
                rows.append(row)
    return pd.DataFrame(rows, columns=["source", "sampling_hz", "id", "verdict", "measured"])


def arrival_answers(table: pd.DataFrame) -> dict[str, Answer]:
    """Return the answers to belt20-1 to belt20-5.

    Parameters
    ----------
    table
        Of one source: ``data_set``, ``model``, ``iqr`` and ``mae`` of the arrival in ms.
    """
    mae, iqr = _wide(table, "mae"), _wide(table, "iqr")
    highest, worst, best, order = {}, {}, {}, {}
    for name in mae.index:
        plotted = iqr.loc[name, PLOTTED]
        highest[f"{name}: IV {iqr['IV'][name]:.2f} ms"] = bool(plotted.idxmax() == "IV")
        worst[f"{name}: CV {mae['CV'][name]:.2f} ms"] = bool(mae.loc[name].idxmax() == "CV")
        best[f"{name}: IA {mae['IA'][name]:.2f} ms"] = bool(mae.loc[name].idxmin() == "IA")
        ca, cvbc = mae.loc[name, ["CA", "CVBC"]]
        text = f"{name}: CA {ca:.2f}, CVBC {cvbc:.2f} ms"
        order[text] = bool((ca > cvbc) == (name != "cuboids"))
    limited = 1 - mae["CALV"] / mae["CA"]
    return {
        "belt20-1": highest,
        "belt20-2": worst,
        "belt20-3": order,
        "belt20-4": limited,
        "belt20-5": best,
    }


def arrival_notes(varied: pd.DataFrame, note: str) -> dict[str, str]:
    """Return what the answers to belt20-1 to belt20-6 rest on, after a note.

    ``varied`` is from `vary_target`; it says how often IA is first.
    """
    first = varied.loc[varied.groupby(["target_mm", "data_set"])["mae"].idxmin(), "model"]
    everywhere = f"IA is first in {(first == 'IA').sum()} of {len(first)} data sets and targets"
    known = dict.fromkeys([f"belt20-{k}" for k in range(1, 7)], f"{note}; mean absolute error")
    known["belt20-1"] = f"{note}; interquartile range"
    known["belt20-4"] = f"{note}; 1 - MAE CALV / MAE CA"
    known["belt20-5"] += f"; {everywhere}"
    known["belt20-6"] = f"{note}; mean velocity"
    return known


def lateral_notes(varied: pd.DataFrame, note: str) -> dict[str, str]:
    """Return what the answers to belt20-7 to belt20-10 rest on, after a note."""
    targets = varied["target_mm"]
    iqr = varied.pivot(index=["target_mm", "data_set"], columns="model", values="iqr")
    shares = (iqr["CV-CV"] / iqr["Straight"]).groupby("target_mm").max()
    changes = iqr["LV-DSC"] / iqr["CA-CA"] - 1
    ranks = _wide(varied[targets == 773.0], "mae").rank(axis=1)["IA-Ratio"]
    at = f"at targets from {targets.iloc[0]:.0f} to {targets.iloc[-1]:.0f} mm"
    by_mae = ", ".join(f"{name} {ranks[name]:.0f}" for name in DATA_SETS)
    note = f"{note}; interquartile range"
    return {
        "belt20-7": f"{note}; {at} the largest share CV / Straight is {shares.min():.2f} to "
        f"{shares.max():.2f}",
        "belt20-8": note,
        "belt20-9": f"{note}, LV-DSC over CA-CA minus 1; {at} the changes lie between "
        f"{changes.min():.2f} and {changes.max():.2f}",
        "belt20-10": f"{note}; rank of IA-Ratio by mean absolute error: {by_mae}",
    }


def by_data_set(answer: Answer) -> dict[str, Answer]:
    """Return an answer data set by data set; one that counts data sets stays whole, as "all"."""
    if isinstance(answer, pd.Series):
        return {str(name): answer.loc[[name]] for name in answer.index}
    parts: dict[str, Answer] = {}
    for text, holds in answer.items():
        name, colon, _ = text.partition(":")
        parts[name if colon else "all"] = {text: holds}
    return parts


def speed_answers(profiles: pd.DataFrame) -> dict[str, Answer]:
    """Return the answer to belt20-6.

    Parameters
    ----------
    profiles
        Of one source: ``data_set``, ``x_mm`` and ``mean_m_s``.
    """
    rising = {}
    for name, part in profiles.groupby("data_set", sort=False):
        mean = part.sort_values("x_mm")["mean_m_s"]
        text = f"{name}: up to {mean.max():.2f} m/s"
        rising[text] = bool(mean.is_monotonic_increasing and mean.max() < 1.5)
    return {"belt20-6": rising}


def lateral_answers(table: pd.DataFrame) -> dict[str, Answer]:
    """Return the answers to belt20-7 to belt20-10.

    Parameters
    ----------
    table
        Of one source: ``data_set``, ``model`` and ``iqr`` of the lateral position in mm.
    """
    iqr = _wide(table, "iqr")
    rank = iqr.rank(axis=1)["IA-Ratio"].astype(int)
    straight, better, best = {}, {}, {}
    for name in iqr.index:
        row, position = iqr.loc[name], int(rank.loc[name])
        text = f"{name}: Straight {row['Straight']:.2f}, CV {row['CV-CV']:.2f} mm"
        worst = row.idxmax() == "Straight"
        straight[text] = bool(worst and row["CV-CV"] < 0.8 * row["Straight"])
        better[name] = bool(row["CA-CA"] < row["CV-CV"])
        first = position == 1
        best[f"{name}: IA-Ratio has rank {position}"] = bool(first == (name != "cylinders"))
    those = ", ".join(str(name) for name in better if better[name]) or "none"
    return {
        "belt20-7": straight,
        "belt20-8": {f"CA-CA below CV-CV for {those}": sum(better.values()) >= 2},
        "belt20-9": iqr["LV-DSC"] / iqr["CA-CA"] - 1,
        "belt20-10": best,
    }


def _wide(table: pd.DataFrame, quantity: str) -> pd.DataFrame:
    wide = table.pivot(index="data_set", columns="model", values=quantity)
    return wide.loc[[name for name in DATA_SETS if name in wide.index]]
