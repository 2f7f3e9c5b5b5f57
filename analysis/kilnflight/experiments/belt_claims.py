"""Answers to the claims of the belt papers from tables of deviations, with notes."""

from __future__ import annotations

import numpy as np
import pandas as pd

from kilnflight.belt.friction import MATERIALS

PLOTTED = ["IV", "CVBC", "CA", "CALV", "IA"]  # Fig. 9 leaves CV out for its bias

SIM, TRACKING, STRAIGHT = "Sim", "Tracking", "Straight"  # approaches of Fig. 6 of 2016
DATA_SETS = tuple(MATERIALS)

Answer = dict[str, bool] | pd.Series  # conditions for `kilnflight.project.claims.judge`


def by_model(table: pd.DataFrame, quantity: str) -> pd.DataFrame:
    """Return a quantity by data set (rows, as the paper orders them) and model."""
    wide = table.pivot(index="data_set", columns="model", values=quantity)
    return wide.reindex([name for name in DATA_SETS if name in wide.index])


def arrival_answers(table: pd.DataFrame) -> dict[str, Answer]:
    """Return the answers to belt20-1 to belt20-5.

    Parameters
    ----------
    table
        Of one source: ``data_set``, ``model``, ``iqr`` and ``mae`` of the arrival in ms.
    """
    mae, iqr = by_model(table, "mae"), by_model(table, "iqr")
    order = {
        f"{name}: CA {ca:.2f}, CVBC {cvbc:.2f} ms": bool((ca > cvbc) == (name != "cuboids"))
        for name, ca, cvbc in mae[["CA", "CVBC"]].itertuples()
    }
    highest, worst, best = iqr[PLOTTED].idxmax(axis=1), mae.idxmax(axis=1), mae.idxmin(axis=1)
    sets = [str(name) for name in mae.index]
    return {
        "belt20-1": {f"{x}: IV {iqr['IV'][x]:.2f} ms": bool(highest[x] == "IV") for x in sets},
        "belt20-2": {f"{x}: CV {mae['CV'][x]:.2f} ms": bool(worst[x] == "CV") for x in sets},
        "belt20-3": order,
        "belt20-4": 1 - mae["CALV"] / mae["CA"],
        "belt20-5": {f"{x}: IA {mae['IA'][x]:.2f} ms": bool(best[x] == "IA") for x in sets},
    }


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
    iqr = by_model(table, "iqr")
    rank = iqr.rank(axis=1)["IA-Ratio"].astype(int)
    worst = (iqr.idxmax(axis=1) == "Straight") & (iqr["CV-CV"] < 0.8 * iqr["Straight"])
    better = [str(name) for name in iqr.index[iqr["CA-CA"] < iqr["CV-CV"]]]
    return {
        "belt20-7": {
            f"{name}: Straight {straight:.2f}, CV {cv:.2f} mm": bool(worst[name])
            for name, straight, cv in iqr[["Straight", "CV-CV"]].itertuples()
        },
        "belt20-8": {f"CA-CA below CV-CV for {', '.join(better) or 'none'}": len(better) >= 2},
        "belt20-9": iqr["LV-DSC"] / iqr["CA-CA"] - 1,
        "belt20-10": {
            f"{name}: IA-Ratio has rank {position}": (position == 1) == (name != "cylinders")
            for name, position in rank.items()
        },
    }


def arrival_notes(by_target: pd.DataFrame, note: str) -> dict[str, str]:
    """Return notes on the measures behind belt20-1 to belt20-6, after a common note.

    ``by_target`` is from `vary_target`; it shows how often IA is best.
    """
    first = by_target.loc[by_target.groupby(["target_mm", "data_set"])["mae"].idxmin(), "model"]
    everywhere = f"IA is first in {(first == 'IA').sum()} of {len(first)} data sets and targets"
    notes = dict.fromkeys([f"belt20-{k}" for k in range(1, 7)], f"{note}; mean absolute error")
    notes["belt20-1"] = f"{note}; interquartile range"
    notes["belt20-4"] = f"{note}; 1 - MAE CALV / MAE CA"
    notes["belt20-5"] += f"; {everywhere}"
    notes["belt20-6"] = f"{note}; mean velocity"
    return notes


def lateral_notes(by_target: pd.DataFrame, note: str) -> dict[str, str]:
    """Return notes on the measures behind belt20-7 to belt20-10, after a common note."""
    targets = by_target["target_mm"]
    iqr = by_target.pivot(index=["target_mm", "data_set"], columns="model", values="iqr")
    shares = (iqr["CV-CV"] / iqr["Straight"]).groupby("target_mm").max()
    changes = iqr["LV-DSC"] / iqr["CA-CA"] - 1
    ranks = by_model(by_target[targets == 773.0], "mae").rank(axis=1)["IA-Ratio"]
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
        "belt20-7 CV is below 0.8 of Straight": across["CV-CV"] < 0.8 * across["Straight"],
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
