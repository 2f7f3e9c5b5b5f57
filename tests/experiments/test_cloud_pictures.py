"""Pictures of clouds: the particle that is marked, and shares of near neighbours."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from kilnflight.experiments import cloud_pictures


def cloud():
    parts = [(-1, 40), (4, 3), (9, 7)]
    generator = np.random.default_rng(0)
    rows = [
        pd.DataFrame(generator.normal(0, 5, (size, 3)), columns=list("xyz")).assign(particle=name)
        for name, size in parts
    ]
    table = pd.concat(rows, ignore_index=True).assign(gray=100.0)
    table["y"] += 700.0 * (table["particle"] == 9)
    table["z"] += 6000.0
    return table


def test_the_particle_with_the_most_points_is_marked_and_drawn_high_where_it_is_high():
    picture, marked = cloud_pictures.draw_cloud(cloud(), 0)
    assert (marked["particle"] == 9).all()
    assert len(marked) == 7
    up = picture.axes[1].collections[0].get_offsets()[:, 1]
    np.testing.assert_allclose(up, marked["y"] - marked["y"].mean(), atol=1e-9)
    ring = picture.axes[0].collections[-1]._offsets3d
    assert ring[2][0] == pytest.approx(marked["y"].mean() / 1000)


def test_a_cloud_without_particles_is_drawn():
    table = cloud()
    _, marked = cloud_pictures.draw_cloud(table[table["particle"] < 0], 0)
    assert marked.empty


def test_shares_count_points_with_a_neighbour_within_reach(monkeypatch):
    points = np.array([[0.0, 0, 0], [0.5, 0, 0], [10, 0, 0], [13, 0, 0]])
    monkeypatch.setattr(cloud_pictures, "calibrated_cloud", lambda recording, t: points)
    subset = SimpleNamespace(name="V1", recording=None, frames=(0,))
    distances, shares = cloud_pictures.neighbour_distances([subset])
    np.testing.assert_allclose(distances["V1"], [0.5, 0.5, 3.0, 3.0])
    row = shares.set_index("cloud").loc["all"]
    assert row.tolist() == [4, 0.5, 0.5, 1.0]
