import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kilnflight.twin import forces


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


def test_still_air_conducts():
    """Nusselt number 2: h = 2 k / d."""
    h = forces.heat_transfer(np.zeros(1), np.array([0.01]), np.array([300.0]))[0]
    assert h == pytest.approx(2 * 0.0303 / 0.01, rel=0.05)


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
    for _ in range(100):
        nodes = forces.conduct(nodes, flux, half, (0.2, 1500.0, solid, 0.0), geometry, step)
    faces = np.linspace(0, 1, 13) ** (geometry + 1)
    mean = (nodes * np.diff(faces)).sum(axis=1)
    expected = 300.0 + flux * 0.01 * (geometry + 1) / (solid * 1500.0 * half)
    np.testing.assert_allclose(mean, expected, rtol=1e-9)


def test_conduction_agrees_with_the_semi_infinite_solid():
    """Surface of a thick body under constant flux: 2 q sqrt(t / (pi k rho c))."""
    flux, time, step = 2e4, 0.5, 2e-4
    nodes = np.full((1, 60), 300.0)
    for _ in range(round(time / step)):
        args = (0.15, 1500.0, np.array([500.0]), 0.0)
        nodes = forces.conduct(nodes, np.array([flux]), np.array([3e-3]), args, 0, step)
    rise = 2 * flux * np.sqrt(time / (np.pi * 0.15 * 500.0 * 1500.0))
    outermost = flux * (3e-3 / 60 / 2) / 0.15  # from the last node to the surface
    assert nodes[0, -1] + outermost - 300.0 == pytest.approx(rise, rel=2e-3)
    assert nodes[0, 0] == pytest.approx(300.0, abs=0.5)
