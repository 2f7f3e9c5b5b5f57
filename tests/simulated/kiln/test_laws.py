"""Flights: the printed numbers that were put in, closed forms, landing."""

from dataclasses import replace

import numpy as np
import pytest

from kilnflight.simulated.kiln import truth
from kilnflight.simulated.kiln.geometry import Geometry
from kilnflight.simulated.kiln.laws import (
    ENDS,
    GRAVITY_M_S2,
    LAWS,
    burning,
    fly,
    released,
)

PLACE = Geometry()
RUNS = pytest.mark.parametrize(("fraction", "bar"), LAWS)
# First metre (m/s), share beyond 2 m (%), median dwell time (s): of the laws with 1000
# particles
EXPECTED = {
    ("wood chip", 4.5): (13.5, 100, 0.33),
    ("wood chip", 5.0): (13.1, 97, 0.30),
    ("confetti", 4.5): (7.5, 33, 0.36),
    ("confetti", 5.0): (7.3, 40, 0.42),
    ("paper shred", 4.5): (5.2, 10, 0.37),
    ("paper shred", 5.0): (5.5, 17, 0.42),
    ("PE granule", 4.5): (8.3, 95, 0.385),
    ("PE granule", 5.0): (7.8, 100, 0.389),
}


@RUNS
def test_the_laws_give_the_printed_numbers(fraction, bar):
    flights = released(fraction, bar, PLACE, 3000, 7)
    first, beyond, dwell = EXPECTED[fraction, bar]
    values = truth.true_flight_values(flights)
    assert np.nanmedian(values.velocity_m_s[:, 0]) == pytest.approx(first, abs=0.25)
    assert 100 * np.isfinite(flights.crossings()[:, 1]).mean() == pytest.approx(
        beyond, abs=3
    )
    assert np.median(values.dwell_s) == pytest.approx(dwell, abs=0.02)
    lit = np.isfinite(flights.ignition_s).mean()
    assert lit == pytest.approx(LAWS[fraction, bar].ignite, abs=0.03)


@RUNS
def test_none_leaves_the_cylinder_and_speeds_change_slowly(fraction, bar):
    flights = released(fraction, bar, PLACE, 200, 3)
    time = np.arange(0, 1.6, 0.001)[:, None] + np.zeros(200)
    flying = time <= flights.end_s
    place = flights.position(time)
    assert (np.hypot(*place[flying][:, 1:].T) < 0.7005).all()
    assert (np.diff(place[..., 0], axis=0)[flying[1:]] > 0).all()
    landed = flights.end == ENDS.index("landed")
    end = flights.position(flights.end_s)[landed]
    np.testing.assert_allclose(np.hypot(*end[:, 1:].T), 0.7, atol=5e-4)
    speed = np.linalg.norm(flights.velocity(time), axis=-1)
    change = np.abs(np.diff(speed, axis=0) / speed[1:])[flying[1:]]
    assert np.quantile(change, 0.99) < 0.05 / 3  # of 5 % in a frame of 3 ms


def test_without_drag_and_flutter_it_is_a_parabola():
    law = replace(
        LAWS["wood chip", 4.5], slope=1e-9, drag_s=1e6, aside_sd=0.0, rise_sd=0.0
    )
    flights = fly(law, 5, replace(PLACE, kiln_radius_mm=5e3), np.random.default_rng(1))
    age = np.linspace(0, 0.3, 7)[:, None] + np.zeros(5)
    s, _, z = np.moveaxis(flights.position(age), -1, 0)
    np.testing.assert_allclose(s, flights.v0 * age, rtol=1e-9)
    expected = PLACE.lance_m[2] + law.rise * age - GRAVITY_M_S2 * age**2 / 2
    np.testing.assert_allclose(z, expected, atol=1e-4)
    crossed = flights.crossings()
    np.testing.assert_allclose(crossed[:, 0], 1 / flights.v0, rtol=1e-6)


def test_the_velocity_is_the_derivative_of_the_path():
    flights = released("PE granule", 4.5, PLACE, 20, 5)
    age = np.full(20, 0.2)
    step = (flights.position(age + 1e-6) - flights.position(age - 1e-6)) / 2e-6
    np.testing.assert_allclose(flights.velocity(age), step, rtol=1e-5, atol=1e-6)


def test_a_flame_ends_a_flight_that_has_not_landed():
    flights = released("wood chip", 4.5, PLACE, 3, 1)
    lit = burning(flights, np.array([0.1, 0.1, np.nan]), np.array([0.05, 9.0, 0.01]))
    np.testing.assert_allclose(lit.end_s, [0.15, *flights.end_s[1:]])
    assert [ENDS[k] for k in lit.end] == ["burnt out", "landed", "landed"]
    values = truth.true_flight_values(lit)
    assert len(values.dwell_s) == 3
    far = np.isfinite(lit.crossings()).sum(axis=1)
    assert far[0] <= far[1]
