"""Truth of a recording, and flights made by hand whose crossings are known."""

import numpy as np
import pytest

from kilnflight.checks import InputError
from kilnflight.experiments import statements
from kilnflight.scores import flights as flight_scores
from kilnflight.twin import scenes, truth
from kilnflight.twin.flight import ENDS, Flight, Flights
from kilnflight.twin.gas import Gas


def straight(speeds, ends_s, ends=None, ignition_s=None):
    """Particles of constant speed in m/s along the kiln until each ends."""
    n = len(speeds)
    age = 0.002 * np.arange(1 + round(max(ends_s) / 0.002))
    way = np.asarray(speeds, dtype=float)[:, None] * age
    alive = age[None, :] < np.asarray(ends_s)[:, None]
    position = np.full((n, len(age), 3), np.nan, dtype=np.float32)
    position[..., 0] = np.where(alive, way, np.nan)
    place = np.zeros((n, 3))
    place[:, 0] = np.asarray(speeds) * np.asarray(ends_s)
    kinds = [ENDS.index(end) for end in ends or ["landed"] * n]
    never = np.full(n, np.nan)
    return Flights(
        age_s=age,
        position_m=position,
        velocity_m_s=np.zeros_like(position),
        surface_k=np.zeros(alive.shape, dtype=np.float32),
        area=np.ones(alive.shape, dtype=np.float32),
        state=np.where(alive, 0, -1).astype(np.int8),
        ignition_s=never if ignition_s is None else np.asarray(ignition_s, dtype=float),
        cause=np.zeros(n, dtype=np.int8),
        end_s=np.asarray(ends_s, dtype=float),
        end=np.array(kinds, dtype=np.int8),
        end_position_m=place,
    )


FOUR = straight([10.0, 8.0, 6.0, 4.0], [0.35, 0.30, 0.25, 0.20])  # 3.5, 2.4, 1.5, 0.8 m


def test_crossings_lie_between_the_samples():
    times = truth.crossing_times(FOUR, 1.0)
    np.testing.assert_allclose(times, [0.1, 0.125, 1 / 6, np.nan], rtol=1e-5)
    np.testing.assert_allclose(truth.crossing_times(FOUR, 0.5, lance_s_m=0.5), times, rtol=1e-5)


def test_velocities_are_one_metre_over_the_time_between_crossings():
    each = truth.velocities(FOUR)
    np.testing.assert_allclose(each[0], [10, 10, 10, np.nan, np.nan], rtol=1e-4)
    np.testing.assert_allclose(each[3], [np.nan] * 5)


def test_medians_are_over_those_that_passed_the_metre():
    values = flight_scores.outcomes(truth.flight_values(FOUR))
    medians = values[[f"velocity {k}-{k + 1} m (m/s)" for k in range(5)]]
    np.testing.assert_allclose(medians, [8, 9, 10, np.nan, np.nan], rtol=1e-4)
    np.testing.assert_allclose(flight_scores.remaining(truth.velocities(FOUR)), [75, 50, 25, 0, 0])
    assert values["velocity last (m/s)"] == pytest.approx(10, rel=1e-4)


def test_a_slowing_particle_has_the_speed_of_each_metre():
    one = straight([10.0], [0.32])
    way = one.position_m[0, :, 0]
    way[way > 1] = 1 + (way[way > 1] - 1) / 2
    np.testing.assert_allclose(truth.velocities(one)[0, :2], [10, 5], rtol=2e-3)


def test_dwell_ends_by_landing_or_burning_out():
    ends = ["landed", "burnt out", "left the kiln", "still flying", "landed"]
    flights = straight([5.0] * 5, [0.3, 0.5, 1.0, 2.5, 0.4], ends)
    np.testing.assert_allclose(
        flight_scores.quartiles(truth.dwell_times(flights)), [0.35, 0.4, 0.45]
    )
    values = flight_scores.outcomes(truth.flight_values(flights))
    assert values["dwell 0.3-0.4 s (%)"] == pytest.approx(200 / 3)
    assert values["dwell longest (s)"] == 0.5


def test_ignition_is_counted_among_all_or_among_the_ignited():
    flights = straight([5.0] * 4, [0.3] * 4, ignition_s=[0.05, 0.15, 0.25, np.nan])
    values = flight_scores.outcomes(truth.flight_values(flights))
    assert values["ignited (%)"] == 75.0
    assert values["ignited < 0.1 s (%)"] == 25.0
    assert values["ignited < 0.2 s (% of ignited)"] == pytest.approx(200 / 3)
    assert values["ignition median (s)"] == 0.15


def test_what_never_happens_has_no_value_and_no_warning():
    short = straight([1.0, 1.0], [0.1, 0.1], ["still flying"] * 2)
    found = flight_scores.outcomes(truth.flight_values(short))
    names = ["velocity 0-1 m (m/s)", "velocity last (m/s)", "dwell median (s)"]
    assert found[[*names, "ignition median (s)"]].isna().all()
    assert found["ignited (%)"] == 0.0


def test_the_same_seed_releases_the_same_particles_and_the_table_has_a_row_per_cell():
    inputs = (Flight(step_s=2e-3, longest_s=0.5), Gas())
    one, two = (truth.released("confetti", 5.0, inputs, 20, 7) for _ in range(2))
    np.testing.assert_array_equal(one.end_s, two.end_s)
    rows = statements.true_outcomes({("confetti", 5.0): one, ("confetti", 4.5): two})
    assert list(rows["pressure_bar"]) == [5.0, 4.5]
    assert (rows["particles"] == 20).all()


def test_boxes_leave_outliers_out_and_count_them():
    ends = ["landed"] * 5 + ["left the kiln"]
    flights = straight([1.0] * 6, [0.3, 0.31, 0.32, 0.33, 1.5, 0.4], ends)
    box = flight_scores.box(truth.dwell_times(flights))
    assert (box["whisker_low"], box["whisker_high"]) == (0.3, 0.33)
    assert box["outliers"] == 1


def test_the_histogram_counts_each_ignition_once_in_per_cent_of_all():
    flights = straight([5.0] * 4, [0.3] * 4, ignition_s=[0.1, 0.15, 2.0, np.nan])
    bins = flight_scores.ignition_histogram(flights.ignition_s)
    np.testing.assert_allclose(bins["percent"], [25, 25, 0, 0, 0, 0, 0, 25])
    with pytest.raises(InputError, match=r"an ignition at -0\.100 s; count from leaving the lance"):
        flight_scores.ignition_histogram(np.array([0.2, -0.1]))
    assert flight_scores.ignition_histogram(np.empty(0))["percent"].tolist() == [0.0] * 8


def test_along_the_way_every_cell_has_five_velocities_and_five_shares():
    rows = flight_scores.along(statements.true_outcomes({("confetti", 4.5): FOUR}))
    assert len(rows) == 10
    share = rows[rows["quantity"] == "remaining"].set_index("distance_m")["value"]
    np.testing.assert_allclose(share.loc[[1.0, 2.0, 3.0]], [75, 50, 25])
    assert set(rows.loc[rows["quantity"] == "velocity", "distance_m"]) == {0.5, 1.5, 2.5, 3.5, 4.5}


def test_of_no_particle_nothing_is_known_and_nothing_warns():
    nobody = flight_scores.FlightValues(np.empty(0), np.empty((0, 5)), np.empty(0), np.empty(0))
    assert flight_scores.outcomes(nobody).isna().all()


def test_truth_and_labels_are_one(twin):
    for t in (10, 30):
        frame, seen = twin.frame(t), truth.sightings(twin, t)
        marked = seen[seen["visible"] & (seen["pixels"] > 0)]
        row = marked["row"].round().astype(int).clip(0, 383)
        column = marked["col"].round().astype(int).clip(0, 511)
        labelled = frame.labels[row, column]
        assert (labelled == marked["label"]).mean() > 0.85  # the rest lies behind another
        # what overlaps is labelled once; the rest of what is marked is in the picture
        assert 0.7 * marked["pixels"].sum() < (frame.labels > 1).sum() <= marked["pixels"].sum()
        assert (seen["frame"] == t).all()


def test_particles_cross_in_order(twin):
    table = truth.particles(twin)
    times = table[[f"crossing_{m}m_s" for m in range(1, 6)]].to_numpy()
    for one, two in zip(times.T, times.T[1:], strict=False):
        both = np.isfinite(one) & np.isfinite(two)
        assert (one[both] < two[both]).all()
        assert not (np.isnan(one) & np.isfinite(two)).any()


def test_instances_and_marks_tell_of_the_same_particles(twin):
    t = 5
    image = truth.instances(twin, t)
    seen = truth.sightings(twin, t)
    assert ((image >= 0) == (twin.frame(t).labels >= 2)).all()
    assert set(np.unique(image[image >= 0])) <= set(seen.loc[seen["visible"], "particle"])
    marked = truth.marked(twin, [t])
    assert marked["visible"].all()
    assert marked["in_roi"].all()


def test_true_trajectories_are_visible_in_the_air_and_long_enough():
    scene = scenes.open_scene("confetti-4.5-bar@small")
    true = truth.true_trajectories(scene, range(200, 220))
    assert true["visible"].all()
    assert (true["label"] != 4).all()
    assert true.groupby("particle").size().min() >= 5
    assert not true.duplicated(["frame", "particle"]).any()
