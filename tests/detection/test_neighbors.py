"""The nearest neighbours, against all distances."""

from __future__ import annotations

import numpy as np
import pytest

from kilnflight.checks import InputError
from kilnflight.detection.neighbors import nearest_neighbors

GENERATOR = np.random.default_rng(0)
CLOUDS = {
    "surface with crumbs": np.concatenate(
        [GENERATOR.normal(size=(2500, 3)) * (900, 900, 5), GENERATOR.normal(size=(40, 3)) * 9000]
    ),
    "on a grid": np.round(GENERATOR.normal(size=(2000, 3)) * 4),
    "every point many times": np.repeat(GENERATOR.normal(size=(40, 3)), 50, axis=0),
    "one place": np.zeros((60, 3)),
}


@pytest.mark.parametrize("k", [1, 7, 35])
@pytest.mark.parametrize("name", CLOUDS)
def test_neighbours_are_those_of_all_distances(name, k):
    cloud = CLOUDS[name]
    found = nearest_neighbors(cloud, k, "cloud")
    axes = [np.subtract.outer(axis, axis) for axis in cloud.T]
    squares = axes[0] ** 2 + axes[1] ** 2 + axes[2] ** 2
    np.fill_diagonal(squares, np.inf)
    # of equally distant points the first ones of the cloud
    wanted = np.argsort(squares, axis=1, kind="stable")[:, :k]
    np.testing.assert_array_equal(np.sort(found.indices, axis=1), np.sort(wanted, axis=1))
    np.testing.assert_array_equal(found.squares, np.sort(squares, axis=1)[:, k - 1])


def test_too_few_points_are_refused():
    with pytest.raises(InputError, match="5 points have no 5 neighbours"):
        nearest_neighbors(np.zeros((5, 3)), 5, "cloud")
