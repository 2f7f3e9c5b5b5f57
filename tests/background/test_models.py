"""The six background models against their equations, and what they have in common."""

from dataclasses import astuple, replace
from unittest.mock import MagicMock

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.definitions import backgrounds as plain

from kilnflight.background import MODELS, Adaptive, Mean, Median, RunningGaussian
from kilnflight.background.models import Surroundings, ThreeFrame, TwoFrame
from kilnflight.background.sliding_median import stack_median
from kilnflight.checks import InputError
from kilnflight.publication import claims

every_model = pytest.mark.parametrize(
    "model", MODELS, ids=lambda model: type(model).__name__
)
WINDOWED = (Mean, Median, Adaptive)


def noise(length, shape=(3, 4), dtype=np.uint16, top=65536):
    return (
        np.random.default_rng(length).integers(0, top, (length, *shape)).astype(dtype)
    )


def test_the_defaults_are_those_of_table_5_4():
    table = claims.published("table_5.4")
    numbers = pd.to_numeric(table["optimal_value"], errors="coerce").dropna()
    printed = numbers.groupby(table["method"]).agg(list)
    names = ["2-frame difference", "3-frame difference", "Mean filter", "Median filter"]
    names += ["Adaptive background learning", "Running Gaussian average"]
    for model, name in zip(MODELS, names, strict=True):
        assert [
            each for each in astuple(model) if not isinstance(each, bool)
        ] == printed[name]


@pytest.mark.parametrize(
    ("model", "length", "t", "beside"),
    [
        (TwoFrame(), 10, 5, [2]),
        (ThreeFrame(), 10, 5, [2, 8]),
        (TwoFrame(), 10, 1, [4]),
        (ThreeFrame(), 10, 1, [4, 4]),
        (ThreeFrame(), 10, 9, [6, 6]),
        (TwoFrame(), 3, 1, [2]),
        (ThreeFrame(), 3, 2, [0, 0]),
        (TwoFrame(), 1, 0, [0]),
    ],
)
def test_frame_differences(model, length, t, beside):
    """At the ends the frame on the other side is taken, then the farther end."""
    stack = noise(length)
    for absolute in (False, True):
        (found,) = replace(model, absolute=absolute)(stack, [t])
        expected = plain.frame_difference(stack, t, beside, absolute)
        np.testing.assert_array_equal(found, expected)


@given(
    st.integers(1, 160),
    st.integers(2, 300),
    st.integers(0, 2**32),
    st.sampled_from([0, 1, 2, 90]),
    st.sampled_from([(np.uint16, 3), (np.uint16, 65536), (np.float32, 65536)]),
)
def test_mean_and_median_are_the_definition(window, length, seed, step, values):
    stack = noise(length, (3, 4), *values)
    indices = np.random.default_rng(seed).integers(0, length, 12)
    indices = range(indices[0], length, step)[:40] if step else indices.tolist()
    means, medians = (
        Mean(window).backgrounds(stack, indices),
        Median(window)(stack, indices),
    )
    for t, mean, foreground in zip(indices, means, medians, strict=True):
        np.testing.assert_allclose(mean, plain.mean(stack, t, window), rtol=1e-6)
        expected = np.maximum(stack[t] - plain.median(stack, t, window), 0)
        np.testing.assert_array_equal(foreground, expected)  # exact, halves included


@pytest.mark.parametrize("count", [1, 2, 21])
def test_the_median_of_a_stack_is_numpys(count):
    frames = noise(count, (97, 101))  # more pixels than a tile
    np.testing.assert_array_equal(stack_median(list(frames)), np.median(frames, axis=0))


@pytest.mark.parametrize(("window", "rate"), [(50, 0.05), (10, 0.5), (4, 0.0)])
def test_adaptive_is_its_equations(window, rate):
    stack, indices = noise(90), [0, 10, 45, 60]
    images = Adaptive(window, rate).backgrounds(stack, indices)
    for t, image in zip(indices, images, strict=True):
        np.testing.assert_allclose(
            image, plain.adaptive(stack, t, window, rate), rtol=1e-6
        )


@pytest.mark.parametrize(
    "model", [RunningGaussian(), RunningGaussian(5, 0.5, 1.5, absolute=True)], ids=repr
)
def test_running_gaussian_is_its_equations(model):
    stack = noise(30)
    means, foregrounds = model.backgrounds(stack, range(30)), model(stack, range(30))
    for t, found, foreground in zip(range(30), means, foregrounds, strict=True):
        settings = model.window, model.memory, model.k, model.absolute
        mean, expected = plain.running_gaussian(stack, t, *settings)
        np.testing.assert_allclose(found, mean, rtol=1e-6)
        np.testing.assert_allclose(foreground, expected, rtol=1e-5, atol=1e-3)
    assert not next(RunningGaussian(1)(stack, [3])).any()


@every_model
@pytest.mark.parametrize(
    "gray", [np.uint16(0), np.uint16(65535), np.float32(1234.5678)]
)
def test_a_still_recording_has_no_foreground(model, gray):
    for length in (1, 2, 60, 200):
        stack = np.full((length, 2, 2), gray)
        assert not np.any(list(model(stack, {0, length // 2, length - 1})))


@every_model
def test_frames_are_read_once_and_only_where_needed(model):
    frames = MagicMock()
    frames.__len__.return_value, frames.__getitem__.side_effect = (
        400,
        noise(400).__getitem__,
    )
    list(model(frames, range(180, 260)))
    read = sorted(call.args[0] for call in frames.__getitem__.call_args_list)
    assert read == list(range(read[0], read[-1] + 1))
    assert 180 - 75 <= read[0] < read[-1] <= 259 + 75


@every_model
def test_a_particle_appears_where_it_is_bright_or_dark(model):
    stack = np.full((200, 30, 40), 1000, np.uint16)
    stack[100, 20, 11] += 5000
    (foreground,) = model(stack, [100])
    assert np.argwhere(foreground).tolist() == [[20, 11]]
    assert foreground[20, 11] == pytest.approx(5000, rel=0.06)
    (dark,) = model(65535 - stack, [100])
    assert dark[20, 11] == 0
    (absolute,) = replace(model, absolute=True)(65535 - stack, [100])
    np.testing.assert_allclose(absolute[20, 11], foreground[20, 11], rtol=1e-6)


@pytest.mark.parametrize("dtype", [np.uint8, ">u2", np.float32])
@pytest.mark.parametrize("kind", WINDOWED)
def test_the_foreground_is_the_difference_or_its_positive_part(kind, dtype):
    stack, indices = list(noise(90, top=200, dtype=dtype)), [0, 40, 41, 89]
    images = list(kind().backgrounds(stack, indices))
    exact = [
        stack[t].astype(np.float64) - image
        for t, image in zip(indices, images, strict=True)
    ]
    np.testing.assert_allclose(
        list(kind()(stack, indices)), np.maximum(exact, 0), atol=1e-4
    )
    absolute = list(kind(absolute=True)(stack, indices))
    np.testing.assert_allclose(absolute, np.abs(exact), atol=1e-4)


def test_frames_of_another_shape_are_refused():
    with pytest.raises(InputError, match="frame 1"):
        list(Mean(4)([np.zeros((3, 4)), np.zeros((3, 5))], [0]))


def test_surroundings_keep_what_rests_and_take_slow_changes_away():
    row, col = np.mgrid[:120, :160]
    image = (1000 + 2 * col + 300 * (np.hypot(row - 60, col - 80) < 3)).astype(
        np.uint16
    )
    (found,) = Surroundings()(np.stack([image] * 3), [1])
    assert found[60, 80] > 280
    assert found[30:50, 30:130].max() < 5
    assert (found.shape, found.dtype) == (image.shape, np.float32)
