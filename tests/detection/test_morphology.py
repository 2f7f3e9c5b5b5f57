"""Morphological clustering against its definition, dilation by dilation."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy import ndimage
from scipy.spatial.distance import cdist

from kilnflight.detection import MorphologicalClustering

CUBE = np.ones((3, 3, 3))


def stretched(points, grid):
    shifted = points - points.min(axis=0)
    extent = shifted.max(axis=0)
    return grid * (shifted / np.where(extent > 0, extent, 1.0))


def domains(points, grid, dilations, size_rule):
    """Label each point by Eqs 2.32 to 2.35 on a full grid; 0 where its domain is dropped."""
    cell = tuple(np.floor(stretched(points, grid) + 0.5).astype(int).T)
    occupied = np.zeros((grid + 1,) * 3, bool)
    occupied[cell] = True
    labels, _ = ndimage.label(occupied, CUBE)
    sizes = np.bincount(labels.ravel())[1:]
    least = sizes.mean() if size_rule else 0
    occupied = np.isin(labels, 1 + np.flatnonzero(sizes >= least))
    kept = occupied[cell]
    labels, count = ndimage.label(occupied, CUBE)
    before = done = 0
    while before != count if dilations is None else done < dilations:
        occupied = ndimage.binary_dilation(occupied, CUBE)
        before = count
        labels, count = ndimage.label(occupied, CUBE)
        done += 1
    return np.where(kept, labels[cell], 0)


def check_against_definition(points, grid, dilations, size_rule):
    labels = MorphologicalClustering(grid, dilations, size_rule)(points)
    plain = domains(points, grid, dilations, size_rule)
    pairs = {*zip(labels[plain > 0], plain[plain > 0], strict=True)}
    assert len(pairs) == len(set(labels)) == len(set(plain) - {0})
    position = stretched(points, grid)
    to_all = cdist(position[plain == 0], position[plain > 0])
    for distances, label in zip(to_all, labels[plain == 0], strict=True):
        nearest = np.isclose(distances, distances.min(), rtol=1e-12)
        assert label in labels[plain > 0][nearest]
    first = [np.flatnonzero(labels == label)[0] for label in range(labels.max() + 1)]
    assert first == sorted(first)


clouds = st.integers(0, 2**32 - 1).map(np.random.default_rng)


@given(clouds, st.integers(1, 25), st.sampled_from([0, 1, 2, 5, 40, None]), st.booleans())
@example(np.random.default_rng(3), 25, None, True)
def test_clouds_of_balls_and_crumbs(rng, grid, dilations, size_rule):
    middles = rng.uniform(0, 100, (6, 3))
    balls = middles[rng.integers(0, 6, 200)] + rng.normal(0, 3, (200, 3))
    points = np.concatenate([balls, rng.uniform(0, 100, (30, 3))])
    check_against_definition(points * [1, 1, 10], grid, dilations, size_rule)


@given(clouds, st.sampled_from([4, 8, 16]), st.sampled_from([1, 2, None]), st.booleans())
def test_points_between_cells(rng, grid, dilations, size_rule):
    points = rng.integers(0, 17, (rng.integers(1, 60), 3)) / 2.0
    check_against_definition(points, grid, dilations, size_rule)


def rods(*starts):
    """Rods of five cells along x in a grid of 40, held open by its corners' rods."""
    cells = np.concatenate([np.arange(start, start + 5) for start in starts])
    return np.stack([cells, np.zeros_like(cells), np.zeros_like(cells)], axis=1).astype(float)


@pytest.mark.parametrize(("gap", "found"), [(2, 1), (3, 1), (4, 2)])
def test_one_dilation_closes_two_empty_cells(gap, found):
    points = rods(0, 4 + gap, 36)
    assert MorphologicalClustering(40)(points).max() == found


def test_without_dilation_touching_cells_are_together():
    points = rods(0, 6, 36)
    assert MorphologicalClustering(40, 0)(points).tolist() == [0] * 5 + [1] * 5 + [2] * 5


def test_dilation_ends_when_the_number_of_domains_stays():
    points = rods(0, 7, 36)  # two empty cells, then 24
    assert MorphologicalClustering(40, None)(points).tolist() == [0] * 10 + [1] * 5
    points = rods(0, 9, 36)  # the first dilation closes nothing
    assert MorphologicalClustering(40, None)(points).max() == 2


def test_a_small_domain_is_a_cluster_and_by_the_size_rule_goes_to_the_nearest():
    """Section 5.1.3 names no size; Eq. 2.35 of the general method does."""
    crumb = np.array([[14.0, 0.0, 0.0]])
    points = np.concatenate([crumb, rods(0, 36)])
    assert MorphologicalClustering(40)(points).tolist() == [0] + [1] * 5 + [2] * 5
    ruled = MorphologicalClustering(40, size_rule=True)(points)
    assert ruled.tolist() == [0] + [0] * 5 + [1] * 5


def test_a_finer_grid_tells_more_apart():
    rng = np.random.default_rng(5)
    middles = rng.uniform(0, 200, (30, 3))
    points = np.concatenate([middle + rng.uniform(-3, 3, (200, 3)) for middle in middles])
    found = [MorphologicalClustering(grid)(points).max() for grid in (4, 12, 40)]
    assert found == sorted(found)
    assert found[0] < found[-1]
