"""Pictures of tracklets: what is drawn is what the steps decide, chosen by the stated rule."""

import numpy as np
import pandas as pd
import pytest

from kilnflight.experiments import tracklet_pictures as pictures
from kilnflight.tracklets import Connection, Elimination, LevelEdge, tracked


def table(*tracklets):
    """Return tracks of (frames, rows, cols)."""
    parts = [
        pd.DataFrame({"frame": frame, "particle": k, "row": np.asarray(row, float), "col": col})
        for k, (frame, row, col) in enumerate(tracklets)
    ]
    return pd.concat(parts, ignore_index=True).astype({"col": float})


SHORT = ([1, 2], [0, 9], 300)
SLOW = ([1, 2, 3, 4], [0, 0.1, 0.2, 0.3], 400)
WILD = ([1, 2, 3, 4, 5, 6], [0, 40, 0, 40, 0, 40], 500)
LONG = (range(1, 9), np.arange(8) * 5.0, 600)


def test_what_fails_a_condition_is_what_the_elimination_drops():
    tracks = table(SHORT, SLOW, WILD, LONG, ([3], [5], 700))
    judged = pictures.judge_tracklets(tracks, Elimination())
    assert judged["fails"].to_dict() == {
        0: "duration", 1: "speed", 2: "regularity", 3: "", 4: "duration + speed",
    }  # fmt: skip
    kept = tracks.loc[tracked(Elimination()(tracks)).index, "particle"]
    assert set(kept) == set(judged.index[judged["fails"] == ""])


def test_of_each_condition_the_one_in_the_middle_that_fails_nothing_else():
    judged = pd.DataFrame(
        {"duration": [1.0, 2, 2, 9, 7], "speed": [0.0, 5, 6, 7, 8], "regularity": 1.0,
         "fails": ["duration + speed", "duration", "duration", "", ""]},
        index=pd.Index([3, 4, 5, 6, 7], name="particle"),
    )  # fmt: skip
    chosen = pictures.chosen_tracklets(judged).set_index(["condition", "verdict"])["particle"]
    assert chosen.to_dict() == {
        ("duration", "eligible"): 6, ("duration", "false"): 5, ("speed", "eligible"): 7,
        ("regularity", "eligible"): 7,
    }  # fmt: skip
    picture = pictures.draw_eligible(table(LONG).assign(particle=6), chosen.head(0).reset_index())
    assert picture.axes[0].get_title() == "eligible: no duration alone"


def test_tracks_of_all_fractions_keep_apart():
    both = pictures.pooled({"a": table(SHORT, LONG), "b": table(WILD)})
    assert both.groupby("particle")["fraction"].first().tolist() == ["a", "a", "b"]


LATER = (range(11, 16), 50 + np.arange(5) * 5.0, 600)
BESIDE = (range(8, 14), 36 + np.arange(6) * 5.0, 602)


@pytest.mark.parametrize(
    ("second", "kind", "end"), [(LATER, "connection", 50.0), (BESIDE, "merging", 36.0)]
)
def test_a_joint_has_the_ends_of_its_tracklets(second, kind, end):
    before = table(LONG, second, SLOW)
    (joint,) = pictures.joins(before, Connection()).to_dict("records")
    assert (joint["earlier"], joint["later"], joint["kind"]) == (0, 1, kind)
    assert (joint["start_row"], joint["end_row"]) == (35.0, end)
    assert (joint["first_frame"], joint["last_frame"]) == (1, max(second[0]))


def test_a_pair_is_told_by_its_own_ends_however_it_was_joined():
    last = (range(18, 23), 85 + np.arange(5) * 5.0, 600)
    joints = pictures.joins(table(LONG, LATER, last), Connection())
    ends = {(row["start_row"], row["end_row"]) for row in joints.to_dict("records")}
    assert ends == {(35.0, 50.0), (70.0, 85.0)}


def test_nothing_joined_is_no_joint():
    before = table(LONG, SLOW)
    assert pictures.joins(before, Connection()).empty
    assert pictures.chosen_joins(pictures.joins(before, Connection())) == {}


def test_of_each_kind_the_longest():
    rows = pd.DataFrame({"kind": ["connection"] * 3 + ["merging"], "fraction": "a"})
    rows = rows.assign(
        start_row=0.0, start_col=0.0, end_row=[30.0, 40, 5, 9], end_col=[1.0, 1, 9, 2]
    )
    chosen = pictures.chosen_joins(rows)
    ends = {name: (joint["end_row"], joint["end_col"]) for name, joint in chosen.items()}
    assert ends == {
        "vertical connection": (40, 1), "lateral connection": (5, 9), "vertical merging": (9, 2),
    }  # fmt: skip


class Blank:
    """No difference anywhere."""

    shape = 200, 200

    def __call__(self, first, last, top, left, bottom, right):
        return np.ones((bottom - top, right - left))


def test_a_sum_is_drawn_where_its_pixels_are():
    before = table(LONG, LATER).assign(col=80.0)
    joint = pictures.joins(before, Connection()).assign(fraction="a")
    window = pictures.Window("a", "a", range(1), before, before, Blank())
    chosen = pictures.chosen_joins(joint)
    picture = pictures.draw_windows([window], {"a": before}, chosen, LevelEdge())
    outline = picture.axes[0].lines[-1].get_xydata()
    np.testing.assert_array_equal(outline, [[65, 35], [95, 35], [95, 50], [65, 50], [65, 35]])
    left, right, bottom, top = picture.axes[0].images[0].get_extent()
    assert left < 65 < 95 < right
    assert top < 35 < 50 < bottom
