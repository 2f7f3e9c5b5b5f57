from dataclasses import replace

import numpy as np
import pytest

from kilnflight.belt.models import BELT_VELOCITY_MM_S
from kilnflight.simulated.belt.friction import GRAVITY_MM_S2, MATERIALS, FrictionBelt
from kilnflight.tables import BELT_TRACKS

# One row of particles without collisions, spread or rolling friction: closed forms
# apply.
QUIET = FrictionBelt(
    particles=20,
    velocity_spread_mm_s=0.0,
    lateral_spread_mm_s=0.0,
    kicks_per_s=0.0,
    rolling_friction=0.0,
)


def run(belt, seed=0):
    return belt(np.random.default_rng(seed))


def final_velocity(tracks):
    steps = tracks.groupby("particle")[["x", "y", "time_s"]].diff().dropna()
    rates = steps[["x", "y"]].div(steps["time_s"], axis=0)
    return rates.groupby(tracks["particle"]).last()


def test_a_cuboid_gains_mu_g_until_it_moves_with_the_belt():
    tracks = run(QUIET)
    first = tracks.groupby("particle").first()
    time = tracks["time_s"] - tracks["particle"].map(first["time_s"])
    gain = QUIET.friction * GRAVITY_MM_S2
    expected = (
        tracks["particle"].map(first["x"])
        + QUIET.velocity_mm_s * time
        + gain * time**2 / 2
    )
    before = QUIET.velocity_mm_s + gain * time < BELT_VELOCITY_MM_S
    np.testing.assert_allclose(tracks["x"][before], expected[before], atol=0.3)


def test_a_cuboid_ends_with_the_belt():
    long = replace(QUIET, end_mm=3000.0)
    np.testing.assert_allclose(final_velocity(run(long))["x"], 1500.0, rtol=1e-6)


def test_a_sphere_that_does_not_roll_yet_gains_two_sevenths_of_the_difference():
    """Rolling without slip: v = v0 + 2/7 (v_belt - v0), whatever the friction."""
    for friction in (0.1, 0.5):
        sphere = replace(QUIET, inertia=0.4, friction=friction, end_mm=3000.0)
        expected = 923.0 + 2 / 7 * (1500.0 - 923.0)
        np.testing.assert_allclose(
            final_velocity(run(sphere))["x"], expected, rtol=1e-6
        )


def test_rolling_friction_brings_a_sphere_to_the_belt():
    sphere = replace(QUIET, inertia=0.4, rolling_friction=0.05, end_mm=5000.0)
    np.testing.assert_allclose(final_velocity(run(sphere))["x"], 1500.0, rtol=1e-3)


def test_lateral_motion_ends_on_the_belt_but_not_for_a_rolling_sphere():
    wide = {"lateral_spread_mm_s": 100.0, "end_mm": 3000.0}
    cuboid = final_velocity(run(replace(QUIET, **wide)))
    np.testing.assert_allclose(cuboid["y"], 0.0, atol=1e-6)
    sphere = final_velocity(run(replace(QUIET, inertia=0.4, **wide)))
    assert (sphere["y"].abs() > 1.0).mean() > 0.8


@pytest.mark.parametrize("material", MATERIALS, ids=str)
def test_a_finer_step_changes_little(material):
    quiet = replace(MATERIALS[material], particles=50, kicks_per_s=0.0)
    coarse, fine = (run(replace(quiet, steps_per_sample=steps)) for steps in (20, 80))
    both = coarse.merge(fine, on=["particle", "frame"])
    assert (both["x_x"] - both["x_y"]).abs().max() < 0.2  # mm, over 0.4 m
    assert (both["y_x"] - both["y_y"]).abs().max() < 0.2


@pytest.mark.parametrize("material", MATERIALS, ids=str)
def test_tracks_are_whole_and_pass_the_check(material):
    tracks = run(replace(MATERIALS[material], particles=100))
    BELT_TRACKS.check(tracks)
    assert tracks["particle"].nunique() == 100
    assert (tracks.groupby("particle")["frame"].diff().dropna() == 1).all()
    assert (tracks.groupby("particle")["x"].max() > 788.0).all()
