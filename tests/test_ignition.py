"""Ignition by grey values: made-up courses, definitions, level and power."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import mannwhitneyu

from kilnflight.ignition import Ignition, best_step, rank_sum_p

TIME = np.arange(60) / 330
TEST = Ignition()
VALUES = st.lists(st.integers(0, 50), min_size=1, max_size=40)


def course(seed=0, low=3000.0, high=6000.0, at=25, scatter=100.0):
    noise = np.random.default_rng(seed).normal(0, scatter, 60)
    return np.where(np.arange(60) < at, low, high) + noise


def test_a_step_is_found():
    ignited = TEST(TIME, course())
    assert ignited.outcome == "seen"
    assert ignited.time_s == pytest.approx(24.5 / 330)
    assert (ignited.before, ignited.after) == pytest.approx((3000, 6000), abs=60)
    assert ignited.scatter == pytest.approx(100, rel=0.4)
    assert ignited.p_value < 1e-10
    for at in (3, 57):
        assert TEST(TIME, course(at=at)).time_s == pytest.approx((at - 0.5) / 330)


@pytest.mark.parametrize("at", [0, 2, 30, 59])
def test_a_single_flash_is_no_ignition_and_hides_none(at):
    flash = 50_000.0 * (np.arange(60) == at)
    assert TEST(TIME, course(high=3000.0) + flash).outcome == "none"
    assert TEST(TIME, course() + flash).time_s == pytest.approx(24.5 / 330)


def test_slow_small_and_downward_changes_are_no_ignition():
    ramp = course(high=3000.0) + 50 * np.arange(60)
    wave = 3000 + 800 * np.sin(np.arange(60) / 4)
    small = course(high=3150.0, scatter=10.0)  # for sure, but 5 %
    blurred = course(high=3500.0, scatter=400.0)  # 1.25 standard deviations
    for values in (
        course(high=3000.0),
        course(high=1000.0),
        ramp,
        wave,
        small,
        blurred,
    ):
        assert TEST(TIME, values).outcome == "none"


def test_constant_saturated_and_light_values():
    constant = TEST(TIME, np.full(60, 65535.0))
    assert (constant.outcome, constant.p_value) == ("none", 1.0)
    assert constant.before == constant.after == 65535.0
    clipped = np.minimum(course(high=90_000.0), 65535.0)
    assert TEST(TIME, clipped).time_s == pytest.approx(24.5 / 330)
    light_at_first, dark = course(low=20_000.0, high=20_000.0), np.full(60, 9000.0)
    assert TEST(TIME, light_at_first, dark).outcome == "none"  # it does not rise
    assert TEST(TIME, np.linspace(9000.0, 3000.0, 60)).outcome == "none"


def test_a_silhouette_before_a_background_that_brightens_is_no_ignition():
    behind = np.where(np.arange(60) < 40, 2000.0, 9000.0)
    silhouette = 0.6 * behind + course(0, 1000.0, 1000.0)
    assert TEST(TIME, silhouette).outcome == "seen"  # where the background is not known
    gray_alone = Ignition(above_background=False)
    for test in (TEST, gray_alone):
        assert test(TIME, silhouette, behind).outcome == "none"
    burning = behind + course(high=20_000.0, at=25)
    assert gray_alone(TIME, burning, behind) == gray_alone(TIME, burning)
    assert gray_alone(TIME, course(high=3000.0) + behind, behind).outcome == "seen"
    assert TEST(TIME, course(high=3000.0) + behind, behind).outcome == "none"
    ignited = TEST(TIME, course(high=8000.0) + behind, behind)
    assert (ignited.before, ignited.after) == pytest.approx((3000, 8000), abs=60)


def test_too_few_detections_to_judge():
    for length in (0, 1, 5, 11):
        values = np.where(np.arange(length) < length // 2, 1.0, 100.0)
        assert TEST(np.arange(length), values).outcome == "too few points"
    assert TEST(np.arange(12), np.repeat([1.0, 100.0], 6)).outcome == "seen"


def test_the_test_holds_its_level_and_has_power():
    noise = np.random.default_rng(1).normal(1000.0, 50.0, (200, 40))
    rise = 250.0 * (np.arange(40) >= 20)
    still, risen = (
        [TEST(np.arange(40), values + r) for values in noise] for r in (0, rise)
    )
    assert np.mean([each.outcome == "seen" for each in still]) <= 0.01
    assert np.mean([each.outcome == "seen" for each in risen]) > 0.99
    assert (
        np.nanmedian([abs(ignited.time_s - 19.5) for ignited in risen]) <= 1
    )  # points


@given(VALUES, st.integers(1, 4))
def test_the_best_step_is_that_of_a_double_loop(values, least):
    numbers, best = np.array(values, float), (-1, np.inf)
    for k in range(least, len(values) - least + 1):
        sides = numbers[:k], numbers[k:]
        rest = sum(np.abs(side - np.median(side)).sum() for side in sides)
        if np.median(sides[0]) < np.median(sides[1]) and rest < best[1]:
            best = (k, rest)
    assert best_step(numbers, least) == best


@given(VALUES, VALUES)
def test_ties_are_no_evidence_and_other_ranks_are_scipys(before, after):
    one, two = np.array(before, float), np.array(after, float)
    broken = rank_sum_p(one - 1e-3, two)
    assert rank_sum_p(one, two) >= broken * (1 - 1e-9)
    ranks = (
        np.random.default_rng(len(one)).permutation(len(one) + len(two)).astype(float)
    )
    first, second = ranks[: len(one)], ranks[len(one) :]
    peer = mannwhitneyu(first, second, alternative="less", method="exact").pvalue
    assert rank_sum_p(first, second) == pytest.approx(peer, rel=1e-9)
