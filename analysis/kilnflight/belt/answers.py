"""What deviations say about the claims of the 2020 paper: conditions for `reference.judge`.

The same questions to every source of tracks. Spread is the interquartile range.
"""

from __future__ import annotations

import pandas as pd

from kilnflight.belt import friction

Answer = dict[str, bool] | pd.Series

PLOTTED = ["IV", "CVBC", "CA", "CALV", "IA"]  # Fig. 9 leaves CV out for its bias


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
        said = f"{name}: CA {ca:.2f}, CVBC {cvbc:.2f} ms"
        order[said] = bool((ca > cvbc) == (name != "cuboids"))
    limited = 1 - mae["CALV"] / mae["CA"]
    return {
        "belt20-1": highest,
        "belt20-2": worst,
        "belt20-3": order,
        "belt20-4": limited,
        "belt20-5": best,
    }


def speed_answers(profiles: pd.DataFrame) -> dict[str, Answer]:
    """Return the answer to belt20-6.

    Parameters
    ----------
    profiles
        Of one source: ``data_set``, ``x_mm`` and ``mean_m_s``.
    """
    rising = {}
    for name, one in profiles.groupby("data_set", sort=False):
        mean = one.sort_values("x_mm")["mean_m_s"]
        said = f"{name}: up to {mean.max():.2f} m/s"
        rising[said] = bool(mean.is_monotonic_increasing and mean.max() < 1.5)
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
        said = f"{name}: Straight {row['Straight']:.2f}, CV {row['CV-CV']:.2f} mm"
        worst = row.idxmax() == "Straight"
        straight[said] = bool(worst and row["CV-CV"] < 0.8 * row["Straight"])
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
    return wide.loc[[name for name in friction.MATERIALS if name in wide.index]]
