"""Numbers of many flights, from values made by hand."""

import numpy as np
import pytest

from kilnflight.scores.flights import FlightValues, outcomes, remaining

EMPTY = FlightValues(
    dwell_s=np.empty(0),
    velocity_m_s=np.empty((0, 5)),
    ignition_s=np.empty(0),
    reached_m=np.empty(0),
    lost=np.zeros(0, np.bool_),
)


def flight_values(speeds, metres, reached_m=None):
    """Return values of particles of constant speed that pass so many metres each."""
    far = np.asarray(metres, dtype=float)
    velocity = np.where(
        np.arange(1, 6) <= far[:, None], np.asarray(speeds)[:, None], np.nan
    )
    reached = far if reached_m is None else np.asarray(reached_m)
    lost = np.zeros(len(far), np.bool_)
    return EMPTY._replace(velocity_m_s=velocity, reached_m=reached, lost=lost)


def test_medians_are_over_the_particles_that_passed_the_metre():
    particles = flight_values([10.0, 8.0, 6.0, 4.0], [3, 2, 1, 0])
    values = outcomes(particles)
    medians = values[[f"velocity {k}-{k + 1} m (m/s)" for k in range(5)]]
    np.testing.assert_allclose(medians, [8, 9, 10, np.nan, np.nan])
    np.testing.assert_allclose(remaining(particles)[0], [75, 50, 25, 0, 0])
    assert values["velocity last (m/s)"] == 10


def test_a_lost_flight_is_censored():
    """Appendix A.1: flights that are not fully tracked cannot be analyzed."""
    four = flight_values([9.0] * 4, [1, 3, 3, 0], [1.5, 3.2, 3.4, 0.5])
    share, counted = remaining(four._replace(lost=np.array([True, *[False] * 3])))
    # one of four ends before 1 m; one of three is lost at 1.5 m, and the others pass 3
    # m
    np.testing.assert_allclose(share, [75, 75, 75, 0, 0])
    assert counted.tolist() == [4, 3, 3, 3, 3]
    np.testing.assert_allclose(remaining(four)[0], [75, 50, 50, 0, 0])
    share = remaining(four._replace(lost=np.array([*[False] * 2, True, False])))[0]
    np.testing.assert_allclose(
        share, [75, 50, 50, np.nan, np.nan]
    )  # the farthest is lost
    assert np.isnan(remaining(EMPTY)[0]).all()


def test_dwell_and_ignition_times():
    values = outcomes(EMPTY._replace(dwell_s=np.array([0.3, 0.5, 0.4])))
    assert values["dwell median (s)"] == 0.4
    assert values["dwell 0.3-0.4 s (%)"] == pytest.approx(200 / 3)
    assert values["dwell longest (s)"] == 0.5
    values = outcomes(EMPTY._replace(ignition_s=np.array([0.05, 0.15, 0.25, np.nan])))
    assert (values["ignited (%)"], values["ignited < 0.1 s (%)"]) == (75.0, 25.0)
    assert values["ignited < 0.2 s (% of ignited)"] == pytest.approx(200 / 3)
    assert values["ignition median (s)"] == 0.15
    assert outcomes(EMPTY).isna().all()
