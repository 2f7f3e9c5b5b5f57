from dataclasses import replace

import numpy as np
import pytest
from numba import njit

from kilnflight.twin import plates as turning
from kilnflight.twin.camera import Geometry
from kilnflight.twin.compiled import numbers, put
from kilnflight.twin.flight import Flight, launch
from kilnflight.twin.gas import GRAVITY_M_S2, Gas
from kilnflight.twin.particles import CONFETTI, PAPER_SHREDS
from kilnflight.twin.plates import Plates

SHEETS = pytest.mark.parametrize("kind", [CONFETTI, PAPER_SHREDS], ids=lambda kind: kind.name)
PLATES = Plates()
FLIGHT = Flight()
STILL = Gas(
    stream_m_s=0.0,
    lance_stream_m_s=0.0,
    turbulence_m_s=0.0,
    turbulence_in_jet=0.0,
    jet_persistence=0.0,
)
# Nothing meets the walls, but the camera sees them.
DEEP = replace(Geometry(), kiln_radius_mm=1e6, inlet_depth_mm=1e8, kiln_length_mm=2e8)
HOT_K = 1373.0


@njit
def turn_each(state, relative, gas_k, plates, aside, step_s):
    free = np.empty(len(state))
    for k in range(len(state)):
        wind = (relative[k, 0], relative[k, 1], relative[k, 2])
        free[k] = turning.turn(state[k], wind, gas_k[k], plates, aside[k], step_s)
    return free


@njit
def move_each(state, wind, gas_k, free, plates, step_s):
    for k in range(len(state)):
        blows = (wind[k, 0], wind[k, 1], wind[k, 2])
        velocity = turning.velocity_after(state[k], blows, gas_k[k], free[k], plates, step_s)
        put(state[k].velocity, velocity)


def turn(state, relative, gas_k, plates, wander, step_s, generator):
    aside = wander * generator.normal(size=relative.shape)
    return turn_each(state, relative, gas_k, numbers(plates), aside, step_s)


def move(state, wind, gas_k, free, plates, step_s):
    move_each(state, wind, gas_k, free, numbers(plates), step_s)


def sheets(kind, n, seed=1):
    generator = np.random.default_rng(seed)
    state = launch(kind.draw(n, generator), STILL, DEEP, generator, FLIGHT)
    return state, np.full(n, HOT_K), generator


def fall(state, gas_k, generator, step_s, wander=0.0):
    """Fall by one step through still air."""
    free = turn(state, -state.velocity, gas_k, PLATES, wander, step_s, generator)
    still = np.zeros_like(state.velocity)
    move(state, still, gas_k, free, PLATES, step_s)


@SHEETS
def test_in_still_air_no_energy_is_created(kind):
    """Of fall, motion and spin, over every two milliseconds."""
    state, gas_k, generator = sheets(kind, 60)
    inertia = state.short_m**2 / (16 if kind.round else 12)
    step, height, before = 2e-4, np.zeros(60), None
    for number in range(4000):
        if number % 10 == 0:
            motion = (state.velocity**2).sum(axis=1) / 2 + inertia * state.spin_1_s**2 / 2
            energy = motion + GRAVITY_M_S2 * height
            if before is not None:
                assert (energy <= before + 1e-3 * motion + 1e-6).all()
            before = energy
        fall(state, gas_k, generator, step)
        height = height + step * state.velocity[:, 2]


@SHEETS
def test_it_spins_up_to_the_tip_speed_of_autorotation_and_tumbles(kind):
    """In a wind across its axis; tip speeds of 0.3 to 1.1 of the wind are published."""
    state, gas_k, generator = sheets(kind, 40)
    state.along = np.tile([0.0, 1.0, 0.0], (40, 1))
    wind = np.tile([3.0, 0.0, 0.0], (40, 1))
    for _ in range(2000):
        turn(state, wind, gas_k, PLATES, 0.0, 1e-3, generator)
    tip = np.abs(state.spin_1_s) * state.short_m / 2 / 3.0
    np.testing.assert_allclose(
        tip,
        turning.tip_speed_ratio(
            state.broadside_m2 / state.short_m**2 * (16 / np.pi**2 if kind.round else 1.0)
        ),
        rtol=0.15,
    )
    assert ((tip > 0.3) & (tip < 1.1)).all()


def test_a_plate_seen_from_the_front_from_its_edge_and_askew():
    half = np.array([[4.0, 2.0, 0.1]] * 3)
    slant = np.sqrt(0.5)
    normal = np.array([[1.0, 0, 0], [0, 0, 1.0], [slant, 0, slant]])
    along = np.tile([0.0, 1.0, 0.0], (3, 1))
    view = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    shape = turning.projected_axes(normal, half, view, along)
    expected = [[16, 4], [16, 0.01], [16, 2 + 0.005]]
    np.testing.assert_allclose(np.diagonal(shape, axis1=1, axis2=2), expected)
    np.testing.assert_allclose(shape[:, 0, 1], 0.0, atol=1e-12)
