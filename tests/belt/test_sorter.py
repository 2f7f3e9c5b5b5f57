"""A sorter that takes tables of particles: spread, windows, classes, warnings."""

import warnings
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from kilnflight.belt.models import (
    CV,
    IA,
    SPREADS,
    LateralCV,
    Predictor,
    Ratio,
    Straight,
)
from kilnflight.belt.online import Numbered, ValveSchedule, sort_spots
from kilnflight.belt.tracker import BELT_FRAME_S, BeltTracker, constant_velocity
from kilnflight.belt.valves import ValveBar
from kilnflight.checks import InputError

RNG = np.random.default_rng(1)
SPREAD_MM = 0.1
TRACKER = BeltTracker(constant_velocity(SPREAD_MM))
BAR = ValveBar(latency_s=0.01)


def belt(count=80, frames=260, velocity=1200.0, frame_s=BELT_FRAME_S, noise=SPREAD_MM):
    """Return the particles of each frame: x, y, number; they move evenly."""
    start = np.linspace(-60, frames, count)
    y = RNG.permuted(np.linspace(5, 175, count))
    spread = velocity * (1 + 0.05 * RNG.standard_normal(count))
    shown = []
    for frame in range(frames):
        x = 390 + spread * (frame - start) * frame_s
        here = (x >= 390) & (x < 800)
        places = np.column_stack([x, y])[here]
        places += RNG.normal(0, noise, places.shape)
        shown.append((frame, np.column_stack([places, np.flatnonzero(here)])))
    return shown


def places(shown):
    return [(frame, spots[:, :2]) for frame, spots in shown]


def sort(spots, predictor=None, bar=BAR, tracker=TRACKER, clock=lambda: 0.0, **more):
    """Return decisions, schedule and warnings."""
    schedule = ValveSchedule(bar)
    predictor = predictor or Predictor()
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        sorter = sort_spots(spots, predictor, schedule, tracker, clock=clock, **more)
        decisions = list(sorter)
    return decisions, schedule, [str(each.message) for each in told]


def predicted(decisions):
    return pd.concat([pd.DataFrame(each.predicted) for each in decisions])


def test_deviations_are_those_of_even_motion_carried_on():
    """Definition: variance of place at the valves, by its velocity."""
    last = {"particle": [0], "time_s": [0.0], "x": [588.0], "y": [90.0]}
    last |= {"velocity_x_mm_s": [1000.0], "velocity_y_mm_s": [30.0]}
    last |= {"acceleration_x_mm_s2": [0.0], "acceleration_y_mm_s2": [0.0]}
    last |= dict(zip(SPREADS, ([0.01], [0.2], [40.0]), strict=True))
    found = Predictor(time_factor=0.5, y_factor=2.0)(last)
    variance = 0.01 + 2 * 0.2 * 0.2 + 40.0 * 0.2**2
    time_sd = 0.5 * np.sqrt(variance) / 1000.0
    np.testing.assert_allclose(found["time_sd_s"], time_sd)
    y_sd = np.sqrt(4.0 * variance + (30.0 * time_sd) ** 2)
    np.testing.assert_allclose(found["y_sd_mm"], y_sd)


def test_calibrated_deviations_hold_what_they_say():
    """Of normal errors 95 % lie within two deviations."""
    n = 4000
    rng = np.random.default_rng(0)
    last = {"particle": np.arange(n), "time_s": np.zeros(n), "x": np.full(n, 600.0)}
    last |= {"y": np.full(n, 90.0), "velocity_x_mm_s": rng.normal(1000, 50, n)}
    last |= {"velocity_y_mm_s": np.zeros(n), "acceleration_x_mm_s2": np.zeros(n)}
    last |= {"acceleration_y_mm_s2": np.zeros(n)}
    variance = rng.uniform(0.5, 2.0, n)
    last |= {SPREADS[0]: variance, SPREADS[1]: np.zeros(n), SPREADS[2]: np.zeros(n)}
    sure = Predictor(CV(), LateralCV())(last)
    off = rng.normal(0.0, 0.3 * np.sqrt(variance))
    arrival = {"particle": np.arange(n), "velocity_y_mm_s": np.zeros(n)}
    arrival["time_s"] = sure["time_s"] + off / last["velocity_x_mm_s"]
    arrival["y"] = sure["y"] + rng.normal(0.0, 0.7 * np.sqrt(variance))
    few = slice(0, 400)
    half = [pd.DataFrame(each)[few] for each in (last, arrival)]
    fitted = Predictor(CV(), LateralCV()).calibrated(*half)
    assert fitted.time_factor == pytest.approx(0.3, rel=0.15)
    assert fitted.y_factor == pytest.approx(0.7, rel=0.15)
    found = fitted(last)
    for name, spread in (("time_s", "time_sd_s"), ("y", "y_sd_mm")):
        within = np.abs(found[name] - arrival[name]) < 2 * found[spread]
        assert within.mean() == pytest.approx(0.954, abs=0.03)


def test_windows_by_deviations_are_wider_and_longer():
    bar = ValveBar(valves=18, open_s=0.002, deviations=2.0)
    one = {"time_s": [1.0, 2.0], "y": [95.0, 5.0]}
    one |= {"time_sd_s": [0.001, 0.0], "y_sd_mm": [4.0, 0.0]}
    valve, opens, closes = bar.events(one)
    assert valve.tolist() == [0, 8, 9, 10]  # 87 to 103 mm, pitch 10 mm; 5 mm
    np.testing.assert_allclose(opens, [1.999, 0.997, 0.997, 0.997])
    np.testing.assert_allclose(closes, [2.001, 1.003, 1.003, 1.003])


def test_a_short_window_within_a_long_one_does_not_close_it():
    bar = ValveBar(valves=1, open_s=1e-9, deviations=1.0)
    two = {"time_s": [1.0, 1.001], "y": [90.0, 90.0]}
    two |= {"time_sd_s": [0.01, 0.001], "y_sd_mm": [0.0, 0.0]}
    valve, opens, closes = bar.events(two)
    assert valve.tolist() == [0]
    np.testing.assert_allclose([opens[0], closes[0]], [0.99, 1.01])
    schedule = ValveSchedule(bar)
    ((valve, open_s, close_s),) = schedule.step(0.5, 2.0, two)
    np.testing.assert_allclose([valve, open_s, close_s], [0, 0.99, 1.01])


def test_the_class_of_a_track_is_that_of_most_of_its_measurements():
    shown = []
    for frame, spots in belt():
        kind = spots[:, 2] % 3
        wrong = RNG.random(len(kind)) < 0.2
        kind = np.where(wrong, (kind + 1) % 3, kind)
        shown.append((frame, np.column_stack([spots[:, :2], kind])))
    decisions, _, _ = sort(shown)
    found = predicted(decisions)
    assert len(found) > 40
    assert set(found["class"]) == {0, 1, 2}
    for chosen in range(3):
        some, _, _ = sort(shown, chooses=lambda seen, k=chosen: seen["class"] == k)
        assert set(predicted(some)["class"]) == {chosen}
        assert len(predicted(some)) == (found["class"] == chosen).sum()


def test_without_classes_a_track_has_none():
    decisions, _, _ = sort(places(belt()))
    assert set(predicted(decisions)["class"]) == {-1}


def test_spots_in_order_of_time_are_numbered_with_their_gaps():
    rng = np.random.default_rng(0)
    kept = np.flatnonzero(rng.random(3000) > 0.1)
    kept = kept[kept != 0]
    stamps = 5.0 + 0.0010004 * kept + rng.uniform(-0.3e-3, 0.3e-3, len(kept))
    found = [number for number, _ in Numbered(zip(stamps, kept, strict=True), 0.001)]
    np.testing.assert_array_equal(found, kept - kept[0])


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 0.05, 1e6, None, "100"])
def test_a_bad_stamp_is_a_lost_frame(bad):
    shown = places(belt())
    stamped = [(BELT_FRAME_S * frame, spots) for frame, spots in shown]
    stamped[100] = (bad, shown[100][1])
    assert [number for number, _ in Numbered(stamped, BELT_FRAME_S)] == [
        *range(100),
        -1,
        *range(101, 260),
    ]
    decisions, _, told = sort(Numbered(stamped, BELT_FRAME_S))
    assert len(decisions) == 259
    assert len(told) == 1
    usual, _, _ = sort(shown)
    assert len(predicted(decisions)) == len(predicted(usual))


def test_a_pause_longer_than_a_second_is_a_gap():
    stamps = [0.0, 0.005, 5.0, 5.005, 5.010]
    found = [number for number, _ in Numbered(zip(stamps, stamps, strict=True), 0.005)]
    assert found == [0, 1, -1, 1001, 1002]  # the first after it is not believed


def test_a_clock_that_starts_again_ends_the_sorter():
    shown = places(belt())
    stamped = [(BELT_FRAME_S * (frame % 140), spots) for frame, spots in shown]
    with pytest.raises(InputError, match="number of the frame"):
        sort(Numbered(stamped, BELT_FRAME_S))


@pytest.mark.parametrize("rate", [1.0, 1.0002, 0.9998])
def test_commands_are_in_the_time_of_a_clock_that_runs_fast_or_slow(rate):
    """Shifted by ``start_s``, windows open when the camera's clock says so."""
    shown = places(belt(frames=2000, count=700))
    rng = np.random.default_rng(0)
    jitter = rng.uniform(-5e-4, 5e-4, len(shown))
    stamps = 70.0 + BELT_FRAME_S * rate * np.arange(len(shown)) + jitter
    frames = Numbered(zip(stamps, places_of(shown), strict=True), BELT_FRAME_S)
    schedule = ValveSchedule(BAR)
    off = []
    for decision in sort_spots(
        frames, Predictor(), schedule, TRACKER, clock=lambda: 0.0
    ):
        if decision.frame > 100:
            true_s = 70.0 + BELT_FRAME_S * rate * decision.frame
            off.append(frames.start_s + BELT_FRAME_S * decision.frame - true_s)
    assert np.abs(off).max() < 5e-4
    assert np.abs(np.mean(off)) < 5e-5


def places_of(shown):
    return [spots for _, spots in shown]


def test_parts_that_do_not_fit_one_another_are_refused():
    shown = places(belt())
    with pytest.raises(InputError, match="belt_mm"):
        sort(shown, bar=ValveBar(belt_mm=90.0))
    stamped = [(0.01 * frame, spots) for frame, spots in shown]
    with pytest.raises(InputError, match="frame_s"):
        sort(Numbered(stamped, 0.01))


def test_windows_that_are_over_are_told_once():
    _, schedule, told = sort(places(belt()), bar=ValveBar(latency_s=10.0))
    assert schedule.never > 40
    assert len(told) == 1
    assert "latency" in told[0]


def test_particles_without_a_class_have_none():
    shown = [
        (frame, np.column_stack([spots[:, :2], np.full(len(spots), np.nan)]))
        for frame, spots in belt()
    ]
    decisions, _, told = sort(shown)
    assert set(predicted(decisions)["class"]) == {-1}
    assert told == []


@pytest.mark.parametrize("kind", [0.5, np.inf, -np.inf, 1e20])
def test_a_class_that_is_no_whole_number_is_refused(kind):
    with pytest.raises(InputError, match="whole"):
        sort([(0, [[400.0, 90.0, kind]])])


@pytest.mark.parametrize(
    "chooses",
    [
        lambda seen: None,
        lambda seen: [True],
        lambda seen: "all",
        lambda seen: seen["time_s"],
        lambda seen: ["no"] * len(seen["time_s"]),
    ],
)
def test_a_choice_that_is_not_one_of_each_particle_is_refused(chooses):
    with pytest.raises(InputError, match="chooses"):
        sort(places(belt()), chooses=chooses)


@pytest.mark.parametrize("took_s", [0.0, 0.002, 0.004])
def test_lateness_is_measured(took_s):
    """A decision takes one tick of the clock, what its user does with it another."""
    ticks = iter(np.arange(10**6) * took_s)
    decisions, schedule, _ = sort(places(belt()), clock=lambda: next(ticks))
    late = np.array([each.late_s for each in decisions])
    np.testing.assert_allclose([each.took_s for each in decisions], took_s)
    behind = np.arange(len(late)) * (2 * took_s - BELT_FRAME_S) + took_s - BELT_FRAME_S
    np.testing.assert_allclose(late, behind.clip(0.0), atol=1e-9)
    if 2 * took_s > BELT_FRAME_S:
        assert schedule.never > 20
        for each in decisions:
            now_s = (each.frame + 1) * BELT_FRAME_S + each.late_s
            assert all(open_s >= now_s for _, open_s, _ in each.due)
    else:
        assert schedule.late == schedule.never == 0


def test_a_running_sorter_goes_on_after_a_bad_frame():
    shown = places(belt())
    bad = dict(shown)
    bad[100] = np.zeros((3, 5))
    bad[101] = "no spots"
    twice = [*bad.items()]
    twice.insert(120, (50, shown[50][1]))  # an old frame once more
    decisions, _, told = sort(twice)
    assert [each.frame for each in decisions] == [
        frame for frame in range(260) if frame not in (100, 101)
    ]
    assert len(told) == 1
    assert "100" in told[0]
    usual, _, _ = sort(shown)
    assert len(predicted(decisions)) == len(predicted(usual))


def test_the_first_frame_has_to_be_usable():
    with pytest.raises(InputError, match="frame 0"):
        sort([(0, np.zeros((3, 5)))])


def swerving(frame, spots):
    return spots + np.array([0, 4.0 * (frame // 25 % 2)])


SPOILED = {
    "metres": (lambda _, spots: spots / 1000, "no mm"),
    "swapped": (lambda _, spots: spots[:, ::-1], "swapped"),
    "outside": (lambda _, spots: spots + np.array([1000, 0]), "lie in the tracked"),
    "centred": (lambda _, spots: spots - np.array([0, 90]), "y not from 0"),
    "twice": (lambda _, spots: np.repeat(spots, 2, axis=0), "twice"),
    "not finite": (lambda _, spots: np.vstack([spots, [np.nan, 5]]), "not finite"),
    "stiff": (swerving, "lost"),  # and the filter does not allow for it
}


@pytest.mark.parametrize("case", SPOILED)
def test_wrong_places_are_said_once(case):
    change, word = SPOILED[case]
    shown = places(belt(frames=400, count=160))
    shown = [(frame, change(frame, spots)) for frame, spots in shown]
    stiff = BeltTracker(constant_velocity(SPREAD_MM, 100.0))
    said_once(shown, stiff if case == "stiff" else TRACKER, word)


@pytest.mark.parametrize("factor", [0.2, 0.5, 2.0, 5.0])
def test_a_wrong_frame_interval_is_said_once(factor):
    tracker = replace(TRACKER, frame_s=factor * BELT_FRAME_S)
    told = said_once(places(belt(frames=400, count=160)), tracker, "frame interval")
    assert len(told) == 1


def said_once(shown, tracker, word):
    decisions, _, told = sort(shown, tracker=tracker)
    assert len(decisions) == len(shown)
    assert len([each for each in told if word in each]) == 1
    assert len(told) == len(set(told))
    return told


def test_a_good_line_is_not_warned_of():
    _, _, told = sort(places(belt(frames=400, count=160)))
    assert told == []


@pytest.mark.parametrize(
    ("late_s", "told"), [(0.0, 0), (0.0004, 0), (0.004, 1), (0.03, 1)]
)
def test_a_calibration_that_drifts_is_told(late_s, told):
    """The camera sees the valves; the calibration is off by a constant."""

    class Late(CV):
        def _duration(self, distance, velocity, acceleration):
            return super()._duration(distance, velocity, acceleration) - late_s

    shown = places(belt(frames=500, count=200))
    _, _, said = sort(shown, Predictor(Late(), Straight()))
    assert len([each for each in said if "calibrate again" in each]) == told


def test_models_that_predict_no_arrival_are_told_of():
    _, _, said = sort(
        places(belt(frames=500, count=200)), Predictor(IA(-1e9), LateralCV())
    )
    assert len([each for each in said if "calibrate again" in each]) == 1


def test_doubled_particles_change_nothing():
    shown = places(belt())
    doubled = [(frame, np.repeat(spots, 2, axis=0)) for frame, spots in shown]
    once, twice = (predicted(sort(each)[0]) for each in (shown, doubled))
    pd.testing.assert_frame_equal(once.drop(columns="row"), twice.drop(columns="row"))


def test_models_that_are_not_calibrated_are_refused():
    with pytest.raises(InputError, match="calibrated"):
        sort(places(belt()), Predictor(IA(), Ratio()))
