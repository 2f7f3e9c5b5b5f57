from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from kilnflight.checks import InputError
from kilnflight.detection.wall import Cylinder, InAir
from kilnflight.flight import (
    FieldOfView,
    Landing,
    Rules,
    StartsAtLance,
    flights,
    remaining,
    slices,
    space_sliced_velocity,
    straight_on,
)
from kilnflight.ignition import Ignition
from kilnflight.tables import FLIGHTS, SLICES

RATE = 330.0
WALL = Cylinder((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 772.0)
LIMIT = InAir(800.0)
FALLING = ((0.0,), (0.0, 5000.0), (-8000.0,))  # 5000 t^2: at 800 mm after 0.4 s
LEVEL = ((0.0,), (500.0,), (-8000.0,))
SPEEDS = st.floats(3_000.0, 20_000.0)  # mm/s


def detections(fit, particle=0, ignites_s=np.inf, bright=False, **more):
    """The detections of a trajectory: dim, and bright from ignition on."""
    frame = np.arange(np.ceil(fit.first_s * RATE), np.floor(fit.last_s * RATE + 1e-9) + 1)
    place = fit(frame / RATE)
    gray = 3000.0 + 5000.0 * (bright | (frame / RATE >= ignites_s)) + 40 * np.sin(7 * frame)
    named = {"frame": frame.astype(int), "particle": particle, "row": 500.0, "col": 900.0}
    named |= {"gray": gray, **dict(zip("xyz", place.T, strict=True))}
    return pd.DataFrame(named | more)


def flight_of(track, fit, rules=None, view=None):
    return flights(track, {0: fit}, WALL, LIMIT, RATE, rules, view).iloc[0]


def test_the_three_cases_of_figure_5_18(polynomials):
    landing = polynomials(FALLING, first_s=0.05, last_s=0.45)
    unlit = flight_of(detections(landing), landing)
    assert (unlit["ending"], unlit["ignition"]) == ("landed", "none")
    assert unlit["dwell_s"] == pytest.approx(0.4, abs=1e-6)
    assert np.isnan(unlit["ignition_s"])
    burning = flight_of(detections(landing, ignites_s=0.2), landing)
    assert (burning["ending"], burning["ignition"]) == ("landed", "seen")
    assert burning["dwell_s"] == pytest.approx(0.4, abs=1e-6)
    assert burning["ignition_s"] == pytest.approx(0.2, abs=1 / RATE)
    burnt = polynomials(LEVEL, first_s=0.05, last_s=0.3)
    gone = flight_of(detections(burnt, ignites_s=0.2), burnt)
    assert (gone["ending"], gone["dwell_s"]) == ("burnt out", pytest.approx(0.3))
    assert gone["wall_mm"] == pytest.approx(150.0)


def test_an_unlit_end_in_the_air_is_a_loss(polynomials):
    fit = polynomials(LEVEL, first_s=0.05, last_s=0.3)
    lost = flight_of(detections(fit), fit)
    assert (lost["ending"], lost["dwell_s"]) == ("lost", pytest.approx(0.3))


@pytest.mark.parametrize(
    ("last_s", "ending", "end_s"),
    [
        (0.39, "landed", 0.39 + (800 - 5000 * 0.39**2) / (2 * 5000 * 0.39)),  # straight on
        (0.375, "landed", 0.375 + (800 - 5000 * 0.375**2) / (2 * 5000 * 0.375)),
        (0.35, "lost", 0.35),  # 188 mm short
    ],
)
def test_a_track_that_ends_short_of_the_wall(polynomials, last_s, ending, end_s):
    fit = polynomials(FALLING, first_s=0.05, last_s=last_s)
    flight = flight_of(detections(fit), fit)
    assert flight["ending"] == ending
    assert flight["end_s"] == pytest.approx(end_s, abs=1e-6)


def test_a_particle_that_rests_next_to_the_limit_has_landed(polynomials):
    resting = polynomials(((0.0,), (1400.0, 0.0), (-8000.0,)), last_s=0.5)
    flight = flight_of(detections(resting), resting, Rules(landing=Landing(beyond_s=0.0)))
    assert (flight["ending"], flight["end_s"]) == ("landed", 0.5)
    no_margin = Rules(landing=Landing(beyond_s=0.0, near_mm=50.0))
    assert flight_of(detections(resting), resting, no_margin)["ending"] == "lost"


def test_a_rise_after_the_landing_is_no_ignition_in_flight(polynomials):
    fit = polynomials(FALLING, first_s=0.05, last_s=0.5)
    assert flight_of(detections(fit, ignites_s=0.42), fit)["ignition"] == "none"


def test_ignition_may_be_a_rise_above_the_background(polynomials):
    fit = polynomials(FALLING, first_s=0.05)
    track = detections(fit, ignites_s=0.2)
    track["background"] = track["gray"] - 1000 - 100 * np.sin(track["frame"])
    assert flight_of(track, fit)["ignition"] == "seen"
    assert flight_of(track.assign(background=1e6), fit)["ignition"] == "none"  # it stays darker
    above = Rules(ignition=Ignition(above_background=True))
    assert flight_of(track, fit, above)["ignition"] == "none"
    with pytest.raises(InputError, match="background missing"):
        flight_of(track.drop(columns="background"), fit, above)


def test_a_burning_particle_may_be_lost_at_the_border_of_the_view(polynomials):
    fit = polynomials(LEVEL, first_s=0.05, last_s=0.3)
    track = detections(fit, ignites_s=0.2)
    corners = [(0, 0), (1500, 0), (1500, 2000), (0, 2000)]
    for row, ending in ((500.0, "burnt out"), (40.0, "lost"), (-10.0, "lost")):
        view = FieldOfView(roi=corners)
        assert flight_of(track.assign(row=row), fit, view=view)["ending"] == ending
    for stop, ending in ((1000, "burnt out"), (105, "lost")):
        assert flight_of(track, fit, view=FieldOfView(frames=range(0, stop)))["ending"] == ending
    landing = polynomials(FALLING, first_s=0.05, last_s=0.39)
    assert (
        flight_of(detections(landing), landing, view=FieldOfView(corners, range(130)))["ending"]
        == "landed"
    )


def test_only_trajectories_that_start_at_the_lance_count(polynomials):
    near = polynomials(FALLING, first_s=0.1)  # 0.8 m in depth
    late = polynomials(FALLING, first_s=0.2)  # 1.6 m
    assert flight_of(detections(near), near)["from_lance"]
    flight = flight_of(detections(late), late)
    assert not flight["from_lance"]
    assert flight["start_mm"] == pytest.approx(np.hypot(1600, 200), rel=0.02)
    farther = Rules(start=StartsAtLance(within_mm=2000.0))
    assert flight_of(detections(late), late, farther)["from_lance"]
    bound = replace(near, t0_at_bound=-1)
    assert not flight_of(detections(bound), bound)["from_lance"]
    assert flight_of(detections(bound), bound, Rules(start=StartsAtLance(at_bound=True)))[
        "from_lance"
    ]
    at_first = replace(near, t0_at_bound=1)  # seen from the exit on
    assert flight_of(detections(at_first), at_first)["from_lance"]


def test_one_wrong_depth_and_missing_ones_do_not_decide(polynomials):
    fit = polynomials(FALLING, first_s=0.05)
    track = detections(fit)
    track.loc[0, "z"] = 100.0
    track.loc[1, ["x", "y", "z"]] = np.nan
    assert flight_of(track, fit)["from_lance"]


@settings(deadline=None)
@given(st.floats(-3.0, 3.0), st.floats(3000.0, 9000.0))
@example(1.0, 4000.0)  # reaches the wall just when it is given up
def test_dwell_does_not_depend_on_the_clock(polynomials, shift, fall):
    frames = round(shift * RATE)
    fit = polynomials(((0.0,), (0.0, fall), (-8000.0,)), first_s=0.05)
    track = detections(fit, ignites_s=0.2)
    later = replace(
        fit,
        t0=frames / RATE,
        first_s=fit.first_s + frames / RATE,
        last_s=fit.last_s + frames / RATE,
    )
    before = flight_of(track, fit)
    after = flight_of(track.assign(frame=track["frame"] + frames), later)
    for name in ("dwell_s", "ignition_s"):
        assert after[name] == pytest.approx(before[name], abs=1e-6, nan_ok=True)
    assert after["ending"] == before["ending"]


def test_detections_without_depth_lengthen_a_flight_that_does_not_land(polynomials):
    fit = polynomials(LEVEL, first_s=0.05, last_s=0.3)
    tail = {"z": np.nan, "x": np.nan, "y": np.nan, "frame": 110}
    track = detections(fit)
    flight = flight_of(pd.concat([track, track[-1:].assign(**tail)]), fit)
    assert flight["end_s"] == flight["last_s"] == pytest.approx(110 / RATE)


def test_the_order_of_rows_and_other_tracks_change_nothing(polynomials):
    fit = polynomials(FALLING, first_s=0.05)
    track = detections(fit, ignites_s=0.2)
    more = pd.concat([track, detections(fit, 5), detections(fit, -1)]).sample(
        frac=1.0, random_state=3
    )
    pd.testing.assert_series_equal(flight_of(more, fit), flight_of(track, fit))


def test_nothing_gives_nothing(polynomials):
    fit = polynomials(FALLING)
    for track in (detections(fit), detections(fit)[:0]):
        table = flights(track, {}, WALL, LIMIT, RATE)
        assert list(table.columns) == FLIGHTS.names
        assert not len(table)


def test_bad_input_is_refused(polynomials):
    fit = polynomials(FALLING)
    track = detections(fit)
    with pytest.raises(InputError, match="no track of particle 3"):
        flights(track, {3: fit}, WALL, LIMIT, RATE)
    with pytest.raises(InputError, match=r"column\(s\) gray missing"):
        flight_of(track.drop(columns="gray"), fit)
    with pytest.raises(InputError, match="frame_rate_hz"):
        flights(track, {0: fit}, WALL, LIMIT, 0.0)
    with pytest.raises(InputError, match=r"particle 0: .*no position with depth"):
        flight_of(track.assign(z=np.nan), fit)
    with pytest.raises(InputError, match=r"particle 0: .*sort the track by time"):
        flight_of(pd.concat([track, track]), fit)
    with pytest.raises(InputError, match=r"particle 0: .*not finite"):
        flight_of(track, polynomials(((np.inf,), (0.0,), (0.0,))))
    lit = polynomials(LEVEL)
    with pytest.raises(InputError, match="roi"):
        flight_of(detections(lit, ignites_s=0.2), lit, view=FieldOfView(roi=[1, 2, 3]))


@pytest.mark.parametrize(
    ("method", "more"),
    [
        (Landing, {"beyond_s": -1.0}),
        (Landing, {"near_mm": "a"}),
        (StartsAtLance, {"within_mm": -1.0}),
        (StartsAtLance, {"points": 0}),
        (Rules, {"edge_px": -1.0}),
    ],
)
def test_parameters_out_of_range_are_refused(method, more):
    with pytest.raises(InputError, match=f"{method.__name__}: {next(iter(more))}"):
        method(**more)


def test_what_starts_backwards_and_swings_round_did_not_leave_the_lance(polynomials):
    forwards = polynomials(((0.0,), (0.0,), (-8000.0, 2000.0)), first_s=0.01, last_s=0.2)
    assert flight_of(detections(forwards), forwards)["from_lance"]
    round_about = polynomials(((0.0,), (0.0,), (3000.0, -40000.0)), first_s=0.08, last_s=0.2)
    assert not flight_of(detections(round_about), round_about)["from_lance"]


def in_plain_code(fit, slice_m, samples=400_001):
    """First times at which each slice is reached, by looking everywhere."""
    time = np.linspace(fit.t0, fit.last_s, samples)
    gone = fit.exit_point_mm[2] - fit(time)[:, 2]
    marks = 1000 * slice_m * np.arange(1, 8)
    return [time[np.argmax(gone >= far)] for far in marks if (gone >= far).any()][:6]


@settings(deadline=None)
@given(SPEEDS, st.floats(-5.0, 5.0), st.floats(0.3, 2.0))
def test_the_velocity_of_a_straight_flight_is_its_speed(polynomials, speed, start, slice_m):
    fit = polynomials(((0.0, 0.0), (100.0, 4900.0), (-speed, 0.0)), start, start, start + 0.4)
    table = space_sliced_velocity(fit, slice_m)
    assert list(table["slice_m"]) == [slice_m * n for n in range(1, int(6.5 / slice_m) + 1)]
    passed = table[table["reached"]]
    np.testing.assert_allclose(passed["velocity_m_s"], speed / 1000, rtol=1e-6)
    far = min(0.0004 * speed, 6.5) / slice_m
    assert len(passed) in (int(far - 1e-9), int(far + 1e-9))
    assert table.loc[~table["reached"], "velocity_m_s"].isna().all()


@settings(deadline=None)
@given(SPEEDS, st.floats(-30_000.0, 30_000.0), st.floats(-60_000.0, 60_000.0))
def test_the_times_are_those_that_looking_everywhere_finds(polynomials, speed, bend, third):
    fit = polynomials(((), (), (-speed, bend, third)))
    table = space_sliced_velocity(fit)
    expected = in_plain_code(fit, 1.0, 4001)
    reached = table.loc[table["reached"] & (table["slice_m"] > 0), "end_s"].to_numpy()
    assert len(reached) - len(expected) in (0, 1)  # a turn between two samples may be missed
    assert (np.abs(reached[: len(expected)] - expected) <= 1.01e-4).all()


@settings(deadline=None)
@given(SPEEDS, st.floats(-9_000.0, 9_000.0), st.floats(-100.0, 100.0))
def test_a_shift_in_time_and_other_detections_change_nothing(polynomials, speed, bend, shift):
    fit = polynomials(((), (), (-speed, bend)))
    later = replace(fit, t0=shift, first_s=shift + 0.1, last_s=shift + 0.4)
    one, other = space_sliced_velocity(fit), space_sliced_velocity(later)
    if (one["reached"] == other["reached"]).all():  # else a turn within rounding of a mark
        np.testing.assert_allclose(one["velocity_m_s"], other["velocity_m_s"], rtol=1e-6)
        np.testing.assert_allclose(one["end_s"] + shift, other["end_s"], atol=1e-9)


def test_a_flight_that_turns_passes_each_slice_once(polynomials):
    turning = polynomials(((), (), (-10_000.0, 20_000.0)), last_s=0.5)  # farthest: 1.25 m
    table = space_sliced_velocity(turning)
    assert list(table["reached"]) == [True] + 5 * [False]
    assert table["velocity_m_s"][0] == pytest.approx(1 / (0.25 - np.sqrt(0.0125)))


def test_what_flies_behind_the_lance_has_negative_velocities(polynomials):
    backwards = polynomials(((), (), (5_000.0, 0.0)), last_s=0.5)
    table = space_sliced_velocity(backwards)
    assert list(table["slice_m"]) == [-2.0, -1.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert list(table["reached"]) == 2 * [True] + 6 * [False]
    np.testing.assert_allclose(table["velocity_m_s"][:2], -5.0)


def test_only_what_was_observed_counts(polynomials):
    fit = polynomials(((), (), (-10_000.0,)), last_s=0.25)
    assert space_sliced_velocity(fit)["reached"].sum() == 2
    assert space_sliced_velocity(fit, until_s=0.15)["reached"].sum() == 1
    assert space_sliced_velocity(fit, until_s=9.0)["reached"].sum() == 2
    slow = polynomials(((), (), (0.0, 0.0)))
    assert not space_sliced_velocity(slow)["reached"].any()


def test_a_slice_that_was_passed_before_the_first_detection_is_refused(polynomials):
    fit = polynomials(((), (), (-10_000.0,)), first_s=0.15, last_s=0.35)
    table = space_sliced_velocity(fit)
    assert list(table["reached"]) == 3 * [True] + 3 * [False]
    assert list(table["observed"]) == [False, True, True, False, False, False]


def test_many_flights_and_who_remains(polynomials):
    fits = {
        4: polynomials(((), (), (-10_000.0,)), last_s=0.35),
        9: polynomials(((), (), (-5_000.0,))),
        2: polynomials(((), (), (3_000.0,))),  # backwards
    }
    table = slices(fits)
    assert list(table["particle"]) == [4, 4, 4, 9, 9, 2]
    left = remaining(table, 4).set_index("slice_m")
    assert dict(left["number"]) == {-1.0: 1, 1.0: 2, 2.0: 2, 3.0: 1}
    assert dict(left["share"]) == {-1.0: 0.25, 1.0: 0.5, 2.0: 0.5, 3.0: 0.25}
    assert left["median_m_s"][1.0] == pytest.approx(7.5)
    assert len(slices(fits, {4: 0.15, 9: 9.0})) == 4


def test_no_flights_pass_no_slices():
    assert list(slices({}).columns) == SLICES.names
    assert len(remaining(slices({}), 0)) == 0


def test_what_cannot_be_sliced_is_refused(polynomials):
    fit = polynomials(((), (), (-10_000.0,)))
    for bad, message in ((0.0, "slice_m"), (-1.0, "slice_m"), (1e-4, "take longer ones")):
        with pytest.raises(InputError, match=message):
            space_sliced_velocity(fit, bad)
    with pytest.raises(InputError, match="until_s is NaN"):
        space_sliced_velocity(fit, until_s=float("nan"))
    with pytest.raises(InputError, match=r"leaves the lance at 0\.5"):
        space_sliced_velocity(replace(fit, t0=0.5))
    with pytest.raises(InputError, match="not finite"):
        space_sliced_velocity(polynomials(((), (), (np.nan,))))
    with pytest.raises(InputError, match="2 particles in a slice, but 1 counted"):
        remaining(slices({0: fit, 1: fit}), 1)


def test_past_the_last_detection_a_flight_goes_straight_on(polynomials):
    bent = polynomials(((0.0, 500.0), (100.0, 4900.0), (-9000.0, 4000.0, 7000.0)), last_s=0.4)
    time = np.linspace(bent.t0, bent.last_s, 9)
    np.testing.assert_array_equal(straight_on(bent, time), bent(time))
    later = bent.last_s + np.array([0.1, 0.5])
    steps = straight_on(bent, later) - bent(bent.last_s)
    np.testing.assert_allclose(steps, np.outer([0.1, 0.5], bent.velocity([bent.last_s])[0]))
    with pytest.raises(InputError, match="fitted trajectory"):
        straight_on(polynomials(((0.0,), (np.nan,), (0.0,))), 0.1)
