import numpy as np
import pytest
from matplotlib import pyplot as plt
from scipy.stats import norm

from kilnflight.experiments import pose_pictures, twin_pose
from kilnflight.experiments.pose_pictures import draw_posterior, draw_views, outlines
from kilnflight.twin.camera import Geometry
from kilnflight.twin.flight import ENDS, Flight, Flights
from kilnflight.twin.poses import DRAWS, Pose


@pytest.fixture(scope="module")
def table():
    return pose_pictures.posterior_table(twin_pose.read_fit())


def chip():
    """One flight along the axis, 10 m/s, by gas and elevation."""
    flights = Flights.blank(1, Flight(sample_s=0.01, longest_s=0.2))
    flights.position_m[0] = flights.age_s[:, None] * np.array((10.0, 0.0, 0.0))
    end = np.array([ENDS.index("still flying")], dtype=np.int8)
    last = flights.position_m[0, -1:].astype(float)
    flown = flights._replace(end=end, end_s=np.array([0.2]), end_position_m=last)
    return {(0, degrees): {"wood chip": flown} for degrees in twin_pose.ELEVATIONS}


def test_every_number_has_all_of_prior_and_posterior(table):
    kinds = table.groupby("number")["kind"].value_counts().unstack()
    assert set(kinds.index) == set(twin_pose.FREE)
    assert (kinds == {"bin": twin_pose.BINS, "draw": DRAWS, "mode": 1, "first": 1}).all(axis=None)
    shares = table[table["kind"] == "bin"].groupby("number")[["posterior", "prior"]].sum()
    assert shares["prior"].to_numpy() == pytest.approx(0.998, abs=1e-6)  # ends: 0.001 either side
    assert (shares["posterior"] > 0.98).all()


def test_the_prior_of_a_bin_is_its_area(table):
    bins = table[(table["number"] == "elevation_deg") & (table["kind"] == "bin")]
    width = bins["value"].diff().median()
    middle = norm(0.0, 4.0).pdf(bins["value"]) * width
    np.testing.assert_allclose(bins["prior"], middle, rtol=0.03)


def test_the_picture_shows_the_four_numbers_with_units(table):
    picture = draw_posterior(table)
    labels = [axes.get_xlabel() for axes in picture.axes]
    assert labels == [pose_pictures.LABELS[name] for name in twin_pose.FREE]
    plt.close(picture)


def test_the_lance_begins_at_the_inlet_and_ends_at_its_pixel():
    geometry, pose = Geometry(), Pose(elevation_deg=3.0)
    lines = outlines(geometry, pose)
    lance = geometry.to_kiln(lines["lance"])
    np.testing.assert_allclose(lance[-1], geometry.lance_m, atol=1e-9)
    assert lance[0, 0] == pytest.approx(geometry.inlet_m)
    rise = (lance[-1, 2] - lance[0, 2]) / (lance[-1, 0] - lance[0, 0])
    assert rise == pytest.approx(np.tan(np.deg2rad(3.0)))
    for name in ("inlet plate", "wall at the lance"):
        wall = geometry.to_kiln(lines[name])
        np.testing.assert_allclose(np.hypot(wall[:, 1], wall[:, 2]), geometry.kiln_radius_mm / 1e3)


def test_views_draw_wall_lance_and_flights_of_every_pose():
    poses = {"low": Pose(axis_height_mm=200.0), "high": Pose(axis_height_mm=400.0)}
    picture, table = draw_views(chip(), poses)
    lines = table.groupby("pose")["line"].unique()
    for name in poses:
        assert set(lines[name]) == {"inlet plate", "wall at the lance", "lance", "chip 0"}
    first = table[table["line"] == "chip 0"].groupby("pose")[["row", "col"]].first()
    pixel = np.array(Geometry().lance_pixel)
    np.testing.assert_allclose(first, [pixel, pixel], atol=1.0)  # every flight leaves the lance
    plt.close(picture)
