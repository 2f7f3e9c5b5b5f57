"""Flights inside the kiln: up is up, the camera is at the left, and nothing sticks out."""

import json

import matplotlib.pyplot as plt
import numpy as np
import pytest

from kilnflight.experiments.inside import PLOTLY, Inside, within
from kilnflight.twin.fitted import second_kiln

TIME = np.linspace(0.0, 1.0, 30)
KILN = second_kiln()
LANCE = KILN.geometry.lance_m
FALLING = LANCE + np.stack([4.0 * TIME, 0.0 * TIME, -0.3 * TIME**2], axis=1)
SIDEWAYS = LANCE + np.stack([0.5 * TIME, 2.0 * TIME, 0.0 * TIME], axis=1)
OUT = LANCE + np.stack([9.0 * TIME, 0.0 * TIME, 0.0 * TIME], axis=1)


@pytest.fixture
def flights():
    return Inside({"wood chip": [FALLING, OUT], "confetti": [SIDEWAYS]}, "simulated")


def drawn(line):
    return np.array([line[axis] for axis in "xyz"], dtype=float).T


def test_everything_drawn_lies_inside_the_kiln(flights):
    geometry = KILN.geometry
    for line in flights.view()["data"]:
        places = drawn(line)
        places = places[np.isfinite(places).all(axis=1)]
        assert len(places)
        assert np.hypot(places[:, 1], places[:, 2]).max() <= geometry.kiln_radius_mm / 1000 + 1e-3
        assert places[:, 0].min() >= geometry.inlet_m - 1e-3
        assert places[:, 0].max() <= geometry.outlet_m + 1e-3


def test_a_path_ends_where_it_leaves_the_kiln_or_has_no_place():
    geometry = KILN.geometry
    assert len(within(FALLING, geometry)) == len(FALLING)
    assert 0 < len(within(SIDEWAYS, geometry)) < len(SIDEWAYS)
    lost = FALLING.copy()
    lost[7] = np.nan
    assert len(within(lost, geometry)) == 7


def test_a_falling_particle_ends_lower_in_the_view_and_in_the_picture(flights):
    view = flights.view()
    assert "autorange" not in view["layout"]["scene"]["zaxis"]  # not upside down
    height = drawn(view["data"][2])[: len(FALLING), 2]
    assert height[-1] < height[0]
    picture = flights.picture()
    side, along = picture.axes
    (way,) = (line for line in side.lines if line.get_label() == "wood chip")
    assert way.get_ydata()[len(FALLING) - 1] < way.get_ydata()[0]
    assert side.get_ylim()[0] < side.get_ylim()[1]
    assert side.get_xlim()[0] > side.get_xlim()[1]  # towards the camera is left
    assert along.get_xlim()[0] < along.get_xlim()[1]
    plt.close(picture)


def test_one_sees_the_kiln_from_the_side_with_the_camera_at_the_left(flights):
    eye = flights.view()["layout"]["scene"]["camera"]["eye"]
    ahead = -np.array([eye["x"], eye["y"], eye["z"]])
    right = np.cross(ahead, [0, 0, 1])
    assert right[0] < 0  # x grows towards the camera
    assert abs(right[0]) > 5 * abs(right[1])


def test_each_fraction_has_one_line_and_the_data_are_light(flights):
    view = flights._repr_mimebundle_()[PLOTLY]
    named = [line["name"] for line in view["data"] if line.get("showlegend", True)]
    assert named == ["wood chip", "confetti"]
    assert view["layout"]["annotations"][0]["text"] == "simulated"
    many = Inside({name: [FALLING] * 40 for name in "abcd"}, "simulated")
    assert len(json.dumps(many.view(), allow_nan=False)) < 300_000


def test_the_lance_is_drawn_along_the_flights_first_direction(flights):
    start, end = flights.lance()
    np.testing.assert_allclose(end, LANCE)
    assert start[0] == pytest.approx(KILN.geometry.inlet_m)
    rise = np.degrees(np.arctan2(end[2] - start[2], end[0] - start[0]))
    assert rise == pytest.approx(KILN.flight.launch_elevation_deg)


def test_no_flight_gives_an_empty_kiln():
    empty = Inside({}, "simulated")
    assert list(empty.table()) == ["fraction", "flight", "from_lance_m", "across_m", "up_m"]
    assert len(empty.view()["data"]) == 2
    plt.close(empty.picture())
