"""The fast way against the definition."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from kilnflight.regression import Loss, Regression
from kilnflight.regression.loss import cost, weight
from kilnflight.regression.projection import COST, CURVATURE, SLOPE, project, reweight
from kilnflight.regression.search import Combinations, range_of_start

few = settings(max_examples=25, deadline=None)
NAMES = {Loss.SQUARES: "linear", Loss.SOFT_L1: "soft_l1", Loss.HUBER: "huber"}


@given(st.integers(0, 2**32 - 1), st.floats(1e-6, 5.0), st.integers(8, 80))
@few
def test_every_order_is_the_linear_least_squares_fit(seed, lead, points):
    rng = np.random.default_rng(seed)
    u = lead + np.sort(rng.random(points))
    place, w = rng.normal(size=points), rng.uniform(0.1, 1, points)
    profile = np.zeros((7, 3))
    left = project(u, place, w, 6, profile)
    for order in range(1, 7):
        residuals = exact(u, place, w, order)
        expected = sum(
            Fraction(mass) * rest**2 for mass, rest in zip(w.tolist(), residuals, strict=True)
        )
        assert profile[order, COST] == pytest.approx(float(expected), rel=1e-9)
    np.testing.assert_allclose(left, [float(rest) for rest in residuals], atol=1e-9)


def exact(u, place, w, order):
    """Residuals of the normal equations, in fractions: a QR in float64 loses six digits here."""
    u, place, w = ([Fraction(value) for value in values.tolist()] for values in (u, place, w))
    powers = [[time ** (k + 1) for time in u] for k in range(order)]
    rows = [
        [
            sum(m * a * b for m, a, b in zip(w, one, other, strict=True))
            for other in [*powers, place]
        ]
        for one in powers
    ]
    for i in range(order):  # Gauss and Jordan
        rows[i] = [value / rows[i][i] for value in rows[i]]
        for k in set(range(order)) - {i}:
            rows[k] = [a - rows[k][i] * b for a, b in zip(rows[k], rows[i], strict=True)]
    fitted = [sum(rows[k][-1] * powers[k][n] for k in range(order)) for n in range(len(u))]
    return [value - fit for value, fit in zip(place, fitted, strict=True)]


@given(st.integers(0, 2**32 - 1), st.sampled_from(list(Loss)), st.integers(1, 4))
@few
def test_the_slope_is_the_derivative_of_the_cost(seed, loss, order):
    rng = np.random.default_rng(seed)
    time, place = np.linspace(0, 1, 40), np.linspace(0, -3, 40) + rng.normal(size=40)
    place[7] += 20.0

    def at(start):
        profile = np.zeros((order + 1, 3))
        reweight(time - start, place, order, int(loss), profile)
        return profile[order]

    step = 1e-4
    numeric = (at(-0.4 + step)[COST] - at(-0.4 - step)[COST]) / (2 * step)
    assert 2 * at(-0.4)[SLOPE] == pytest.approx(numeric, rel=1e-3, abs=1e-3)
    assert at(-0.4)[CURVATURE] >= 0


@given(st.floats(0, 1e6), st.sampled_from(list(Loss)))
def test_the_losses_are_those_of_scipy(squared, loss):
    def residual(_):
        return np.array([np.sqrt(squared)])

    theirs = least_squares(residual, [0.0], loss=NAMES[loss], max_nfev=1, jac=lambda _: [[1.0]])
    assert cost(squared, int(loss)) == pytest.approx(2 * theirs.cost, rel=1e-9, abs=1e-12)
    step = 1e-6 * (1 + squared)
    numeric = (cost(squared + step, int(loss)) - cost(squared, int(loss))) / step
    assert weight(squared, int(loss)) == pytest.approx(numeric, rel=1e-4, abs=1e-6)


@pytest.mark.parametrize("orders", [(2, 2, 2), (2, 2, 4), (3, 2, 3)])
@pytest.mark.parametrize("loss", Loss)
def test_scipy_over_all_unknowns_finds_the_same(flight, plain, loss, orders):
    scatter = np.array([2.0, 2.0, 30.0])
    track = flight(scatter=scatter, seed=3)
    track.loc[20, "z"] += 700.0
    time = np.linspace(0, 1, 60)
    places = track[list("xyz")].to_numpy() / scatter
    exit_point = np.array([120.0, 60.0, 6500.0]) / scatter
    moved = np.ascontiguousarray((places - exit_point).T)
    limits, first = range_of_start(time, moved, 20, 5.0, np.random.default_rng(0))
    costs = Combinations(time, moved, 2, np.array(orders), int(loss), limits, first)
    theirs = plain.solve(time, places, exit_point, orders, first, limits, loss=NAMES[loss])
    last = tuple(order - 2 for order in orders)
    assert costs[last].sum() == pytest.approx(2 * theirs.cost, rel=1e-9)
    assert costs.start(last) == pytest.approx(theirs.x[-1], abs=1e-4)


def test_orders_go_up_while_the_gain_is_one_per_cent():
    costs = np.ones((3, 3, 3, 3))
    left = 1.0 / (60 - np.arange(3, 6))  # the same RMSE for every order
    costs *= 1 / left[:, None, None, None]
    points, regression = 60, Regression()
    by_order = (60 - np.arange(3, 6)).astype(float)
    x, y, z = np.meshgrid(by_order, by_order, by_order, indexing="ij")
    costs = np.stack([x, y, z], axis=-1)  # RMSE is 1 everywhere
    assert regression.choose(costs, points) == (0, 0, 0)
    costs[:, :, 1:, 2] *= 0.98**2
    costs[:, :, 2, 2] *= 0.992**2  # the second step gains too little
    costs[1:, :, :, 0] *= 0.985**2
    assert regression.choose(costs, points) == (1, 0, 1)
    assert regression.choose(np.zeros((3, 3, 3, 3)), points) == (0, 0, 0)


def test_asking_for_few_combinations_chooses_as_solving_all_does(flight):
    track = flight(scatter=np.array([2.0, 2.0, 30.0]), seed=4)
    moved = (track[list("xyz")].to_numpy() - np.array([120.0, 60.0, 6500.0])).T
    time, highest = np.linspace(0, 1, 60), np.full(3, 4)
    limits, first = range_of_start(time, moved, 20, 5.0, np.random.default_rng(0))
    asked, every = (Combinations(time, moved, 2, highest, 0, limits, first) for _ in range(2))
    solved = np.array([every[place] for place in np.ndindex(3, 3, 3)]).reshape(3, 3, 3, 3)
    chosen = Regression().choose(asked, 60)
    assert chosen == Regression().choose(solved, 60)
    assert len(asked.solved) < 27
    assert asked.start(chosen) == every.start(chosen)
