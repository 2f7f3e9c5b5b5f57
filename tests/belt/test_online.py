"""A sorter that takes one picture at a time: as the whole recording, gaps, commands."""

import os
import subprocess
import sys

import cv2
import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kilnflight.belt.camera import BELT, Calibration
from kilnflight.belt.models import CV, CVBC, IA, LateralCV, Predictor
from kilnflight.belt.online import ValveSchedule, sort_pictures
from kilnflight.belt.phase import last_states
from kilnflight.belt.pictures import MeasureSpots, Spots
from kilnflight.belt.tracker import BELT_FRAME_S, Appearance, BeltTracker
from kilnflight.belt.valves import ValveBar
from kilnflight.checks import InputError
from kilnflight.tables import TABLES

# One pixel per mm; the belt's first corner is pixel (10, 10).
CALIBRATION = Calibration(
    np.array([[1.0, 0, 378.0], [0, 1.0, -10.0], [0, 0, 1]]), 0.0, 1.0
)
BACKGROUND = np.full((200, 420), 60, dtype=np.uint8)
MEASURE = MeasureSpots(BACKGROUND, Spots(single_px=80.0), CALIBRATION)
BAR = ValveBar(18, latency_s=0.01)
MODELS = CV(), LateralCV()


def picture(*places):
    """Draw discs of 10 px at places in mm."""
    drawn = BACKGROUND.copy()
    for x, y in places:
        centre = round(16 * (x - 378)), round(16 * (y + 10))
        cv2.circle(drawn, centre, 16 * 5, 200, -1, shift=4)
    return drawn


def way(frame, first=0, y=90.0, velocity=1200.0, across=0.0):
    time = (frame - first) * BELT_FRAME_S
    return [(390.0 + velocity * time, y + across * time)] if time >= 0 else []


RNG = np.random.default_rng(0)
STARTS = [
    (int(RNG.integers(40)), *RNG.uniform([20, 1000, -40], [160, 1300, 40]))
    for _ in range(9)
]
PICTURES = [
    picture(*(place for start in STARTS for place in way(k, *start)))
    for k in range(110)
]


def run(numbered, models=MODELS, bar=BAR, **settings):
    schedule = ValveSchedule(bar)
    settings = {"clock": lambda: 0.0} | settings
    sorter = sort_pictures(numbered, MEASURE, Predictor(*models), schedule, **settings)
    return list(sorter), schedule


def joined(commands):
    """Commands of consecutive steps as whole windows, in the order of opening."""
    names = TABLES["valve events"].names
    parts = pd.DataFrame([each for step in commands for each in step], columns=names)
    parts = parts.sort_values(["valve", "open_s"])
    before = parts.shift()
    goes_on = parts["open_s"].eq(before["close_s"]) & parts["valve"].eq(before["valve"])
    windows = parts.groupby((~goes_on).cumsum())
    whole = windows.agg({"valve": "first", "open_s": "first", "close_s": "last"})
    return whole.sort_values(["valve", "open_s"]).to_numpy()


def events(bar, predicted):
    return np.column_stack(bar.events(predicted))


def test_decisions_are_those_of_the_whole_recording():
    decisions, schedule = run(enumerate([*PICTURES, *30 * [BACKGROUND]]))
    spots = MEASURE.table(PICTURES)
    measured = np.concatenate([done.measured for done in decisions])
    np.testing.assert_array_equal(measured, spots.iloc[:, 1:])
    followed = BeltTracker()(spots, 110)
    states = [
        (d.frame, t["particle"], *t["state"]) for d in decisions[:110] for t in d.tracks
    ]
    names = ["frame", "particle", "x", "y", "velocity_x_mm_s", "velocity_y_mm_s"]
    np.testing.assert_array_equal(states, followed.states[names])
    predicted = pd.DataFrame(Predictor(*MODELS)(last_states(followed, BELT_FRAME_S)))
    known = told(decisions).sort_values("particle", ignore_index=True)
    pd.testing.assert_frame_equal(known[predicted.columns], predicted)
    np.testing.assert_array_equal(
        joined([d.due for d in decisions]), events(BAR, predicted)
    )
    assert len(predicted) == 9
    assert schedule.late == schedule.never == 0
    for done in decisions:
        for _, open_s, close_s in done.due:
            assert (done.frame + 1) * BELT_FRAME_S <= open_s
            assert open_s < close_s <= (done.frame + 2) * BELT_FRAME_S


def test_lost_frames_are_no_misses_and_no_arrival_lies_before_the_last_observation():
    """Eight misses in a row lose a track; eight lost frames do not."""
    decisions, _ = run((k, picture(*way(k))) for k in range(60) if not 20 <= k < 28)
    assert {track["particle"] for done in decisions for track in done.tracks} == {0}
    (one,) = (done for done in decisions if len(done.predicted["y"]))
    assert one.frame == 50  # seen last at 684 mm in frame 49
    assert one.predicted["time_s"][0] == pytest.approx((788 - 390) / 1200, abs=1e-3)
    early, _ = run(
        ((k, picture(*way(k))) for k in range(60)), (CVBC(-0.2), LateralCV())
    )
    assert told(early)["time_s"].isna().tolist() == [True]
    assert not any(done.due for done in early)


def test_particles_that_left_in_a_long_gap_open_no_valve_afterwards():
    frames = [*((k, picture(*way(k))) for k in range(20)), (20_000, BACKGROUND)]
    with pytest.warns(UserWarning, match="over before"):
        decisions, schedule = run([*frames, (20_001, BACKGROUND)])
    assert len(decisions[-2].predicted["y"]) == 1
    assert schedule.never == 1
    assert not decisions[-2].due
    assert not len(decisions[-1].tracks)


def test_only_chosen_tracks_are_blown_out():
    shown = [picture(*way(k), *way(k, 3, 30.0)) for k in range(70)]
    for chooses, valves in (
        (None, {9, 3}),
        (lambda seen: seen["particle"] % 2 == 0, {9}),
        (lambda seen: seen["particle"] < 0, set()),
    ):
        decisions, _ = run(enumerate(shown), chooses=chooses)
        assert {valve for done in decisions for valve, *_ in done.due} == valves


def told(decisions):
    return pd.concat([pd.DataFrame(done.predicted) for done in decisions])


def arrivals(*rows):
    """Predictions by time and place, particles numbered through."""
    time, y = np.array(rows, dtype=np.float64).reshape(-1, 2).T
    return pd.DataFrame({"particle": np.arange(len(rows)), "time_s": time, "y": y})


@settings(max_examples=15)
@given(
    st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.003, 0.02]), st.integers(1, 30)
)
def test_commands_are_the_events_that_are_known_in_advance(seed, dead_s, valves):
    rng = np.random.default_rng(seed)
    bar = ValveBar(valves, latency_s=0.01, delay_s=0.001, dead_s=dead_s)
    predicted = arrivals(
        *zip(rng.uniform(0, 0.3, 20), rng.uniform(0, 180, 20), strict=True)
    )
    opens = predicted["time_s"] + 0.001 - 0.01 - bar.open_s / 2
    known = opens - dead_s - rng.exponential(0.03, 20)  # just in time, or earlier
    schedule, before, parts = ValveSchedule(bar), -np.inf, []
    times = np.append(np.sort(known), np.inf)
    for now, until in zip(times, [*times[1:], np.inf], strict=True):
        parts.append(
            schedule.step(now, until, predicted[(known > before) & (known <= now)])
        )
        before = now
    np.testing.assert_array_equal(joined(parts), events(bar, predicted))
    assert schedule.late == schedule.never == 0


def test_predictions_known_too_late_open_late_or_never():
    bar = ValveBar(18, open_s=0.01, dead_s=0.02)
    schedule = ValveSchedule(bar)
    due = schedule.step(0.1, 0.12, arrivals((0.101, 5), (0.090, 15), (0.2, 25)))
    assert (schedule.late, schedule.never) == (1, 1)
    np.testing.assert_allclose(due, [[0, 0.1, 0.106]])
    # in time, but valve 0 has a pause until 126 ms
    due = schedule.step(0.12, 0.3, arrivals((0.124, 5)))
    assert (schedule.late, schedule.never) == (2, 1)
    np.testing.assert_allclose(due, [[0, 0.126, 0.129], [2, 0.195, 0.205]])


@pytest.mark.parametrize(
    ("numbered", "more", "match"),
    [
        ([(0.5, BACKGROUND)], {}, "frame"),
        ([(7, BACKGROUND[1:])], {}, "frame 7"),
        ([], {"tracker": BeltTracker(appearance=Appearance(BELT))}, "target_mm"),
        (enumerate(PICTURES), {"models": (IA(), LateralCV())}, "IA is not calibrated"),
    ],
)
def test_unusable_pictures_and_parts_are_refused_by_name(numbered, more, match):
    with pytest.raises(InputError, match=match):
        run(numbered, **more)


COMPILES = """
import numpy as np
from numba.core import event
from kilnflight.belt.models import Predictor
from kilnflight.belt.online import ValveSchedule, sort_spots
from kilnflight.belt.valves import ValveBar

class Never(event.Listener):
    def on_start(self, event):
        raise SystemExit("compiled late")
    def on_end(self, event):
        pass

def spots():
    event.register("numba:compile", Never())
    for k in range(30):
        born = [(5, 90.0), (9, 40.0)]
        yield k, [(390.0 + 6 * (k - first), y) for first, y in born if k > first]

for decision in sort_spots(spots(), Predictor(), ValveSchedule(ValveBar())):
    pass
"""


def test_no_frame_waits_for_a_compiler(tmp_path):
    """The first frame has no particle, later ones have one and two."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    subprocess.run([sys.executable, "-c", COMPILES], env=environment, check=True)
