import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.stats import mannwhitneyu, norm, theilslopes

from kilnflight.checks import InputError
from kilnflight.ignition import EXACT, Ignition, LitTrace, best_step, line_deviation, rank_sum_p

TIME = np.arange(60) / 330
LOOK = Ignition()
VALUES = st.lists(st.integers(0, 50), min_size=1, max_size=40)


def course(seed=0, low=3000.0, high=6000.0, at=25, scatter=100.0):
    noise = np.random.default_rng(seed).normal(0, scatter, 60)
    return np.where(np.arange(60) < at, low, high) + noise


def test_a_step_is_found_where_it_is():
    ignited = LOOK(TIME, course())
    assert ignited.outcome == "seen"
    assert ignited.time_s == pytest.approx(24.5 / 330)
    assert (ignited.before, ignited.after) == pytest.approx((3000, 6000), abs=60)
    assert ignited.scatter == pytest.approx(100, rel=0.4)
    assert ignited.p_value < 1e-10


@pytest.mark.parametrize("at", [3, 5, 55, 57])
def test_also_close_to_the_ends(at):
    assert LOOK(TIME, course(at=at)).time_s == pytest.approx((at - 0.5) / 330)


@pytest.mark.parametrize("at", [0, 1, 2, 30, 57, 59])
def test_a_single_flash_is_no_ignition_and_hides_none(at):
    flash = 50_000.0 * (np.arange(60) == at)
    assert LOOK(TIME, course(high=3000.0) + flash).outcome == "none"
    assert LOOK(TIME, course() + flash).time_s == pytest.approx(24.5 / 330)


def test_what_is_no_ignition():
    ramp = course(high=3000.0) + 50 * np.arange(60)
    wave = 3000 + 800 * np.sin(np.arange(60) / 4)
    small = course(high=3150.0, scatter=10.0)  # for sure, but 5 %
    blurred = course(high=3500.0, scatter=400.0)  # 1.25 standard deviations
    for values in (course(high=3000.0), course(high=1000.0), ramp, wave, small, blurred):
        assert LOOK(TIME, values).outcome == "none"


def test_constant_and_saturated_values():
    constant = LOOK(TIME, np.full(60, 65535.0))
    assert (constant.outcome, constant.p_value) == ("none", 1.0)
    assert constant.before == constant.after == 65535.0
    assert Ignition(bright=65535.0)(TIME, np.full(60, 65535.0)).outcome == "before seen"
    clipped = np.minimum(course(high=90_000.0), 65535.0)
    assert LOOK(TIME, clipped).time_s == pytest.approx(24.5 / 330)


def test_bright_from_the_first_detection_on():
    fading = np.linspace(9000.0, 3000.0, 60)
    assert LOOK(TIME, fading).outcome == "none"
    assert Ignition(bright=8000.0)(TIME, fading).outcome == "before seen"
    assert Ignition(bright=8000.0)(TIME, course()).outcome == "seen"


def test_a_background_that_brightens_is_no_ignition():
    behind = np.where(np.arange(60) < 40, 2000.0, 6000.0)
    unlit = course(high=3000.0) + behind
    assert LOOK(TIME, unlit).time_s == pytest.approx(39.5 / 330)  # of the values as they are
    above = Ignition(above_background=True)
    assert above(TIME, unlit, behind).outcome == "none"
    lit = course(high=8000.0) + behind
    ignited = above(TIME, lit, behind)
    assert ignited.time_s == pytest.approx(24.5 / 330)
    assert (ignited.before, ignited.after) == pytest.approx((3000, 8000), abs=60)


def test_a_silhouette_that_passes_from_dark_to_bright_is_no_ignition():
    """What burns is brighter than what is behind it; an unlit particle darker than the wall."""
    behind = np.where(np.arange(60) < 40, 2000.0, 9000.0)
    silhouette = 0.6 * behind + course(0, 1000.0, 1000.0)
    assert LOOK(TIME, silhouette).outcome == "seen"  # where the background is not known
    assert LOOK(TIME, silhouette, behind).outcome == "none"
    burning = behind + course(high=20_000.0, at=25)
    assert LOOK(TIME, burning, behind).time_s == pytest.approx(24.5 / 330)
    assert LOOK(TIME, burning, behind) == LOOK(TIME, burning)  # lit: unchanged
    with pytest.raises(InputError, match="needs the background's grey values"):
        Ignition(above_background=True)(TIME, burning)


def test_too_few_detections_to_judge():
    for length in (0, 1, 5, 11):
        values = np.where(np.arange(length) < length // 2, 1.0, 100.0)
        assert LOOK(np.arange(length), values).outcome == "too few points"
    assert LOOK(np.arange(12), np.repeat([1.0, 100.0], 6)).outcome == "seen"


@settings(deadline=None)
@given(st.integers(0, 99), st.floats(1e-2, 1e2), st.floats(-1e3, 1e3), st.integers(0, 60))
def test_a_factor_and_a_shift_in_time_move_nothing(seed, factor, shift, at):
    values = course(seed, at=at, high=5000.0, scatter=500.0)
    assume((values > 0).all())
    one, other = LOOK(TIME, values), LOOK(TIME + shift, factor * values)
    assert one.outcome == other.outcome
    assert one.p_value == pytest.approx(other.p_value)
    if one.outcome == "seen":
        assert other.time_s == pytest.approx(one.time_s + shift, abs=1e-9)


@pytest.mark.parametrize("length", [12, 40])
def test_the_test_holds_its_level_and_has_power(length):
    noise = np.random.default_rng(1).normal(1000.0, 50.0, (300, length))
    rise = 250.0 * (np.arange(length) >= length // 2)
    still, risen = ([LOOK(np.arange(length), values + r) for values in noise] for r in (0, rise))
    level, power = (
        np.mean([each.outcome == "seen" for each in tracks]) for tracks in (still, risen)
    )
    assert level <= 0.01
    assert power > {12: 0.6, 40: 0.99}[length]
    off = [abs(ignited.time_s + 0.5 - length // 2) for ignited in risen]
    assert np.nanmedian(off) <= 1  # points


@pytest.mark.parametrize(
    ("time", "gray", "message"),
    [
        ([0, 1], [1.0], "2 times, but 1"),
        ([0, 0], [1.0, 1.0], "sort the track by time"),
        ([1, 0], [1.0, 1.0], "sort the track by time"),
        ([0, 1], [1.0, np.nan], "not finite"),
        ([0, 1], [1.0, -1.0], "grey value is -1"),
    ],
)
def test_bad_input_is_refused(time, gray, message):
    with pytest.raises(InputError, match=message):
        LOOK(time, gray)


@pytest.mark.parametrize(
    "more",
    [{"significance": 2.0}, {"least_points": 0}, {"rise": -1.0}, {"share": "a"}, {"bright": -1.0}],
)
def test_parameters_out_of_range_are_refused(more):
    with pytest.raises(InputError, match=f"Ignition: {next(iter(more))}"):
        Ignition(**more)


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


TRACE = LitTrace()
BEHIND = np.linspace(1000.0, 9000.0, 60)  # from a dark end plate to a hot wall


def outcome(gray, look=TRACE):
    return look(TIME, gray, BEHIND)


def test_a_trace_that_turns_lighter_than_the_kiln_lights_up():
    gray = np.where(np.arange(60) < 25, 0.8, 1.5) * BEHIND
    assert outcome(gray) == "seen"


def test_a_silhouette_does_not_light_up_wherever_it_passes():
    """What is unlit takes away light, and never more than all of it (5.2.2)."""
    for share in (0.0, 0.5, 0.99):
        assert outcome(share * BEHIND) == "none"
        assert np.abs(share * BEHIND - BEHIND).max() <= BEHIND.max()


def test_a_slight_rise_near_the_wall_is_no_ignition():
    """Section 5.2.4: brightness "only slightly increases when close to the inner wall"."""
    assert outcome(np.where(np.arange(60) < 50, 0.9, 1.08) * BEHIND) == "none"


def test_the_second_reading_asks_for_more_than_a_silhouette_can_take():
    twice = LitTrace(1.0)
    rising = np.where(np.arange(60) < 25, 0.8, 1.9) * BEHIND
    assert (outcome(rising), outcome(rising, twice)) == ("seen", "none")
    burning = np.where(np.arange(60) < 25, 0.8, 2.5) * BEHIND
    assert outcome(burning, twice) == "seen"


@pytest.mark.parametrize("at", [0, 1, 30, 58, 59])
def test_a_flash_does_not_light_a_trace_up(at):
    assert outcome(np.where(np.arange(60) == at, 9.0, 0.8) * BEHIND) == "none"


def test_a_trace_that_is_light_all_the_way_turned_so_nowhere():
    assert outcome(1.5 * BEHIND) == "before seen"
    assert outcome(np.where(np.arange(60) < 30, 1.5, 0.8) * BEHIND) == "before seen"


def test_short_traces_and_wrong_ones():
    assert TRACE(TIME[:5], BEHIND[:5], BEHIND[:5]) == "too few points"
    with pytest.raises(InputError, match="5 times, but 4"):
        TRACE(TIME[:5], BEHIND[:5], BEHIND[:4])
    with pytest.raises(InputError, match="share"):
        LitTrace(-0.1)
