"""Other people's trackers behind our interface: an easy recording, gaps, nothing, bad input."""

import numpy as np
import pandas as pd
import pytest

from kilnflight.checks import InputError
from kilnflight.experiments import other_trackers as peers

PACKAGE = {
    peers.Trackpy: "trackpy",
    peers.LapTrack: "laptrack",
    peers.StoneSoupGNN: "stonesoup",
    peers.StoneSoupJPDA: "stonesoup",
}


@pytest.fixture(
    params=[*peers.PEERS, peers.Trackpy(predict=True)],
    ids=lambda one: type(one).__name__ + "-predict" * getattr(one, "predict", False),
)
def peer(request):
    package = PACKAGE[type(request.param)]
    if package not in peers.available():
        pytest.skip(f"{package} is not installed (pip install kilnflight[peer])")
    return request.param


def recording(count=12, frames=20):
    """Straight flights of 3 to 8 px per frame, rows shuffled, with an index of its own."""
    rng = np.random.default_rng(1)
    angle, speed = rng.uniform(0, 2 * np.pi, count), rng.uniform(3, 8, count)
    velocity = speed * np.array([np.sin(angle), np.cos(angle)])
    start = np.array(np.divmod(np.arange(count), 4)) * 400.0 + 200.0
    path = start[:, :, None] + velocity[:, :, None] * np.arange(frames)
    row, col = path + rng.normal(0, 0.3, path.shape)
    table = pd.DataFrame({"frame": np.tile(np.arange(frames), count), "row": row.ravel()})
    table = table.assign(col=col.ravel(), truth=np.repeat(np.arange(count), frames))
    return table.sample(frac=1, random_state=0)


def links(table, column):
    """Return the pairs of rows that follow each other in a track."""
    ordered = table.sort_values([column, "frame"])
    same = (ordered[column].diff() == 0).to_numpy()[1:]
    return set(zip(ordered.index[:-1][same], ordered.index[1:][same], strict=True))


def test_an_easy_recording_is_linked(peer):
    table = recording()
    found = peer(table)
    pd.testing.assert_frame_equal(found[table.columns], table)
    assert found["particle"].dtype == np.int64
    true, ours = links(table, "truth"), links(found, "particle")
    assert len(true & ours) >= 0.99 * len(true | ours)
    assert set(found["particle"]) == set(range(found["particle"].nunique()))


def test_rows_that_are_left_out_stay_out(peer):
    table = recording().assign(particle=0)
    out = table["truth"] == 3
    table.loc[out, "particle"] = -1
    found = peer(table)
    assert (found.loc[out, "particle"] == -1).all()
    assert (found.loc[~out, "particle"] >= 0).all()


@pytest.mark.parametrize("index", [[], [7]])
def test_nothing_and_one_detection(peer, index):
    table = pd.DataFrame({"frame": 3, "row": 1.0, "col": 2.0}, index=index)
    found = peer(table.astype({"frame": int, "row": float, "col": float}))
    assert found["particle"].tolist() == [0] * len(index)
    assert found["particle"].dtype == np.int64


GAPS = {  # over one frame in which a particle is not seen
    "trackpy": (peers.Trackpy(missed_frames=0), peers.Trackpy(missed_frames=1)),
    "laptrack": (peers.LapTrack(15, 0), peers.LapTrack(15, 25)),
    "stonesoup": (peers.StoneSoupGNN(missed_frames=0), peers.StoneSoupGNN(missed_frames=1)),
    "stonesoup JPDA": (peers.StoneSoupJPDA(missed_frames=0), peers.StoneSoupJPDA(missed_frames=1)),
}


@pytest.mark.parametrize("name", GAPS)
@pytest.mark.parametrize("whole", [False, True], ids=["one particle", "whole frame"])
def test_a_gap_is_closed_if_it_may_be(name, whole):
    if name.split()[0] not in peers.available():
        pytest.skip(f"{name} is not installed (pip install kilnflight[peer])")
    table = recording(4)
    table = table[(table["frame"] != 9) | ((table["truth"] != 2) & (not whole))]
    strict, lenient = (one(table)["particle"].nunique() for one in GAPS[name])
    assert lenient < strict  # of four equal gaps, laptrack leaves the widest open
    assert strict == (8 if whole else 5)


def test_bad_input_is_named(peer):
    with pytest.raises(InputError, match="row missing"):
        peer(recording().drop(columns="row"))
    with pytest.raises(InputError, match="not finite"):
        peer(recording().assign(col=np.nan))
    with pytest.raises(InputError, match="frame holds float64"):
        peer(recording().astype({"frame": float}))


def test_settings_that_are_none_are_refused():
    for make in (
        lambda: peers.Trackpy(0),
        lambda: peers.Trackpy(missed_frames=-1),
        lambda: peers.LapTrack(-1),
        lambda: peers.LapTrack(gap_closing_cutoff=-1),
        lambda: peers.StoneSoupGNN(distance=np.inf),
        lambda: peers.StoneSoupGNN(missed_frames=0.5),
        lambda: peers.StoneSoupJPDA(detection_probability=1),
        lambda: peers.StoneSoupJPDA(clutter_density=0),
    ):
        with pytest.raises(InputError, match="must be"):
            make()


def test_a_peer_that_is_missing_says_how_to_get_it(monkeypatch):
    monkeypatch.setattr(peers, "find_spec", lambda name: None)
    assert peers.available() == ()
    for one in peers.PEERS:
        with pytest.raises(InputError, match=r"pip install kilnflight\[peer\]"):
            one(recording())


def test_crowds_are_refused_not_waited_for():
    if "trackpy" not in peers.available() or "stonesoup" not in peers.available():
        pytest.skip("trackpy and Stone Soup are not both installed")
    rng = np.random.default_rng(0)
    table = pd.DataFrame(rng.uniform(0, 60, (120, 2)), columns=["row", "col"])
    table = table.assign(frame=np.repeat([0, 1], 60))
    with pytest.raises(InputError, match="smaller one"):
        peers.Trackpy(60.0)(table)
    with pytest.raises(InputError, match="60 tracks share"):
        peers.StoneSoupJPDA()(table)


def with_holes():
    """Return a crowded recording, sorted, in which a third of the detections are missing."""
    table = recording(40, 30).sample(frac=0.67, random_state=1)
    table = table.assign(row=table["row"] % 300, col=table["col"] % 300)  # paths cross
    table = table[~table["frame"].isin([11, 12])]
    return table.sort_values(["frame", "row", "col"], ignore_index=True)


def test_laptracks_labels_are_those_of_its_table():
    laptrack = pytest.importorskip("laptrack")
    table = with_holes()
    tracker = laptrack.LapTrack(cutoff=400, gap_closing_cutoff=900, gap_closing_max_frame_count=3)
    own = tracker.predict_dataframe(
        table.assign(number=table.index), ["row", "col"], "frame", False
    )
    own = own[0].set_index("number")["track_id"].sort_index()
    fast = peers.LapTrack(20.0, 30.0, 3)(table)["particle"]
    assert np.array_equal(fast, pd.factorize(own)[0])


def test_matrices_of_stone_soup_are_made_once_for_each_step_in_time():
    made = []

    def make(time_interval, **_):
        made.append(time_interval)
        return np.full((2, 2), time_interval.total_seconds())

    kept = peers._remembered(make)
    for seconds in (1, 3, 1, 3):
        assert kept(prior=None, time_interval=peers.timedelta(seconds=seconds))[0, 0] == seconds
    assert len(made) == 2
