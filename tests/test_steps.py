import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import mannwhitneyu, norm, theilslopes

from kilnflight.steps import EXACT, best_step, line_deviation, rank_sum_p

VALUES = st.lists(st.integers(0, 50), min_size=1, max_size=40)


def step_in_plain_code(values, least):
    best = (-1, np.inf)
    for k in range(least, len(values) - least + 1):
        sides = values[:k], values[k:]
        rest = sum(sum(abs(v - np.median(side)) for v in side) for side in sides)
        if np.median(sides[0]) < np.median(sides[1]) and rest < best[1]:
            best = (k, rest)
    return best


@settings(deadline=None)
@given(VALUES, st.integers(1, 4))
def test_the_step_is_the_one_that_a_double_loop_finds(values, least):
    assert best_step(np.array(values, float), least) == step_in_plain_code(values, least)


@settings(deadline=None)
@given(st.lists(st.integers(), min_size=2, max_size=40, unique=True), st.data())
def test_the_probability_is_scipys_where_no_values_are_equal(values, data):
    split = data.draw(st.integers(1, len(values) - 1))
    ranks = np.argsort(np.argsort(values)).astype(float)
    before, after = ranks[:split], ranks[split:]
    peer = mannwhitneyu(before, after, alternative="less", method="exact").pvalue
    assert rank_sum_p(before, after) == pytest.approx(peer, rel=1e-9)


@pytest.mark.parametrize("split", [3, 40, 100])
def test_many_values_are_as_exact(split):
    values = np.random.default_rng(split).normal(0.02 * np.arange(EXACT), 1.0)
    peer = mannwhitneyu(values[:split], values[split:], alternative="less", method="exact")
    assert rank_sum_p(values[:split], values[split:]) == pytest.approx(peer.pvalue, rel=1e-9)


def test_beyond_it_is_the_normal_approximation():
    before, after = np.arange(0.0, 300.0), np.arange(100.5, 300.0)
    inversions = sum((before >= late).sum() for late in after)
    sigma = np.sqrt(300 * 200 * 501 / 12)
    expected = norm.cdf((inversions + 0.5 - 300 * 200 / 2) / sigma)
    assert rank_sum_p(before, after) == pytest.approx(expected, rel=1e-9)


@settings(deadline=None)
@given(VALUES, VALUES)
def test_ties_are_no_evidence(before, after):
    """Whatever order equal values are given, the probability is not below the one without ties."""
    one, two = np.array(before, float), np.array(after, float)
    broken = rank_sum_p(one - 1e-3, two)
    assert rank_sum_p(one, two) >= broken * (1 - 1e-9)
    assert rank_sum_p(np.zeros(5), np.zeros(7)) == 1.0


def test_the_line_is_that_of_theil_and_sen():
    generator = np.random.default_rng(3)
    time = np.cumsum(generator.uniform(0.1, 1.0, 30))
    values = 3 * time + generator.normal(0, 2, 30)
    slope, offset = theilslopes(values, time, method="joint")[:2]
    expected = np.abs(values - slope * time - offset).sum()
    assert line_deviation(time, values) == pytest.approx(expected)
