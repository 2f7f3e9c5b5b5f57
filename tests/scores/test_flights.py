"""Numbers of many flights, from values made by hand."""

import numpy as np
import pytest

from kilnflight.checks import InputError
from kilnflight.experiments.campaigns import outcome_table
from kilnflight.scores import flights as flight_scores
from kilnflight.scores.flights import FlightValues

EMPTY = FlightValues(np.empty(0), np.empty((0, 5)), np.empty(0), np.empty(0))


def flight_values(dwell_s=(), speeds=(), metres=(), ignition_s=(), reached_m=()):
    """Return values of particles of constant speed that pass so many metres each."""
    passed = np.arange(1, 6) <= np.asarray(metres)[:, None] if len(metres) else np.empty((0, 5))
    velocity = np.where(passed, np.asarray(speeds)[:, None], np.nan) if len(metres) else passed
    reached_m = reached_m if len(reached_m) else np.asarray(metres, dtype=float)
    arrays = (np.asarray(values, dtype=float) for values in (ignition_s, reached_m))
    return FlightValues(np.asarray(dwell_s, dtype=float), velocity, *arrays)


PARTICLES = flight_values(speeds=[10.0, 8.0, 6.0, 4.0], metres=[3, 2, 1, 0])


def test_medians_are_over_those_that_passed_the_metre():
    values = flight_scores.outcomes(PARTICLES)
    medians = values[[f"velocity {k}-{k + 1} m (m/s)" for k in range(5)]]
    np.testing.assert_allclose(medians, [8, 9, 10, np.nan, np.nan])
    np.testing.assert_allclose(flight_scores.remaining(PARTICLES)[0], [75, 50, 25, 0, 0])
    assert values["velocity last (m/s)"] == 10


def test_a_lost_flight_says_nothing_about_the_metres_behind():
    """Appendix A.1: of what is not fully tracked the flight cannot be analyzed."""
    four = flight_values(speeds=[9.0] * 4, metres=[1, 3, 3, 0], reached_m=[1.5, 3.2, 3.4, 0.5])
    share, counted = flight_scores.remaining(four._replace(lost=np.array([True, *[False] * 3])))
    # one of four ends before 1 m; of three the lost one is gone at 1.5 m, and the others pass 3 m
    np.testing.assert_allclose(share, [75, 75, 75, 0, 0])
    assert counted.tolist() == [4, 3, 3, 3, 3]
    np.testing.assert_allclose(flight_scores.remaining(four)[0], [75, 50, 50, 0, 0])
    nothing, counted = flight_scores.remaining(EMPTY)
    assert np.isnan(nothing).all()
    assert counted.tolist() == [0] * 5


def test_dwell_times_are_summed_up_by_quartiles_shares_and_the_longest():
    dwell_s = np.array([0.3, 0.5, 0.4])
    np.testing.assert_allclose(flight_scores.quartiles(dwell_s), [0.35, 0.4, 0.45])
    values = flight_scores.outcomes(EMPTY._replace(dwell_s=dwell_s))
    assert values["dwell 0.3-0.4 s (%)"] == pytest.approx(200 / 3)
    assert values["dwell longest (s)"] == 0.5


def test_ignition_is_counted_among_all_or_among_the_ignited():
    values = flight_scores.outcomes(flight_values(ignition_s=[0.05, 0.15, 0.25, np.nan]))
    assert values["ignited (%)"] == 75.0
    assert values["ignited < 0.1 s (%)"] == 25.0
    assert values["ignited < 0.2 s (% of ignited)"] == pytest.approx(200 / 3)
    assert values["ignition median (s)"] == 0.15


def test_what_never_happens_has_no_value_and_no_warning():
    short = flight_values(speeds=[1.0, 1.0], metres=[0, 0], ignition_s=[np.nan, np.nan])
    values = flight_scores.outcomes(short)
    names = ["velocity 0-1 m (m/s)", "velocity last (m/s)", "dwell median (s)"]
    assert values[[*names, "ignition median (s)"]].isna().all()
    assert values["ignited (%)"] == 0.0


def test_without_particles_there_are_no_values_and_no_warning():
    assert flight_scores.outcomes(EMPTY).isna().all()


def test_boxes_leave_outliers_out_and_count_them():
    box = flight_scores.box(np.array([0.3, 0.31, 0.32, 0.33, 1.5]))
    assert (box["whisker_low"], box["whisker_high"]) == (0.3, 0.33)
    assert box["outliers"] == 1


def test_the_histogram_counts_each_ignition_once_in_per_cent_of_all():
    bins = flight_scores.ignition_histogram(np.array([0.1, 0.15, 2.0, np.nan]))
    np.testing.assert_allclose(bins["percent"], [25, 25, 0, 0, 0, 0, 0, 25])
    with pytest.raises(InputError, match=r"an ignition at -0\.100 s; count from leaving the lance"):
        flight_scores.ignition_histogram(np.array([0.2, -0.1]))
    assert flight_scores.ignition_histogram(np.empty(0))["percent"].tolist() == [0.0] * 8


def test_along_the_way_every_campaign_has_five_velocities_and_five_shares():
    rows = flight_scores.along(outcome_table({("confetti", 4.5): PARTICLES}))
    assert len(rows) == 10
    share = rows[rows["quantity"] == "remaining"].set_index("distance_m")["value"]
    np.testing.assert_allclose(share.loc[[1.0, 2.0, 3.0]], [75, 50, 25])
    assert set(rows.loc[rows["quantity"] == "velocity", "distance_m"]) == {0.5, 1.5, 2.5, 3.5, 4.5}


def by_hand(complete, lost):
    """Kaplan and Meier's product, written out: at each landing, of those still followed."""
    share, curve = 1.0, [1.0]
    for time in sorted({*complete, *lost}):
        followed = sum(each >= time for each in (*complete, *lost))
        share *= 1 - sum(each == time for each in complete) / followed
        curve.append(share)
    return curve
