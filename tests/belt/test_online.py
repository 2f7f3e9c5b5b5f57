"""A sorter that takes one picture at a time: as the whole recording, and what goes wrong."""

import gc
import tracemalloc
from dataclasses import replace

import cv2
import numpy as np
import pandas as pd
import pytest

from kilnflight.belt import ARRIVAL_MODELS, LATERAL_MODELS, PredictionPhase
from kilnflight.belt.camera import BELT, TRACKED, Area, Calibration
from kilnflight.belt.evaluation import last_states, observe
from kilnflight.belt.models import CV, CVBC, IA, LateralCV, Ratio
from kilnflight.belt.online import EMPTY, MOVES, STANDS, UNCLEAR, OnlineSorter, predict_arrivals
from kilnflight.belt.pictures import MeasureSpots, Spots, measure_spots
from kilnflight.belt.tracker import BELT_FRAME_S, LEFT, LOST, Appearance, BeltTracker
from kilnflight.belt.valves import ValveBar
from kilnflight.belt.velocity import WatchVelocity
from kilnflight.checks import InputError
from kilnflight.tables import VALVE_EVENTS

# One pixel per mm; the belt's first corner is pixel (10, 10).
CALIBRATION = Calibration(np.array([[1.0, 0, 378.0], [0, 1.0, -10.0], [0, 0, 1]]), 0.0, 1.0, 0)
BACKGROUND = np.full((200, 420), 60, dtype=np.uint8)
MEASURE = MeasureSpots(BACKGROUND, Spots(single_px=80.0, split=True), CALIBRATION)
BAR = ValveBar(18, latency_s=0.01)


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


def crowd(frames=130, seed=0):
    rng = np.random.default_rng(seed)
    starts = [
        (int(first), *rng.uniform([20, 1000, -40], [160, 1300, 40]))
        for first in rng.integers(0, frames - 40, 25)
    ]
    return [
        picture(*(place for start in starts for place in way(k, *start))) for k in range(frames)
    ]


PICTURES = crowd()


def sorter(**settings):
    return OnlineSorter(MEASURE, CV(), LateralCV(), BAR, **settings)


def run(online, numbered):
    return [online(shown, frame) for frame, shown in numbered]


def as_states(decisions):
    """Return frame, track, row, valid and state of every track in every frame."""
    return [
        (done.frame, track["particle"], track["row"], track["valid"], *track["state"])
        for done in decisions
        for track in done.tracks
    ]


def events_of(online, decisions):
    parts = [*(done.events for done in decisions), online.close()]
    return pd.concat(parts).sort_values(["open_s", "valve"], ignore_index=True)


def batch(taken):
    """Return what the steps for a whole recording make of the pictures that were taken."""
    shown = [PICTURES[k] for k in taken]
    spots = measure_spots(shown, MEASURE.background, MEASURE.spots, CALIBRATION)
    spots["frame"] = np.asarray(taken)[spots["frame"]]
    return spots, BeltTracker()(spots, taken)


def planned(followed, arrival, lateral):
    last = last_states(followed, BELT_FRAME_S)
    predicted = predict_arrivals(last, arrival, lateral, BELT.end_mm)
    return predicted, BAR.events(predicted)


def calibrated():
    """Return all models, from particles that are seen on the whole belt."""
    spots = measure_spots(PICTURES, BACKGROUND, MEASURE.spots, CALIBRATION, BELT)
    followed = BeltTracker(appearance=Appearance(BELT))(spots)
    phase = PredictionPhase(TRACKED.end_mm, BELT.end_mm - 10)
    last, arrival, _ = observe(followed, spots, phase, BELT_FRAME_S)
    whens = [model.calibrated(last, arrival, phase.target_mm) for model in ARRIVAL_MODELS]
    return whens, [model.calibrated(last, arrival) for model in LATERAL_MODELS]


def test_measurements_and_tracks_are_those_of_the_whole_recording():
    decisions = run(sorter(), enumerate(PICTURES))
    spots, followed = batch(range(130))
    measured = np.concatenate([done.measured for done in decisions])
    np.testing.assert_array_equal(measured, spots.iloc[:, 1:])
    states, number = followed.states, np.bincount(spots["frame"], minlength=130)
    seen = states["row"] >= 0  # rows of a recording are counted through, those of a frame anew
    states.loc[seen, "row"] -= (number.cumsum() - number)[states.loc[seen, "frame"]]
    names = ["frame", "particle", "row", "valid", "x", "y", "velocity_x_mm_s", "velocity_y_mm_s"]
    np.testing.assert_array_equal(as_states(decisions), states[names])


def test_predictions_and_events_are_those_of_the_whole_recording_with_all_models():
    arrivals, laterals = calibrated()
    _, followed = batch(range(130))
    for arrival, lateral in zip(arrivals, [*laterals, laterals[1]], strict=True):
        online = OnlineSorter(MEASURE, arrival, lateral, BAR)
        decisions = run(online, enumerate(PICTURES))
        predicted, events = planned(followed, arrival, lateral)
        known = pd.concat([done.predicted for done in decisions]).sort_values("particle")
        pd.testing.assert_frame_equal(known.reset_index(drop=True), predicted)
        pd.testing.assert_frame_equal(events_of(online, decisions), events)
        assert len(predicted) >= 15
        assert online.schedule.late == online.schedule.never == 0


@pytest.mark.parametrize("lost", [[20], [20, 21, 22], [*range(15, 27)], [*range(0, 130, 3)]])
def test_lost_frames_are_predicted_over_as_in_the_whole_recording(lost):
    taken = [k for k in range(130) if k not in lost]
    online = sorter()
    decisions = run(online, ((k, PICTURES[k]) for k in taken))
    predicted, events = planned(batch(taken)[1], CV(), LateralCV())
    pd.testing.assert_frame_equal(events_of(online, decisions), events)
    assert len(predicted) >= 15


def test_a_gap_is_no_miss():
    """Eight misses in a row lose a track; eight lost frames do not."""
    online, gap = sorter(), range(20, 28)
    numbered = [(k, picture(*way(k))) for k in range(60) if k not in gap]
    decisions = run(online, numbered)
    assert {track["particle"] for done in decisions for track in done.tracks} == {0}
    missed = BeltTracker()(
        pd.DataFrame([(k, *way(k)[0]) for k, _ in numbered], columns=["frame", "x", "y"])
    )
    assert missed.ends["reason"].tolist()[0] == LOST
    assert len(events_of(online, decisions)) == 1


def test_what_left_in_a_long_gap_opens_no_valve_afterwards():
    online = sorter()
    run(online, ((k, picture(*way(k))) for k in range(20)))
    late = online(BACKGROUND, 720_000)
    assert len(late.predicted) == 1
    assert online.schedule.never == 1
    assert late.events.empty
    assert not len(online(BACKGROUND, 720_001).tracks)
    assert online.close().empty


def test_an_hour_of_an_empty_belt_leaves_nothing_behind():
    small = replace(MEASURE, background=BACKGROUND[:60, :60])
    watch = WatchVelocity(6.0, 1.0, frames=50)
    online = OnlineSorter(small, CV(), LateralCV(), BAR, watch=watch)
    run(online, ((k, small.background) for k in range(100)))  # pandas keeps what it meets first
    tracemalloc.start()
    sizes = []
    for first in (100, 719_900):
        for frame in range(first, first + 100):
            done = online(small.background, frame)
        gc.collect()
        sizes.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    grown = sizes[1] - sizes[0]
    assert grown < 100 * 200  # bytes: a decision or a table kept of each frame would be more
    assert done.belt == EMPTY
    assert not len(done.tracks)
    assert np.isnan(watch.change())
    assert watch.has_drifted() is None
    assert all(len(value) == 0 for value in vars(online).values() if hasattr(value, "__len__"))
    assert len(watch._recent) == 50


def places_on_a_belt_that_stops(brake_s, frames):
    """Return x by frame: 1200 mm/s, braked from frame 10 on; from frame 300 on as before."""
    time = BELT_FRAME_S * np.arange(frames)
    changes = [0.05, 0.05 + brake_s, 1.5, 1.5 + brake_s]
    velocity = 1200 * np.interp(time, changes, [1, 0, 0, 1])
    return 392.0 + np.cumsum(velocity) * BELT_FRAME_S


@pytest.mark.parametrize("brake_s", [0.001, 0.25])
def test_a_belt_that_stops_is_noticed_keeps_its_particles_and_opens_no_valve(brake_s):
    online, x = sorter(), places_on_a_belt_that_stops(brake_s, 420)
    shown = [picture((place, 90.0), (place + 20, 40.0)) for place in x]
    decisions = run(online, enumerate(shown))
    belt = [done.belt for done in decisions]
    assert belt[8] == MOVES
    assert set(belt[80:300]) == {STANDS}
    assert belt[320] == MOVES
    assert belt[-1] == EMPTY
    assert all(len(done.measured) == 2 for done in decisions[:300])  # the background stays
    known = [len(done.predicted) for done in decisions]
    assert (sum(known[:300]), sum(known)) == (0, 2)
    assert len(events_of(online, decisions)) == 2


def test_dirt_at_rest_does_not_stop_the_belt():
    online = sorter()
    dirt = (500.0, 30.0)
    decisions = run(online, ((k, picture(dirt, *way(k))) for k in range(60)))
    assert decisions[20].belt == MOVES
    assert decisions[-1].belt == EMPTY
    assert sum(len(done.predicted) for done in decisions) == 1


def test_only_chosen_tracks_are_blown_out():
    shown = [picture(*way(k), *way(k, 3, 30.0)) for k in range(70)]
    all_of, even, none = (
        sorter(),
        sorter(chooses=lambda particle: particle % 2 == 0),
        sorter(chooses=lambda particle: np.zeros(len(particle), dtype=bool)),
    )
    events = [events_of(online, run(online, enumerate(shown))) for online in (all_of, even, none)]
    assert [len(VALVE_EVENTS.check(part)) for part in events] == [2, 1, 0]
    assert events[1]["valve"].tolist() == [9]


def test_a_track_is_predicted_in_the_frame_after_it_was_last_seen():
    online = sorter()
    decisions = run(online, ((k, picture(*way(k))) for k in range(60)))
    told = next(done for done in decisions if len(done.predicted))
    assert online.tracker.reasons(told.tracks).tolist() == [LEFT]
    assert told.frame == 50  # seen last at 684 mm in frame 49
    assert told.predicted["time_s"][0] == pytest.approx((788 - 390) / 1200, abs=1e-3)


def test_what_cannot_be_sorted_is_refused_and_changes_nothing():
    online = sorter()
    run(online, enumerate(PICTURES[:50]))
    for wrong in (49, 3, -1, 50.5, "50", 2**70):
        with pytest.raises(InputError, match="OnlineSorter: frame"):
            online(PICTURES[50], wrong)
    picture, none = PICTURES[50], np.empty((0, 0), np.uint8)
    for wrong in (picture[1:], picture.astype(float), picture.tolist(), None, "50.png", none):
        with pytest.raises(InputError, match=r"frame 50: .*uint8"):
            online(wrong, 50)
    decisions = run(online, ((k, PICTURES[k]) for k in range(50, 130)))
    undisturbed = sorter()
    expected = run(undisturbed, enumerate(PICTURES))
    assert as_states(decisions) == as_states(expected[50:])
    with pytest.raises(InputError, match=r"target_mm 600.* Track less"):
        sorter(target_mm=600.0)


@pytest.mark.parametrize("open_s", [0.001, 0.003, 0.012])
def test_the_commands_of_each_frame_make_up_the_events(open_s):
    online = OnlineSorter(MEASURE, CV(), LateralCV(), replace(BAR, open_s=open_s))
    decisions = run(online, enumerate([*PICTURES, *60 * [BACKGROUND]]))  # until all have ended
    for done in decisions:
        inside = done.due["open_s"] >= (done.frame + 1) * BELT_FRAME_S
        assert (inside & (done.due["close_s"] <= (done.frame + 2) * BELT_FRAME_S)).all()
    parts = pd.concat([done.due for done in decisions]).sort_values(["valve", "open_s"])
    continues = parts["open_s"].eq(parts["close_s"].shift()) & parts["valve"].eq(
        parts["valve"].shift()
    )
    joined = parts.groupby((~continues).cumsum()).agg(
        {"valve": "first", "open_s": "first", "close_s": "last"}
    )
    joined = joined.sort_values(["open_s", "valve"], ignore_index=True)
    pd.testing.assert_frame_equal(joined, events_of(online, decisions))
    assert len(joined) >= 15


def test_a_belt_of_another_size_is_sorted_as_the_papers():
    """The same pictures, taken for a belt of 1.5 times the size from 0 on."""
    size = np.diag([1.5, 1.5, 1.0]) @ np.array([[1.0, 0, -388.0], [0, 1, 0], [0, 0, 1]])
    calibration = Calibration(size @ CALIBRATION.matrix, 0.0, 1.5, 0)
    own = OnlineSorter.of_belt(
        Area(0, 600, 270),
        replace(MEASURE, calibration=calibration),
        CV(),
        LateralCV(),
        BAR,
        velocity_mm_s=2250.0,
        untracked_mm=150.0,
    )
    predicted = [
        pd.concat([done.predicted for done in run(each, enumerate(PICTURES))])
        for each in (own, sorter())
    ]
    assert len(predicted[0]) == len(predicted[1]) >= 15
    np.testing.assert_allclose(predicted[0]["time_s"], predicted[1]["time_s"], atol=5e-4)
    np.testing.assert_allclose(predicted[0]["y"], 1.5 * predicted[1]["y"], atol=0.5)


def test_the_papers_belt_has_the_defaults():
    own = OnlineSorter.of_belt(BELT, MEASURE, CV(), LateralCV(), BAR)
    expected = sorter()
    for name in ("measure", "bar", "tracker", "target_mm"):
        assert getattr(own, name) == getattr(expected, name) or name == "measure"
    assert own.measure.area == expected.measure.area
    with pytest.raises(InputError, match="velocity_mm_s"):
        OnlineSorter.of_belt(BELT, MEASURE, CV(), LateralCV(), BAR, velocity_mm_s=0.0)


@pytest.mark.parametrize(
    ("measure", "bar"),
    [
        (replace(MEASURE, area=Area(end_mm=650.0)), BAR),
        (replace(MEASURE, area=Area(0, 600, 270)), BAR),
        (MEASURE, replace(BAR, belt_mm=270.0)),
    ],
)
def test_parts_of_two_belts_are_refused(measure, bar):
    with pytest.raises(InputError, match=r"two belts.*of_belt"):
        OnlineSorter(measure, CV(), LateralCV(), bar)


@pytest.mark.parametrize(("arrival", "lateral"), [(IA(), LateralCV()), (CV(), Ratio())])
def test_models_that_are_not_calibrated_are_refused_at_once(arrival, lateral):
    with pytest.raises(InputError, match="not calibrated"):
        OnlineSorter(MEASURE, arrival, lateral, BAR)


@pytest.mark.parametrize("wrong", [[1], [True, False], ["yes"]])
def test_a_choice_that_is_none_is_refused(wrong):
    online = sorter(chooses=lambda particle: np.array(wrong))
    with pytest.raises(InputError, match="chooses returned"):
        run(online, ((k, picture(*way(k))) for k in range(60)))


@pytest.mark.parametrize("settings", [{"arrival": CVBC(-0.2)}, {"most_s": 0.05}])
def test_what_arrives_before_it_was_seen_or_far_too_late_is_out_of_reach(settings):
    online = OnlineSorter(
        **{"arrival": CV()} | settings, measure=MEASURE, lateral=LateralCV(), bar=BAR
    )
    decisions = run(online, ((k, picture(*way(k))) for k in range(60)))
    assert pd.concat([done.predicted for done in decisions])["time_s"].isna().tolist() == [True]
    assert online.schedule.out_of_reach == 1
    assert events_of(online, decisions).empty


@pytest.mark.parametrize("lighter", [45, 80])
def test_another_light_is_noticed_and_opens_no_valve(lighter):
    online = sorter()
    shown = [picture(*way(k)) + np.uint8(lighter * (k >= 70)) for k in range(100)]
    decisions = run(online, enumerate(shown))
    assert {done.belt for done in decisions[70:]} == {UNCLEAR}
    assert sum(len(done.predicted) for done in decisions) == 1
    flash = [picture(*way(k)) + np.uint8(lighter * (k == 20)) for k in range(70)]
    online = sorter()
    decisions = run(online, enumerate(flash))
    assert [done.frame for done in decisions if done.belt == UNCLEAR] == [20]
    assert len(events_of(online, decisions)) == 1


def test_a_class_by_size_can_be_chosen_from_the_frames_before():
    areas = {}
    online = sorter(chooses=lambda ids: np.array([np.median(areas[k]) > 100 for k in ids], bool))
    parts = []
    for frame in range(70):
        shown = picture(*way(frame), *way(frame, y=30.0))
        for x, y in way(frame, y=125.0):
            cv2.circle(shown, (round(x - 378), round(y + 10)), 8, 200, -1)
        parts.append(online(shown, frame))
        seen = parts[-1].tracks[parts[-1].tracks["row"] >= 0]
        for particle, row in zip(seen["particle"], seen["row"], strict=True):
            areas.setdefault(particle, []).append(parts[-1].measured[row, 2])
    assert events_of(online, parts)["valve"].tolist() == [12]
