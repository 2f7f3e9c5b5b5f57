import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba import njit

from kilnflight.twin import gas as forces
from kilnflight.twin.gas import Gas, density, viscosity

JET = Gas(pressure_bar=5.0)


def on_axis(*distances):
    x = np.array(distances)
    return np.stack([x, np.zeros_like(x), -forces.jet_drop(JET, x)])


def test_properties_of_air_are_the_handbooks():
    assert density(293.15) == pytest.approx(1.204, rel=0.01)
    assert viscosity(293.15) == pytest.approx(1.81e-5, rel=0.01)
    assert viscosity(1300.0) == pytest.approx(4.97e-5, rel=0.03)


def test_the_jet_decays_with_one_over_distance():
    near, far = forces.excess_velocity(JET, on_axis(1.0, 2.0))
    assert near / far == pytest.approx(2.0)
    expected = 6.3 * JET.effective_diameter_m / 1.0 * (16.0 - JET.stream_m_s)
    assert near == pytest.approx(expected)


def test_drag_coefficients_of_the_handbooks():
    re = np.array([0.01, 1.0, 100.0, 5000.0])
    np.testing.assert_allclose(
        forces.sphere_drag(re), [2400.0 * 1.006, 27.6, 1.09, 0.44], rtol=0.02
    )
    np.testing.assert_allclose(forces.disc_drag(re[1:]), [23.2, 1.28, 1.17], rtol=0.02)


@given(st.floats(1e-6, 1e5))
def test_drag_force_grows_with_velocity(re):
    for law in (forces.sphere_drag, forces.disc_drag):
        low, high = (float(law(np.array([x]))[0]) * x**2 for x in (re, 1.05 * re))
        assert high > low


def test_drying_costs_the_latent_heat():
    kelvin = np.linspace(300.0, 500.0, 200_001)
    capacity = forces.apparent_heat_capacity(kelvin, 1400.0, 0.08)
    energy = np.trapezoid(capacity, kelvin)
    assert energy == pytest.approx(1400.0 * 200 + 0.08 * forces.LATENT_HEAT_J_KG, rel=1e-4)


@pytest.mark.parametrize("geometry", [0, 2])
def test_conduction_keeps_the_energy(geometry):
    half, flux, step = np.array([1e-3, 2e-3]), np.array([3e5, -1e5]), 1e-4
    solid = np.array([500.0, 900.0])
    nodes = np.full((2, 12), 300.0)
    shells = forces.shells(12, geometry)
    for body in range(2):
        properties = (0.2, 1500.0, solid[body] * half[body] / (geometry + 1), 0.0)
        for _ in range(100):
            forces.conduct(nodes[body], flux[body], half[body], properties, shells, step)
    faces = np.linspace(0, 1, 13) ** (geometry + 1)
    mean = (nodes * np.diff(faces)).sum(axis=1)
    expected = 300.0 + flux * 0.01 * (geometry + 1) / (solid * 1500.0 * half)
    np.testing.assert_allclose(mean, expected, rtol=1e-9)


def test_conduction_agrees_with_the_semi_infinite_solid():
    """Surface of a thick body under constant flux: 2 q sqrt(t / (pi k rho c))."""
    flux, time, step = 2e4, 0.5, 2e-4
    nodes, shells = np.full(60, 300.0), forces.shells(60, 0)
    conduct = njit(forces.conduct)
    for _ in range(round(time / step)):
        conduct(nodes, flux, 3e-3, (0.15, 1500.0, 500.0 * 3e-3, 0.0), shells, step)
    rise = 2 * flux * np.sqrt(time / (np.pi * 0.15 * 500.0 * 1500.0))
    outermost = flux * (3e-3 / 60 / 2) / 0.15  # from the last node to the surface
    assert nodes[-1] + outermost - 300.0 == pytest.approx(rise, rel=2e-3)
    assert nodes[0] == pytest.approx(300.0, abs=0.5)


def test_a_choked_lance_gives_both_printed_velocities():
    """Sec. 2.1.1: about 4 m/s at 0.5 bar, 16 m/s at 5 bar; 0.5 bar itself is refused."""
    at_4_bar, at_5_bar = Gas(pressure_bar=4.0), Gas(pressure_bar=5.0)
    per_bar = at_5_bar.jet_velocity_m_s - at_4_bar.jet_velocity_m_s
    assert at_5_bar.jet_velocity_m_s == 16.0
    assert at_5_bar.jet_velocity_m_s - 4.5 * per_bar == pytest.approx(4.0, abs=0.1)


def test_oxygen_lies_between_flue_gas_and_air():
    points = np.random.default_rng(1).uniform(-1, 5, (3, 500))
    oxygen = forces.oxygen(JET, np.concatenate([points, on_axis(0.05)], axis=1))
    assert (oxygen >= JET.flue_oxygen).all()
    assert (oxygen <= forces.AIR_OXYGEN).all()
    assert oxygen[-1] == pytest.approx(forces.AIR_OXYGEN)
