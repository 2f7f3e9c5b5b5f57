"""The campaigns of the small twin, at the smallest scale; values of flights made by hand."""

import numpy as np
import pandas as pd

from kilnflight.experiments import campaigns
from kilnflight.regression import Regression, regress_all
from kilnflight.tables import FLIGHTS

EXIT = (0.0, 0.0, 6500.0)


def track(particle, speed, start=0, count=40):
    frame = np.arange(start + 2, start + 2 + count)
    t = (frame - start) / 100.0
    places = {"x": 300.0 * t, "y": 4900.0 * t**2, "z": 6500.0 - 1000.0 * speed * t}
    return pd.DataFrame({"particle": particle, "frame": frame, **places})


def flight(particle, dwell, from_lance=True, ignition=np.nan):
    row = dict.fromkeys(FLIGHTS.names, 0.0) | {"particle": particle, "dwell_s": dwell}
    row |= {"end_s": 0.3, "ending": "landed", "ignition": "none", "ignition_s": ignition}
    return row | {"from_lance": from_lance, "refused": ""}


FITTED = regress_all(
    pd.concat([track(1, 5.0), track(2, 8.0), track(3, 5.0)]), EXIT, 100.0, Regression(highest=2)
)
FLOWN = pd.DataFrame([flight(1, 0.3), flight(2, 0.4, ignition=0.1), flight(3, 9.0, False)])
SLICED = pd.DataFrame(
    {"particle": [1, 2, 2, 2], "slice_m": [1.0, -1.0, 1.0, 2.0], "velocity_m_s": [5.0, -3.0, 8, 7]}
)


def test_only_flights_from_the_lance_count_and_slices_behind_it_do_not():
    values = campaigns.flight_values(FITTED, FLOWN, SLICED)
    assert values.dwell_s.tolist() == [0.3, 0.4]
    np.testing.assert_equal(values.velocity_m_s[:, :3], [[5, np.nan, np.nan], [8, 7, np.nan]])
    np.testing.assert_equal(values.ignition_s, [np.nan, 0.1])
    np.testing.assert_allclose(values.reached_m, [1.5, 2.4], rtol=1e-3)


def test_only_complete_flights_have_a_dwell_time_and_refused_ones_do_not_count():
    one = FLOWN.assign(ending=["lost", "burnt out", "landed"], last_s=[0.25, 0.4, 9.0])
    values = campaigns.flight_values(FITTED, one, SLICED)
    assert values.dwell_s.tolist() == [0.4]
    assert values.censored_s.tolist() == [0.25]  # last detected 0.25 s after it left, at t0 = 0
    assert len(values.ignition_s) == len(values.reached_m) == 2
    refused = one.assign(refused=["", "turns back behind the lance", ""])
    values = campaigns.flight_values(FITTED, refused, SLICED)
    assert (len(values.dwell_s), len(values.censored_s), len(values.velocity_m_s)) == (0, 1, 1)
