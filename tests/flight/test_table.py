"""The table of flights: made-up trajectories with known ends."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kilnflight.detection.wall import Cylinder, InAir
from kilnflight.flight import TOO_FAST, FieldOfView, Rules, flights, kept
from kilnflight.ignition import Ignition
from kilnflight.tables import FLIGHTS

RATE = 330.0
WALL, LIMIT = Cylinder((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 772.0), InAir(800.0)
FALLING = ((0.0,), (0.0, 5000.0), (-8000.0,))  # 5000 t^2: at 800 mm after 0.4 s
LEVEL = ((0.0,), (500.0,), (-8000.0,))


def detections(fit, particle=0, ignites_s=np.inf, **more):
    """The detections of a trajectory: dim, and bright from ignition on."""
    frame = np.arange(
        np.ceil(fit.first_s * RATE), np.floor(fit.last_s * RATE + 1e-9) + 1
    )
    place = fit(frame / RATE)
    gray = 3000.0 + 5000.0 * (frame / RATE >= ignites_s) + 40 * np.sin(7 * frame)
    named = {
        "frame": frame.astype(int),
        "particle": particle,
        "row": 500.0,
        "col": 900.0,
    }
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
    assert burning["ignition_s"] == pytest.approx(0.2, abs=1 / RATE)
    late = flight_of(
        detections(landing, ignites_s=0.42), landing
    )  # the wall ignites it
    assert late["ignition"] == "none"
    burnt = polynomials(LEVEL, first_s=0.05, last_s=0.3)
    gone = flight_of(detections(burnt, ignites_s=0.2), burnt)
    assert (gone["ending"], gone["dwell_s"]) == ("burnt out", pytest.approx(0.3))
    lost = flight_of(detections(burnt), burnt)
    assert (lost["ending"], lost["dwell_s"]) == ("lost", pytest.approx(0.3))


@pytest.mark.parametrize(
    ("last_s", "ending", "end_s"),
    [
        # straight on with the mean velocity of the last 20 ms
        (0.39, "landed", 0.39 + (800 - 5000 * 0.39**2) / (2 * 5000 * 0.38)),
        (0.385, "landed", 0.385 + (800 - 5000 * 0.385**2) / (2 * 5000 * 0.375)),
        (0.36, "lost", 0.36),  # 152 mm short: 300 mm of way with 8.7 m/s are 34 ms
    ],
)
def test_a_track_that_ends_short_of_the_wall(polynomials, last_s, ending, end_s):
    fit = polynomials(FALLING, first_s=0.05, last_s=last_s)
    flight = flight_of(detections(fit), fit)
    assert flight["ending"] == ending
    assert flight["end_s"] == pytest.approx(end_s, abs=1e-6)


def test_without_the_test_of_grey_values_a_flight_lands_or_is_lost(polynomials):
    for last_s, ending in ((0.45, "landed"), (0.3, "lost")):
        fit = polynomials(FALLING, first_s=0.05, last_s=last_s)
        track = detections(fit, ignites_s=0.2)
        flight = flight_of(track, fit, Rules(ignition=None))
        assert (flight["ending"], flight["ignition"]) == (ending, "none")


def test_ignition_is_a_rise_above_the_background(polynomials):
    fit = polynomials(FALLING, first_s=0.05)
    track = detections(fit, ignites_s=0.2)
    track["background"] = track["gray"] - 1000 - 100 * np.sin(track["frame"])
    gray_alone = Rules(ignition=Ignition(above_background=False))
    assert flight_of(track, fit)["ignition"] == "none"
    assert flight_of(track, fit, gray_alone)["ignition"] == "seen"
    darker = track.assign(background=1e6)
    assert flight_of(darker, fit, gray_alone)["ignition"] == "none"
    assert flight_of(track.drop(columns="background"), fit)["ignition"] == "seen"


def test_what_ends_in_the_air_left_the_view_burnt_out_or_was_lost(polynomials):
    """Appendix A.1: unlit ones that leave count; burning ones at the edge cannot be
    analyzed.
    """
    fit = polynomials(LEVEL, first_s=0.05, last_s=0.3)
    burning, unlit = detections(fit, ignites_s=0.2), detections(fit)
    view = FieldOfView(
        roi=[(0, 0), (1500, 0), (1500, 2000), (0, 2000)], frames=range(1000)
    )
    cut = view._replace(frames=range(105))
    for row, lit, dark in (
        (500.0, "burnt out", "lost"),
        (40.0, "lost", "left the view"),
        (-10.0, "lost", "left the view"),
    ):
        for track, ending in ((burning, lit), (unlit, dark)):
            found = flight_of(track.assign(row=row), fit, view=view)
            assert (found["ending"], found["dwell_s"]) == (ending, pytest.approx(0.3))
            assert flight_of(track.assign(row=row), fit, view=cut)["ending"] == "lost"
    landing = polynomials(FALLING, first_s=0.05, last_s=0.45)
    assert (
        flight_of(detections(landing, row=40.0), landing, view=view)["ending"]
        == "landed"
    )


def test_a_flight_that_goes_on_as_another_track_did_not_burn_out(polynomials):
    """Within 50 ms and 45 px."""
    fit = polynomials(LEVEL, first_s=0.05, last_s=0.3)
    track = detections(fit, ignites_s=0.2)
    for after, col, particle, ending in (
        (1, 905.0, 1, "lost"),
        (16, 944.0, 1, "lost"),
        (17, 905.0, 1, "burnt out"),  # too late
        (1, 946.0, 1, "burnt out"),  # too far
        (1, 905.0, -1, "burnt out"),  # in no track
        (-3, 905.0, 1, "burnt out"),  # was there before
    ):
        other = track.assign(frame=track["frame"] + len(track) - 1 + after, col=col)
        both = pd.concat([track, other.assign(particle=particle)], ignore_index=True)
        assert flight_of(both, fit)["ending"] == ending, (after, col, particle)


def test_only_trajectories_that_start_at_the_lance_count(polynomials):
    near = polynomials(FALLING, first_s=0.1)  # 0.8 m in depth
    late = polynomials(FALLING, first_s=0.2)  # 1.6 m
    backwards = polynomials(
        ((0.0,), (0.0,), (3000.0, -40000.0)), first_s=0.08, last_s=0.2
    )
    early, bound = replace(near, t0_at_bound=-1), replace(near, t0_at_bound=1)
    for fit, counts in ((near, 1), (late, 0), (backwards, 0), (early, 0), (bound, 1)):
        assert flight_of(detections(fit), fit)["from_lance"] == counts
    track = detections(near)
    track.loc[0, "z"] = 100.0  # one wrong depth and a missing one
    track.loc[1, ["x", "y", "z"]] = np.nan
    assert flight_of(track, near)["from_lance"]


@given(st.integers(-1000, 1000), st.floats(3000.0, 9000.0))
def test_dwell_does_not_depend_on_the_clock_or_the_order_of_rows(
    polynomials, frames, fall
):
    shift = frames / RATE
    fit = polynomials(((0.0,), (0.0, fall), (-8000.0,)), first_s=0.05)
    track = detections(fit, ignites_s=0.2)
    later = replace(
        fit, t0=shift, first_s=fit.first_s + shift, last_s=fit.last_s + shift
    )
    before = flight_of(track, fit)
    after = flight_of(track.assign(frame=track["frame"] + frames), later)
    for name in ("dwell_s", "ignition_s"):
        assert after[name] == pytest.approx(before[name], abs=1e-6, nan_ok=True)
    more = pd.concat([track, detections(fit, 5), detections(fit, -1)])
    mixed = flight_of(more.sample(frac=1.0, random_state=abs(frames)), fit)
    pd.testing.assert_series_equal(mixed, before)


def test_detections_without_depth_lengthen_a_flight_that_does_not_land(polynomials):
    fit = polynomials(LEVEL, first_s=0.05, last_s=0.3)
    tail = {"z": np.nan, "x": np.nan, "y": np.nan, "frame": 110}
    track = detections(fit)
    flight = flight_of(pd.concat([track, track[-1:].assign(**tail)]), fit)
    assert flight["end_s"] == flight["last_s"] == pytest.approx(110 / RATE)


def test_a_rejected_flight_stays_in_the_table_with_its_reason(polynomials):
    fit = polynomials(((0.0,), (0.0,), (-8000.0,)))
    fast = polynomials(((0.0,), (0.0,), (-40_000.0, 90_000.0)))
    tracks = pd.concat([detections(fit), detections(fast, 1)])
    table = flights(tracks, {0: fit, 1: fast}, WALL, LIMIT, RATE)
    assert list(table["refused"]) == ["", TOO_FAST]
    assert list(kept(table)["particle"]) == [0]
    pd.testing.assert_frame_equal(FLIGHTS.check(table), table)
    assert list(flights(tracks, {}, WALL, LIMIT, RATE).columns) == FLIGHTS.names
    every = flights(tracks, {0: fit, 1: fast}, WALL, LIMIT, RATE, Rules(plausible=None))
    assert list(kept(every)["particle"]) == [0, 1]
