import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kilnflight.belt import PredictionPhase
from kilnflight.checks import InputError
from kilnflight.tables import BELT_ARRIVAL, BELT_LAST, BELT_TRACKS

PHASE = PredictionPhase()


def observe_in_plain_code(tracks, phase):
    """What Figs 2 and 5 describe, one particle and one row at a time."""
    rows, reasons = [], {"gap": 0, "short": 0, "missed": 0}
    for particle, track in tracks.sort_values("frame").groupby("particle"):
        points = list(track[["frame", "time_s", "x", "y"]].itertuples(index=False))
        if points[-1].frame - points[0].frame + 1 != len(points):
            reasons["gap"] += 1
            continue
        begun = next((i for i, p in enumerate(points) if p.x >= phase.start_mm), len(points))
        beyond = next((i for i, p in enumerate(points) if p.x >= phase.target_mm), None)
        if begun < 3:
            reasons["short"] += 1
        elif beyond is None:
            reasons["missed"] += 1
        else:
            a, b, c = points[begun - 3 : begun]
            p, q = points[beyond - 1], points[beyond]
            share = (phase.target_mm - p.x) / (q.x - p.x)
            parabola = np.polyfit([a.time_s - c.time_s, b.time_s - c.time_s, 0], [a.x, b.x, c.x], 2)
            crossing = (p.time_s + share * (q.time_s - p.time_s), p.y + share * (q.y - p.y))
            rows.append((particle, c.time_s, parabola[1], 2 * parabola[0], *crossing))
    return rows, reasons


@st.composite
def some_tracks(draw):
    """Tracks with gaps, late starts and early ends."""
    parts = [BELT_TRACKS.empty()]
    for particle in draw(st.lists(st.integers(0, 50), unique=True, max_size=6)):
        steps = draw(st.lists(st.floats(5.0, 30.0), min_size=1, max_size=40))
        x = draw(st.floats(380.0, 640.0)) + np.cumsum(steps)
        frame = draw(st.integers(0, 9)) + np.arange(len(x))
        keep = np.ones(len(x), dtype=bool)
        keep[draw(st.lists(st.integers(0, len(x) - 1), max_size=1))] = False
        table = pd.DataFrame({"frame": frame, "particle": particle, "time_s": frame / 100})
        parts.append(table.assign(x=x, y=np.sin(x))[keep])
    shuffled = pd.concat(parts).sample(frac=1.0, random_state=1)
    return shuffled.astype({"frame": int, "particle": int})


@given(some_tracks())
def test_the_fast_version_is_the_definition(tracks):
    rows, reasons = observe_in_plain_code(tracks, PHASE)
    last, arrival, left_out = PHASE.observe(tracks)
    assert list(left_out.values()) == list(reasons.values())
    assert last["particle"].tolist() == arrival["particle"].tolist() == [row[0] for row in rows]
    observed = np.column_stack(
        [
            last[["time_s", "velocity_x_mm_s", "acceleration_x_mm_s2"]],
            arrival[["time_s", "y"]],
        ]
    )
    expected = np.array([row[1:] for row in rows]).reshape(-1, 5)
    np.testing.assert_allclose(observed, expected, rtol=1e-6, atol=1e-4)


def test_constant_acceleration_is_recovered_exactly(constant_acceleration):
    last, _, _ = PHASE.observe(constant_acceleration)
    np.testing.assert_allclose(last["acceleration_x_mm_s2"], [1500.0, 800.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(last["acceleration_y_mm_s2"], [-100.0, -100.0, 0.0], atol=1e-6)


def test_no_observation_of_the_phase_is_used(constant_acceleration):
    """Changing what happens inside the phase must not change the last observation."""
    other = constant_acceleration.copy()
    inside = (other["x"] > 640.0) & (other["x"] < 740.0)
    other.loc[inside, "y"] += 5.0
    pd.testing.assert_frame_equal(
        PHASE.observe(constant_acceleration).last, PHASE.observe(other).last
    )


def test_each_reason_to_leave_a_particle_out_is_counted(constant_acceleration):
    gap = constant_acceleration[~constant_acceleration["frame"].isin([12])]
    assert PHASE.observe(gap).left_out["gap in the track"] == 3
    ends = constant_acceleration[constant_acceleration["x"] < 770.0]
    assert PHASE.observe(ends).left_out["target never reached"] == 3
    late = constant_acceleration[constant_acceleration["x"] > 610.0]
    assert PHASE.observe(late).left_out["fewer than three observations before the phase"] == 3


def test_no_tracks_give_empty_tables():
    last, arrival, left_out = PHASE.observe(BELT_TRACKS.empty())
    assert list(last.columns) == BELT_LAST.names
    assert list(arrival.columns) == BELT_ARRIVAL.names
    assert len(last) == len(arrival) == sum(left_out.values()) == 0


def test_two_rows_in_one_frame_are_an_error(constant_acceleration):
    twice = pd.concat([constant_acceleration, constant_acceleration.iloc[[5]]])
    with pytest.raises(InputError, match="particle 3 has two rows in frame 5"):
        PHASE.observe(twice)


def test_uneven_time_is_an_error(constant_acceleration):
    constant_acceleration.loc[7, "time_s"] += 0.004
    with pytest.raises(InputError, match=r"particle 3, frame [78]: time_s does not grow evenly"):
        PHASE.observe(constant_acceleration)
    constant_acceleration["time_s"] = 1.0
    with pytest.raises(InputError, match="does not grow evenly"):
        PHASE.observe(constant_acceleration)


def test_half_frames_are_an_error(constant_acceleration):
    with pytest.raises(InputError, match="column frame holds float64, expected int"):
        PHASE.observe(constant_acceleration.assign(frame=constant_acceleration["frame"] + 0.5))


def test_a_phase_leads_downstream():
    with pytest.raises(InputError, match="downstream"):
        PredictionPhase(start_mm=800.0)


def test_the_target_has_an_observation_after_it(authors_data):
    """The public tracks end between 773 and 788 mm, which is why the target is 773 mm."""
    from kilnflight.belt.recordings import find_dem, read_dem

    for name, path in find_dem().items():
        tracks = read_dem(path)
        end = tracks.groupby("particle")["x"].max()
        arrived = end[end > 700.0]
        assert arrived.min() >= PHASE.target_mm, name
        assert arrived.max() < 788.0 + 1.0
