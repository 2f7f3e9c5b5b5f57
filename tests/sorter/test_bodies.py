"""Single bodies in MuJoCo, for which mechanics gives the answer."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from kilnflight.checks import InputError
from kilnflight.sorter import bodies
from kilnflight.sorter.bodies import Batch, build_model, engine, missing_reason
from kilnflight.sorter.machine import BULKS, Contacts, Conveyor, Feed, Slide
from kilnflight.sorter.simulation import Sorter
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
    assert np.abs(height).max() < 0.02
    equal = replace(Contacts(), slip_time_s=Contacts.belt_time_s)
    assert laid(material, 500.0, 500, equal)[0].max() > 0.05  # the reason for the slip time


def test_the_last_slip_fades_over_two_milliseconds():
    _, slip = laid("cuboids", 3.0, 40, Contacts())  # half of mu g / b_t
    assert slip[9] == pytest.approx(3.0 / np.e, rel=0.1)


def passing(material, **times):
    """Return velocities 60 mm after five landings at different moments of a step."""
    contacts = replace(Contacts(), belt_friction=0.18, rolling_friction=0.03, **times)
    slide, bulk = Slide(drop_mm=75.0, exit_deg=15.0), BULKS[material]
    speed, surface = slide.speed(bulk)
    along, down = speed * np.cos(np.radians(15.0)), speed * np.sin(np.radians(15.0))
    velocity = np.column_stack([np.full(5, along), np.zeros(5), -down + np.linspace(0.0, 2.0, 5)])
    places, spin = np.linspace(30.0, 150.0, 5), np.full(5, surface / bulk.half_mm[0])
    fed = Feed(np.zeros(5), places, velocity, spin, np.full(5, 0.3))
    belt = Conveyor(step_s=0.0001, edge_mm=460.0, end_mm=460.0)
    table = Batch(belt, contacts, bulk, fed, np.zeros(5)).table()
    tracks = table.groupby("particle")
    return np.array([np.interp(450.0, part["x"], part["velocity_x_mm_s"]) for _, part in tracks])


@pytest.mark.parametrize("material", BULKS)
def test_a_landing_hardly_depends_on_the_times_of_its_contact(material):
    """Friction takes part in the push to its limit: half and twice change little."""
    known = passing(material).mean()
    for name in ("belt_time_s", "slip_time_s"):
        for factor in (0.5, 2.0):
            changed = passing(material, **{name: factor * getattr(Contacts, name)})
            assert changed.mean() == pytest.approx(known, abs=5.0)
            assert np.abs(changed - known).max() < 9.0
    assert abs(passing(material, belt_time_s=0.0003, slip_time_s=0.016).mean() - known) > 10.0


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


def both_fed(material, y, yaw):
    """Return first frames of two particles due at once at places across the belt."""
    velocity = np.tile([1000.0, 0.0, 0.0], (2, 1))
    fed = Feed(np.zeros(2), np.array(y), velocity, np.zeros(2), np.full(2, yaw))
    table = Batch(Conveyor(), DRY, BULKS[material], fed, np.zeros(2)).table()
    return table.groupby("particle")["frame"].first().tolist()


def test_particles_may_come_side_by_side_and_touch_but_not_overlap():
    assert both_fed("cylinders", [90.0, 93.001], 0.0) == [0, 0]  # 3 mm thick, along the belt
    assert both_fed("cylinders", [90.0, 92.9], 0.0)[1] > 3
    assert both_fed("cylinders", [90.0, 98.5], np.pi / 2)[1] > 0  # 9 mm long, across it
    assert both_fed("cuboids", [90.0, 95.001], 0.0) == [0, 0]
    assert both_fed("spheres", [90.0, 95.001], 0.0) == [0, 0]


def test_who_waits_for_a_place_is_passed():
    velocity = np.tile([1000.0, 0.0, 0.0], (3, 1))
    fed = Feed(np.zeros(3), np.array([90.0, 90.0, 60.0]), velocity, np.zeros(3), np.zeros(3))
    table = Batch(Conveyor(), DRY, BULKS["spheres"], fed, np.zeros(3)).table()
    first = table.groupby("particle")["frame"].first()
    assert (first[0], first[2]) == (0, 0)
    assert first[1] > 3


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
