from dataclasses import replace

import numpy as np
import pytest
from numba import njit

from kilnflight.checks import InputError
from kilnflight.twin import gas as forces
from kilnflight.twin import plates as turning
from kilnflight.twin.burning import mass_kg
from kilnflight.twin.camera import Geometry, unit_vectors
from kilnflight.twin.compiled import numbers, put
from kilnflight.twin.flight import Flight, fly, launch
from kilnflight.twin.gas import GRAVITY_M_S2, Gas
from kilnflight.twin.life import OnTheWall, live
from kilnflight.twin.particles import CONFETTI, FRACTIONS, PAPER_SHREDS, WOOD_CHIPS, Burst
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


def steady_fall(state, share=1.0):
    """Terminal speed at a share of the broadside drag, by a fixed point."""
    speed, gas_k = np.ones(len(state)), np.full(len(state), HOT_K)
    weight = mass_kg(state) * GRAVITY_M_S2
    for _ in range(300):
        law = forces.disc_drag(forces.reynolds(speed, state.diameter_m, gas_k))
        drag = share * forces.density(gas_k) * law * state.broadside_m2 / 2
        speed = np.sqrt(speed * np.sqrt(weight / drag))
    return speed


def fall(state, gas_k, generator, step_s, wander=0.0):
    """Fall by one step through still air."""
    free = turn(state, -state.velocity, gas_k, PLATES, wander, step_s, generator)
    still = np.zeros_like(state.velocity)
    move(state, still, gas_k, free, PLATES, step_s)


def fallen(kind, n=60, steps=3000, step_s=1e-3):
    """Fall through still hot air at one temperature; yield the state after every step."""
    state, gas_k, generator = sheets(kind, n)
    state.velocity[:] = 0.0
    for _ in range(steps):
        fall(state, gas_k, generator, step_s, 0.05)
        yield state


@SHEETS
def test_a_sheet_falls_faster_than_broadside_and_slower_than_edge_on(kind):
    speeds = [-state.velocity[:, 2] for state in fallen(kind)][2000:]
    state, _, _ = sheets(kind, 60)
    mean = np.mean(speeds, axis=0)
    assert (mean > steady_fall(state)).all()
    assert (mean < steady_fall(state, PLATES.edge_drag)).all()


def test_held_broadside_or_edge_on_it_falls_as_fast_as_drag_and_weight_say():
    state, gas_k, _ = sheets(CONFETTI, 20)
    state.spin_1_s[:] = 0.0
    state.along[:], still = [1.0, 0.0, 0.0], np.zeros((20, 3))
    for normal, share in (((0.0, 0.0, 1.0), 1.0), ((0.0, 1.0, 0.0), PLATES.edge_drag)):
        state.normal[:], state.velocity[:] = normal, 0.0
        for _ in range(3000):
            move(state, still, gas_k, np.ones(20), PLATES, 2e-3)
        np.testing.assert_allclose(-state.velocity[:, 2], steady_fall(state, share), rtol=0.01)


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
    assert (turning.froude(state, gas_k) > PLATES.critical_froude).all()
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


def test_slender_plates_turn_faster_up_to_that_of_two_dimensions():
    ratio = turning.tip_speed_ratio(np.array([0.5, 1.0, 4.0, 1e6]))
    assert (np.diff(ratio) > 0).all()
    assert ratio[1] == pytest.approx(0.455, abs=0.001)
    assert ratio[-1] == pytest.approx(1.0, abs=0.001)


def test_below_the_critical_froude_number_it_settles_broadside():
    state, gas_k, generator = sheets(CONFETTI, 40)
    wind = np.tile([1.0, 0.0, 0.0], (40, 1))
    state.along = np.tile([0.0, 1.0, 0.0], (40, 1))
    light = replace(PLATES, critical_froude=100.0)
    for _ in range(4000):
        turn(state, wind, gas_k, light, 0.0, 1e-3, generator)
    assert (np.abs(state.normal[:, 0]) > 0.99).all()
    assert (np.abs(state.spin_1_s) < 1.0).all()


@SHEETS
def test_normals_are_isotropic_at_the_lance_and_stay_so_without_wind(kind):
    state, gas_k, generator = sheets(kind, 4000)
    for _ in range(2):
        mean = state.normal.T @ state.normal / 4000
        np.testing.assert_allclose(mean, np.eye(3) / 3, atol=0.03)
        np.testing.assert_allclose(np.linalg.norm(state.normal, axis=1), 1.0)
        assert np.abs((state.normal * state.along).sum(axis=1)).max() < 1e-9
        for _ in range(20):
            turn(state, 0 * state.velocity, gas_k, PLATES, 0.1, 1e-3, generator)


@SHEETS
def test_flights_are_symmetric_to_the_side(kind):
    place = replace(Geometry(), lance_pixel=((1536 - 1) / 2, (2048 - 1) / 2))
    place = replace(
        DEEP, axis_far_mm=(0.0, 0.0, 8400.0), axis_height_mm=0.0, lance_pixel=place.lance_pixel
    )
    generator = np.random.default_rng(4)
    settings = replace(FLIGHT, longest_s=0.5, step_s=1e-3)
    flights = fly(kind.draw(600, generator), Gas(), place, generator, settings).cut()
    aside = flights.position_m[:, 100, 1]
    assert abs(np.mean(aside)) < 3 * np.std(aside) / np.sqrt(600)
    assert np.std(aside) > 0.02


def test_mirrored_it_moves_as_the_mirror_image():
    state, gas_k, generator = sheets(PAPER_SHREDS, 30)
    other, _, again = sheets(PAPER_SHREDS, 30)
    mirror = np.array([1.0, -1.0, 1.0])
    other.velocity, other.normal = other.velocity * mirror, other.normal * mirror
    other.along = other.along * mirror
    other.spin_1_s = -other.spin_1_s  # a spin is an axial vector
    for _ in range(200):
        for each, draws in ((state, generator), (other, again)):
            fall(each, gas_k, draws, 1e-3)
    np.testing.assert_allclose(other.velocity, state.velocity * mirror, atol=1e-9)


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


def test_of_a_disc_the_long_side_does_not_matter():
    generator = np.random.default_rng(1)
    normal = unit_vectors(generator.normal(size=(50, 3)))
    half, view = np.tile([3.0, 3.0, 0.05], (50, 1)), np.eye(3)[1:]
    shapes = [
        turning.projected_axes(normal, half, view, unit_vectors(np.cross(normal, others)))
        for others in generator.normal(size=(2, 50, 3))
    ]
    np.testing.assert_allclose(*shapes, atol=1e-9)


def test_edge_on_the_length_of_heat_transfer_is_surface_over_perimeter():
    state, gas_k, generator = sheets(CONFETTI, 1)
    state.spin_1_s[:], state.along[:] = 0.0, [0.0, 1.0, 0.0]
    lengths = []
    for normal in ([1.0, 0.0, 0.0], [0.0, 0.0, 1.0]):
        state.normal[:] = normal
        turn(state, np.array([[3.0, 0, 0]]), gas_k, PLATES, 0.0, 1e-9, generator)
        lengths.append(state.length_m[0])
    diameter = state.diameter_m[0]
    assert lengths[0] == pytest.approx(diameter / 2)
    assert lengths[1] == pytest.approx(np.pi * diameter / 4, rel=0.01)


@pytest.mark.parametrize("kind", FRACTIONS.values(), ids=lambda kind: kind.name)
def test_only_sheets_become_plates(kind):
    generator, settings = np.random.default_rng(3), Flight(longest_s=0.3)
    flown = fly(kind.draw(10, generator), Gas(), Geometry(), generator, settings).cut()
    turned = np.isfinite(flown.normal[..., 0])
    np.testing.assert_array_equal(turned, (flown.state >= 0) & kind.sheet)


def test_a_moment_holds_the_normal_of_sheets_alone():
    feed = (Burst("confetti", 20, -0.3), Burst("wood chip", 20, -0.3))
    life = live(feed, Gas(), Geometry(), FLIGHT, OnTheWall(), seed=2)
    moment = life.at(0.0501)
    sheet = (life.table["fraction"] == CONFETTI.name).to_numpy()[moment.particle]
    assert 0 < sheet.sum() < len(sheet)
    np.testing.assert_array_equal(np.isfinite(moment.normal).all(axis=1), sheet)
    np.testing.assert_allclose(np.linalg.norm(moment.normal[sheet], axis=1), 1.0, atol=1e-5)
    assert len(moment.take(sheet).normal) == sheet.sum()
    assert WOOD_CHIPS.name in set(life.table["fraction"])


def test_coefficients_that_make_no_sense_are_refused():
    for wrong in ({"edge_drag": 0.0}, {"critical_froude": -1.0}):
        with pytest.raises(InputError, match="Plates"):
            Plates(**wrong)
