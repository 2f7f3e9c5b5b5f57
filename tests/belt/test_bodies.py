"""Single bodies in MuJoCo, for which mechanics gives the answer."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from kilnflight.belt import bodies
from kilnflight.belt.bodies import Batch, build_model, engine, missing_reason
from kilnflight.belt.machine import BULKS, Contacts, Conveyor, Feed
from kilnflight.belt.sorter import Sorter
from kilnflight.checks import InputError
from kilnflight.tables import BELT_BODIES

mujoco = pytest.importorskip("mujoco")
G = 9810.0
DRY = Contacts(belt_friction=0.2, rolling_friction=0.0)


def single_track(material, velocity=(1000.0, 0.0), spin=0.0, yaw=0.0, contacts=DRY, **conveyor):
    """Return the track of one particle that is put on the belt."""
    fed = Feed(
        np.zeros(1),
        np.full(1, 90.0),
        np.array([[*velocity, 0.0]]),
        np.full(1, spin),
        np.full(1, yaw),
    )
    belt = replace(Conveyor(), **conveyor)
    table = Batch(belt, contacts, BULKS[material], fed, np.zeros(1)).table()
    return table[table["x"] < belt.edge_mm]


def gain(table, first_s=0.03, last_s=0.1):
    """Return the acceleration along the belt between two times, after the fall of 0.2 mm."""
    rows = table[table["time_s"].between(first_s, last_s)]
    return np.polyfit(rows["time_s"], rows["velocity_x_mm_s"], 1)[0]


@pytest.mark.parametrize("material", BULKS)
def test_what_moves_with_the_belt_stays_as_it_is(material):
    table = single_track(material, velocity=(1500.0, 0.0))
    np.testing.assert_allclose(table["velocity_x_mm_s"], 1500.0, atol=0.5)
    np.testing.assert_allclose(table["y"], 90.0, atol=0.05)


@pytest.mark.parametrize("material", ["cuboids", "cylinders"])
def test_what_does_not_roll_gains_mu_g(material):
    assert gain(single_track(material)) == pytest.approx(0.2 * G, rel=0.02)


def test_a_sphere_without_rolling_friction_gains_two_sevenths_of_the_difference():
    end = single_track("spheres", edge_mm=1200.0, end_mm=1200.0)["velocity_x_mm_s"].iloc[-1]
    assert end == pytest.approx(1000.0 + 2 / 7 * 500.0, abs=1.0)


def test_a_cylinder_across_the_belt_gains_a_third_of_the_difference():
    end = single_track("cylinders", yaw=np.pi / 2, edge_mm=1200.0, end_mm=1200.0)[
        "velocity_x_mm_s"
    ].iloc[-1]
    assert end == pytest.approx(1000.0 + 1 / 3 * 500.0, abs=2.0)


def test_rolling_friction_slows_the_rolling_by_five_sevenths_of_its_share():
    """On a belt that drives it, a rolling sphere gains 5/7 c g, c the arm over the radius."""
    contacts = replace(DRY, rolling_friction=0.02)
    table = single_track("spheres", velocity=(1200.0, 0.0), spin=-120.0, contacts=contacts)
    assert gain(table, 0.1, 0.2) == pytest.approx(5 / 7 * 0.02 * G, rel=0.1)


@pytest.mark.parametrize("material", BULKS)
def test_what_lies_on_the_belt_is_never_inside_it(material):
    table = single_track(material, velocity=(1000.0, 100.0), yaw=0.4)
    assert table["z"].min() > BULKS[material].rest_mm - 0.02
    settled = table[table["time_s"] > 0.05]
    assert settled["z"].max() < BULKS[material].rest_mm + 0.02


def laid(material, slip, steps, contacts):
    """Return heights and slip of a body laid on the belt, step by step, in mm and mm/s."""
    model = build_model(BULKS[material], contacts, 1, Conveyor())
    data = mujoco.MjData(model)
    down = [np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0] if material == "cylinders" else [1.0, 0, 0, 0]
    data.qpos[:] = [400.0, 90.0, BULKS[material].rest_mm, *down]
    data.qvel[0] = 1500.0 - slip
    way = np.empty((steps, 2))
    for row in way:
        mujoco.mj_step(model, data)
        row[:] = data.qpos[2] - BULKS[material].rest_mm, 1500.0 - data.qvel[0]
    return way.T


@pytest.mark.parametrize("material", BULKS)
def test_what_is_laid_on_the_belt_does_not_hop(material):
    height, _ = laid(material, 500.0, 500, Contacts())
    assert np.abs(height).max() < 0.01
    equal = replace(Contacts(), slip_time_s=Contacts.belt_time_s)
    assert laid(material, 500.0, 500, equal)[0].max() > 0.1  # the reason for the slip time


def test_the_last_slip_fades_over_four_milliseconds():
    _, slip = laid("cuboids", 6.0, 40, Contacts())  # half of mu g / b_t
    assert slip[19] == pytest.approx(6.0 / np.e, rel=0.1)


def restitution(step_s, closing=100.0):
    """Return relative speeds after and before two spheres meet, by the moment of meeting."""
    model = build_model(
        BULKS["spheres"], Contacts(particle_friction=0.0), 2, Conveyor(step_s=step_s)
    )
    model.opt.gravity[:] = 0.0
    shares = []
    for part in np.linspace(0.0, 1.0, 5):
        data = mujoco.MjData(model)
        apart = 5.0 + (5.0 + part) * closing * step_s
        data.qpos.reshape(2, 7)[:, :3] = [[0.0, 90.0, 500.0], [apart, 90.0, 500.0]]
        data.qvel[0] = closing
        mujoco.mj_step(model, data, round(0.02 / step_s))
        shares.append((data.qvel[6] - data.qvel[0]) / closing)
    return min(shares), max(shares)


@pytest.mark.parametrize(("step_s", "low", "high"), [(0.0002, 0.2, 0.36), (0.00005, 0.27, 0.32)])
def test_restitution_is_as_documented_and_scatters_less_with_shorter_steps(step_s, low, high):
    least, most = restitution(step_s)
    assert low < least < most < high


def test_a_wall_keeps_a_particle_on_the_belt():
    table = single_track("spheres", velocity=(600.0, 900.0))
    assert table["y"].max() < 180.0 - 2.3  # pressed 0.2 mm into the wall
    assert table["y"].iloc[-1] < 175.0


def test_beyond_the_edge_the_velocity_stays():
    fed = Feed(
        np.zeros(1), np.full(1, 90.0), np.array([[1000.0, 40.0, 0.0]]), np.zeros(1), np.zeros(1)
    )
    table = Batch(Conveyor(), DRY, BULKS["cuboids"], fed, np.zeros(1)).table()
    flight = table[table["x"] >= 788.0]
    assert len(flight) >= 8
    np.testing.assert_allclose(np.diff(flight["x"]), flight["velocity_x_mm_s"].iloc[0] / 1000.0)
    assert table.columns.tolist() == BELT_BODIES.names


def test_two_at_one_place_come_one_after_the_other():
    fed = Feed(
        np.zeros(2), np.full(2, 90.0), np.tile([1000.0, 0.0, 0.0], (2, 1)), np.zeros(2), np.zeros(2)
    )
    table = Batch(Conveyor(), DRY, BULKS["spheres"], fed, np.zeros(2)).table()
    first = table.groupby("particle")["frame"].first()
    assert first[0] == 0
    assert first[1] == pytest.approx(5, abs=1)  # a diameter of 5 mm at 1000 mm/s


def test_a_particle_that_does_not_leave_is_refused():
    slow = replace(DRY, belt_friction=1e-6)
    with pytest.raises(InputError, match="particle 0 has not left the belt after"):
        single_track("cuboids", velocity=(10.0, 0.0), contacts=slow, patience_s=0.3)


def test_halving_the_step_moves_a_particle_by_ever_less():
    steps = [single_track("cylinders", yaw=0.5, step_s=step) for step in (0.0002, 0.0001, 0.00005)]
    away = []
    for coarse, fine in pairwise(steps):
        both = coarse.merge(fine, on="frame")
        off = (both["velocity_x_mm_s_x"] - both["velocity_x_mm_s_y"]).abs().iloc[-50:].max()
        away.append(((both["x_x"] - both["x_y"]).abs().max(), off))
    assert away[0][0] < 0.8  # mm over 400
    assert away[0][1] < 4.5  # mm/s of 1410: three in a thousand
    assert away[1][1] < 0.7 * away[0][1]  # half, if the error is of first order


def test_missing_or_old_mujoco_is_refused(monkeypatch):
    import sys

    assert missing_reason() == ""
    monkeypatch.delattr(mujoco.MjModel, "geom_surfacevel")
    assert "needs MuJoCo 4" in missing_reason()
    assert "not installed" not in missing_reason()
    with pytest.raises(InputError, match="needs MuJoCo 4"):
        engine()
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(InputError, match=r"pip install 'kilnflight\[sorter\]'"):
        engine()


@pytest.mark.parametrize("material", BULKS)
def test_nothing_depends_on_how_many_bodies_there_are_at_first(material, monkeypatch):
    bulk = BULKS[material]
    known = Sorter()(bulk, 40, np.random.default_rng(3))
    monkeypatch.setattr(bodies, "POOL", 12)  # fewer than 10: the engine has dense matrices
    monkeypatch.setattr(bodies, "POOL_STEP", 7)
    assert Sorter()(bulk, 40, np.random.default_rng(3)).equals(known)


def test_more_bodies_keep_settings_and_warnings(monkeypatch):
    monkeypatch.setattr(bodies, "POOL", 1)
    fed = Feed(np.zeros(2), np.full(2, 90.0), np.zeros((2, 3)), np.zeros(2), np.zeros(2))
    batch = Batch(Conveyor(), DRY, BULKS["spheres"], fed, np.zeros(2))
    batch.model.pair_solimp[:, :2] = 0.95
    batch.data.warning.number[0] = 1
    batch._grow()
    assert len(batch.particle) == 2
    np.testing.assert_array_equal(batch.model.pair_solimp[:, :2], 0.95)
    with pytest.raises(InputError, match="unstable"):
        batch._check(0)
