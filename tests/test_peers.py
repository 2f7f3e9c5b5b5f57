"""Trackers of other packages that the benchmarks compare with (benchmarks/peers.py)."""

import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from kilnflight.checks import InputError

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
import peers

GAPS = {  # without and with a gap of one frame allowed
    "trackpy": (peers.Trackpy(missed_frames=0), peers.Trackpy(missed_frames=1)),
    "laptrack": (peers.LapTrack(15, 0), peers.LapTrack(15, 25)),
    "stonesoup": (peers.StoneSoupGNN(missed_frames=0), peers.StoneSoupGNN(missed_frames=1)),
}


@pytest.fixture(params=GAPS)
def pair(request):
    if request.param not in peers.available():
        pytest.skip(f"{request.param} is not installed (pip install kilnflight[peer])")
    return GAPS[request.param]


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


def test_an_easy_recording_is_linked_and_rows_left_out_stay_out(pair):
    table = recording()
    found = pair[1](table)
    pd.testing.assert_frame_equal(found[table.columns], table)
    assert len(found[["truth", "particle"]].drop_duplicates()) == 12
    assert sorted(found["particle"].unique()) == list(range(12))
    out = table["truth"] == 3
    found = pair[1](table.assign(particle=np.where(out, -1, 0)))
    assert ((found["particle"] == -1) == out).all()


def test_a_gap_is_closed_if_it_may_be(pair):
    table = recording(4)
    table = table[(table["frame"] != 9) | (table["truth"] != 2)]
    assert [tracker(table)["particle"].nunique() for tracker in pair] == [5, 4]


def test_bad_input_and_a_missing_package_are_named(pair, monkeypatch):
    with pytest.raises(InputError, match="not finite"):
        pair[0](recording().assign(col=np.nan))
    monkeypatch.setattr(peers, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"pip install kilnflight\[peer\]"):
        pair[0](recording())
