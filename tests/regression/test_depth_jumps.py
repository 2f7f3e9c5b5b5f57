"""Depths that jump: what a fit comes to then, and by what a user sees it.

Nothing is left out of a fit, and no fit is dropped: RMSE in depth, which counts every
detection, tells that depths jumped; the velocity tells what no particle can do.
"""

import numpy as np
import pandas as pd
import pytest

from kilnflight.flight import slices
from kilnflight.regression import Regression, fits, regress_all

EXIT, RATE, T0 = (120.0, 60.0, 6500.0), 330.0, 0.1
PLAIN, SCATTER = Regression(), (5.0, 5.0, 150.0)  # mm
ROBUST = Regression(robust=True, scale_mm=SCATTER)


def jumping(track, share, seed):
    """Let a share of the depths be those of something else, 3 m in front to 1.5 m behind."""
    draw = np.random.default_rng(seed)
    at = draw.random(len(track)) < share
    return track.assign(z=track["z"] + at * draw.uniform(-3000.0, 1500.0, len(track)))


def judged(track, parameters):
    """Return the row of the table and how far in mm the fit is from the true depth (RMS)."""
    table = regress_all(track, EXIT, RATE, parameters)
    assert table["outcome"].tolist() == ["fitted"]
    fit = fits(table)[0]
    time = np.linspace(fit.first_s, fit.last_s, 50)
    true = EXIT[2] - 11_000.0 * (time - T0) + 6000.0 * (time - T0) ** 2
    return table.iloc[0], np.sqrt(np.mean((fit(time)[:, 2] - true) ** 2))


def test_a_robust_loss_stays_near_the_truth_where_the_plain_one_does_not(flight):
    far = []
    for seed in range(8):
        track = jumping(flight(t0=T0, points=80, scatter=SCATTER, seed=seed), 0.15, seed)
        (robust, robust_mm), (plain, plain_mm) = judged(track, ROBUST), judged(track, PLAIN)
        far.append((robust_mm, plain_mm))
        assert robust_mm < min(plain_mm, 80.0)
        assert abs(robust["t0_s"] - T0) < 0.015
        for row in (robust, plain):  # both tell it: the measures count every detection
            assert row["rmse_z_mm"] > 2 * SCATTER[2]
    assert np.mean(far, axis=0)[1] > 2.5 * np.mean(far, axis=0)[0]


@pytest.mark.parametrize("parameters", [PLAIN, ROBUST])
def test_without_jumps_the_rmse_is_the_scatter(flight, parameters):
    row, _ = judged(flight(t0=T0, points=80, scatter=SCATTER), parameters)
    assert row["rmse_z_mm"] == pytest.approx(SCATTER[2], rel=0.25)


def test_half_a_track_at_another_depth_is_told_by_the_rmse(flight):
    track = flight(t0=T0, points=80, scatter=SCATTER)
    step = track.assign(z=track["z"] - np.where(track.index >= 40, 2000.0, 0.0))
    for parameters in (PLAIN, ROBUST):
        row, _ = judged(step, parameters)
        assert row["rmse_z_mm"] > 2 * SCATTER[2]


def test_a_speed_that_no_particle_has_fits_well_and_is_told_by_the_velocity(flight):
    factors = ((400.0, 0.0), (900.0, 0.0), (-150_000.0, 0.0))  # 0.45 m from frame to frame
    short = Regression(longest_s=0.05)  # as long as it may be unseen; in 1 s it flies 150 m
    table = regress_all(flight(t0=T0, points=8, lead=1, factors=factors), EXIT, RATE, short)
    assert table["outcome"].tolist() == ["fitted"]
    assert table["rmse_z_mm"].iloc[0] < 1e-3
    told = slices(fits(table))
    assert len(told) >= 3
    np.testing.assert_allclose(told["velocity_m_s"], 150.0, rtol=1e-3)


def test_one_jump_at_the_start_makes_metres_that_nobody_saw(flight):
    track = flight(t0=T0, points=60)
    track.loc[:2, "z"] -= 3000.0  # in front of all that follows
    found = pd.DataFrame(slices(fits(regress_all(track, EXIT, RATE))))
    assert not found["observed"].all()
