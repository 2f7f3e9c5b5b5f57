"""Cuts at physically impossible steps."""

import numpy as np
import pandas as pd
import pytest

from kilnflight.checks import InputError
from kilnflight.tracklets import Cutting


def flight(speed_z=-8.0, speed_x=2.0, count=30, start=0, z=6000.0, x=0.0):
    """A straight flight of mm a millisecond, seen 330 times a second."""
    frame = start + np.arange(count)
    t = 1000 * (frame - start) / 330
    places = {"x": x + speed_x * t, "y": 100.0, "z": z + speed_z * t}
    return pd.DataFrame(
        {"frame": frame, "particle": 0, "row": 500.0, "col": 3.0 * t, **places}
    )


def joined(*flights):
    return pd.concat(flights, ignore_index=True)


def parts(tracks, **limits):
    """The frames of each track after cutting."""
    table = Cutting(**limits)(tracks, 330.0)
    return [
        list(part["frame"]) for name, part in table.groupby("particle") if name >= 0
    ]


def on_ray(tracks, depth_mm):
    """The same pixels at other depths: a place stays on its pixel's ray (section
    4.1.2).
    """
    shift = pd.Series(depth_mm, tracks.index) / tracks["z"]
    return tracks.assign(**{axis: tracks[axis] * shift for axis in "xyz"})


def test_a_track_is_cut_at_an_impossible_step():
    assert parts(flight(speed_z=-31.0)) == [
        list(range(30))
    ]  # below twice the lance's air
    aside = joined(flight(count=12), flight(start=12, count=18, x=400.0, z=5700.0))
    assert parts(aside) == [
        list(range(12)),
        list(range(12, 30)),
    ]  # 300 mm aside in 3 ms
    later = joined(flight(count=12), flight(start=22, count=18, x=400.0, z=5700.0))
    assert parts(later) == [[*range(12), *range(22, 40)]]  # possible in 33 ms
    assert parts(later, fastest_m_s=5.0) == [list(range(12)), list(range(22, 40))]
    short = joined(flight(count=2), flight(start=2, x=400.0))
    assert parts(short) == [list(range(2, 32))]
    aside = joined(flight(count=12), flight(start=12, count=18, x=700.0))
    aside.loc[10:13, ["x", "y", "z"]] = np.nan  # stay with those before
    assert parts(aside) == [list(range(14)), list(range(14, 30))]


@pytest.mark.parametrize("by", [3000.0, -3000.0])
def test_a_step_along_the_ray_is_cut_if_it_lasts(by):
    track = flight(x=300.0)
    late = track["frame"] >= 14
    assert parts(on_ray(track, track["z"] + by * late)) == [
        list(range(14)),
        list(range(14, 30)),
    ]
    for frames in ([14], [14, 15], [3, 9, 10, 20], [0, 1], [28, 29]):
        wrong = on_ray(track, track["z"] + by * track["frame"].isin(frames))
        assert parts(wrong) == [list(range(30))]


def test_tables_without_cuts_come_back_and_cuts_are_idempotent():
    other = flight(start=3).assign(particle=7)
    blind = flight().assign(x=np.nan, y=np.nan, z=np.nan)
    for tracks in (
        joined(other, flight()),
        flight().drop(columns="x"),
        flight()[:0],
        blind,
    ):
        assert Cutting()(tracks, 330.0) is tracks
    tracks = joined(flight(count=12), flight(start=12, count=18, x=500.0), other)
    cut = Cutting()(tracks, 330.0)
    assert cut["particle"].nunique() == 3
    assert Cutting()(cut, 330.0) is cut
    with pytest.raises(InputError, match="frame_rate_hz"):
        Cutting()(flight(), 0.0)
