"""The search over t0 against scipy over all unknowns, and the choice of orders."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from kilnflight.regression import (
    Regression,
    loss,
    range_of_start,
    residuals,
    trajectory_solver,
)

EXIT, SCATTER = np.array([120.0, 60.0, 6500.0]), np.array([2.0, 2.0, 30.0])


@pytest.mark.parametrize("orders", [(2, 2, 2), (2, 2, 4), (3, 2, 3)])
@pytest.mark.parametrize("loss", ["linear", "soft_l1"])
def test_scipy_over_all_unknowns_finds_the_same(flight, plain, loss, orders):
    track = flight(scatter=SCATTER, seed=3)
    track.loc[20, "z"] += 700.0
    time = np.linspace(0, 1, 60)
    moved = ((track[list("xyz")].to_numpy() - EXIT) / SCATTER).T
    limits, first = range_of_start(time, moved, 20, 5.0, np.random.default_rng(0))
    solution = trajectory_solver(time, moved, 6, limits, first, loss == "soft_l1")(orders)
    peer = plain.solve(time, moved.T, np.zeros(3), orders, first, limits, loss=loss)
    assert solution.costs.sum() == pytest.approx(2 * peer.cost, rel=1e-9)
    assert solution.start == pytest.approx(peer.x[-1], abs=1e-4)


@pytest.mark.parametrize("seed", range(4, 12))
def test_the_cost_of_every_order_is_that_of_its_own_fit(flight, seed):
    track = flight(scatter=SCATTER, seed=seed)
    time, moved = np.linspace(0, 1, 60), (track[list("xyz")].to_numpy() - EXIT).T
    solve = trajectory_solver(time, moved, 6, np.array([-1.0, -0.1]), -0.2)
    for order in range(1, 7):
        solution = solve((order,) * 3)
        powers = (time - solution.start)[:, None] ** np.arange(1, order + 1)
        squares = [np.linalg.lstsq(powers, axis)[1][0] for axis in moved]
        np.testing.assert_allclose(solution.costs, squares, rtol=1e-9)


@pytest.mark.parametrize("robust", [False, True])
@pytest.mark.parametrize(("first", "valley"), [(-0.1, -0.2), (-0.35, -0.2), (-0.7, -0.8)])
def test_the_minimum_is_the_one_downhill_of_the_first_guess(first, valley, robust):
    """Sec. 4.3: a trust region from a start; this parabola passes the exit at two times."""
    time, limits = np.linspace(0, 1, 12), np.array([-1.2, -0.01])
    up_and_back, straight = (time + 0.2) * (time + 0.8), 0.001 * (time + 0.8)  # -0.8 is deeper
    places = 100 * np.stack([straight, 0 * time, up_and_back])
    solve = trajectory_solver(time, places, 2, limits, first, robust)
    solution = solve((1, 1, 2))
    assert solution.start == pytest.approx(valley, abs=0.01)
    deepest = trajectory_solver(time, places, 2, limits, -0.8, robust)((1, 1, 2))
    assert deepest.costs.sum() < 1e-9
    assert (solution.costs.sum() > 1e-6) == (valley > -0.5)


@given(st.floats(-1e3, 1e3), st.booleans())
def test_the_losses_are_those_of_scipy(left, robust):
    peer = least_squares(
        lambda _: [left], [0.0], loss="soft_l1" if robust else "linear", max_nfev=1
    )
    assert loss(np.array([left]), robust) == pytest.approx(2 * peer.cost, rel=1e-9, abs=1e-12)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.booleans(), st.integers(1, 4))
def test_at_the_best_of_each_order_the_slope_of_the_loss_vanishes(seed, robust, order):
    """The derivative by each factor: what is left, weighted as the loss does, against the basis."""
    rng = np.random.default_rng(seed)
    time, place = np.linspace(0, 1, 40), np.linspace(0, -3, 40) + rng.normal(size=40)
    place[7] += 20.0
    basis = np.linalg.qr((time + 0.4)[:, None] ** np.arange(1, order + 1))[0]
    left = residuals(basis[None], place, robust)[0]
    step = 1e-4
    for column in basis.T:
        rise = loss(left + step * column, robust) - loss(left - step * column, robust)
        assert rise / (2 * step) == pytest.approx(0, abs=1e-3)


def test_three_random_points_give_the_range_of_a_flight_without_scatter(flight):
    track = flight(t0=0.1)
    time, moved = np.linspace(0, 1, 60), (track[list("xyz")].to_numpy() - EXIT).T
    frame = track["frame"].to_numpy()
    true = (0.1 * 330 - frame[0]) / (frame[-1] - frame[0])
    limits, first = range_of_start(time, moved, 20, 5.0, np.random.default_rng(0))
    assert first == pytest.approx(true, abs=1e-6)
    assert limits == pytest.approx([true - 1 / 59, true + 1 / 59], abs=1e-5)


def test_orders_go_up_while_the_gain_is_one_per_cent():
    free = 60 - np.arange(7) - 1.0  # cost of RMSE 1 by order
    shares = np.ones((3, 7))
    choose = Regression(highest=4).choose

    def costs(orders):
        return np.array([shares[axis, k] * free[k] for axis, k in enumerate(orders)])

    assert choose(costs, 4, 60) == (2, 2, 2)
    shares[2, 3:] *= 0.98**2
    shares[2, 4:] *= 0.992**2  # the second step gains too little
    shares[0, 3:] *= 0.985**2
    assert choose(costs, 4, 60) == (3, 2, 3)
    assert choose(costs, 2, 60) == (2, 2, 2)
    assert choose(lambda _: np.zeros(3), 4, 60) == (2, 2, 2)


def test_few_combinations_are_solved_to_choose_the_orders(flight):
    """Chosen as from a table of all 27, by the rule in plain code."""
    track = flight(scatter=SCATTER, seed=4)
    time, moved = np.linspace(0, 1, 60), (track[list("xyz")].to_numpy() - EXIT).T
    limits, first = range_of_start(time, moved, 20, 5.0, np.random.default_rng(0))
    solve, asked = trajectory_solver(time, moved, 4, limits, first), {}

    def costs(orders):
        return asked.setdefault(orders, solve(orders).costs)

    chosen = Regression(highest=4).choose(costs, 4, 60)
    assert len(asked) < 27
    every = {orders: solve(orders).costs for orders in product(range(2, 5), repeat=3)}
    rmse = {orders: np.sqrt(cost / (60 - np.array(orders) - 1)) for orders, cost in every.items()}
    orders = (2, 2, 2)
    while True:
        gains = {}
        for axis in range(3):
            higher = tuple(order + (k == axis) for k, order in enumerate(orders))
            if higher in rmse:
                gains[higher] = 1 - rmse[higher][axis] / rmse[orders][axis]
        if not gains or max(gains.values()) < 0.01:
            break
        orders = max(gains, key=gains.get)
    assert chosen == orders
