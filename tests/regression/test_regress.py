"""Tracks whose t0 is known, and what holds for any track."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kilnflight.flight import slices
from kilnflight.regression import Regression, fits, regress, regress_all

EXIT, RATE = (120.0, 60.0, 6500.0), 330.0
SCATTER = (7.0, 7.0, 150.0)
ROBUST = Regression(robust=True, scale_mm=(10.0, 10.0, 150.0))
few = settings(max_examples=15, deadline=None)
seeds = st.integers(0, 2**32 - 1)


@pytest.mark.parametrize("robust", [False, True])
def test_a_flight_without_scatter_is_recovered(flight, robust):
    track = flight(t0=0.1234)
    fit = regress(track, EXIT, RATE, Regression(robust=robust))
    assert fit.t0 == pytest.approx(0.1234, abs=1e-8)
    assert (fit.t0_at_bound, fit.orders, fit.points) == (0, (2, 2, 2), 60)
    expected = ((400.0, -300.0), (900.0, -4900.0), (-11_000.0, 6000.0))
    np.testing.assert_allclose(fit.coefficients, expected, rtol=1e-5)
    np.testing.assert_allclose(fit.rmse_mm, 0, atol=1e-6)
    np.testing.assert_allclose([fit.r2, fit.r2_adjusted], 1, atol=1e-12)


@given(st.lists(st.integers(2, 6), min_size=3, max_size=3), st.floats(0.0, 1.0))
@few
def test_the_orders_of_a_flight_without_scatter_are_found(flight, orders, t0):
    slow = (500.0, 900.0, -9000.0)
    factors = [[v, *[v * (-2.0) ** (k - 1) / k for k in range(2, n + 1)]] for v, n in
               zip(slow, orders, strict=True)]  # fmt: skip
    track = flight(t0=t0, points=90, lead=5, factors=factors)
    fixed = [replace(Regression(), lowest=max(orders), highest=max(orders))]
    for parameters in [Regression(), *fixed]:
        fit = regress(track, EXIT, RATE, parameters)
        scatter = np.array([0.5, 0.5, 10.0])  # 1 % of what order 2 leaves may stay
        assert (np.array(fit.rmse_mm) < scatter).all()
    assert fit.t0 == pytest.approx(t0, abs=1e-4)


@given(seeds, st.sampled_from([Regression(), ROBUST]))
@few
def test_it_passes_the_exit_before_the_first_detection(flight, seed, parameters):
    parameters = replace(parameters, highest=3)
    track = flight(seed=seed, points=30, scatter=SCATTER)
    fit = regress(track, EXIT, RATE, parameters)
    np.testing.assert_allclose(fit(fit.t0), [EXIT], atol=1e-9)
    assert fit.first_s - 1.0 <= fit.t0_range_s[0] <= fit.t0 <= fit.t0_range_s[1] < fit.first_s
    np.testing.assert_allclose(fit.velocity(fit.t0)[0], [axis[0] for axis in fit.coefficients])
    step = 1e-6
    slope = (fit([0.3 + step]) - fit([0.3 - step])) / (2 * step)
    np.testing.assert_allclose(fit.velocity([0.3]), slope, rtol=1e-4, atol=0.1)


@given(seeds, st.integers(-1000, 10_000))
@few
def test_a_shift_in_time_shifts_t0(flight, seed, frames):
    track = flight(seed=seed, scatter=SCATTER)
    later = track.assign(frame=track["frame"] + frames)
    first, other = regress(track, EXIT, RATE), regress(later, EXIT, RATE)
    assert other.t0 == pytest.approx(first.t0 + frames / RATE, abs=1e-6)
    assert other.orders == first.orders
    np.testing.assert_allclose(other.rmse_mm, first.rmse_mm, rtol=1e-5)


@given(seeds, st.sampled_from("xyz"))
@few
def test_a_mirrored_axis_mirrors_its_polynomial(flight, seed, axis):
    track = flight(seed=seed, scatter=SCATTER)
    signs = np.where(np.array(list("xyz")) == axis, -1.0, 1.0)
    first = regress(track, EXIT, RATE)
    other = regress(track.assign(**{axis: -track[axis]}), signs * EXIT, RATE)
    assert other.t0 == pytest.approx(first.t0, abs=1e-9)
    time = np.linspace(first.first_s, first.last_s, 7)
    np.testing.assert_allclose(other(time), signs * first(time), atol=1e-5)


@given(seeds)
@few
def test_shuffled_rows_and_the_same_seed_give_the_same_bytes(flight, seed):
    track = flight(seed=seed, scatter=SCATTER)
    shuffled = track.sample(frac=1.0, random_state=seed % 1000)
    assert regress(shuffled, EXIT, RATE) == regress(track, EXIT, RATE)


def test_the_clock_may_be_seconds(flight):
    track = flight()
    timed = track.assign(time_s=track["frame"] / RATE).drop(columns=["frame", "particle"])
    assert regress(timed, EXIT) == regress(track, EXIT, RATE)


def test_depth_jumps_are_borne_by_a_robust_loss(flight):
    track = flight(t0=0.1, scatter=(2.0, 2.0, 20.0))
    track.loc[[5, 17, 30, 31, 50], "z"] += [1500.0, -2000.0, 1500.0, 1800.0, -2500.0]
    robust = regress(track, EXIT, RATE, replace(ROBUST, scale_mm=(2.0, 2.0, 20.0)))
    plain = regress(track, EXIT, RATE)
    assert abs(robust.t0 - 0.1) < 0.004 < abs(plain.t0 - 0.1)
    assert robust.rmse_mm[2] > 400  # the measures count every detection


def test_a_t0_that_its_range_does_not_hold_is_marked(flight):
    track = flight(t0=0.1)
    back = track.assign(z=2000 + (6500 - track["z"]))  # flies towards the lance, not from it
    assert regress(back, EXIT, RATE).t0_at_bound != 0
    assert regress(track, EXIT, RATE, Regression(longest_s=0.01)).t0_at_bound == -1
    assert regress(flight(t0=0.1, lead=0), EXIT, RATE).t0_at_bound == 1  # seen at the exit


def test_the_weights_of_the_axes_are_the_callers(flight):
    track = flight(scatter=SCATTER)
    printed = regress(track, EXIT, RATE)
    same = regress(track, EXIT, RATE, Regression(scale_mm=(5.0, 5.0, 5.0)))
    assert same.t0 == pytest.approx(printed.t0, abs=1e-8)
    weighted = regress(track, EXIT, RATE, Regression(scale_mm=SCATTER))
    assert abs(weighted.t0 - printed.t0) > 1e-5


EXIT, RATE, T0 = (120.0, 60.0, 6500.0), 330.0, 0.1
PLAIN, SPREAD = Regression(), (5.0, 5.0, 150.0)  # mm
WEIGHED = Regression(robust=True, scale_mm=SPREAD)


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
        track = jumping(flight(t0=T0, points=80, scatter=SPREAD, seed=seed), 0.15, seed)
        (robust, robust_mm), (plain, plain_mm) = judged(track, WEIGHED), judged(track, PLAIN)
        far.append((robust_mm, plain_mm))
        assert robust_mm < min(plain_mm, 80.0)
        assert abs(robust["t0_s"] - T0) < 0.015
        for row in (robust, plain):  # both tell it: the measures count every detection
            assert row["rmse_z_mm"] > 2 * SPREAD[2]
    assert np.mean(far, axis=0)[1] > 2.5 * np.mean(far, axis=0)[0]


@pytest.mark.parametrize("parameters", [PLAIN, WEIGHED])
def test_without_jumps_the_rmse_is_the_scatter(flight, parameters):
    row, _ = judged(flight(t0=T0, points=80, scatter=SPREAD), parameters)
    assert row["rmse_z_mm"] == pytest.approx(SPREAD[2], rel=0.25)


def test_half_a_track_at_another_depth_is_shown_by_the_rmse(flight):
    track = flight(t0=T0, points=80, scatter=SPREAD)
    step = track.assign(z=track["z"] - np.where(track.index >= 40, 2000.0, 0.0))
    for parameters in (PLAIN, WEIGHED):
        row, _ = judged(step, parameters)
        assert row["rmse_z_mm"] > 2 * SPREAD[2]


def test_a_speed_that_no_particle_has_fits_well_and_is_shown_by_the_velocity(flight):
    factors = ((400.0, 0.0), (900.0, 0.0), (-150_000.0, 0.0))  # 0.45 m from frame to frame
    short = Regression(longest_s=0.05)  # as long as it may be unseen; in 1 s it flies 150 m
    table = regress_all(flight(t0=T0, points=8, lead=1, factors=factors), EXIT, RATE, short)
    assert table["outcome"].tolist() == ["fitted"]
    assert table["rmse_z_mm"].iloc[0] < 1e-3
    sliced = slices(fits(table))
    assert len(sliced) >= 3
    np.testing.assert_allclose(sliced["velocity_m_s"], 150.0, rtol=1e-3)


def test_one_jump_at_the_start_makes_metres_that_nobody_saw(flight):
    track = flight(t0=T0, points=60)
    track.loc[:2, "z"] -= 3000.0  # in front of all that follows
    table = pd.DataFrame(slices(fits(regress_all(track, EXIT, RATE))))
    assert not table["observed"].all()
