from itertools import islice

import numpy as np
import pytest

from kilnflight.experiments import twin_mixture as mixture
from kilnflight.twin import scenes


def test_published_counts_are_those_of_table_5_2():
    assert list(mixture.published_counts("V4")) == [1150, 167, 631]


def test_the_search_tries_neighbours_until_close():
    known, tried = {(5, 9): 0.5}, []

    def measure(sizes):
        tried.append(sizes)
        known[sizes] = (abs(sizes[0] - 7) + abs(sizes[1] - 8)) / 10

    assert mixture.refine(known, measure, 40) == (7, 8)
    assert len(tried) == len(set(tried)) < 40
    assert mixture.refine({(1, 1): 0.3}, known.get, 0) == (1, 1)


def test_neighbours_come_nearest_first_and_never_fall_below_zero():
    nearest = list(islice(mixture.neighbours((0, 4)), 8))
    assert nearest[:4] == [(1, 4), (0, 4), (0, 5), (0, 3)]
    assert min(map(min, nearest)) == 0


@pytest.mark.parametrize("name", ["V5"])  # all five: python -m kilnflight.experiments.twin_mixture
def test_a_subset_counts_as_table_5_2_within_ten_per_cent(name):
    counts = mixture.counted(scenes.ground_truth(name))
    published = mixture.published_counts(name)
    assert np.all(np.abs(counts / published - 1) <= 0.1), f"{counts} instead of {published}"
