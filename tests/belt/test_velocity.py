import numpy as np
import pandas as pd
import pytest

from kilnflight.belt.velocity import motion_profile, velocities, velocity_profile
from kilnflight.tables import BELT_TRACKS


def test_velocity_between_two_observations_stands_at_their_midpoint(constant_acceleration):
    steps = velocities(constant_acceleration)
    first = steps.iloc[0]
    assert first["velocity_x_mm_s"] == pytest.approx(1000.0 + 1500.0 * 0.005)
    x = constant_acceleration["x"]
    assert first["x"] == pytest.approx((x[0] + x[1]) / 2)


def test_no_velocity_across_a_gap_or_between_particles(constant_acceleration):
    whole = velocities(constant_acceleration)
    assert len(whole) == len(constant_acceleration) - 3
    assert (whole["velocity_x_mm_s"] > 0).all()
    assert len(velocities(constant_acceleration.drop(index=[5]))) == len(whole) - 2


def test_the_profile_is_mean_and_spread_of_those_seen_there(constant_acceleration):
    steps = velocities(constant_acceleration)
    grid = np.array([350.0, 500.0, 700.0])
    profile = velocity_profile(steps, grid)
    expected = [
        np.interp(500.0, one["x"], one["velocity_x_mm_s"]) / 1000
        for _, one in steps.groupby("particle")
    ]
    assert profile["particles"].tolist() == [0, 3, 3]
    assert profile["mean_m_s"][1] == pytest.approx(np.mean(expected))
    assert profile["std_m_s"][1] == pytest.approx(np.std(expected, ddof=1))
    assert np.isnan(profile["mean_m_s"][0])


def test_no_tracks_give_an_empty_profile():
    steps = velocities(BELT_TRACKS.empty())
    profile = velocity_profile(steps, np.array([500.0]))
    assert isinstance(profile, pd.DataFrame)
    assert profile["particles"].tolist() == [0]


def test_the_motion_profile_has_the_median_of_absolute_velocities_across(constant_acceleration):
    steps = velocities(constant_acceleration)
    profile = motion_profile(steps, np.array([350.0, 500.0]))
    across = [
        np.interp(500.0, one["x"], one["velocity_y_mm_s"]) / 1000
        for _, one in steps.groupby("particle")
    ]
    assert profile["lateral_m_s"][1] == pytest.approx(np.median(np.abs(across)))
    assert profile["lateral_std_m_s"][1] == pytest.approx(np.std(across, ddof=1))
    assert profile.loc[0, ["lateral_m_s", "lateral_std_m_s"]].isna().all()
    assert motion_profile(velocities(BELT_TRACKS.empty()), np.array([500.0]))["particles"][0] == 0
