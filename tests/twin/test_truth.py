"""Truth of a recording, and flights made by hand with known crossings."""

import numpy as np

from kilnflight.scores.flights import outcomes, remaining
from kilnflight.twin import truth
from kilnflight.twin.flight import ENDS, Flights


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
        normal=np.full_like(position, np.nan),
        along=np.full_like(position, np.nan),
    )


FLIGHTS = straight([10.0, 8.0, 6.0, 4.0], [0.35, 0.30, 0.25, 0.20])  # 3.5, 2.4, 1.5, 0.8 m


def test_crossings_lie_between_the_samples():
    times = truth.crossing_times(FLIGHTS, 1.0)
    np.testing.assert_allclose(times, [0.1, 0.125, 1 / 6, np.nan], rtol=1e-5)
    np.testing.assert_allclose(truth.crossing_times(FLIGHTS, 0.5, lance_s_m=0.5), times, rtol=1e-5)


def test_velocities_are_one_metre_over_the_time_between_crossings():
    velocities = truth.metre_velocities(FLIGHTS)
    np.testing.assert_allclose(velocities[0], [10, 10, 10, np.nan, np.nan], rtol=1e-4)
    np.testing.assert_allclose(velocities[3], [np.nan] * 5)
    true = truth.true_flight_values(FLIGHTS)
    values = outcomes(true)
    medians = values[[f"velocity {k}-{k + 1} m (m/s)" for k in range(5)]]
    np.testing.assert_allclose(medians, [8, 9, 10, np.nan, np.nan], rtol=1e-4)
    np.testing.assert_allclose(remaining(true)[0], [75, 50, 25, 0, 0])


def test_dwell_ends_by_landing_or_burning_out():
    ends = ["landed", "burnt out", "left the kiln", "still flying", "landed"]
    flights = straight([5.0] * 5, [0.3, 0.5, 1.0, 2.5, 0.4], ends)
    np.testing.assert_allclose(truth.dwell_times(flights), [0.3, 0.5, 0.4])


def test_labels_match_truth(twin):
    for t in (10, 30):
        frame, sightings = twin.frame(t), truth.sightings(twin, t)
        marked = sightings[sightings["visible"] & (sightings["pixels"] > 0)]
        row = marked["row"].round().astype(int).clip(0, 383)
        column = marked["col"].round().astype(int).clip(0, 511)
        labelled = frame.labels[row, column]
        assert (labelled == marked["label"]).mean() > 0.85  # the rest lies behind another
        # what overlaps is labelled once; the rest of what is marked is in the picture
        assert 0.7 * marked["pixels"].sum() < (frame.labels > 1).sum() <= marked["pixels"].sum()
        assert (sightings["frame"] == t).all()


def test_instances_and_sightings_show_the_same_particles(twin):
    t = 5
    image = truth.instances(twin, t)
    sightings = truth.sightings(twin, t)
    assert ((image >= 0) == (twin.frame(t).labels >= 2)).all()
    assert set(np.unique(image[image >= 0])) <= set(sightings.loc[sightings["visible"], "particle"])
    marked = truth.marked(twin, [t])
    assert marked["visible"].all()
    assert marked["in_roi"].all()
