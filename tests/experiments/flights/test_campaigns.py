"""The values of a campaign's flights, made by hand."""

import numpy as np
import pandas as pd
from hypothesis import given
from hypothesis import strategies as st

from kilnflight.experiments.flights import campaigns
from kilnflight.regression import Regression, regress_all
from kilnflight.tables import FLIGHTS


def track(particle, speed):
    frame = np.arange(2, 42)
    t = frame / 100.0
    places = {"x": 300.0 * t, "y": 4900.0 * t**2, "z": 6500.0 - 1000.0 * speed * t}
    return pd.DataFrame({"particle": particle, "frame": frame, **places})


def test_values_are_of_accepted_flights_from_the_lance():
    tracks = pd.concat([track(1, 5.0), track(2, 8.0), track(3, 5.0)])
    fitted = regress_all(tracks, (0.0, 0.0, 6500.0), 100.0, Regression(highest=2))
    flown = pd.DataFrame(dict.fromkeys(FLIGHTS.names, 0.0) | {"particle": [1, 2, 3]})
    flown = flown.assign(
        dwell_s=[0.3, 0.4, 9.0], end_s=0.3, ending="landed", refused=""
    )
    flown = flown.assign(
        ignition_s=[np.nan, 0.1, np.nan], from_lance=[True, True, False]
    )
    velocity = {"slice_m": [1.0, -1.0, 1.0, 2.0], "velocity_m_s": [5.0, -3.0, 8.0, 7.0]}
    sliced = pd.DataFrame({"particle": [1, 2, 2, 2], **velocity})
    measured = campaigns.Measurement(tracks, fitted, flown, sliced)
    values = campaigns.flight_values(measured)
    assert values.dwell_s.tolist() == [0.3, 0.4]
    np.testing.assert_equal(
        values.velocity_m_s[:, :3], [[5, np.nan, np.nan], [8, 7, np.nan]]
    )
    np.testing.assert_equal(values.ignition_s, [np.nan, 0.1])
    np.testing.assert_allclose(values.reached_m, [1.5, 2.4], rtol=1e-3)
    lost = flown.assign(ending=["lost", "burnt out", "landed"], last_s=[0.25, 0.4, 9.0])
    values = campaigns.flight_values(measured._replace(flights=lost))
    assert values.dwell_s.tolist() == [0.4]  # only complete flights have a dwell time
    every = campaigns.flight_values(
        measured._replace(flights=lost), complete=("lost", "burnt out")
    )
    assert every.dwell_s.tolist() == [0.3, 0.4]
    left = lost.assign(ending=["left the view", "lost", "landed"])
    left_values = campaigns.flight_values(measured._replace(flights=left))
    assert left_values.dwell_s.tolist() == [0.3]
    assert values.lost.tolist() == [True, False]
    assert len(values.ignition_s) == len(values.reached_m) == 2
    refused = lost.assign(refused=["", "turns back behind the lance", ""])
    values = campaigns.flight_values(measured._replace(flights=refused))
    assert len(values.dwell_s) == 0
    assert values.lost.tolist() == [True]
    assert len(values.velocity_m_s) == 1


@given(
    st.lists(st.tuples(st.floats(-0.5, 6.0), st.floats(0.05, 1.5)), max_size=12),
    st.integers(1, 300),
)
def test_the_busiest_frames_hold_the_most_whole_flights(flown, count):
    """Against all windows of a recording of 500 frames at 100 Hz."""
    release, dwell = np.reshape(np.array(flown, np.float64), (-1, 2)).T

    def whole(first):
        begin, end = release * 100, (release + dwell) * 100
        return ((begin >= first) & (end < first + count)).sum()

    end = 100 * (release + dwell)
    frames = campaigns.busiest(100 * release, end, count, 500)
    assert len(frames) == count
    assert (frames.start >= 0) & (frames.stop <= 500)
    assert whole(frames.start) == max(whole(first) for first in range(501 - count))


def test_of_windows_without_a_whole_flight_the_one_with_most_flying_counts():
    begin = np.array([100.0, 200.0, 210.0])
    frames = campaigns.busiest(begin, begin + 90.0, 50, 500)
    assert frames == range(210, 260)
    assert campaigns.busiest(np.empty(0), np.empty(0), 900, 500) == range(500)
