"""Answers to the claims of the belt papers from tables of deviations, with notes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from kilnflight.belt.friction import MATERIALS
from kilnflight.experiments.belt_intervals import ISOLATED, MEASURES, Compared, agree

PLOTTED = ["IV", "CVBC", "CA", "CALV", "IA"]  # Fig. 9 leaves CV out for its bias

SIM, TRACKING, STRAIGHT = "Sim", "Tracking", "Straight"  # approaches of Fig. 6 of 2016
DATA_SETS = tuple(MATERIALS)

Answer = dict[str, bool | None] | pd.Series  # conditions for `kilnflight.project.claims.judge`


def by_model(table: pd.DataFrame, quantity: str) -> pd.DataFrame:
    """Return a quantity by data set (rows, as the paper orders them) and model."""
    wide = table.pivot(index="data_set", columns="model", values=quantity)
    return wide.reindex([name for name in DATA_SETS if name in wide.index])


# By claim and data set: which models deviate less than which, by the text of sections 5.2, 5.3.
Order = tuple[str, str, tuple[str, ...], tuple[str, ...]]  # claim, data set, lower, higher
ALL = ("IV", "CV", "CVBC", "CA", "CALV", "IA")
PLACES = ("Straight", "CV-CV", "CA-CA", "LV-DSC", "IA-CV", "IA-CA", "IA-Ratio")


def _but(names: tuple[str, ...] | list[str], model: str) -> tuple[str, ...]:
    return tuple(name for name in names if name != model)


def arrival_orders() -> list[Order]:
    """Return what belt20-1, -2, -3 and -5 say (section 5.2)."""
    orders: list[Order] = []
    for name in DATA_SETS:
        pair = (("CA",), ("CVBC",))
        orders += [
            ("belt20-1", name, _but(PLOTTED, "IV"), ("IV",)),
            ("belt20-2", name, _but(ALL, "CV"), ("CV",)),
            ("belt20-3", name, *(pair if name == "cuboids" else pair[::-1])),
            ("belt20-5", name, ("IA",), _but(ALL, "IA")),
        ]
    return orders


def lateral_orders() -> list[Order]:
    """Return what belt20-7 to belt20-10 compare (section 5.3)."""
    orders: list[Order] = []
    for name in DATA_SETS:
        orders += [
            ("belt20-7", name, _but(PLACES, "Straight"), ("Straight",)),
            ("belt20-8", name, ("CA-CA",), ("CV-CV",)),
            ("belt20-9", name, ("LV-DSC",), ("CA-CA",)),
            ("belt20-9", name, (ISOLATED,), ("CA-CA",)),
            ("belt20-10", name, ("IA-Ratio",), _but(PLACES, "IA-Ratio")),
        ]
    return orders


def compared(
    readings: Mapping[str, pd.DataFrame],
    resampled: Mapping[str, Mapping[str, pd.DataFrame]] | None = None,
) -> Compared:
    """Return deviations by measure and reading, for the answers below.

    Parameters
    ----------
    readings
        Tables of one source with ``data_set``, ``model``, ``iqr``, ``mae``, by the reading's name
        ("" for the only one).
    resampled
        By the same names: from `belt_intervals.resample`.
    """
    point, samples = {}, {}
    for reading, table in readings.items():
        for measure, name in MEASURES.items():
            point[f"{name} {reading}".strip()] = by_model(table, measure)
            if resampled:
                samples[f"{name} {reading}".strip()] = resampled[reading][measure]
    return Compared(point, samples)


def differences(values: Compared, orders: list[Order]) -> pd.DataFrame:
    """Return the difference behind each order, by measure, with its 95 % interval.

    Returns
    -------
    DataFrame
        ``id``, ``data_set``, ``measure``, ``lower``, ``higher`` (models), and by how much the
        latter exceed: ``excess``, ``excess_low``, ``excess_high``.
    """
    rows = []
    for claim, data_set, lower, higher in _there(values, orders):
        for measure, numbers in values.by_measure(data_set, lower, higher).items():
            rows.append((claim, data_set, measure, " ".join(lower), " ".join(higher), *numbers))
    columns = ["id", "data_set", "measure", "lower", "higher"]
    return pd.DataFrame(rows, columns=[*columns, "excess", "excess_low", "excess_high"])


def _there(values: Compared, orders: list[Order]) -> list[Order]:
    """Return the orders whose data set and models there are."""
    table = next(iter(values.point.values()))
    return [
        order
        for order in orders
        if order[1] in table.index and {*order[2], *order[3]} <= set(table.columns)
    ]


def arrival_answers(values: Compared | pd.DataFrame) -> dict[str, Answer]:
    """Return the answers to belt20-1 to belt20-5.

    Parameters
    ----------
    values
        From `compared`; or a table of one source with ``data_set``, ``model``, ``iqr`` and ``mae``
        of the arrival in ms. An answer is None where measures or readings differ.
    """
    values = values if isinstance(values, Compared) else compared({"": values})
    answers: dict[str, dict[str, bool | None]] = {f"belt20-{k}": {} for k in (1, 2, 3, 5)}
    shown = {"belt20-1": ("IV",), "belt20-2": ("CV",), "belt20-3": ("CA", "CVBC")}
    for claim, name, lower, higher in _there(values, arrival_orders()):
        # "because of its bias" (5.2): the spread, which sees no bias, does not decide belt20-2
        sees = [not (claim == "belt20-2" and each.startswith("IQR")) for each in values.point]
        each = [x for x, seen in zip(values.less(name, lower, higher), sees, strict=True) if seen]
        models = ", ".join(values.sizes(name, x) for x in shown.get(claim, ("IA",)))
        answers[claim][f"{name}: {models} ms"] = agree(each)
    gain = {
        f"{name} {measure}": float(1 - row["CALV"] / row["CA"])
        for measure, table in values.point.items()
        for name, row in table.iterrows()
    }
    return {**answers, "belt20-4": pd.Series(gain)}


def speed_answers(profiles: pd.DataFrame) -> dict[str, Answer]:
    """Return the answer to belt20-6.

    Parameters
    ----------
    profiles
        Of one source: ``data_set``, ``x_mm`` and ``mean_m_s``.
    """
    rising: dict[str, bool | None] = {}
    for name, part in profiles.groupby("data_set", sort=False):
        mean = part.sort_values("x_mm")["mean_m_s"]
        text = f"{name}: up to {mean.max():.2f} m/s"
        rising[text] = bool(mean.is_monotonic_increasing and mean.max() < 1.5)
    return {"belt20-6": rising}


def lateral_answers(values: Compared | pd.DataFrame) -> dict[str, Answer]:
    """Return the answers to belt20-7 to belt20-10.

    Parameters
    ----------
    values
        From `compared`; or a table of one source with ``data_set``, ``model``, ``iqr`` and ``mae``
        of the lateral position in mm. An answer is None where measures differ.
    """
    values = values if isinstance(values, Compared) else compared({"": values})
    answers: dict[str, dict[str, bool | None]] = {f"belt20-{k}": {} for k in range(7, 11)}
    better: dict[str, bool | None] = {}
    for claim, name, lower, higher in _there(values, lateral_orders()):
        each = values.less(name, lower, higher)
        sizes = ", ".join(values.sizes(name, model) for model in (*lower[:1], *higher[:1]))
        if claim == "belt20-7":
            gain = agree([*each, *values.less(name, ("CV-CV",), ("Straight",))])
            text = f"{values.sizes(name, 'Straight')}, {values.sizes(name, 'CV-CV')}"
            answers[claim][f"{name}: {text} mm"] = gain
        elif claim == "belt20-8":
            better[name] = agree(each)
        elif claim == "belt20-9":
            answers[claim][f"{name}: {sizes} mm"] = _no_improvement(values, name, lower, higher)
        else:
            best = agree(each)
            right = best if name != "cylinders" or best is None else not best
            text = f"{values.sizes(name, 'IA-Ratio')} mm, best: {_WORDS[best]}"
            answers[claim][f"{name}: {text}"] = right
    answers["belt20-8"] = _exactly_two(better)
    return dict(answers)


def _no_improvement(
    values: Compared, data_set: str, lower: tuple[str, ...], higher: tuple[str, ...]
) -> bool | None:
    """Return whether a model is no better than another (belt20-9).

    True if it is not better beyond chance by any measure. A box plot does not show a gain of a few
    percent, and how large a gain must be is not printed: up to `LARGE_GAIN` the answer is None.
    """
    if not any(values.less(data_set, lower, higher)):
        return True
    gains = [
        1 - table[lower[0]][data_set] / table[higher[0]][data_set]
        for table in values.point.values()
    ]
    return False if min(gains) > LARGE_GAIN else None


LARGE_GAIN = 0.2  # of the deviation, which nobody calls no improvement; a bound of ours
_WORDS = {True: "yes", False: "no", None: "depends on the measure"}


def _exactly_two(better: Mapping[str, bool | None]) -> dict[str, bool | None]:
    """Return whether CA is better than CV in two data sets of three, neither more nor fewer."""
    sure = sum(answer is True for answer in better.values())
    possible = sure + sum(answer is None for answer in better.values())
    text = ", ".join(f"{name} {_WORDS[answer]}" for name, answer in better.items())
    holds = None if sure <= 2 <= possible and sure < possible else sure == 2 == possible
    return {f"CA-CA better than CV-CV: {text}": holds}


_BOTH = "MAE and IQR must agree, beyond chance (particles resampled)"


def arrival_notes(by_target: pd.DataFrame, note: str) -> dict[str, str]:
    """Return notes on the measures behind belt20-1 to belt20-6, after a common note.

    ``by_target`` is from `vary_target`; it shows how often IA is best.
    """
    first = by_target.loc[by_target.groupby(["target_mm", "data_set"])["mae"].idxmin(), "model"]
    everywhere = f"IA has the least MAE in {(first == 'IA').sum()} of {len(first)} data sets and "
    notes = dict.fromkeys([f"belt20-{k}" for k in range(1, 7)], f"{note}; {_BOTH}")
    notes["belt20-2"] = f"{note}; mean absolute error, since the text names the bias"
    notes["belt20-3"] += "; the public spheres contradict several sentences of the paper, and may "
    notes["belt20-3"] += "not be those of its Fig. 9"
    notes["belt20-4"] = f"{note}; 1 - CALV / CA"
    notes["belt20-5"] += f"; {everywhere}targets"
    notes["belt20-6"] = f"{note}; mean velocity"
    return notes


def lateral_notes(by_target: pd.DataFrame, note: str) -> dict[str, str]:
    """Return notes on the measures behind belt20-7 to belt20-10, after a common note."""
    targets, note = by_target["target_mm"], f"{note}; {_BOTH}"
    iqr = by_target.pivot(index=["target_mm", "data_set"], columns="model", values="iqr")
    shares = (iqr["CV-CV"] / iqr["Straight"]).groupby("target_mm").max()
    changes = iqr["LV-DSC"] / iqr["CA-CA"] - 1
    at = f"at targets from {targets.iloc[0]:.0f} to {targets.iloc[-1]:.0f} mm"
    return {
        "belt20-7": f"{note}; {at} the largest share CV / Straight (IQR) is {shares.min():.2f} to "
        f"{shares.max():.2f}",
        "belt20-8": f"{note}; exactly two of three, as printed",
        "belt20-9": f"{note}; {at} the changes of the IQR lie between {changes.min():.2f} and "
        f"{changes.max():.2f}; {ISOLATED} isolates the ban of sign changes",
        "belt20-10": note,
    }


def hold_on_recordings(table: pd.DataFrame) -> pd.DataFrame:
    """Return which sentences of the 2020 paper hold on recordings of a real belt.

    The recordings are the authors'.
    Each model has the filter that fits it: constant velocity for most, constant acceleration
    for CA. No verdict: nobody claimed it of these recordings.

    Parameters
    ----------
    table
        ``data_set``, ``filter`` ("CV filter", "CA filter"), ``quantity`` ("arrival_frames",
        "lateral_px"), ``model``, ``mae`` and ``iqr``.

    Returns
    -------
    DataFrame
        Index: the sentences; a column per data set.
    """
    wide = {
        (*key, measure): part.pivot(index="data_set", columns="model", values=measure)
        for key, part in table.groupby(["filter", "quantity"])
        for measure in ("mae", "iqr")
    }
    mae, spread = (wide["CV filter", "arrival_frames", measure] for measure in ("mae", "iqr"))
    across, ca = (
        wide["CV filter", "lateral_px", "iqr"],
        wide["CA filter", "arrival_frames", "mae"]["CA"],
    )
    ca_across = wide["CA filter", "lateral_px", "iqr"]["CA-CA"]
    holds = {
        "belt20-1 IV has the widest box": spread["IV"] >= spread.max(axis=1),
        "belt20-2 CV is worst": mae["CV"] >= np.maximum(mae.max(axis=1), ca),
        "belt20-3 CA is worse than CVBC": ca > mae["CVBC"],
        "belt20-5 IA is best": mae["IA"] <= np.minimum(mae.min(axis=1), ca),
        "belt20-7 CV is below Straight": across["CV-CV"] < across["Straight"],
        "belt20-8 CA beats CV across": ca_across < across["CV-CV"],
        "belt20-10 Ratio is best across": across["IA-Ratio"]
        <= np.minimum(across.min(axis=1), ca_across),
    }
    return pd.DataFrame(holds).T.replace({True: "yes", False: "no"})[table["data_set"].unique()]


def tracking_answers(table: pd.DataFrame) -> dict[str, Answer]:
    """Return the answers to belt16-1 to belt16-5 that a table has data for.

    "Very similar" is read as not half as much again, "far worse" as more than twice as much.

    Parameters
    ----------
    table
        Of one material: ``data`` ("noise-free" or "images"), ``approach``, ``lateral_mm``,
        ``temporal_ms``, as `noise_free` and `from_images` give them.
    """
    error = table["lateral_mm"].abs()
    grouped = table.assign(near=error < 0.2, far=error < 1.5).groupby(["data", "approach"])
    within = grouped[["near", "far"]].mean()
    values = ["lateral_mm", "temporal_ms"]
    median, iqr = grouped[values].median(), grouped[values].quantile(0.75)
    iqr -= grouped[values].quantile(0.25)
    free, images = ((data, TRACKING) for data in ("noise-free", "images"))
    sim, straight = ("noise-free", SIM), ("noise-free", STRAIGHT)
    answers: dict[str, Answer] = {}
    if sim in iqr.index:
        answers["belt16-1"] = pd.Series({"": within["near"][sim]})
    if {sim, free, straight} <= set(iqr.index):
        spread = {key[1]: float(iqr["lateral_mm"][key]) for key in (sim, free, straight)}
        answers["belt16-2"] = {
            f"Tracking {spread[TRACKING]:.3f} mm, Sim {spread[SIM]:.3f} mm": spread[TRACKING]
            < 1.5 * spread[SIM],
            f"Straight {spread[STRAIGHT]:.3f} mm": spread[STRAIGHT]
            > 2 * max(spread[SIM], spread[TRACKING]),
        }
    if images in iqr.index:
        answers["belt16-3"] = pd.Series({"": within["far"][images]})
    if sim in iqr.index:
        answers["belt16-4"] = median["temporal_ms"]["noise-free"].dropna()
    if {images, free} <= set(iqr.index):
        measures = {"spread": iqr["temporal_ms"], "bias": median["temporal_ms"].abs()}
        answers["belt16-5"] = {
            f"{name} from images {value[images]:.2f}, noise-free {value[free]:.2f} ms": bool(
                value[images] > value[free]
            )
            for name, value in measures.items()
        }
    return answers
