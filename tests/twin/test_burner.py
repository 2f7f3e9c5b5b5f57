from dataclasses import replace

import numpy as np
import pytest

from kilnflight.twin.burner import Burner, lance_tube
from kilnflight.twin.camera import Geometry
from kilnflight.twin.life import Moment
from kilnflight.twin.scene import Twin

SMALL = replace(
    Geometry(), rows=192, columns=256, focal_length_px=85.0 / 0.088, lance_pixel=(60.5, 117.0)
)


def test_the_lances_mouth_is_where_particles_start():
    depth, _ = lance_tube(Burner(), SMALL).seen(SMALL, np.array([60.5]), np.array([117.0]))
    assert depth[0] == pytest.approx(SMALL.lance_depth_mm, rel=1e-6)


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
