"""Particles, slide, belt and contacts."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kilnflight.checks import InputError
from kilnflight.sorter.machine import BULKS, FEEDS, Bulk, Contacts, Conveyor, Slide

SPHERES, CUBOIDS = BULKS["spheres"], BULKS["cuboids"]


def test_densities_are_those_of_wood_and_counts_weigh_200_g():
    volumes_mm3 = {"spheres": 4 / 3 * np.pi * 2.5**3, "cuboids": 60.0}
    volumes_mm3["cylinders"] = np.pi * 1.5**2 * 9
    for name, bulk in BULKS.items():
        assert 700e-6 < bulk.density_g_mm3 < 830e-6
        assert bulk.density_g_mm3 * volumes_mm3[name] * bulk.count == pytest.approx(200.0)


def test_a_rolling_sphere_has_five_sevenths_of_the_energy_and_a_sliding_cuboid_what_is_left():
    slide = Slide(drop_mm=100.0, angle_deg=45.0, friction=0.4)
    free = 2 * 9810.0 * 100.0
    assert slide.speed(SPHERES)[0] ** 2 == pytest.approx(5 / 7 * free)
    assert slide.speed(CUBOIDS)[0] ** 2 == pytest.approx(0.6 * free)
    assert slide.speed(SPHERES)[1] == slide.speed(SPHERES)[0]
    assert slide.speed(CUBOIDS)[1] == 0.0


@given(st.floats(0.0, 0.9), st.floats(45.0, 85.0))
def test_a_sphere_is_never_slower_than_rolling_nor_turns_faster(friction, angle):
    speed, surface = Slide(friction=friction, angle_deg=angle).speed(SPHERES)
    assert speed**2 >= 5 / 7 * 2 * 9810.0 * 100.0 * (1 - 1e-12)
    assert 0.0 <= surface <= speed * (1 + 1e-12)


def test_on_a_smooth_slide_a_sphere_does_not_turn():
    assert Slide(friction=0.0).speed(SPHERES) == (pytest.approx(np.sqrt(2 * 9810.0 * 100)), 0.0)


def test_particles_come_in_order_within_the_feeder_s_width():
    slide = Slide()
    fed = slide(CUBOIDS, 2000, 180.0, np.random.default_rng(1))
    assert (np.diff(fed.time_s) >= 0).all()
    assert fed.y.min() > 20.0
    assert fed.y.max() < 160.0
    speed = np.hypot(fed.velocity_mm_s[:, 0], fed.velocity_mm_s[:, 2])
    assert speed.mean() == pytest.approx(slide.speed(CUBOIDS)[0], rel=0.01)
    assert speed.std() / speed.mean() == pytest.approx(slide.speed_spread, rel=0.1)


@pytest.mark.parametrize("share", [1.0, 0.25])
def test_particles_come_at_the_rate_of_the_whole_run_however_many(share):
    slide, bulk = Slide(), replace(SPHERES, count=40_000)
    time_s = slide(bulk, round(share * 40_000), 180.0, np.random.default_rng(2)).time_s / share
    assert time_s[0] == 0.0
    assert time_s.mean() == pytest.approx(slide.feed_mean_s, rel=0.04)  # the first is at 0
    assert time_s.std() == pytest.approx(slide.feed_std_s, rel=0.02)


@pytest.mark.parametrize("material", FEEDS)
def test_each_material_comes_with_its_own_entry_times(material):
    last, mean, spread = FEEDS[material]
    bulk = replace(BULKS[material], count=40_000)
    slide = Slide(drop_mm=80.0).feeding(material)
    assert replace(slide, feed_s=14.24, feed_mean_s=5.92, feed_std_s=3.14) == Slide(drop_mm=80.0)
    time_s = slide(bulk, 40_000, 180.0, np.random.default_rng(2)).time_s
    assert time_s.mean() == pytest.approx(mean, rel=0.04)
    assert time_s.std() == pytest.approx(spread, rel=0.02)
    assert 0.9 * last < time_s[-1] <= last


def test_a_slide_with_other_entry_times_keeps_them_and_spheres_have_the_default():
    twice = Slide(feed_s=7.12, feed_mean_s=2.96, feed_std_s=1.57)
    assert twice.feeding("cuboids") == twice
    assert Slide().feeding("spheres") == Slide()
    assert Slide().feeding("cuboids").feeding("cuboids") == Slide().feeding("cuboids")
    with pytest.raises(InputError, match="no material 'sand'"):
        Slide().feeding("sand")


def test_a_slide_on_which_nothing_slides_is_told():
    with pytest.raises(InputError, match="nothing slides down 20"):
        Slide(friction=0.5, angle_deg=20.0).speed(CUBOIDS)


def test_a_feeder_wider_than_the_belt_is_told():
    with pytest.raises(InputError, match="wider than the belt"):
        Slide(width_mm=200.0)(SPHERES, 3, 180.0, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("kind", "wrong"),
    [
        (Contacts, {"belt_friction": 0.0}),
        (Contacts, {"rolling_friction": -0.1}),
        (Slide, {"drop_mm": -1.0}),
        (Slide, {"speed_spread": float("nan")}),
        (Slide, {"exit_deg": 90.0}),
        (Slide, {"rolling_share": 1.5}),
        (Slide, {"feed_std_s": 8.0}),
        (Conveyor, {"start_mm": 900.0}),
        (Conveyor, {"step_s": 0.0003}),
        (Conveyor, {"sampling_hz": 0.0}),
    ],
)
def test_what_is_no_sorter_is_told(kind, wrong):
    with pytest.raises(InputError, match=kind.__name__):
        kind(**wrong)


def test_a_body_needs_the_lengths_of_its_shape():
    with pytest.raises(InputError, match="a sphere has one"):
        Bulk("sphere", (1.0, 2.0), 10)
    with pytest.raises(InputError, match="Bulk: half_mm"):
        Bulk("sphere", (-1.0,), 10)
