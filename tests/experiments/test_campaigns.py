"""The values of a campaign's flights, made by hand."""

import numpy as np
import pandas as pd

from kilnflight.experiments import campaigns
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
    flown = flown.assign(dwell_s=[0.3, 0.4, 9.0], end_s=0.3, ending="landed", refused="")
    flown = flown.assign(ignition_s=[np.nan, 0.1, np.nan], from_lance=[True, True, False])
    velocity = {"slice_m": [1.0, -1.0, 1.0, 2.0], "velocity_m_s": [5.0, -3.0, 8.0, 7.0]}
    sliced = pd.DataFrame({"particle": [1, 2, 2, 2], **velocity})
    values = campaigns.flight_values(fitted, flown, sliced)
    assert values.dwell_s.tolist() == [0.3, 0.4]
    np.testing.assert_equal(values.velocity_m_s[:, :3], [[5, np.nan, np.nan], [8, 7, np.nan]])
    np.testing.assert_equal(values.ignition_s, [np.nan, 0.1])
    np.testing.assert_allclose(values.reached_m, [1.5, 2.4], rtol=1e-3)
    lost = flown.assign(ending=["lost", "burnt out", "landed"], last_s=[0.25, 0.4, 9.0])
    values = campaigns.flight_values(fitted, lost, sliced)
    assert values.dwell_s.tolist() == [0.4]  # only complete flights have a dwell time
    assert values.censored_s.tolist() == [0.25]  # last detected 0.25 s after it left, at t0 = 0
    assert len(values.ignition_s) == len(values.reached_m) == 2
    refused = lost.assign(refused=["", "turns back behind the lance", ""])
    values = campaigns.flight_values(fitted, refused, sliced)
    assert (len(values.dwell_s), len(values.censored_s), len(values.velocity_m_s)) == (0, 1, 1)
