import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kilnflight.background.sliding_median import (
    COMPARE,
    EMIT,
    LOAD,
    NONE,
    program,
    stack_median,
    surrounding,
)


def run(table, count, frames, outputs, ranks):
    """Execute a program step by step, as its docstring says."""
    slots, results = [None] * count, [None] * outputs
    for kind, *row in table:
        if kind == LOAD:
            slots[row[1]] = frames[row[0]]
        elif kind == EMIT:
            results[row[0]] = [slots[slot] for slot in row[1 : 1 + ranks]]
        else:
            assert kind == COMPARE
            assert not {row[0], row[1]} & {row[2], row[3]}, "in place"
            a, b = slots[row[0]], slots[row[1]]
            for slot, value in zip(row[2:4], (np.minimum(a, b), np.maximum(a, b)), strict=True):
                if slot != NONE:
                    slots[slot] = value
    return results


@settings(max_examples=40, deadline=None)
@given(st.data())
def test_every_rank_of_every_window(data):
    size = data.draw(st.integers(2, 40))
    ranks = tuple(sorted(data.draw(st.sets(st.integers(0, size - 1), min_size=1, max_size=4))))
    starts = tuple(data.draw(st.lists(st.integers(0, 50), min_size=1, max_size=20)))
    starts = tuple(start - min(starts) for start in starts)
    frames = np.random.default_rng(size).integers(0, 30, (max(starts) + size, 50))
    results = run(*program(size, ranks, starts), frames, len(starts), len(ranks))
    for start, values in zip(starts, results, strict=True):
        ordered = np.sort(frames[start : start + size], axis=0)
        np.testing.assert_array_equal(values, ordered[list(ranks)])


@pytest.mark.parametrize(("frames", "most"), [(1, 3100), (10, 330), (32, 125), (64, 95)])
def test_neighbours_share_the_work(frames, most):
    """Minima and maxima per median of 150 frames; a sort of each alone takes 3000."""
    table = program(151, (74, 75, 75, 76), tuple(range(frames)))[0]
    results = table[table[:, 0] == COMPARE, 3:5]
    assert np.sum(results != NONE) / frames <= most


@given(st.integers(1, 30), st.integers(1, 60), st.data())
def test_the_window_holds_the_nearest_frames_that_there_are(window, length, data):
    index = data.draw(st.integers(0, length - 1))
    around = surrounding(index, window, length)
    assert index in around
    assert len(around) == min(window + 1, length)
    assert around.start >= 0
    assert around.stop <= length
    farthest = max(abs(j - index) for j in around)
    for outside in set(range(length)) - set(around):
        assert abs(outside - index) >= min(farthest, (window + 1) // 2)


@pytest.mark.parametrize("count", [1, 2, 3, 20, 21])
def test_the_median_of_a_stack_is_numpys(count):
    frames = np.random.default_rng(count).integers(0, 65536, (count, 13, 17), dtype=np.uint16)
    assert np.array_equal(stack_median(list(frames)), np.median(frames, axis=0))
