import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kilnflight.background import Mean, Median
from kilnflight.background.sliding_median import CHUNK


def others(stack, t, window):
    """The definition: the window other frames nearest in time to t, earlier ones first."""
    length = len(stack)
    first = t - (window + 1) // 2
    first = max(min(first, length - window - 1), 0)
    return [j for j in range(first, min(first + window + 1, length)) if j != t]


def random_stack(length, dtype=np.uint16, seed=0, top=65536):
    generator = np.random.default_rng(seed)
    return generator.integers(0, top, (length, 4, 5)).astype(dtype)


def test_the_window_is_that_of_table_5_4():
    stack = random_stack(400)
    assert others(stack, 200, 150) == [*range(125, 200), *range(201, 276)]
    for model, centre in ((Mean(), np.mean), (Median(), np.median)):
        half = model.window // 2
        window = np.concatenate([stack[200 - half : 200], stack[201 : 201 + half]])
        (background,) = model.backgrounds(stack, [200])
        np.testing.assert_allclose(background, centre(window, axis=0), rtol=1e-6)


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 60), st.integers(2, 70), st.integers(0, 2**32), st.sampled_from([3, 65536]))
def test_they_are_the_definition(window, length, seed, top):
    stack = random_stack(length, seed=seed, top=top)
    indices = np.random.default_rng(seed).integers(0, length, 12)
    means, medians = Mean(window).backgrounds(stack, indices), Median(window)(stack, indices)
    for t, mean, foreground in zip(indices, means, medians, strict=True):
        frames = stack[others(stack, t, window)]
        np.testing.assert_array_equal(mean, frames.mean(axis=0).astype(np.float32))
        expected = np.abs(stack[t] - np.median(frames, axis=0))
        np.testing.assert_array_equal(foreground, expected)  # exact, halves included


@pytest.mark.parametrize("dtype", [np.uint16, np.int32, np.float32, np.float64])
def test_a_long_run_of_medians_is_the_definition(dtype):
    stack = random_stack(260, dtype)
    indices = range(len(stack))
    for t, background in zip(indices, Median().backgrounds(stack, indices), strict=True):
        expected = np.median(stack[others(stack, t, 150)].astype(np.float64), axis=0)
        np.testing.assert_allclose(background, expected, rtol=1e-7)


def test_floats_are_averaged_too():
    stack = random_stack(80).astype(np.float64) / 7
    for t, background in zip(range(80), Mean().backgrounds(stack, range(80)), strict=True):
        np.testing.assert_allclose(background, stack[others(stack, t, 50)].mean(axis=0), rtol=1e-12)


def test_indices_far_apart_and_in_chunks_of_any_length():
    stack = random_stack(2000)
    for indices in (range(0, 2000, 90), [1999, 0, 1000], range(300, 300 + 2 * CHUNK + 1, 2)):
        for t, background in zip(indices, Median().backgrounds(stack, indices), strict=True):
            expected = np.median(stack[others(stack, t, 150)], axis=0)
            np.testing.assert_array_equal(background, expected)


@given(st.integers(2, 150))
@settings(max_examples=20, deadline=None)
def test_a_window_longer_than_the_recording_takes_all_others(length):
    stack = random_stack(length)
    t = length // 3
    rest = np.delete(stack, t, axis=0)
    (median,) = Median(150).backgrounds(stack, [t])
    np.testing.assert_array_equal(median, np.median(rest, axis=0))
    (mean,) = Mean(10**9).backgrounds(stack, [t])
    np.testing.assert_allclose(mean, rest.mean(axis=0), rtol=1e-6)


def test_more_pixels_than_a_tile():
    stack = np.random.default_rng(3).integers(0, 65536, (40, 97, 101)).astype(np.uint16)
    (background,) = Median(20).backgrounds(stack, [17])
    np.testing.assert_array_equal(background, np.median(stack[others(stack, 17, 20)], axis=0))
