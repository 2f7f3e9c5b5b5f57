from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from kilnflight.checks import InputError
from kilnflight.detection.wall import Cylinder, distance_to_axis
from kilnflight.experiments import twin_pose
from kilnflight.experiments.twin_pose import (
    CENTRE_MM,
    DIRECTED_MM,
    DIRECTION,
    FREE,
    PRIOR,
    bands,
    ended,
    in_kiln,
    moved,
    off_middle,
    predicted,
    true_numbers,
    within_roi,
    z_scores,
)
from kilnflight.project import claims
from kilnflight.twin import truth
from kilnflight.twin.background import Surroundings
from kilnflight.twin.camera import Geometry
from kilnflight.twin.fitted import first_kiln
from kilnflight.twin.flight import ENDS, Flight, Flights
from kilnflight.twin.particles import FRACTIONS
from kilnflight.twin.poses import DRAWS, Pose, read_poses

PLACE = Geometry()


def straight(velocity_m_s, seconds=1.0):
    """One flight from the origin with a constant velocity (3,)."""
    settings = Flight(sample_s=0.01, longest_s=seconds)
    flights = Flights.blank(1, settings)
    path = flights.age_s[:, None] * np.array(velocity_m_s)
    flights.position_m[0] = path
    end = ENDS.index("still flying")
    return flights._replace(
        end=np.array([end], dtype=np.int8), end_s=np.array([seconds]), end_position_m=path[-1:]
    )


@pytest.fixture(scope="module")
def flown():
    """Flights at the grid's elevations, all the same but for their angle."""
    flights = {}
    for gas in (0, 1):
        for degrees in twin_pose.ELEVATIONS:
            up = 10.0 * np.tan(np.deg2rad(degrees))
            flights[gas, degrees] = {
                name: straight((10.0, aside, up - 1.5))
                for name, aside in zip(FRACTIONS, (0.5, -0.5, 1.0, 0.2), strict=True)
            }
    return flights


def test_a_flight_ends_where_it_meets_the_wall():
    flight = ended(
        straight((10.0, 0.0, -2.0)),
        np.abs(straight((10.0, 0.0, -2.0)).position_m[..., 2]),
        0.705,
        "landed",
    )
    assert flight.end_s[0] == pytest.approx(0.3525, abs=1e-4)
    np.testing.assert_allclose(flight.end_position_m[0], (3.525, 0.0, -0.705), atol=1e-4)
    assert ENDS[flight.end[0]] == "landed"
    known = np.isfinite(flight.position_m[0, :, 0])
    assert known.sum() == 36
    assert known[:36].all()


def test_between_computed_elevations_a_flight_is_turned(flown):
    pose = Pose(elevation_deg=4.2)
    geometry = pose.placed(PLACE)
    path = in_kiln(flown, pose, geometry)["wood chip"].position_m[0]
    up = path[5, 2] - geometry.lance_m[2]
    assert up == pytest.approx(10.0 * 0.05 * np.tan(np.deg2rad(4.2)) - 1.5 * 0.05, abs=1e-5)


def test_flights_of_the_library_land_as_those_in_the_kiln():
    kiln, count = first_kiln(), 60
    flight = replace(kiln.flight, step_s=1e-3, sample_s=1e-2, longest_s=1.5)
    degrees = 3.0
    flight = replace(flight, launch_elevation_deg=degrees)
    direct = truth.released("wood chip", 4.5, kiln._replace(flight=flight), count, 2)
    free = kiln._replace(flight=flight, geometry=twin_pose.WIDE)
    wide = moved(truth.released("wood chip", 4.5, free, count, 2), -twin_pose.WIDE.lance_m)
    cut = in_kiln({(0, 3): {"wood chip": wide}}, Pose(elevation_deg=degrees), PLACE)["wood chip"]
    assert np.median(cut.end_s) == pytest.approx(np.median(direct.end_s), rel=0.07)
    reach = [np.median(each.end_position_m[:, 0]) for each in (cut, direct)]
    assert reach[0] == pytest.approx(reach[1], rel=0.07)
    radius = np.hypot(*cut.end_position_m[cut.end == ENDS.index("landed"), 1:].T)
    np.testing.assert_allclose(radius, 0.7, atol=2e-3)


def test_the_border_of_the_picture_and_what_is_behind_the_camera():
    corner = PLACE.unproject([0.0, 767.5, 0.0], [0.0, 1023.5, 1023.5], 5000.0)
    np.testing.assert_allclose(off_middle(corner, PLACE), [1.0, 0.0, 1.0], atol=1e-9)
    assert np.isnan(off_middle(np.array([[0.0, 0.0, -5.0]]), PLACE)).all()


def test_the_region_of_interest_is_the_scenes_polygon():
    row, column = np.meshgrid(np.arange(5.0, 1530, 61), np.arange(3.0, 2040, 67))
    place = PLACE.unproject(row, column, 5000.0)
    polygon = [(r * PLACE.rows, c * PLACE.columns) for r, c in Surroundings().roi]
    expected = truth.inside(polygon, row, column)
    np.testing.assert_array_equal(within_roi(place, PLACE, twin_pose.FIRST_BOTTOM), expected)


def test_distances_without_error_are_those_from_the_printed_axis():
    axis = Cylinder(CENTRE_MM, DIRECTION, 772.18)
    at_camera = np.array(
        [[CENTRE_MM[0] - DIRECTION[0] / DIRECTION[2] * CENTRE_MM[2], DIRECTED_MM, 0.0]]
    )
    assert distance_to_axis(at_camera, axis)[0] == pytest.approx(0.0, abs=1e-6)
    table = claims.published("table_5.12").set_index("quantity")["value_mm"]
    assert tuple(map(float, table["Center"].strip("[]").split(","))) == pytest.approx(CENTRE_MM)
    assert tuple(map(float, table["Orientation"].strip("[]").split(","))) == DIRECTION


def test_every_term_has_a_value_and_none_is_r2(flown):
    rows, values = twin_pose.terms(), predicted(flown, Pose(), 0, 0.87)
    assert {row.name for row in rows} == set(values.index)
    assert not any("R2" in row.name for row in rows)
    assert all(row.low <= row.high and row.spread > 0 and row.why for row in rows)
    assert values["fitted radius (mm)"] == pytest.approx(772.18, abs=0.01)


def test_lengths_and_depths_follow_the_scale(flown):
    near, far = (predicted(flown, Pose(scale=s), 0, 0.87) for s in (1.0, 1.1))
    assert far["fitted radius (mm)"] == pytest.approx(1.1 * near["fitted radius (mm)"])
    speeds = [true_numbers(flown, Pose(scale=s))["PE granule", "all"] for s in (1.0, 1.1)]
    first = "velocity 0-1 m (m/s)"
    assert speeds[0][first] == pytest.approx(10.0, rel=1e-3)
    assert speeds[1][first] == pytest.approx(11.0, rel=1e-3)


def test_what_is_seen_ends_no_later(flown):
    numbers = true_numbers(flown, Pose(elevation_deg=6.0))
    for name in FRACTIONS:
        reach = numbers[name].unstack()["penetration (m)"]
        assert reach["in view"] <= reach["all"] + 1e-6
        assert 0.0 <= numbers[name, "in view", "lands (%)"] <= 100.0


def test_a_deeper_lance_makes_depth_err_less_relatively(flown):
    first, second = (predicted(flown, Pose(lance_depth_mm=d), 0, 0.87) for d in (5500.0, 7000.0))
    assert second["MAPE z, wood chip (%)"] < first["MAPE z, wood chip (%)"]


def test_z_counts_from_the_bounds():
    rows = [
        twin_pose.Term("a", "t", 1.0, 2.0, 0.5, "w"),
        twin_pose.Term("b", "t", 3.0, 3.0, 1.0, "w"),
    ]
    z = z_scores(rows, pd.Series({"a": 2.5, "b": 1.0}))
    assert z.to_dict() == {"a": 1.0, "b": -2.0}
    inside = z_scores(rows, pd.Series({"a": 1.5, "b": np.nan}))
    assert inside["a"] == 0.0
    assert np.isnan(inside["b"])


def test_bands_range_over_the_draws_alone():
    numbers = {
        "base": pd.Series({"dwell": 0.4, "f1": 0.9}),
        "pose": pd.Series({"dwell": 0.5, "f1": 0.8}),
        "pose-00": pd.Series({"dwell": 0.3, "f1": 0.7}),
        "pose-01": pd.Series({"dwell": 0.6, "f1": np.nan}),
        "pose-02": pd.Series({"dwell": 0.4, "f1": 0.6}),
        "full-jet": pd.Series({"dwell": 9.0, "f1": 0.0}),
    }
    table = bands(numbers)
    assert table.loc["dwell"].tolist() == [0.4, 0.5, 0.3, 0.4, 0.6, 3]
    assert table.loc["f1"].tolist() == [0.9, 0.8, 0.6, pytest.approx(0.65), 0.7, 2]
    with pytest.raises(InputError, match="no draws"):
        bands({"base": numbers["base"]})


def test_the_frozen_result_is_of_todays_terms_and_lies_in_the_prior():
    content = twin_pose.read_fit()
    assert content["cost_calibrated"] < content["cost_inputs_only"] / 2
    assert content["effective"] > 4 * DRAWS  # else draws repeat
    assert len({read_poses().mode, *read_poses().draws}) == DRAWS + 1
    for pose in (read_poses().mode, *read_poses().draws):
        for name in FREE:
            assert np.isfinite(PRIOR[name].logpdf(getattr(pose, name)))
    table = twin_pose.term_table(content)
    assert table["mode_z"].abs().max() < 3.0
    assert (table["mode_z"] ** 2).sum() == pytest.approx(content["cost_calibrated"], abs=0.05)


def test_flights_of_a_kiln_are_computed_at_the_elevations_that_poses_need(monkeypatch):
    asked = []
    monkeypatch.setattr(twin_pose, "_free", lambda kiln, degrees, *_: asked.append(degrees) or {})
    poses = [Pose(elevation_deg=degrees) for degrees in (5.5, 6.9, -1.2, 40.0)]
    flights = twin_pose.library_for(first_kiln(), poses, 1, 0)
    assert asked == [0, 6, 12]
    assert list(flights) == [(0, 0), (0, 6), (0, 12)]
    for pose in poses:
        assert (0, twin_pose.nearest(pose, [key[1] for key in flights])) in flights
