"""Tables that come with the pictures of simulated flights."""

import numpy as np
import pandas as pd
import pytest

from kilnflight.experiments import flight_pictures
from kilnflight.scores.flights import METRES, FlightValues
from kilnflight.twin.flight import Flight, Flights

DEPTH = [3.0, 1.0, 2.0]


@pytest.fixture
def flown():
    blank = Flights.blank(3, Flight())
    places = np.column_stack([DEPTH, [0.0] * 3, [0.0] * 3])
    end = np.array([1, 0, 0], dtype=np.int8)
    flights = blank._replace(end=end, end_s=np.array([0.3, 0.1, 0.2]), end_position_m=places)
    return {"confetti": flights}


def test_simulated_flights_are_counted_by_their_end(flown):
    _, ends = flight_pictures.draw_simulated_in_space(flown, 0, 5.0)
    assert ends.to_numpy().tolist() == [["confetti", "landed", 2], ["confetti", "burnt out", 1]]


def test_the_first_flights_end_then_and_there(flown):
    table = flight_pictures.simulated_ends(flown, 2)
    assert table.to_numpy().tolist() == [["confetti", 0, 0.3, 3.0], ["confetti", 1, 0.1, 1.0]]


def values(*dwell):
    velocity = np.arange(5.0 * len(dwell)).reshape(len(dwell), 5)
    return FlightValues(np.array(dwell), velocity, np.full(len(dwell), np.nan), np.array(dwell))


def test_velocities_of_the_first_flights_are_long_and_flight_by_flight():
    table = flight_pictures.simulated_velocities({("confetti", 5.0): values(1.0, 2.0, 3.0)}, 2)
    assert table["flight"].tolist() == [0] * 5 + [1] * 5
    assert table["metre"].tolist() == 2 * list(METRES)
    assert table["velocity_m_s"].tolist() == list(range(10))


def test_dwell_times_are_boxes_by_source_and_fraction():
    key, times = ("confetti", 5.0), [0.1, 0.2, 0.3, 0.4, 0.5]
    sources = {"simulated": {key: values(*times)}, "measured": {key: values(0.7)}}
    picture, table = flight_pictures.draw_dwell_by_source(sources)
    assert picture.axes[0].get_title() == "5.0 bar"
    expected = pd.DataFrame({"source": ["simulated", "measured"], "fraction": "confetti"})
    expected["median"] = [0.3, 0.7]
    pd.testing.assert_frame_equal(table[expected.columns], expected)


def test_facts_are_filled_half_or_crossed_by_campaign_and_version():
    keys = {"fraction": "confetti", "pressure_bar": [4.5, 4.5, 5.0]}
    table = pd.DataFrame(keys | {"fact": "reach", "a_holds": [True, False, False]})
    table["b_holds"] = True
    picture = flight_pictures.draw_facts(table, ["a", "b"])
    axes = picture.axes[0]
    marks = [line.get_fillstyle() for line in axes.lines if len(line.get_xdata())]
    assert sorted(marks) == ["full", "full", "full", "left", "none"]
    assert [text.get_text() for text in axes.texts] == ["1/2", "2/2"]
    assert [each.get_text() for each in axes.get_yticklabels()] == [
        "confetti, 4.5 bar",
        "confetti, 5.0 bar",
    ]
