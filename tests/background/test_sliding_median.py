"""The compiled sliding median against numpy's."""

import numpy as np
import pytest
from tests.definitions import backgrounds as plain

from kilnflight.background import Median
from kilnflight.background.sliding_median import stack_median


@pytest.mark.parametrize(
    ("length", "shape", "window", "indices"),
    [
        (260, (4, 5), 150, range(260)),
        (700, (2, 3), 150, range(0, 700, 90)),
        (500, (2, 3), 31, [499, 0, 250]),
        (200, (2, 3), 150, range(60, 130, 2)),
        (40, (97, 101), 20, [17]),  # more pixels than a tile
        (90, (2, 3), 150, [30]),
    ],
)
@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_runs_and_single_frames_of_any_distance(length, shape, window, indices, dtype):
    stack = np.random.default_rng(length).integers(0, 65536, (length, *shape)).astype(dtype)
    found = Median(window).backgrounds(stack, indices)
    for t, background in zip(indices, found, strict=True):
        np.testing.assert_array_equal(background, plain.median(stack, t, window))


@pytest.mark.parametrize("count", [1, 2, 21])
def test_the_median_of_a_stack_is_numpys(count):
    frames = np.random.default_rng(count).integers(0, 65536, (count, 13, 17), dtype=np.uint16)
    np.testing.assert_array_equal(stack_median(list(frames)), np.median(frames, axis=0))
