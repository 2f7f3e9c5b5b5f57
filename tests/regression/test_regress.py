"""Regression of tracks with known t0, against its definition, and invariants."""

from itertools import product

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.definitions import plain_regression

from kilnflight import regression
from kilnflight.checks import InputError
from kilnflight.regression import Regression, fits, regress, regress_all
from kilnflight.tables import TRAJECTORIES

EXIT, RATE, SCATTER = (120.0, 60.0, 6500.0), 330.0, (7.0, 7.0, 150.0)
FACTORS = ((400.0, -300.0), (900.0, -4900.0), (-11_000.0, 6000.0))  # mm/s, mm/s^2


def flight(
    t0=0.1, points=60, lead=12, scatter=(0.0, 0.0, 0.0), factors=FACTORS, seed=0
):
    """Return a track that leaves the exit at t0 (s) on known polynomials."""
    frame = int(np.ceil(t0 * RATE)) + lead + np.arange(points)
    since = frame / RATE - t0
    places = np.stack(
        [np.polyval([*axis[::-1], 0.0], since) for axis in factors], axis=1
    )
    places += EXIT + np.random.default_rng(seed).normal(size=(points, 3)) * scatter
    return pd.DataFrame(
        {"frame": frame, "particle": 0} | dict(zip("xyz", places.T, strict=True))
    )


FAR = np.array(
    [20_000.0, 20_000.0, 20_000.0]
)  # no coordinate near 0: MAPE divides by it


def waves(orders, t0, weak=1.0):
    """Return a track of Legendre polynomials up to the given orders, each of the same
    variance.

    The highest polynomial of each axis has the share ``weak`` of the others' amplitude.
    """
    frame = int(np.ceil(t0 * RATE)) + 5 + np.arange(90)
    time = np.append(t0, frame / RATE)
    u = 2 * (time - time[1]) / (time[-1] - time[1]) - 1
    places = []
    for order in orders:
        sizes = 300.0 * np.sqrt(2.0 * np.arange(order + 1) + 1.0)
        sizes[order] *= weak
        curve = np.polynomial.legendre.legval(u, sizes)
        places.append(curve[1:] - curve[0])
    rows = np.stack(places, axis=1) + FAR
    return pd.DataFrame(
        {"frame": frame, "particle": 0} | dict(zip("xyz", rows.T, strict=True))
    )


@pytest.mark.parametrize("orders", list(product((2, 3), repeat=3)))
def test_the_known_orders_of_a_flight_are_found(orders):
    fit = regress(waves(orders, 0.3), FAR, RATE)
    assert fit.orders == orders
    assert fit.t0 == pytest.approx(0.3, abs=1e-6)


@given(st.lists(st.integers(2, 6), min_size=3, max_size=3))
def test_the_rule_finds_the_order_of_any_polynomials(orders):
    """Fitted axis by axis, as if t0 were known."""
    track = waves(orders, 0.3)
    time = (track["frame"] - track["frame"].mean()) / 45

    def measure(tried):
        fitted = [
            np.polyfit(time, track[a], k) for a, k in zip("xyz", tried, strict=True)
        ]
        curves = [np.polyval(each, time) for each in fitted]
        sides = zip("xyz", curves, tried, strict=True)
        return np.array(
            [regression.fit_measures(track[a].to_numpy(), c, k) for a, c, k in sides]
        )

    assert Regression().choose(measure, 7) == tuple(orders)


def test_an_order_that_one_measure_alone_rewards_is_not_taken():
    """The error halves, but R2 rises from .99 only: less than 1 %."""
    track = waves((2, 2, 3), 0.1, weak=0.13)
    stronger = waves((2, 2, 3), 0.1, weak=0.2)
    assert regress(stronger, FAR, RATE).orders == (2, 2, 3)
    assert regress(track, FAR, RATE).orders == (2, 2, 2)
    alone = Regression(measures=("rmse_mm",))
    assert regress(track, FAR, RATE, alone).orders == (2, 2, 3)
    for wrong in ((), ("speed",)):
        with pytest.raises(InputError, match="measures"):
            Regression(measures=wrong)


@pytest.mark.parametrize("orders", [(2, 2, 2), (2, 2, 4), (3, 2, 3)])
def test_the_definition_over_all_unknowns_finds_the_same_minimum(orders):
    track = flight(scatter=(2.0, 2.0, 30.0), seed=3)
    track.loc[20, "z"] += 700.0
    time, moved = (
        np.linspace(0, 1, len(track)),
        (track[list("xyz")].to_numpy() - EXIT).T,
    )
    limits, first = regression.range_of_start(time, moved, 5.0)
    start, fitted = regression.trajectory_solver(time, moved, 6, limits, first)(orders)
    peer = plain_regression.solve(time, moved.T, np.zeros(3), orders, first, limits)
    assert ((moved - fitted) ** 2).sum() == pytest.approx(2 * peer.cost, rel=1e-9)
    assert start == pytest.approx(peer.x[-1], abs=1e-4)


@pytest.mark.parametrize(
    ("first", "valley"), [(-0.1, -0.2), (-0.35, -0.2), (-0.7, -0.8)]
)
def test_the_minimum_is_the_one_downhill_of_the_first_guess(first, valley):
    time, limits = np.linspace(0, 1, 12), np.array([-1.2, -0.01])
    up_and_back, straight = (
        (time + 0.2) * (time + 0.8),
        0.001 * (time + 0.8),
    )  # -0.8 is deeper
    places = 100 * np.stack([straight, 0 * time, up_and_back])
    start, fitted = regression.trajectory_solver(time, places, 2, limits, first)(
        (1, 1, 2)
    )
    assert start == pytest.approx(valley, abs=0.01)
    assert (np.abs(fitted - places).max() > 1e-4) == (valley > -0.5)


def test_orders_rise_while_all_measures_gain_one_per_cent():
    table = np.ones((3, 9, 4)) * [10.0, 5.0, 0.5, 0.4]  # axis, order, measure
    better = np.array([0.98, 0.98, 1.02, 1.02])
    table[2, 3:] *= better
    table[2, 4:] *= better**0.4  # the second step gains too little
    table[0, 3:] *= better
    table[0, 3:, 2] *= 0.989  # too little in R2
    table[1, 3:] *= [0.5, 0.5, 1.5, np.nan]  # unknown

    def measure(orders):
        return np.array([table[axis, k] for axis, k in enumerate(orders)])

    assert Regression().choose(measure, 4) == (2, 2, 3)
    assert Regression().choose(measure, 2) == (2, 2, 2)
    assert Regression(measures=("rmse_mm",)).choose(measure, 4) == (3, 3, 3)
    assert Regression().choose(lambda _: np.zeros((3, 4)), 4) == (2, 2, 2)


@given(st.integers(0, 2**32 - 1), st.integers(-1000, 10_000))
def test_invariants_of_a_fit(seed, frames):
    track = flight(seed=seed, points=30, scatter=SCATTER)
    orders = Regression(highest=3)
    fit = regress(track, EXIT, RATE, orders)
    np.testing.assert_allclose(fit(fit.t0), [EXIT], atol=1e-9)
    assert (
        fit.first_s - 1.0
        <= fit.t0_range_s[0]
        <= fit.t0
        <= fit.t0_range_s[1]
        < fit.first_s
    )
    np.testing.assert_allclose(
        fit.velocity(fit.t0)[0], [axis[0] for axis in fit.coefficients]
    )
    slope = (fit([0.3 + 1e-6]) - fit([0.3 - 1e-6])) / 2e-6
    np.testing.assert_allclose(fit.velocity([0.3]), slope, rtol=1e-4, atol=0.1)
    later = track.assign(frame=track["frame"] + frames)
    shifted = regress(later, EXIT, RATE, orders)
    assert shifted.t0 == pytest.approx(fit.t0 + frames / RATE, abs=1e-6)
    mirrored = regress(track.assign(x=-track["x"]), (-EXIT[0], *EXIT[1:]), RATE, orders)
    assert mirrored.t0 == pytest.approx(fit.t0, abs=1e-9)


def test_the_range_of_t0_and_a_t0_outside_are_known():
    for t0 in np.linspace(0.0234, 0.9234, 10):
        track = flight(t0=t0)
        fit, around = regress(track, EXIT, RATE), t0 + np.array([-1, 1]) / RATE
        assert fit.t0 == pytest.approx(t0, abs=1e-8)
        assert fit.t0_range_s == pytest.approx(around, abs=1e-5)
    back = track.assign(
        z=2000 + (6500 - track["z"])
    )  # flies towards the lance, not from it
    assert regress(back, EXIT, RATE).t0_at_bound != 0
    assert (
        regress(flight(t0=-2.0, lead=700), EXIT, RATE).t0_at_bound == -1
    )  # unseen for 2.1 s
    assert (
        regress(flight(t0=0.1, lead=0), EXIT, RATE).t0_at_bound == 1
    )  # seen at the exit


def test_the_measures_are_the_equations():
    places, fitted = np.array([1.0, 2.0, 4.0, 3.0]), np.array([1.5, 2.0, 3.0, 3.0])
    r2 = 1 - 1.25 / 5
    expected = [np.sqrt(1.25 / 1), 100 / 4 * (0.5 + 0.25), r2, r2 - (1 - r2) * 2 / 1]
    np.testing.assert_allclose(regression.fit_measures(places, fitted, 2), expected)
    assert np.isnan(regression.fit_measures(np.zeros(5), np.ones(5), 2)[1:]).all()
    still = regress(flight(scatter=SCATTER).assign(x=150.0), EXIT, RATE)
    assert np.isnan([still.r2[0], still.r2_adjusted[0]]).all()
    assert np.isfinite([*still.rmse_mm, *still.r2[1:]]).all()


@pytest.mark.parametrize("order", [2, 7])
def test_a_fixed_order_needs_two_points_more(order):
    fixed = Regression(lowest=order, highest=order)
    fit = regress(flight(points=order + 2, scatter=SCATTER), EXIT, RATE, fixed)
    assert fit.orders == (order,) * 3
    with pytest.raises(InputError, match="track"):
        regress(flight(points=order + 1), EXIT, RATE, fixed)


def test_every_track_has_its_row_and_the_fits_come_back():
    parts = [flight(seed=k, t0=0.1 * k, scatter=SCATTER) for k in range(5)]
    parts[2][list("xyz")] = np.nan
    parts[3].loc[3:, "z"] = np.nan
    named = zip(parts, (7, 0, 3, 5, -1), strict=True)
    tracks = pd.concat(
        [part.assign(particle=name) for part, name in named], ignore_index=True
    )
    table = regress_all(tracks.sample(frac=1.0, random_state=1), EXIT, RATE)
    assert table["particle"].tolist() == [0, 3, 5, 7]
    assert table["outcome"].tolist() == [
        "fitted",
        "no depth",
        "too few points",
        "fitted",
    ]
    assert table["points"].tolist() == [60, 0, 3, 60]
    assert table.loc[1:2, "t0_s"].isna().all()
    pd.testing.assert_frame_equal(TRAJECTORIES.check(table), table)
    expected = {k: regress(tracks[tracks["particle"] == k], EXIT, RATE) for k in (0, 7)}
    assert fits(table) == expected
    assert fits(regress_all(tracks.iloc[:0], EXIT, RATE)) == {}
