import numpy as np
import pytest

from kilnflight.checks import InputError
from kilnflight.twin.gas import Gas, density, viscosity

JET = Gas(pressure_bar=5.0)


def on_axis(*distances):
    x = np.array(distances)
    return np.stack([x, np.zeros_like(x), -JET.jet_drop(x)], axis=1)


def test_properties_of_air_are_the_handbooks():
    assert density(293.15) == pytest.approx(1.204, rel=0.01)
    assert viscosity(293.15) == pytest.approx(1.81e-5, rel=0.01)
    assert viscosity(1300.0) == pytest.approx(4.97e-5, rel=0.03)


def test_the_jet_leaves_with_the_published_velocity_and_scales_with_pressure():
    assert JET.jet_velocity_m_s == 16.0
    assert Gas(pressure_bar=4.5).jet_velocity_m_s == pytest.approx(15.18, abs=0.01)


def test_the_jet_decays_with_one_over_distance():
    near, far = JET.excess_velocity(on_axis(1.0, 2.0))
    assert near / far == pytest.approx(2.0)
    expected = 6.3 * JET.effective_diameter_m / 1.0 * (16.0 - JET.stream_m_s)
    assert near == pytest.approx(expected)


def test_the_core_keeps_its_velocity_and_behind_the_lance_there_is_no_jet():
    core, behind = JET.excess_velocity(on_axis(0.1, -0.1))
    assert core == pytest.approx(16.0 - JET.stream_m_s)
    assert behind == 0.0
    assert JET.cold_share(on_axis(-0.1))[0] == 0.0


def test_momentum_flux_is_kept_within_the_laws_accuracy():
    """Integrate rho U^2 over the cross-section at two distances of the far field."""
    radius = np.linspace(0.0, 2.0, 4001)
    flux = []
    for x in (1.0, 3.0):
        middle = np.full_like(radius, -float(JET.jet_drop(np.array([x]))[0]))
        points = np.stack([np.full_like(radius, x), radius, middle], axis=1)
        velocity = JET.excess_velocity(points)
        flux.append(np.trapezoid(velocity**2 * 2 * np.pi * radius, radius))
    assert flux[0] == pytest.approx(flux[1], rel=1e-3)


def test_the_cold_jet_sinks_with_the_third_power():
    one, two = JET.jet_drop(np.array([1.0, 2.0]))
    assert two / one == pytest.approx(8.0)
    assert 0.01 < one < 0.04


def test_the_mixture_lies_between_cold_and_hot():
    points = np.random.default_rng(1).uniform(-1, 5, (500, 3))
    temperature = JET.temperature(points)
    assert (temperature >= JET.lance_temperature_k - 1e-9).all()
    assert (temperature <= JET.temperature_k + 1e-9).all()


def test_without_persistence_there_is_no_jet():
    assert not Gas(jet_persistence=0.0).excess_velocity(on_axis(0.5, 1.0)).any()


@pytest.mark.parametrize("bar", [3.9, 0.5, 7.0])
def test_a_lance_that_blocks_is_refused(bar):
    with pytest.raises(InputError, match="stick in the lance"):
        Gas(pressure_bar=bar)
