from dataclasses import replace

import numpy as np
import pytest

from kilnflight.checks import InputError
from kilnflight.twin.background import Background, Surroundings
from kilnflight.twin.burner import Burner, Tube, burner_tube, lance_tube
from kilnflight.twin.camera import Geometry, Optics
from kilnflight.twin.life import Moment
from kilnflight.twin.scene import Twin

SMALL = replace(
    Geometry(), rows=192, columns=256, focal_length_px=85.0 / 0.088, lance_pixel=(60.5, 117.0)
)
AROUND = Surroundings(flame_roi=(70, 122, 22, 78), edge_px=11, texture_k=10.0)
BACK = Background(SMALL, Optics(wall_level=12_500.0), AROUND, seed=2)
GRID = np.indices((192, 256), dtype=float)


def test_the_lances_mouth_is_where_particles_start():
    depth, _ = lance_tube(Burner(), SMALL).seen(SMALL, np.array([60.5]), np.array([117.0]))
    assert depth[0] == pytest.approx(SMALL.lance_depth_mm, rel=1e-6)


def test_a_tube_is_seen_where_its_points_are():
    """Points of its side that face the camera lie in the mask, at their own depth or nearer."""
    tube = burner_tube(Burner(), SMALL, AROUND.flame_roi)
    angle, back = np.meshgrid(np.linspace(0, 2 * np.pi, 60), np.linspace(0.0, 1.1, 40))
    radius = 0.999 * tube.radius_mm / 1000
    offset = np.stack([-back, radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    camera = SMALL.to_camera(np.array(tube.mouth_m) + offset)
    row, column = SMALL.project(camera)
    depth, _ = tube.seen(SMALL, row, column)
    assert np.isfinite(depth).mean() > 0.99
    assert (depth <= camera[..., 2] + 1.0).all()
    assert np.isclose(depth, camera[..., 2], rtol=2e-3).mean() > 0.25  # the side turned to us


@pytest.mark.parametrize("degrees", [0.0, 5.5, -1.3])
def test_the_lance_points_where_particles_go(degrees):
    """Points of its side, back along the launch, are seen at their own depth or nearer."""
    tube = lance_tube(Burner(), SMALL, degrees)
    ahead = np.array([np.cos(np.deg2rad(degrees)), 0.0, np.sin(np.deg2rad(degrees))])
    up = np.array([-ahead[2], 0.0, ahead[0]])
    angle, back = np.meshgrid(np.linspace(0, 2 * np.pi, 60), np.linspace(0.0, 2.0, 40))
    radius = 0.999 * tube.radius_mm / 1000
    aside = np.cos(angle)[..., None] * np.array([0.0, 1.0, 0.0]) + np.sin(angle)[..., None] * up
    camera = SMALL.to_camera(np.array(tube.mouth_m) - back[..., None] * ahead + radius * aside)
    depth, _ = tube.seen(SMALL, *SMALL.project(camera))
    assert np.isfinite(depth).mean() > 0.99
    assert (depth <= camera[..., 2] + 1.0).all()
    assert np.isclose(depth, camera[..., 2], rtol=2e-3).mean() > 0.25


def test_a_rising_lance_has_its_far_end_lower():
    rows = []
    for degrees in (0.0, 5.5):
        seen, _ = lance_tube(Burner(), SMALL, degrees).seen(SMALL, *GRID)
        rows.append(np.nonzero(np.isfinite(seen))[0].max())
        assert np.nanmax(seen[np.isfinite(seen)]) <= SMALL.inlet_depth_mm + 100
    assert rows[1] > rows[0] + 10


def test_the_tube_of_a_scene_has_the_elevation_of_its_flights(small_scene):
    twin = Twin(small_scene())
    steep = replace(twin.scene, flight=replace(twin.scene.flight, launch_elevation_deg=6.0))
    assert [Twin(steep)._background.tubes[k].elevation_deg for k in (0, 1)] == [6.0, 0.0]


def test_depth_knows_lance_and_burner():
    solid = np.isfinite(BACK.solid_mm)
    assert 0.002 < solid.mean() < 0.05
    np.testing.assert_array_equal(BACK.depth_mm[solid], BACK.solid_mm[solid])
    assert (BACK.solid_mm[solid] < SMALL.wall_depth(*GRID)[solid]).all()
    assert BACK.depth_mm[~solid].max() <= SMALL.inlet_depth_mm + 100
    assert BACK.solid_mm.min() == pytest.approx(SMALL.lance_depth_mm, rel=0.01)


def test_tubes_are_seen_as_if_all_rays_were_followed_at_once():
    nearest = np.full(SMALL.wall_depth(*GRID).shape, np.inf)
    for tube, (at, seen_mm, shade) in zip(BACK.tubes, BACK._seen_tubes, strict=True):
        depth, shades = tube.seen(SMALL, *GRID)
        whole = np.full_like(depth, np.inf)
        whole[at] = seen_mm
        np.testing.assert_array_equal(whole, depth)
        np.testing.assert_array_equal(shade, shades[at])
        nearest = np.minimum(nearest, depth)
    hidden = nearest >= SMALL.wall_depth(*GRID)
    np.testing.assert_array_equal(
        BACK.solid_mm, np.where(hidden, np.inf, nearest).astype(np.float32)
    )


def test_the_plate_is_not_cloudy():
    point = SMALL.to_kiln(SMALL.unproject(*GRID, BACK.depth_mm))
    plate = np.isclose(point[..., 0], SMALL.inlet_m)
    plate &= GRID[1] > 150  # away from tubes and flame
    assert BACK.level[plate].std() < 0.06 * BACK.level[plate].mean()
    assert BACK.level[plate].mean() < 0.6 * BACK.optics.at_wall


def test_the_flicker_has_strength_and_pace_but_no_lattice():
    times = np.arange(0.0, 12.0, 0.1)
    fields = np.log([BACK._local(t)[::4, ::4] for t in times])
    expected = np.hypot(AROUND.flicker, AROUND.common_flicker)
    assert fields.std(axis=0).mean() == pytest.approx(expected, rel=0.4)
    # a lattice is kinks at its cells: second differences that are nearly all zero
    kinks = np.abs(np.diff([BACK._local(t)[:, 128] for t in times], 2, axis=1)).mean(axis=0)
    assert np.median(kinks) > 0.5 * kinks.mean()


def test_the_burner_stands_inside_the_kiln():
    tube = burner_tube(Burner(), SMALL, AROUND.flame_roi)
    assert np.hypot(*tube.mouth_m[1:]) * 1000 + tube.radius_mm < SMALL.kiln_radius_mm
    assert SMALL.inlet_m + 1.0 < tube.mouth_m[0] < SMALL.lance_m[0] + 1.0


def test_the_flame_is_long_lets_light_through_and_flickers():
    wide = replace(SMALL, rows=384, columns=512, focal_length_px=85.0 / 0.044)
    wide = replace(wide, lance_pixel=(121.0, 234.1))
    around = replace(AROUND, flame_roi=(140, 245, 45, 155), edge_px=22)
    back = Background(wide, BACK.optics, around, seed=4)
    flames = [back.veiled(t)[1] for t in np.arange(0, 2.0, 0.05)]
    dense = np.mean([1 - flame.passing for flame in flames], axis=0)
    row, column = np.indices(dense.shape)
    spread = [
        np.sqrt(np.average((x - np.average(x, weights=dense)) ** 2, weights=dense))
        for x in (row, column)
    ]
    assert spread[1] > 1.2 * spread[0]  # along its axis, which lies nearly along the view
    assert 0.1 < np.mean([flame.passing.min() for flame in flames]) < 0.9
    assert np.std([flame.own.sum() for flame in flames]) > 0.03 * flames[0].own.sum()
    assert all((flame.own[0] == 0).all() for flame in flames)  # ends inside its rectangle
    again = Background(wide, BACK.optics, around, seed=4).veiled(1.0)[1]
    np.testing.assert_array_equal(again.own, back.veiled(1.0)[1].own)


def test_a_particle_behind_the_lance_is_hidden(small_scene):
    twin = Twin(small_scene())
    one = twin.view(20).moment.take(np.array([0]))
    lance = twin.scene.geometry.lance_m
    counts = []
    for ahead in (0.05, -0.3):
        place = lance + np.array([ahead, 0.0, 0.0])
        moved = one._replace(position_m=place[None], landed=np.array([False]))
        twin.life.__dict__["at"] = lambda _, moved=moved: Moment._make(moved)
        counts.append(len(twin.view(20).pixels.place))
    assert counts[0] > 4
    assert counts[1] < 0.3 * counts[0]


def test_a_burner_that_cannot_be_is_refused():
    with pytest.raises(InputError, match="length_mm"):
        Burner(length_mm=0.0)
    assert isinstance(lance_tube(Burner(), SMALL), Tube)
