from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from kilnflight.twin import burning
from kilnflight.twin import gas as forces
from kilnflight.twin.burning import BURNING, CHAR, VolatileIgnition
from kilnflight.twin.gas import Gas
from kilnflight.twin.particles import CONFETTI, PE_GRANULES, WOOD_CHIPS

GAS, STEP = Gas(), 0.5e-3
# Between these temperatures in K; thick bodies of one temperature give off more than real ones
IGNITE_AT = [(CONFETTI, 600.0, 700.0), (WOOD_CHIPS, 530.0, 700.0), (PE_GRANULES, 600.0, 750.0)]


def at_rest(kind, n=1):
    return burning.at_rest(kind.draw(n, np.random.default_rng(1)), 12, 330.0)


def heat(state, seconds, slip=2.0):
    for _ in range(round(seconds / STEP)):
        for particle in state:
            burning.heat_and_burn(particle, GAS.wall_temperature_k, 1373.0, slip, STEP)


def test_a_sheet_heats_like_a_lumped_body():
    """Against scipy's integrator, without moisture."""
    state = at_rest(replace(CONFETTI, moisture=0.0))
    area, mass, size = state.surface_m2[0], state.dry_kg[0], state.diameter_m

    def rate(_, kelvin):
        h = forces.heat_transfer(np.array([2.0]), size, np.array([1373.0]))
        flux = forces.heat_flux(kelvin, np.array([1373.0]), GAS.wall_temperature_k, h, 0.9)
        return flux * area / (mass * 1400.0)

    expected = solve_ivp(rate, (0, 0.05), [330.0], rtol=1e-8).y[0, -1]
    heat(state, 0.05)
    assert state.nodes_k[0, 0] == pytest.approx(expected, rel=5e-3)


def test_a_granule_is_hot_outside_first():
    state = at_rest(PE_GRANULES)
    heat(state, 0.3)
    assert (np.diff(state.nodes_k[0]) > 0).all()
    assert (
        state.nodes_k[0, -1] < state.surface_k[0] < 683.0
    )  # as the thesis: none ignites in flight


def test_volatiles_go_first_then_char_and_mass_only_falls():
    state = at_rest(CONFETTI)
    state.surface_k[:] = 700.0
    state.burning[:] = BURNING
    masses, states = [], []
    for _ in range(2000):
        heat(state, STEP)
        masses.append(burning.mass_kg(state)[0])
        states.append(state.burning[0])
    assert (np.diff(masses) <= 1e-18).all()
    assert states[0] == BURNING
    assert states[-1] == CHAR
    assert (np.diff(np.array(states, dtype=int)) >= 0).all()
    assert burning.area_share(state)[0] < 0.5


def test_the_energy_to_burn_off_the_volatiles_is_the_stated_one():
    state = at_rest(CONFETTI)
    state.surface_k[:] = 700.0
    state.burning[:] = BURNING
    before = state.volatiles_kg[0]
    h = forces.heat_transfer(np.array([2.0]), state.diameter_m, np.array([1373.0]))
    flux = forces.heat_flux(np.array([700.0]), np.array([1373.0]), GAS.wall_temperature_k, h, 0.9)
    heat(state, 10 * STEP)
    lost = before - state.volatiles_kg[0]
    assert lost == pytest.approx(float(flux[0] * state.surface_m2[0] * 10 * STEP / 1.2e6), rel=1e-9)
    assert state.burning[0] == BURNING


@pytest.mark.parametrize(("kind", "low", "high"), IGNITE_AT)
def test_volatiles_are_enough_at_the_handbooks_temperatures(kind, low, high):
    """A body of one temperature gives off 3 g/m2 s between the piloted and the spontaneous."""
    state = at_rest(kind)
    flux = []
    for kelvin in (low, high):
        state.nodes_k[:] = kelvin
        flux.append(float(burning.lose_volatiles(state[0], 0.0)))
    assert flux[0] < VolatileIgnition().critical_flux_kg_m2_s < flux[1]
