"""Peers and ours in both readings on made-up windows."""

import numpy as np
import pandas as pd
import pytest

from kilnflight.checks import InputError
from kilnflight.experiments import tracker_ranks, tuning
from kilnflight.experiments.tracking import Window
from kilnflight.experiments.tracking_scores import ALL, FROM_LANCE, Lance

LANCE = Lance(row=500.0, col=900.0, depth_mm=6500.0)


class Flat:
    shape = (1536, 2048)

    def __call__(self, first, last, top, left, bottom, right):
        return np.ones((bottom - top, right - left)) * (last - first + 1)


def window_of(fraction):
    """Twelve trajectories from the lance and twelve from elsewhere, at the same times."""
    frame = np.arange(12 * 30)
    frame = frame[frame % 30 < 20]
    here = pd.DataFrame({"frame": frame, "particle": frame // 30, "row": 500.0})
    here = here.assign(col=900.0 + 20.0 * (frame % 30), x=0.0, y=0.0, z=6500.0)
    there = here.assign(row=1200.0, particle=here["particle"] + 12)
    truth = pd.concat([here, there]).sort_values("frame", ignore_index=True)
    seen = truth.drop(columns="particle")
    return Window(fraction, "made up", range(360), seen, truth, Flat(), LANCE)


def from_lance(seen):
    """Follow what comes from the lance."""
    return seen.assign(particle=(seen["frame"] // 30).where(seen["row"] < 1000, -1))


def everything(seen):
    return seen.assign(particle=seen["frame"] // 30 + 12 * (seen["row"] > 1000))


def half(seen):
    """Follow every other trajectory."""
    return everything(seen).assign(
        particle=lambda t: t["particle"].where(t["particle"] % 2 == 0, -1)
    )


def refuses(seen):
    if seen["frame"].max() < 1000:
        raise InputError("too dense.")


@pytest.fixture(scope="module")
def ranked():
    windows = [window_of("wood chip"), window_of("confetti")]
    trackers = {"GNN, ours": half, "A": everything, "B": from_lance, "C": refuses}
    scores, cells = tracker_ranks.score(windows, trackers)
    return scores, tracker_ranks.ahead_of_ours(scores, cells, {})


def test_every_tracker_has_both_readings(ranked):
    scores, _ = ranked
    assert scores.groupby(["fraction", "tracker"]).size().eq(4).all()
    assert scores.loc[scores["tracker"] == "C", "beta"].isna().all()
    assert scores.loc[scores["tracker"] == "C", "note"].eq("not run: too dense.").all()
    plain = scores[scores["postprocessing"] == "without"].set_index(["tracker", "reading"])
    assert plain.loc[("B", FROM_LANCE), "beta"].tolist() == [1.0, 1.0]
    assert plain.loc[("B", ALL), "beta"].tolist() == [0.5, 0.5]


def test_ranks_are_by_the_mean_and_beside_our_best(ranked):
    ranks = ranked[1].set_index(["reading", "postprocessing", "tracker"])
    assert "C" not in ranks.index.get_level_values("tracker")
    assert ranks["ours"].eq("GNN, ours").all()
    ahead = ranks.loc[(FROM_LANCE, "without", "B")]
    assert ahead["beta"] == 1.0
    assert ahead["beta_minus_ours"] == pytest.approx(0.5)  # ours: 6 of 12
    assert 0.2 < ahead["difference_low"] < 0.5 < ahead["difference_high"] < 0.8
    even = ranks.loc[(ALL, "without", "B")]
    assert even["difference_low"] < even["beta_minus_ours"] == 0 < even["difference_high"]


def test_the_description_names_all_and_who_did_not_run(ranked):
    text = tracker_ranks.describe(ranked[1], ranked[0])
    assert "From the lance: A 1.00; " in text
    assert "All tracks: " in text
    assert text.endswith("Not run on every window: C.")


def test_few_trajectories_leave_any_difference_open():
    window = window_of("confetti")
    short = {
        name: table[table["frame"] < 90]
        for name, table in window._asdict().items()
        if name in ("detections", "truth")
    }
    few = window._replace(frames=range(90), **short)
    scores, cells = tracker_ranks.score([few], {"GNN, ours": half, "A": everything})
    ranks = tracker_ranks.ahead_of_ours(scores, cells, {})
    here = ranks[ranks["reading"] == FROM_LANCE]
    assert here[["difference_low", "difference_high"]].isna().all(axis=None)


def test_nobody_of_ours_is_no_rank(ranked):
    scores, cells = tracker_ranks.score([window_of("confetti")], {"A": everything})
    assert tracker_ranks.ahead_of_ours(scores, cells, {}).empty
    assert len(tracker_ranks.draw(ranked[0], {}).axes) == 4


def test_columns_of_text_that_nothing_fills_are_not_saved():
    table = pd.DataFrame({"a": ["", ""], "b": ["", "x"], "c": [np.nan, np.nan], "d": [0, 0]})
    assert list(tracker_ranks.filled(table)) == ["b", "c", "d"]


def test_what_refused_settings_is_held_back(ranked):
    tried = pd.DataFrame({"tracker": ["A", "A", "B"], "beta": [np.nan, 0.4, 0.5], "frames": 40})
    limits = tracker_ranks.held_back(tried)
    assert limits == {"A": "1 of 2 settings refused, on 40 frames"}
    labels = [
        text.get_text() for text in tracker_ranks.draw(ranked[0], limits).axes[0].get_yticklabels()
    ]
    assert "A *" in labels


def test_a_tracker_without_any_setting_is_named_in_table_curves_and_words(ranked):
    """As Stone Soup's JPDA is where more tracks share detections than our limit."""
    tried = pd.DataFrame({"tracker": ["A", "A", "B"], "gate": [1.0, 2.0, 2.0], "frames": 40})
    tried = tried.assign(beta=[np.nan, np.nan, 0.5], chosen=[False, False, True])
    tried[["noise", "missed_frames"]] = [1.0, 3]
    tried["note"] = ["not run: 22 tracks share detections"] * 2 + [""]
    window = window_of("confetti")
    trackers = tuning.chosen_trackers(
        tried, {"B": tuning.Grid(lambda gate: everything, {"gate": (2.0,)}, {})}
    )
    scores, cells = tracker_ranks.score([window], {"GNN, ours": half, **trackers})
    ranks = tracker_ranks.ahead_of_ours(scores, cells, limits := tracker_ranks.held_back(tried))
    assert limits == {"A": "2 of 2 settings refused, on 40 frames"}
    note = scores.loc[scores["tracker"] == "A", "note"]
    assert note.str.contains("A refuses each of 2 settings; the first: 22 tracks share").all()
    assert tracker_ranks.describe(ranks, scores).endswith("Not run on every window: A.")
    assert len(tracker_ranks.draw_curves(tried).axes) == 6
