"""The experiment of the 2020 paper: from tracks to deviations to verdicts.

tracks -> observe -> compare the models -> summaries over the draws -> answers to the claims

Notebook 40 studies the time of arrival (`ARRIVAL`), notebook 41 the lateral position (`LATERAL`); a
`Study` holds the differences.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.interpolate import CubicSpline
from tqdm import tqdm

from kilnflight.belt.evaluation import (
    SUMMARY,
    Deviations,
    Evaluation,
    arrival_deviations,
    lateral_deviations,
)
from kilnflight.belt.models import BELT_EDGE_MM
from kilnflight.belt.phase import Observed, PredictionPhase
from kilnflight.belt.recordings import read_dem
from kilnflight.experiments import belt_claims
from kilnflight.experiments.belt_claims import DATA_SETS, Answer, Order
from kilnflight.experiments.belt_profile import motion_profile, step_velocities
from kilnflight.project import claims
from kilnflight.sorter import simulation
from kilnflight.sorter.bodies import is_installed
from kilnflight.sorter.friction import MATERIALS
from kilnflight.sorter.rendering import at_rate
from kilnflight.tables import BELT_TRACKS

AUTHORS = "authors-dem"
OWN = "own-simulation"
CALLED = {AUTHORS: "the authors' tracks", OWN: "our own simulation"}  # in sentences
# Particles of each material in the simulated sorter, by scale; None: as many as published.
PARTICLES: dict[str, int | None] = {"quick": 120, "standard": 300, "full": None}
DRAWS = {"quick": 5, "standard": 50, "full": 1000}  # of calibration particles, by scale
PHASE = PredictionPhase()
# The paper's own place, 150 mm to the edge (sec. 5); for tracks that go on beyond it, as ours.
AT_EDGE = PredictionPhase(BELT_EDGE_MM - 150.0, BELT_EDGE_MM)

Key = tuple[str, str]  # source, data set; on recordings data set, filter
Source = tuple[str, float]  # source, sampling rate
Answered = dict[str, Answer]  # by claim
Answers = Callable[[pd.DataFrame], Answered]


def load_tracks(
    files: Mapping[str, Path], seed: int, particles: int | None = None
) -> dict[str, pd.DataFrame]:
    """Return the tracks of each data set: the authors', or else those of the friction model.

    Parameters
    ----------
    files
        The authors' files by data set, from `kilnflight.belt.recordings.find_dem`; empty: the
        friction model (`kilnflight.sorter.friction`) stands in.
    seed
        Of the friction model.
    particles
        How many of each data set, the first to enter; None: all.

    Returns
    -------
    dict
        `kilnflight.tables.BELT_TRACKS` at 100 Hz by data set. ``attrs["particles"]`` is how many
        particles there are, those without a position among them.
    """
    tracks = {}
    for number, (name, friction) in enumerate(MATERIALS.items()):
        authors = read_dem(files[name]) if files else None
        table = friction(np.random.default_rng([seed, number])) if authors is None else authors
        if particles is not None:
            entered = table.groupby("particle")["frame"].min().sort_values(kind="stable")
            table = table[table["particle"].isin(entered.index[:particles])].reset_index(drop=True)
            table.attrs["particles"] = particles
        tracks[name] = table
    return tracks


def resample(tracks: pd.DataFrame, rate_hz: float) -> pd.DataFrame:
    """Return tracks at another sampling rate, interpolated by a cubic spline per particle.

    The authors evaluated at 1000 Hz and published their tracks at 100 Hz. A spline shows what a
    rate does to the models. It adds nothing that lies between the published positions.

    Parameters
    ----------
    tracks
        `kilnflight.tables.BELT_TRACKS` without gaps.
    rate_hz
        Frames per second of the result; frame 0 is at 0 s.

    Returns
    -------
    DataFrame
        `kilnflight.tables.BELT_TRACKS`, each particle from its first to its last position.
    """
    table = tracks.sort_values(["particle", "frame"], kind="stable")
    columns = table[["time_s", "x", "y"]].to_numpy(np.float64)
    particles, starts = np.unique(table["particle"].to_numpy(), return_index=True)
    parts = []
    for particle, part in zip(particles, np.split(columns, starts[1:]), strict=True):
        time = part[:, 0]
        first, last = np.ceil(time[0] * rate_hz - 1e-6), np.floor(time[-1] * rate_hz + 1e-6)
        frame = np.arange(first, last + 1)
        places = CubicSpline(time, part[:, 1:])(frame / rate_hz)
        parts.append(np.column_stack([frame, np.full(len(frame), particle), places]))
    frame, number, x, y = np.concatenate(parts).T
    values = (frame.astype(np.int64), number.astype(np.int64), frame / rate_hz, x, y)
    resampled = pd.DataFrame(dict(zip(BELT_TRACKS.names, values, strict=True)))
    resampled.attrs |= tracks.attrs
    return resampled


def tracks_by_source(
    files: Mapping[str, Path], seed: int, count: int | None = None, jobs: int = 1
) -> dict[Key, pd.DataFrame]:
    """Return the tracks by source (the authors' files, our simulation) and data set.

    Our simulation is the sorter with contacts at 1000 Hz (`kilnflight.sorter.simulation`)
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
            tracks[OWN, name] = simulation.simulate_tracks(name, count, seed, jobs)
        else:
            tracks[OWN, name] = friction(np.random.default_rng([seed, number]))
    return tracks


def describe_own() -> str:
    """Describe our simulation in words: with contacts, or the friction model."""
    if is_installed():
        return "the sorter simulated with all contacts (MuJoCo) at 1000 Hz"
    return "our friction model at 100 Hz, which only assumes how each shape moves"


def describe_input(files: Mapping[str, Path]) -> str:
    """Describe in Markdown the tracks that decide: the authors' ``files``, or ours."""
    own = describe_own()
    if files:
        return f"**Input:** the authors' DEM tracks at 100 Hz decide; beside them stands {own}."
    return f"**Own simulation**, {own}. The authors' tracks are not here; `make data` gets them."


def profiles(
    tracks: Mapping[Key, pd.DataFrame], x_mm: npt.NDArray[np.float64], name: str = "source"
) -> pd.DataFrame:
    """Return `motion_profile` of all tracks, ``name`` and ``data_set`` in front."""
    parts = {key: motion_profile(step_velocities(table), x_mm) for key, table in tracks.items()}
    return pd.concat(parts, names=[name, "data_set"]).droplevel(-1).reset_index()


def sample_steps(
    tracks: Mapping[Key, pd.DataFrame], source: str, particles: int, seed: int
) -> pd.DataFrame:
    """Return `step_velocities` of some particles of each ``data_set``, drawn at random."""
    parts = {}
    for data_set in DATA_SETS:
        steps = step_velocities(tracks[source, data_set])
        known = steps["particle"].unique()
        chosen = np.random.default_rng(seed).choice(known, particles, replace=False)
        parts[data_set] = steps[steps["particle"].isin(chosen)].assign(data_set=data_set)
    return pd.concat(parts.values())


def count_particles(
    tracks: Mapping[Key, pd.DataFrame], observed: Mapping[Key, Observed]
) -> pd.DataFrame:
    """Count the particles of each data set: all, evaluated, and left out by reason."""
    rows = []
    for (source, data_set), table in tracks.items():
        part, visible = observed[source, data_set], table["particle"].nunique()
        listed = table.attrs.get("particles", visible)
        row = {"source": source, "data_set": data_set, "particles": listed}
        row |= {"evaluated": len(part.last), "never on the belt": listed - visible}
        rows.append(row | part.left_out)
    return pd.DataFrame(rows)


def compare_models(
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
    parts = {
        key: evaluation(part, phase, deviations, seed)
        for key, part in tqdm(observed.items(), desc="data sets", disable=None)
    }
    table = pd.concat(parts, names=["source", "data_set"]).droplevel(-1)
    return table.reset_index()


def over_draws(draws: pd.DataFrame) -> pd.DataFrame:
    """Return the median over the draws of every summary, one row per model.

    Columns other than ``draw`` and `SUMMARY` (model, data set, source) identify a row. Between
    ``iqr_low`` and ``iqr_high``, ``mae_low`` and ``mae_high`` lie 95 % of the draws.
    """
    rows = [name for name in draws.columns if name != "draw" and name not in SUMMARY]
    grouped = draws.groupby(rows, sort=False)
    table = grouped[SUMMARY].median().astype({"n": int, "unpredicted": int})
    for end, share in (("low", 0.025), ("high", 0.975)):
        table[[f"iqr_{end}", f"mae_{end}"]] = grouped[["iqr", "mae"]].quantile(share)
    return table.reset_index()


def vary_target(
    tracks: Mapping[Key, pd.DataFrame],
    targets_mm: Iterable[float],
    evaluation: Evaluation,
    deviations: Deviations,
    seed: int,
) -> pd.DataFrame:
    """Return the deviations for several targets, the length of the phase kept.

    The target is our choice, since the public tracks end at the belt's edge. The table shows its
    influence on verdicts.

    Returns
    -------
    DataFrame
        ``target_mm`` and the columns of `over_draws`.
    """
    parts = {}
    for target in targets_mm:
        phase = PredictionPhase(target - (PHASE.target_mm - PHASE.start_mm), target)
        observed = {key: phase.observe(table) for key, table in tracks.items()}
        parts[target] = over_draws(compare_models(observed, phase, evaluation, deviations, seed))
    return pd.concat(parts, names=["target_mm"]).droplevel(-1).reset_index()


def vary_rate(
    tracks: Mapping[Key, pd.DataFrame],
    every: Iterable[int],
    evaluation: Evaluation,
    deviations: Deviations,
    seed: int,
) -> pd.DataFrame:
    """Return the deviations at the edge for tracks that keep only every n-th frame.

    Only particles that are observed at every rate count, the same ones in the same draws. At a slow
    rate some have no observation between the edge and the end of the tracks.

    Returns
    -------
    DataFrame
        ``sampling_hz`` and the columns of `over_draws`.
    """
    later = pd.concat(tracks.values()).query("frame > 0")
    full_hz = float(np.round((later["frame"] / later["time_s"]).median(), 6))
    observed = {
        full_hz / n: {
            key: AT_EDGE.observe(at_rate(table, full_hz / n)) for key, table in tracks.items()
        }
        for n in every
    }
    parts = {}
    for rate, by_key in observed.items():
        shared = {}
        for key, part in by_key.items():
            particles = [other[key].last["particle"] for other in observed.values()]
            kept = np.all([part.last["particle"].isin(others) for others in particles], axis=0)
            shared[key] = Observed(part.last[kept], part.arrival[kept], part.left_out)
        parts[rate] = over_draws(compare_models(shared, AT_EDGE, evaluation, deviations, seed))
    return pd.concat(parts, names=["sampling_hz"]).droplevel(-1).reset_index()


def describe_changes(by_rate: pd.DataFrame, answers: Answers) -> str:
    """Describe which verdicts the sampling rate changes, as a whole and by data set.

    Parameters
    ----------
    by_rate
        From `vary_rate`.
    answers
        `arrival_answers` or `lateral_answers`.
    """
    slowest, fastest = by_rate["sampling_hz"].agg(["min", "max"])
    if slowest == fastest:
        return "One rate only, nothing to compare"
    verdicts: dict[float, dict[Key, str]] = {slowest: {}, fastest: {}}
    for rate, verdict_of in verdicts.items():
        table = by_rate[by_rate["sampling_hz"] == rate]
        for data_set, part in (("", table), *table.groupby("data_set")):
            for claim, answer in answers(part).items():
                verdict = belt_claims.judge(claim, answer, because="method")
                verdict_of[claim, str(data_set)] = verdict.verdict
    changed = sorted(
        key for key, verdict in verdicts[slowest].items() if verdict != verdicts[fastest][key]
    )
    overall = [claim for claim, data_set in changed if not data_set]
    single = [f"{claim} for {data_set}" for claim, data_set in changed if data_set]
    return (
        f"From {slowest:.0f} to {fastest:.0f} Hz {', '.join(overall) or 'no claim'} changes its "
        f"verdict on our own simulation. Single data sets change: {', '.join(single) or 'none'}"
    )


def describe_lowest(by_rate: pd.DataFrame) -> str:
    """Describe which model has the lowest mean absolute error at the highest rate."""
    fastest = by_rate[by_rate["sampling_hz"] == by_rate["sampling_hz"].max()]
    best = fastest.loc[fastest.groupby("data_set")["mae"].idxmin()].set_index("data_set")["model"]
    models = ", ".join(f"{name} {best[name]}" for name in DATA_SETS)
    return (
        f"At {fastest['sampling_hz'].iloc[0]:.0f} Hz the lowest mean absolute error has: {models}"
    )


def by_source(table: pd.DataFrame, answers: Answers, fastest_hz: float) -> dict[Source, Answered]:
    """Return answers from a table with ``source``, by source and its rate (ours: the fastest)."""
    groups = table.groupby("source", sort=False)
    rates = {AUTHORS: 100.0, OWN: fastest_hz}
    return {(str(name), rates[str(name)]): answers(part) for name, part in groups}


def verdicts_by_source(
    deviations: pd.DataFrame,
    by_rate: pd.DataFrame,
    answers: Answers,
    motion: Mapping[Source, Answered],
) -> pd.DataFrame:
    """Return claims' verdicts by other sources, and by our simulation at every rate.

    Parameters
    ----------
    deviations, by_rate
        From `over_draws` and from `vary_rate`.
    answers
        `arrival_answers` or `lateral_answers`.
    motion
        From `by_source`: answers from the tracks themselves.

    Returns
    -------
    DataFrame
        ``source``, ``sampling_hz``, ``id``, ``by_point_values``, ``measured``.
    """
    others = deviations[deviations["source"] != OWN].assign(sampling_hz=100.0)
    groups = pd.concat([others, by_rate]).groupby(["source", "sampling_hz"])
    given = [(key, answers(table)) for key, table in groups] + list(motion.items())
    rows = []
    for (source, rate), answered in given:
        for claim, answer in answered.items():
            because = "twin" if source == OWN else "method"
            verdict = belt_claims.judge(claim, answer, because=because)
            rows.append((source, rate, claim, verdict.verdict, verdict.measured))
    return pd.DataFrame(
        rows, columns=["source", "sampling_hz", "id", "by_point_values", "measured"]
    )


@dataclass(frozen=True)
class Study:
    """A comparison of models: when particles arrive, or where.

    `ARRIVAL` or `LATERAL`.
    """

    quantity: str
    unit: tuple[str, str]  # its sign and its name
    models: tuple[str, str, str]  # compared models, how to read their boxes, figure
    measure: str  # of its claims: mae or iqr
    deviations: Deviations
    answers: Callable[[Any], dict[str, Answer]]
    notes: Callable[[pd.DataFrame, str], dict[str, str]]
    shapes: tuple[str, ...]  # claims on how each shape moves, which the friction model assumes
    orders: Callable[[], list[Order]]
    resampled: Deviations  # those that are resampled
    carried: bool = False  # whether states carried to the start of the phase decide

    @property
    def captions(self) -> dict[str, str]:
        """Captions of its table, box plots, rates and verdicts."""
        (sign, unit), (model, reading, figure) = self.unit, self.models
        return {
            "table": f"Deviation of the predicted from the true {self.quantity} in {unit}. "
            f"Median, quartiles and mean absolute error of each {model}, as medians over the "
            f"calibration draws. Predicted over the 150 mm to {PHASE.target_mm:.0f} mm.",
            "boxes": f"Deviation of the {self.quantity}, after {figure} of the 2020 paper. Box "
            f"plots without outliers, the numbers are the widths of the boxes ({sign}). {reading} "
            "Axes differ between panels. The table has the interval that holds 95 % of the "
            "calibration draws, too.",
            "rates": f"Deviation of the {self.quantity} in {unit} by sampling rate, own "
            f"simulation, over the last 150 mm to the edge ({AT_EDGE.target_mm:.0f} mm). "
            "Interquartile range and mean absolute error of the particles that are observed at "
            "every rate.",
            "verdicts": f"What point values alone say of the claims about the {self.quantity}, by "
            "source and sampling rate. Verdicts ask that a difference is beyond chance, and may "
            "differ. Our own simulation is predicted to the edge (788 mm), other tracks to 773 mm.",
        }

    def labelled(self, deviations: pd.DataFrame) -> pd.DataFrame:
        """Return summaries or differences with the unit in the names of their columns."""
        measured = re.compile("(median|q25|q75|iqr|mae|whisker|excess)(_|$)")
        unit = self.unit[0]
        return deviations.rename(
            columns=lambda name: f"{name}_{unit}" if measured.match(name) else name
        )

    def table(self, deviations: pd.DataFrame) -> pd.DataFrame:
        """Return the columns of belt-arrival or belt-lateral."""
        values = [f"{name}_{self.unit[0]}" for name in ("median", "q25", "q75", "mae")]
        return self.labelled(deviations)[["source", "data_set", "model", "n", *values]]

    def compare(self, observed: Mapping[Key, Observed], draws: int, seed: int) -> pd.DataFrame:
        """Return `over_draws` of `compare_models` to the target of `PHASE`, rounded."""
        evaluation = Evaluation(draws=draws)
        by_draw = compare_models(observed, PHASE, evaluation, self.deviations, seed)
        return over_draws(by_draw).round(6)

    def vary(
        self, tracks: Mapping[Key, pd.DataFrame], evaluation: Evaluation, seed: int
    ) -> tuple[pd.DataFrame, pd.DataFrame]:
        """Return deviations by target (tracks that decide) and by sampling rate (ours).

        The authors' tracks decide where they are; they end at the edge, ours go on beyond it.
        """
        ours = {key: table for key, table in tracks.items() if key[0] == OWN}
        authors = {key: table for key, table in tracks.items() if key[0] == AUTHORS}
        targets = (733.0, 743.0, 753.0, 763.0, 773.0) + (() if authors else (BELT_EDGE_MM,))
        every = (1, 2, 5, 10) if is_installed() else (1,)
        arguments = evaluation, self.deviations, seed
        by_target = vary_target(authors or ours, targets, *arguments)
        return by_target.round(6), vary_rate(ours, every, *arguments).round(6)

    def answer(
        self, observed: Mapping[Key, Observed], source: str, scale: str, seed: int
    ) -> tuple[dict[str, Answer], pd.DataFrame]:
        """Return the answers by the tracks of a source, and the differences that decide.

        Both measures count. On arrivals they are those of states carried on to the start of the
        phase; the last observation as it is stands beside.
        """
        parts = {name: part for (where, name), part in observed.items() if where == source}
        readings = {"": parts}
        if self.carried:
            readings["carried"] = {name: PHASE.carry(part) for name, part in parts.items()}
        evaluation = Evaluation(draws=min(DRAWS[scale], belt_claims.DRAWS))
        replicates, deviations = belt_claims.REPLICATES[scale], self.resampled
        tables, samples = {}, {}
        for reading, each in readings.items():
            keyed = {(source, name): part for name, part in each.items()}
            by_draw = compare_models(keyed, PHASE, evaluation, deviations, seed)
            tables[reading] = over_draws(by_draw)
            samples[reading] = belt_claims.resample(each, PHASE, deviations, replicates, seed)
        values = belt_claims.compared(tables, samples)
        return self.answers(values), belt_claims.differences(values, self.orders())

    def judge(
        self,
        answers: Mapping[str, Answer],
        by_target: pd.DataFrame,
        sampling_hz: float,
        details: Mapping[str, str] | None = None,
    ) -> list[claims.Verdict]:
        """Return the verdicts by tracks of a sampling rate; ``by_target`` is from `vary`.

        ``details`` by id are added to the reasons.
        """
        source = by_target["source"].iloc[0]
        notes = self.notes(by_target, f"decided by {CALLED[source]} at {sampling_hz:.0f} Hz")
        notes |= {id: f"{notes[id]}; {detail}" for id, detail in (details or {}).items()}
        because = "method" if source == AUTHORS else "twin"  # on the authors' own tracks
        verdicts = {
            id: claims.with_cause(belt_claims.judge(id, answer, notes[id], because))
            for id, answer in answers.items()
        }
        if source == OWN and not is_installed():
            reason = "depends on how each shape moves, which our friction simulation only assumes"
            verdicts |= {id: claims.undecidable(id, reason, because="twin") for id in self.shapes}
        return list(verdicts.values())


ARRIVAL = Study(
    "arrival time",
    ("ms", "milliseconds"),
    ("model", "Positive: the particle came earlier than predicted.", "Fig. 9"),
    "mae",
    arrival_deviations,
    belt_claims.arrival_answers,
    belt_claims.arrival_notes,
    ("belt20-3", "belt20-14"),
    belt_claims.arrival_orders,
    arrival_deviations,
    carried=True,
)
LATERAL = Study(
    "lateral position",
    ("mm", "millimetres"),
    (
        "combination",
        "Each combination names its arrival model, then its lateral model.",
        "Fig. 10",
    ),
    "iqr",
    lateral_deviations,
    belt_claims.lateral_answers,
    belt_claims.lateral_notes,
    ("belt20-8", "belt20-10", "belt20-17", "belt20-18", "belt20-19"),
    belt_claims.lateral_orders,
    belt_claims.for_lateral_claims,
)
