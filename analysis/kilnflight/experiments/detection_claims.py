"""Verdicts on the detection claims of sections 5.1.2 to 5.1.4.

A rank or a difference is decided by the sums over all frames. How often it holds when frames are
drawn anew, or the interval of the difference, stands beside it. One frame per subset gives no
draws, and a claim that needs them is then not decidable. Times are those of our own programs and
decide no claim. Everywhere ``seed`` is that of the draws of frames, and ``note`` says how many
frames there are and which scoring distance.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np
import pandas as pd

from kilnflight.experiments.detection import COUNTS, TABLES, sum_counts
from kilnflight.experiments.detection_tables import (
    NOT_DRAWN,
    PARAMETERS,
    analysed_recall,
    class_recall,
    cluster_table,
    cluster_totals,
    interval,
    listed,
    resampled_rates,
    share,
    subset_draws,
    with_total,
)
from kilnflight.project import claims
from kilnflight.project.style import words
from kilnflight.scores.intervals import percentiles
from kilnflight.twin import truth

# Two readings of the text each: what is subtracted (2.2.1), and what 45 px are (3.3).
DIFFERENCES = ("absolute differences", "differences that stop at zero")
DISTANCES = ("45 px as a distance", "45 px as a diameter")
# Otsu's row is no prediction: the light of the twin was fitted to it. Nor is what the pose was
# fitted to (`kilnflight.experiments.twin_pose.terms`).
FITTED = "the picture was fitted to Otsu's row (notebook 13)"
POSED = "the pose was fitted to the printed {} (notebook 15)"
FAMILIES = {"dbscan": "DBSCAN", "mo": "MO", "qcc": "QCC"}
OUR_TIME = "a time of our own program; the thesis's was another"
CHAR = "many that burn are specks of glowing char, dimmer than flames (notebook 10)"
ABOUT = 0.05  # a bound of ours, half of the printed digit
BOUND = f"about is within {ABOUT}, a bound of ours"


def beside(
    verdicts: Iterable[claims.Verdict], others: Iterable[claims.Verdict], held: str, other: str
) -> list[claims.Verdict]:
    """Return verdicts in the reading ``held`` whose reasons say what the ``other`` one gives.

    A claim that is reproduced in the other reading only fails by a choice that no work prints.
    Claims that do not hang on the reading are missing in ``others``.
    """
    by_id, both = {verdict.id: verdict for verdict in others}, []
    for verdict in verdicts:
        second = by_id.get(verdict.id)
        undecided = verdict.verdict == claims.NOT_DECIDABLE
        if second is None or (undecided and second == verdict):  # it hangs on no reading
            both.append(verdict)
            continue
        also = "also " if second.verdict == verdict.verdict else ""
        words = f"{also}{second.verdict} ({second.measured})"
        if also and second.measured == verdict.measured:
            words = "the same"
        told, because = verdict.reason.split("; "), verdict.because
        if (verdict.verdict, second.verdict) == (claims.NOT_REPRODUCED, claims.REPRODUCED):
            # computed, not judged
            told, because = [part for part in told if part != claims.JUDGED], "method"
        told += [f"this is with {held}", f"with {other} it is {words}"]
        both.append(replace(verdict, reason="; ".join(filter(None, told)), because=because))
    return both


def _judged(
    claim: str, measured: claims.Measured, note: str, because: str = "twin", shown: str = ""
) -> claims.Verdict:
    """Return a verdict that says what shows its cause, by default judgement alone."""
    verdict = claims.judge(claim, measured, note=note, because=because)
    return claims.with_cause(verdict, shown)


def _judged_if_drawn(
    claim: str, measured: claims.Measured, note: str, sure: str, shown: str = ""
) -> claims.Verdict:
    """Return a verdict beside which stands how ``sure`` it is.

    Without draws of frames ``sure`` is empty, chance is not known, and nothing is decided.
    """
    if sure:
        return _judged(claim, measured, f"{note}; {sure}", shown=shown)
    value = claims.judge(claim, measured, because="chain").measured
    return claims.undecidable(claim, f"{note}; {NOT_DRAWN}", value, because="chain")


def background_verdicts(
    attempts: pd.DataFrame, traces: Mapping[str, float], seed: int, note: str
) -> list[claims.Verdict]:
    """Return the verdicts on the claims of section 5.1.2.

    ``attempts`` is of `detection.compare_backgrounds`, in one reading of the differences. Without
    ``traces``, those of `background_traces`, bg-6 is left out.
    """
    by_model = attempts.assign(method=attempts["model"])
    f1 = sum_counts(by_model, ["method"]).set_index("method")["f1"]
    draws = resampled_rates(by_model, seed)["f1"]
    best, last = f1.idxmax(), f1.idxmin()
    static, moving = ["Mean", "Median"], ["TwoFrame", "ThreeFrame"]
    others, better = f1.index.difference(static), f1.index.difference(moving)
    lead, gap = f1[static].min() - f1[others].max(), f1[better].min() - f1[moving].max()
    ranked = draws[static].min(axis=1) > draws[others].max(axis=1)
    ranked &= draws[better].min(axis=1) > draws[moving].max(axis=1)
    static_first = {f"static ahead by {lead:+.4f} > 0": bool(lead > 0)}
    static_first[f"moving behind by {gap:+.4f} > 0"] = bool(gap > 0)
    apart = draws["Median"] - draws["Mean"]
    behind = draws.max(axis=1) - draws["Adaptive"]
    first_in = share(draws.idxmax(axis=1) == best, "first")
    last_in = share(draws.idxmin(axis=1) == last, "last")
    verdicts = [
        ("bg-1", {f"first is {words(str(best))}": best == "Median"}, first_in),
        ("bg-2", {f"last is {words(str(last))}": last == "TwoFrame"}, last_in),
        ("bg-3", abs(f1["Median"] - f1["Mean"]), interval(apart, "median less mean")),
        ("bg-4", f1.max() - f1["Adaptive"], interval(behind)),
        ("bg-5", static_first, share(ranked, "so ranked")),
    ]
    judged = [_judged_if_drawn(claim, measured, note, sure) for claim, measured, sure in verdicts]
    if not traces:
        return judged
    kept = {f"{traces['Mean']:.0f} > {traces['Median']:.0f}": traces["Mean"] > traces["Median"]}
    measure = "root mean square from the scene without particles, in grey values"
    return [*judged, _judged("bg-6", kept, measure)]


def picture_verdicts(
    attempts: pd.DataFrame, times: pd.DataFrame, seed: int, note: str
) -> list[claims.Verdict]:
    """Return the verdicts on Otsu and SIFT (section 5.1.3).

    ``attempts`` is of `detection.compare_pictures`, with the chosen thresholds. Without rows of
    ``times``, those of `time_table`, sift-4 is left out.
    """
    otsu, sift = (
        with_total(attempts[attempts["method"] == name], ["subset"]).set_index("subset")
        for name in ("Otsu", "SIFT")
    )
    subsets = otsu.index.drop("Total")
    gain = (draws := resampled_rates(attempts, seed)["f1"])["SIFT"] - draws["Otsu"]
    ahead = f"{sift['f1']['Total']:.4f} > {otsu['f1']['Total']:.4f}"
    last, last_of_sift = (table.loc[subsets, "f1"].idxmin() for table in (otsu, sift))
    fifth = sift["f1"]["V5"] - otsu["f1"]["V5"]
    v5 = {f"last is {last_of_sift}": last_of_sift == "V5", f"V5 {fifth:+.3f} > 0": fifth > 0}
    tp, fp, fn = subset_draws(attempts, "SIFT", COUNTS, seed)
    last_in = (2 * tp / (2 * tp + fp + fn).clip(lower=1)).idxmin(axis=1)
    precision = _judged("otsu-1", otsu.loc[subsets, "precision"], note)
    rank = _judged("otsu-4", {f"last is {last}": last == "V5"}, note)
    first = {ahead: sift["f1"]["Total"] > otsu["f1"]["Total"]}
    verdicts = [
        claims.fitted(precision, FITTED),
        claims.fitted(rank, FITTED),
        _judged_if_drawn("sift-1", first, note, interval(gain, "lead")),
        _judged_if_drawn("sift-3", v5, note, share(last_in == "V5", "V5 last")),
        *_unlit_verdicts(attempts, seed, note),
    ]
    if len(times):
        seconds = times.set_index("threshold")["measured_s"]
        ratio = f"{seconds[400] / seconds[1000]:.4g}"
        verdicts.append(claims.undecidable("sift-4", OUR_TIME, ratio, because="method"))
    return sorted(verdicts, key=lambda verdict: verdict.id)


def _unlit_verdicts(attempts: pd.DataFrame, seed: int, note: str) -> list[claims.Verdict]:
    """Return the verdicts on which particles Otsu and SIFT find (Figs 5.5 and 5.6)."""
    recall = class_recall(attempts, ["method", "subset"])
    by_class = recall.pivot(index="subset", columns=["method", "label"], values="recall")
    burning, unlit, more = (by_class[key] for key in (("Otsu", 2), ("Otsu", 3), ("SIFT", 3)))
    less = {f"{name} {unlit[name]:.2f} < {burning[name]:.2f}": bool(unlit[name] < burning[name])
            for name in unlit.index}  # fmt: skip
    less["V4 lowest"] = bool(unlit["V4"] == unlit.min())
    drawn = {}
    for name in ("Otsu", "SIFT"):
        tp, fn = subset_draws(attempts, name, ["tp_3", "fn_3"], seed)
        drawn[name] = tp / (tp + fn).clip(lower=1)
    v4 = share(drawn["Otsu"].idxmin(axis=1) == "V4", "V4 lowest")
    mean = interval(drawn["SIFT"].mean(axis=1), "mean")
    half = {
        f"mean of the subsets {more.mean():.2f} about 0.5": claims.about(more.mean(), 0.5, ABOUT),
        f"above Otsu's {unlit.mean():.2f}": bool(more.mean() > unlit.mean()),
    }
    by_subset = ", ".join(f"{name} {value:.2f}" for name, value in more.items())
    ranked = _judged_if_drawn("otsu-3", less, note, v4)
    sure = mean and f"{mean}; {by_subset}; {BOUND}"
    return [
        _judged("otsu-2", burning, f"{note}; {CHAR}"),
        claims.fitted(ranked, FITTED),
        _judged_if_drawn("sift-2", half, note, sure),
    ]


def cluster_verdicts(attempts: pd.DataFrame, note: str) -> list[claims.Verdict]:
    """Return the verdicts on the clusterers (5.1.3), from `detection.compare_clusterers`."""
    totals = cluster_totals({family: cluster_table(attempts, family) for family in TABLES})
    dbscan, mo, qcc = (totals[family].set_index(PARAMETERS[family]) for family in TABLES)
    by_points = dbscan.groupby(level="minPts")
    eps = {f"minPts {n}: FP falls": fp.is_monotonic_decreasing for n, fp in by_points["fp"]}
    eps |= {f"minPts {n}: FN rises": fn.is_monotonic_increasing for n, fn in by_points["fn"]}
    of_eps = dbscan["f1"].groupby(level="minPts").agg(np.ptp).mean()
    of_points = dbscan["f1"].groupby(level="epsilon_mm").agg(np.ptp)[[30, 50, 70]].mean()
    seconds = dbscan["seconds_per_image"]
    slower = f"{seconds[(6, 50)] / seconds[(6, 10)]:.4g}"
    grows = {name: mo[name].is_monotonic_increasing for name in ("tp", "fp")}
    more_time = mo["seconds_per_image"].iloc[-1] / mo["seconds_per_image"].iloc[0]
    times = f"our time grows {more_time:.1f} times from R 100 to 500 and decides nothing"
    by_alpha = qcc["fp"].groupby(level="alpha")
    alphas = {f"alpha {n}: FP falls with K": fp.is_monotonic_decreasing for n, fp in by_alpha}
    recall, precision = (
        qcc[name].unstack("alpha").diff(axis=1)[0.2] for name in ("recall", "precision")
    )
    for k in (20, 25, 30):
        alphas[f"K {k}: recall up with alpha"] = bool(recall[k] > 0)
        alphas[f"K {k}: precision down"] = bool(precision[k] < 0)
    effect = f"{note}; mean range of F1"
    return [
        _judged("cluster-1", eps, note),
        _judged("cluster-2", of_eps / of_points, effect),
        claims.undecidable("cluster-3", OUR_TIME, slower, because="method"),
        _judged("cluster-4", grows, f"{note}; {times}", "method"),
        _judged("cluster-5", alphas, note),
        *_class_verdicts(attempts, note),
    ]


def _class_verdicts(attempts: pd.DataFrame, note: str) -> list[claims.Verdict]:
    """Return the verdicts on which classes the clusterers detect."""
    # Fig. 5.9: MO finds all "except for V4"
    printed = attempts[(attempts["family"] != "mo") | (attempts["subset"] != "V4")]
    burning = analysed_recall(printed, ["family"]).query("label == 2").set_index("family")["recall"]
    pooled = analysed_recall(attempts, ["family"])
    by_class = pooled.pivot(index="family", columns="label", values="recall").rename(FAMILIES)
    most = {
        f"{truth.CLASSES[k]}: {listed(by_class[k])}": by_class[k].idxmax() == "QCC" for k in (3, 4)
    }
    walls = analysed_recall(attempts, ["family", "subset"]).query("label == 4")
    half = walls.query("family == 'dbscan'").set_index("subset")["recall"].filter(["V1", "V4"])
    pool = f"{note}; all subsets, MO without V4 as printed"
    return [
        _judged("cluster-7", burning, pool),
        _judged("cluster-8", half, note),
        _judged("cluster-9", most, note),
    ]


def combination_verdicts(attempts: pd.DataFrame, seed: int, note: str) -> list[claims.Verdict]:
    """Return the verdicts on Table 5.11, from `detection.compare_methods`.

    The sentences on gains speak of averages, so means over the three combinations of a 2D
    detector decide; a change whose interval holds 0 is open. Without the clouds alone cluster-6
    is left out.
    """
    rates = sum_counts(attempts, ["method"]).set_index("method")[["precision", "recall", "f1"]]
    draws = resampled_rates(attempts, seed)
    f1, best = rates["f1"], str(rates["f1"].idxmax())
    first = share(draws["f1"].idxmax(axis=1) == best, "first")
    ranked = {f"first is {best}": best == "Combi SIFT+DBSCAN"}
    verdicts = [
        *_gain_verdicts(rates, draws, f"{note}; mean of three combinations"),
        _judged_if_drawn("combi-2", ranked, note, first),
    ]
    verdicts.sort(key=lambda verdict: verdict.id)
    clouds = f1[f1.index.str.startswith("3D")]
    if clouds.empty:
        return verdicts
    lower = f1[["2D-OTSU", "2D-SIFT"]].min()
    below = {
        f"{name} {value:.3f} about 0.6": claims.about(value, 0.6, ABOUT)
        for name, value in clouds.items()
    }
    below |= {f"{name} below {lower:.3f}": bool(value < lower) for name, value in clouds.items()}
    return [_judged("cluster-6", below, f"{note}; {BOUND}"), *verdicts]


def _gain_verdicts(
    rates: pd.DataFrame, draws: Mapping[str, pd.DataFrame], note: str
) -> list[claims.Verdict]:
    """Return the verdicts on what combinations gain on their 2D detector."""
    gains, of_draws = mean_gains(rates.T).T, {name: mean_gains(draws[name]) for name in draws}
    otsu, sift = (gains.loc[name].astype(float).to_dict() for name in ("OTSU", "SIFT"))
    fall = _sign(otsu["precision"] < 0, of_draws["precision"]["OTSU"])
    rise = _sign(otsu["recall"] > 0, of_draws["recall"]["OTSU"])
    much = {
        f"recall {otsu['recall']:+.3f} > 0": rise,
        f"precision {otsu['precision']:+.3f} < 0": fall,
        "falls by less than recall rises": abs(otsu["precision"]) < otsu["recall"],
    }
    both = {
        f"{name} {sift[name]:+.3f} > 0": _sign(sift[name] > 0, of_draws[name]["SIFT"])
        for name in ("precision", "recall")
    }
    spread = [", ".join(filter(None, (interval(of_draws[name][k], name) for name in draws)))
              for k in ("OTSU", "SIFT")]  # fmt: skip
    mean = ", ".join(filter(None, (interval(of_draws["f1"][k], str(k)) for k in gains.index)))
    printed = claims.published("table_5.11").set_index("method")["f1"].astype(float)
    names, f1 = ("OTSU", "SIFT"), rates["f1"].astype(float)
    alone = ", ".join(f"{name} {float(f1[f'2D-{name}']):.3f}" for name in names)
    print_f1 = ", ".join(f"{printed[f'2D-{name}']:.3f}" for name in names)
    size = (
        "the sign alone decides, not the size: 3 to 5 points in the text, 1.9 to 4.8 in the table; "
        f"the pictures alone have F1 {alone} (print {print_f1}), so there is more to gain"
    )
    return [
        _judged_if_drawn("combi-1", gains["f1"], f"{note}; {size}", mean),
        _judged_if_drawn("combi-3", much, note, spread[0]),
        _judged_if_drawn("combi-4", both, note, spread[1]),
    ]


def _sign(holds: bool, draws: pd.Series) -> bool | None:
    """Return whether a difference has a sign; None if the interval of its draws holds 0.

    Without draws a verdict is not decided anyway (`_judged_if_drawn`).
    """
    low, high = percentiles(draws) if len(draws) else (np.nan, np.nan)
    return None if low <= 0 <= high else holds


def mean_gains(rates: pd.DataFrame) -> pd.DataFrame:
    """Return what combinations gain on OTSU and SIFT, mean of the three; columns by method."""
    parts = {
        name: rates.filter(regex=rf"^Combi {name}\+").mean(axis=1) - rates[f"2D-{name}"]
        for name in ("OTSU", "SIFT")
    }
    return pd.DataFrame(parts)


def wall_verdicts(
    cylinders: pd.DataFrame, crossing_mm: float, marked: pd.DataFrame, detected: pd.DataFrame
) -> list[claims.Verdict]:
    """Return the verdicts on the wall and on what is in the air (section 5.1.4).

    ``cylinders`` is of `cylinder_table`; the first one serves all subsets. The Gaussians cross at
    ``crossing_mm`` from the axis. ``marked`` and ``detected`` are Tables 5.13 and 5.14, of
    `classification_table`, with the `detection_tables.axis_thresholds`. Radius, crossing and the
    share of what flies beyond 800 mm are terms of the pose, so that agreement with them is no
    result. Nor is an F1 that all particles called airborne have, too.
    """
    exact, measured = (
        table[table["subset"] == "Total"].set_index("threshold") for table in (marked, detected)
    )
    radius = cylinders.set_index("subset")["radius_mm"]
    off = radius / cylinders["radius_true_mm"].to_numpy() - 1
    why = "the printed 760 mm belong to a radius of 772 mm; how far off ours may be is nowhere said"
    why += f"; it would be no result, as {POSED.format('crossing')}"
    f1, lower = exact["f1"]["crossing_plus_40"], measured["f1"]["crossing_plus_40"]
    note = f"crossing + 40 mm = {crossing_mm + 40:.0f} mm"
    at_800 = {key: table.loc["printed_800"] for key, table in (("5.13", exact), ("5.14", measured))}
    null = exact["f1"]["all_in_air"]
    of_f1 = f"{note}; with 800 mm F1 {at_800['5.13']['f1']:.3f}; all called airborne {null:.3f}"
    inside = f"{crossing_mm - radius.iloc[0]:+.0f} mm"
    found = _cylinders_found(off)
    at_5 = f"{note}; with 800 mm {1 - at_800['5.13']['recall']:.3f}"
    missed = _judged("wall-5", 1 - exact["recall"]["crossing_plus_40"], at_5)
    right = _judged("wall-3", f1, of_f1)
    if _judged("wall-3", null, "").verdict == claims.REPRODUCED:
        why = f"no test where nearly all flies: {of_f1}"
        right = claims.undecidable("wall-3", why, right.measured, because="twin")
    at_4 = f"{note}; with 800 mm F1 {at_800['5.14']['f1']:.3f}"
    return [
        claims.fitted(found, POSED.format("radius")),
        claims.undecidable("wall-2", why, inside, because="twin"),
        right,
        _judged("wall-4", {f"{lower:.4f} < {f1:.4f}": bool(lower < f1)}, at_4),
        claims.fitted(missed, POSED.format("share in the air beyond 800 mm")),
    ]


def _cylinders_found(off: pd.Series) -> claims.Verdict:
    """Return the verdict on wall-1; ``off`` is each radius over the true one less 1, or NaN."""
    note, lost = "one frame of each subset, against the true 700 mm", off.index[off.isna()]
    found = _judged("wall-1", off.dropna(), note)
    if lost.empty:
        return found
    names = ", ".join(lost)
    # ours: the thesis takes clusters of several frames and prints one cylinder
    why = f"{note}; in {names} the largest cluster of the frame is flat and holds no cylinder"
    text = f"{found.measured}; {names} none"
    return replace(
        found, verdict=claims.NOT_REPRODUCED, measured=text, reason=why, because="method"
    )
