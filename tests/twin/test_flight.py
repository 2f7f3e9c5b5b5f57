from dataclasses import replace

import numpy as np
import pytest

from kilnflight.twin import gas as forces
from kilnflight.twin.camera import Geometry
from kilnflight.twin.fitted import second_kiln
from kilnflight.twin.flight import ENDS, Flight, fly
from kilnflight.twin.gas import GRAVITY_M_S2, Gas
from kilnflight.twin.particles import CONFETTI, FRACTIONS, PE_GRANULES, WOOD_CHIPS

PLACE = Geometry()
# Nothing meets them, but the camera sees them.
FAR_WALLS = {"kiln_radius_mm": 1e6, "inlet_depth_mm": 1e8, "kiln_length_mm": 2e8}
STILL = Gas(
    stream_m_s=0.0,
    lance_stream_m_s=0.0,
    turbulence_m_s=0.0,
    turbulence_in_jet=0.0,
    jet_persistence=0.0,
)
QUIET = Gas(turbulence_m_s=0.0, turbulence_in_jet=0.0)


def flown(kind, gas=STILL, settings=None, n=50, seed=1):
    generator = np.random.default_rng(seed)
    return fly(kind.draw(n, generator), gas, PLACE, generator, settings or Flight()).cut()


def test_without_drag_it_is_a_parabola():
    heavy = replace(PE_GRANULES, density_kg_m3=(1e9, 1e9 + 1), launch_spread_deg=0.0)
    wide = replace(PLACE, **FAR_WALLS)
    generator = np.random.default_rng(1)
    particles = heavy.draw(5, generator)
    flights = fly(particles, STILL, wide, generator, Flight(longest_s=0.5)).cut()
    start, speed = flights.position_m[:, 0], flights.velocity_m_s[:, 0]
    age = flights.age_s[None, :, None]
    down = np.array([0.0, 0.0, -GRAVITY_M_S2])
    expected = start[:, None] + speed[:, None] * age + down * age**2 / 2
    np.testing.assert_allclose(flights.position_m, expected, atol=2e-3)


def test_what_falls_long_enough_reaches_its_terminal_velocity():
    """Weight equals drag, found by a fixed point that knows nothing of the integrator."""
    deep = replace(PLACE, **FAR_WALLS)
    kind = replace(PE_GRANULES, pyrolysis_1_s=0.0)  # it never ignites
    generator = np.random.default_rng(2)
    particles = kind.draw(20, generator)
    hot = replace(STILL, lance_temperature_k=1373.0)
    flights = fly(particles, hot, deep, generator, Flight(longest_s=9.0, step_s=1e-3)).cut()
    speed = np.full(20, 1.0)
    for _ in range(500):
        number = forces.reynolds(speed, particles.diameter_m, np.full(20, 1373.0))
        area = particles.orientation * particles.broadside_m2
        drag = 0.2571 * forces.sphere_drag(number) * area / 2
        speed = np.sqrt(speed * np.sqrt(particles.dry_mass_kg * GRAVITY_M_S2 / drag))
    np.testing.assert_allclose(-flights.velocity_m_s[:, -1, 2], speed, rtol=5e-3)


@pytest.mark.parametrize("kind", FRACTIONS.values(), ids=lambda kind: kind.name)
def test_no_particle_is_lost_and_each_has_one_end(kind):
    flights = flown(kind, Gas(), n=80)
    assert (flights.end >= 0).all()
    assert np.isfinite(flights.end_s).all()
    radius = np.hypot(flights.end_position_m[:, 1], flights.end_position_m[:, 2])
    landed = flights.end == ENDS.index("landed")
    assert (radius[landed] >= 0.7).all()
    assert (radius[landed] < 0.72).all()
    assert (radius[~landed] < 0.7).all()
    known = np.isfinite(flights.position_m[:, :, 0])
    np.testing.assert_array_equal(known, flights.state >= 0)
    samples = known.sum(axis=1)
    expected = np.ceil(flights.end_s / 2e-3 - 1e-9)
    np.testing.assert_array_equal(samples, np.maximum(expected, 0))


@pytest.mark.parametrize("kind", [WOOD_CHIPS, CONFETTI], ids=lambda kind: kind.name)
def test_a_finer_step_changes_medians_little(kind):
    """Without chance on the way; most have landed within a second."""
    results = []
    for step in (0.5e-3, 0.125e-3):
        settings = replace(second_kiln().flight, step_s=step, longest_s=1.0, lift_time_s=1e9)
        flights = flown(kind, QUIET, settings, n=300, seed=3)
        speed = np.nanmedian(flights.velocity_m_s[:, 25, 0])
        results.append([np.median(flights.end_s), speed])
    assert results[1][0] < 0.9
    np.testing.assert_allclose(results[0], results[1], rtol=0.03)
