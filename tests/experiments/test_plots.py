"""Plots of flights: what is marked lies where the definition says."""

from itertools import pairwise

import numpy as np
import pandas as pd
import pytest

from kilnflight.checks import InputError
from kilnflight.experiments import plots
from kilnflight.flight import slices
from kilnflight.regression import Fit
from kilnflight.twin.flight import Flight, Flights

FIT = Fit(
    (0.0, 100.0, 6500.0), 0.1, 0, (0.0, 0.1), (2, 2, 2),
    ((1.0, 0.0), (0.0, -4905.0), (-9000.0, 4000.0)), 0.2, 0.6, 60,
)  # fmt: skip
FLIGHT = {
    **{"ending": "landed", "ignition": "seen", "t0_s": 0.1, "ignition_s": 0.2, "end_s": 0.6},
    "dwell_s": 0.5,
}
TRACK = pd.DataFrame({"x": [0.0, np.nan], "y": [0.0, np.nan], "z": [5500.0, np.nan]})


def lines(axes):
    return {line.get_label(): line.get_xydata() for line in axes.lines}


@pytest.mark.parametrize(
    ("ending", "ignition", "case"),
    [
        ("landed", "none", "landed unlit"),
        ("landed", "seen", "landed burning"),
        ("burnt out", "seen", "burnt out"),
        ("landed", "too few points", None),
        ("burnt out", "before seen", None),
        ("lost", "seen", None),
    ],
)
def test_cases_are_those_of_the_figure(ending, ignition, case):
    assert plots.case_of({"ending": ending, "ignition": ignition}) == case


def test_of_each_case_the_flight_with_the_median_dwell_time():
    endings = ["landed", "landed", "landed", "landed", "lost", "burnt out"]
    flights = pd.DataFrame({"particle": range(6), "ending": endings, "from_lance": True})
    flights = flights.assign(ignition="none", dwell_s=[0.5, 0.3, 0.4, 0.1, 0.2, 0.9])
    flights.loc[5, "ignition"] = "seen"
    flights.loc[3, "from_lance"] = False  # does not count
    chosen = plots.examples(flights)
    assert {case: flight["particle"] for case, flight in chosen.items()} == {
        "landed unlit": 2,
        "burnt out": 5,
    }
    fewer = plots.examples(flights.drop(index=1))
    assert fewer["landed unlit"]["particle"] == 2
    assert plots.examples(flights.head(0)) == {}


def test_a_flight_begins_at_the_lance_burns_from_ignition_on_and_ends_where_it_ends(axes):
    plots.draw_dwell_time(axes, FIT, FLIGHT, TRACK)
    drawn = lines(axes)
    np.testing.assert_allclose(drawn["detections"], [[1.0, -0.1]])
    np.testing.assert_allclose(drawn["unlit"][0], [0.0, 0.0], atol=1e-12)
    lit = [9.0 * 0.2 - 4.0 * 0.04, -4.905 * 0.04]
    np.testing.assert_allclose(drawn["unlit"][-1], lit)
    np.testing.assert_allclose(drawn["burning"][0], lit)
    np.testing.assert_allclose(drawn["burning"][-1], drawn["end: landed"][0])
    assert [text.get_text() for text in axes.texts] == ["dwell time 0.50 s"]


def test_past_its_last_detection_a_flight_is_drawn_straight(axes):
    plots.draw_dwell_time(axes, FIT, {**FLIGHT, "end_s": 1.6}, TRACK)
    last, speed = FIT(0.6)[0], FIT.velocity(0.6)[0]
    far = (np.array(FIT.exit_point_mm) - last - speed)[2:] / 1000
    np.testing.assert_allclose(lines(axes)["end: landed"][0][:1], far)
    np.testing.assert_allclose(lines(axes)["burning"][-1], lines(axes)["end: landed"][0])


def test_what_never_burns_is_drawn_unlit_to_its_end(axes):
    plots.draw_dwell_time(axes, FIT, {**FLIGHT, "ignition": "none", "ignition_s": np.nan}, TRACK)
    drawn = lines(axes)
    assert "burning" not in drawn
    np.testing.assert_allclose(drawn["unlit"][-1], drawn["end: landed"][0])


def test_metres_are_passed_on_the_trajectory_and_velocities_are_those_of_the_table(axes):
    passed = slices({3: FIT}, {3: 0.6})
    plots.draw_space_slices(axes, FIT, passed.sample(frac=1.0, random_state=0), 0.6)
    time, depth = lines(axes)["a metre is passed"].T
    np.testing.assert_allclose(depth, [1.0, 2.0, 3.0])
    np.testing.assert_allclose(9.0 * time - 4.0 * time**2, depth)
    labels = [float(text.get_text().split("=")[1].split()[0]) for text in axes.texts]
    np.testing.assert_allclose(labels, passed["velocity_m_s"], atol=0.05)


def test_a_flight_with_a_gap_among_its_slices_is_refused(axes):
    passed = slices({3: FIT}, {3: 0.6})
    for some in (passed[passed["slice_m"] != 2.0], passed.head(0)):
        with pytest.raises(InputError, match="slices: not every slice"):
            plots.draw_space_slices(axes, FIT, some, 0.6)


@pytest.mark.parametrize("by_sample", [False, True])
def test_simulated_flights_are_coloured_as_far_as_they_fly(axes, by_sample):
    flights = Flights.blank(3, Flight())
    for k, samples in enumerate((4, 1, 6)):
        flights.position_m[k, :samples] = np.arange(3.0 * samples).reshape(samples, 3)
    ends = np.array([0.3, 0.5, 0.7])
    values = np.tile(np.arange(len(flights.age_s), dtype=float), (3, 1)) if by_sample else ends
    drawn = plots.draw_from_the_side(axes, flights, values, (0.0, 1.0), 3)
    assert len(drawn.get_segments()) == 3 + 0 + 5
    expected = [0, 1, 2, 0, 1, 2, 3, 4] if by_sample else [0.3] * 3 + [0.7] * 5
    np.testing.assert_allclose(drawn.get_array(), expected)
    np.testing.assert_allclose(drawn.get_segments()[0], [[0.0, 2.0], [3.0, 5.0]])
    fewer = plots.draw_from_the_side(axes, flights, values, (0.0, 1.0), 2)
    assert len(fewer.get_segments()) == 3


def test_boxes_stand_side_by_side_with_their_numbers(axes):
    groups = {
        "true": [np.array([1.0, 2, 3]), np.empty(0)],
        "measured": [np.array([2.0, np.nan])] * 2,
    }
    plots.draw_grouped_boxes(axes, groups, ["a", "b"])
    assert [text.get_text() for text in axes.texts] == ["3", "0", "1", "1"]
    assert [text.get_text() for text in axes.get_xticklabels()] == ["a", "b"]
    names = [handle.get_label() for handle in axes.get_legend_handles_labels()[0]]
    assert names == ["true", "measured"]


def test_open_bounds_are_arrows_from_their_end_and_numbers_diamonds(axes):
    axes.set_ylim(0, 10)
    columns = {"low": [3.0, np.nan, 5.0, 1.0], "high": [np.nan, 4.0, 5.0, 2.0]}
    plots.draw_published(axes, pd.DataFrame({"at": [1.0, 2.0, 3.0, 4.0]} | columns))
    ends = [segment[:, 1] for segment in axes.collections[0].get_segments()]
    np.testing.assert_allclose(ends, [[3.0, 3.9], [3.1, 4.0], [5.0, 5.0], [1.0, 2.0]])
    marks = {line.get_marker(): line.get_xdata().tolist() for line in axes.lines[:3]}
    assert marks == {"D": [3.0], "^": [1.0], "v": [2.0]}
    assert axes.get_ylim() == (0, 10)
    axes.set_ylim(0, 4.5)
    plots.draw_published(axes, pd.DataFrame({"at": [1.0], "low": [7.1], "high": [7.1]}))
    assert axes.get_ylim()[1] > 7.1  # no printed value is cut off


def test_a_falling_particle_ends_lower_from_the_side(axes):
    plots.draw_dwell_time(axes, FIT, FLIGHT, TRACK)  # falls by g t^2 / 2
    assert lines(axes)["end: landed"][0][1] == pytest.approx(-4.905 * 0.5**2)


def test_grouped_bars_stand_side_by_side(axes):
    table = pd.DataFrame(
        {"subset": ["V1", "V1", "V2", "V2"], "kind": ["a", "b"] * 2, "recall": [0.1, 0.2, 0.3, 0.4]}
    )
    plots.draw_bars(axes, table, "subset", "kind", "recall")
    heights = [bar.get_height() for bar in axes.patches]
    assert heights == [0.1, 0.3, 0.2, 0.4]
    assert [label.get_text() for label in axes.get_xticklabels()] == ["V1", "V2"]
    edges = sorted((bar.get_x(), bar.get_x() + bar.get_width()) for bar in axes.patches)
    assert all(left[1] < right[0] for left, right in pairwise(edges))


def test_intervals_have_a_row_per_method_the_first_on_top(axes):
    table = pd.DataFrame(
        {"f1": [0.8, 0.6], "f1_low": [0.7, 0.5], "f1_high": [0.85, 0.65], "printed": [0.9, np.nan],
         "pixels": [0.75, 0.55]},
        index=["best", "other"],
    )  # fmt: skip
    plots.draw_intervals(axes, table, "printed", "pixels")
    assert [label.get_text() for label in axes.get_yticklabels()] == ["best", "other"]
    assert axes.get_ylim()[0] > axes.get_ylim()[1]
    bars = [segment for bars in axes.collections for segment in bars.get_segments()]
    np.testing.assert_allclose(bars, [[[0.7, 0], [0.85, 0]], [[0.5, 1], [0.65, 1]]])
    drawn = lines(axes)
    np.testing.assert_array_equal(drawn["in pixels"], [[0.75, 0], [0.55, 1]])
    np.testing.assert_array_equal(drawn["published"], [[0.9, 0], [np.nan, 1]])


def test_without_and_with_are_joined_at_the_place_of_their_entry(axes):
    table = pd.DataFrame({"who": ["b", "b", "a", "a"], "stage": ["without", "with"] * 2})
    table = table.assign(value=[1.0, 2.0, 3.0, np.nan])
    plots.draw_before_after(axes, table, "who", "stage", "value")
    drawn = lines(axes)
    np.testing.assert_array_equal(drawn["without"], [[1, 0], [3, 1]])
    np.testing.assert_array_equal(drawn["with"], [[2, 0], [np.nan, 1]])
    assert [text.get_text() for text in axes.get_yticklabels()] == ["b", "a"]


def test_no_line_is_drawn_where_a_track_misses_frames():
    tracks = pd.DataFrame({"particle": [1, 1, 1, 2], "frame": [3, 4, 7, 9], "row": [0.0, 1, 5, 2]})
    broken = plots.broken_at_gaps(tracks.assign(col=2.0))
    assert broken["particle"].tolist() == [1] * 4 + [2]
    assert broken["frame"].tolist() == [3, 4, 6, 7, 9]
    assert broken["row"].isna().tolist() == [False, False, True, False, False]
    assert plots.broken_at_gaps(tracks.assign(col=2.0)[:0]).empty
