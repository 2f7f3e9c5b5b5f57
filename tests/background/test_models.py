"""The six background models against their equations, and what they have in common."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.definitions import backgrounds as plain

from kilnflight.background import (
    MODELS,
    Adaptive,
    Mean,
    Median,
    RunningGaussian,
    ThreeFrame,
    TwoFrame,
)
from kilnflight.background.frames import HeldFrames
from kilnflight.checks import InputError
from kilnflight.project import claims

every_model = pytest.mark.parametrize("model", MODELS, ids=lambda model: type(model).__name__)
WINDOWED = (Mean, Median, Adaptive)


def noise(length, shape=(3, 4), dtype=np.uint16, top=65536):
    return np.random.default_rng(length).integers(0, top, (length, *shape)).astype(dtype)


class Lazy:
    """A view of a stack that notes what is read."""

    def __init__(self, stack):
        self.stack, self.read = stack, []

    def __len__(self):
        return len(self.stack)

    def __getitem__(self, index):
        self.read.append(index)
        return self.stack[index]


def test_the_defaults_are_those_of_table_5_4():
    table = claims.published("table_5.4")
    value = table.set_index(["method", "adjustable_parameter"])["optimal_value"]
    learning, running = value["Adaptive background learning"], value["Running Gaussian average"]
    printed = (
        TwoFrame(int(value["2-frame difference", "Computing interval"])),
        ThreeFrame(int(value["3-frame difference", "Computing interval"])),
        Mean(int(value["Mean filter", "Number of frames"])),
        Median(int(value["Median filter", "Number of frames"])),
        Adaptive(int(learning["Number of frames"]), float(learning["Learning rate alpha"])),
        RunningGaussian(
            int(running["Number of frames"]),
            float(running["Learning rate alpha"]),
            float(running["Coefficient k"]),
        ),
    )
    assert printed == MODELS


@given(st.integers(1, 6), st.integers(13, 20), st.data())
def test_frame_differences_are_the_equations(interval, length, data):
    stack = noise(length)
    t = data.draw(st.integers(interval, length - 1 - interval))
    (two,) = TwoFrame(interval)(stack, [t])
    np.testing.assert_array_equal(two, plain.frame_difference(stack, t, [t - interval]))
    (three,) = ThreeFrame(interval)(stack, [t])
    beside = [t - interval, t + interval]
    np.testing.assert_array_equal(three, plain.frame_difference(stack, t, beside))


@pytest.mark.parametrize(
    ("model", "length", "t", "beside"),
    [
        (TwoFrame(), 10, 1, [4]),
        (ThreeFrame(), 10, 1, [4, 4]),
        (ThreeFrame(), 10, 9, [6, 6]),
        (TwoFrame(), 3, 1, [2]),
        (ThreeFrame(), 3, 2, [0, 0]),
        (TwoFrame(), 1, 0, [0]),
    ],
)
def test_at_the_ends_the_other_side_and_then_the_farther_end_is_taken(model, length, t, beside):
    stack = Lazy(noise(length))
    (found,) = model(stack, [t])
    np.testing.assert_array_equal(found, plain.frame_difference(stack.stack, t, beside))
    assert set(stack.read) == {t, *beside}


@given(st.integers(1, 60), st.integers(2, 70), st.integers(0, 2**32), st.sampled_from([3, 65536]))
def test_mean_and_median_are_the_definition(window, length, seed, top):
    stack = noise(length, top=top)
    indices = np.random.default_rng(seed).integers(0, length, 12)
    means, medians = Mean(window).backgrounds(stack, indices), Median(window)(stack, indices)
    for t, mean, foreground in zip(indices, means, medians, strict=True):
        np.testing.assert_allclose(mean, plain.mean(stack, t, window), rtol=1e-7)
        expected = np.abs(stack[t] - plain.median(stack, t, window))
        np.testing.assert_array_equal(foreground, expected)  # exact, halves included


@pytest.mark.parametrize("dtype", [np.uint16, np.float64])
@pytest.mark.parametrize(("window", "rate"), [(50, 0.05), (10, 0.5), (4, 0.0)])
def test_adaptive_is_its_equations(window, rate, dtype):
    stack, indices = noise(90, dtype=dtype), [0, 10, 45, 60]
    images = Adaptive(window, rate).backgrounds(stack, indices)
    for t, image in zip(indices, images, strict=True):
        np.testing.assert_allclose(image, plain.adaptive(stack, t, window, rate), rtol=1e-6)


@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
@pytest.mark.parametrize("model", [RunningGaussian(), RunningGaussian(5, 0.5, 1.5)], ids=repr)
def test_running_gaussian_is_its_equations(model, dtype):
    stack = noise(30, dtype=dtype)
    means = list(model.backgrounds(stack, range(30)))
    for t, foreground in zip(range(30), model(stack, range(30)), strict=True):
        mean, expected = plain.running_gaussian(stack, t, model.window, model.memory, model.k)
        np.testing.assert_allclose(means[t], mean, rtol=1e-6)
        np.testing.assert_allclose(foreground, expected, rtol=1e-5, atol=1e-3)
    assert not next(RunningGaussian(1)(stack, [3])).any()


@every_model
@pytest.mark.parametrize("gray", [np.uint16(0), np.uint16(65535), np.float32(1234.5678)])
def test_a_still_recording_has_no_foreground(model, gray):
    for length in (1, 2, 60, 200):
        stack = np.full((length, 2, 2), gray)
        assert not np.any(list(model(stack, {0, length // 2, length - 1})))


@every_model
def test_frames_are_read_once_and_only_where_needed(model):
    stack = Lazy(noise(400))
    list(model(stack, range(180, 260)))
    assert len(stack.read) == len(set(stack.read))
    assert min(stack.read) >= 180 - 75
    assert max(stack.read) <= 259 + 75
    empty = Lazy(noise(5))
    assert list(model(empty, [])) == empty.read == []


def test_no_more_frames_are_held_than_there_is_room_for():
    stack = Lazy(np.arange(100, dtype=np.uint16).repeat(6).reshape(100, 2, 3))
    held = HeldFrames(stack, 3)
    for indices in ([10], [11], [50], [12], [11, 10], [97, 98, 99]):
        held.fetch(indices)
        assert [held[index][0, 0] for index in indices] == indices
        assert len(held._images) <= 3
    assert stack.read == [10, 11, 50, 12, 97, 98, 99]  # the farthest, 50, was evicted for 12


@every_model
def test_a_particle_appears_where_it_is_bright_or_dark(model):
    stack = np.full((200, 30, 40), 1000, np.uint16)
    stack[100, 20, 11] += 5000
    (foreground,) = model(stack, [100])
    assert np.argwhere(foreground).tolist() == [[20, 11]]
    assert foreground[20, 11] == pytest.approx(5000, rel=0.06)
    np.testing.assert_allclose(next(model(65535 - stack, [100])), foreground, rtol=1e-6)


def test_frames_of_different_shapes_are_refused():
    with pytest.raises(InputError, match="frame 1"):
        list(Mean(4)([np.zeros((3, 4)), np.zeros((3, 5))], [0]))


@pytest.mark.parametrize("dtype", [np.uint8, ">u2", np.float32])
@pytest.mark.parametrize("kind", WINDOWED)
def test_the_foreground_is_the_difference_or_its_positive_part(kind, dtype):
    stack, indices = list(noise(90, top=200, dtype=dtype)), [0, 40, 41, 89]
    images = list(kind().backgrounds(stack, indices))
    exact = [stack[t].astype(np.float64) - image for t, image in zip(indices, images, strict=True)]
    np.testing.assert_allclose(list(kind()(stack, indices)), np.abs(exact), atol=1e-4)
    positive = list(kind(signed=True)(stack, indices))
    np.testing.assert_allclose(positive, np.maximum(exact, 0), atol=1e-4)


@pytest.mark.parametrize(
    ("kind", "name", "bad"),
    [
        *((kind, "interval", bad) for kind in (TwoFrame, ThreeFrame) for bad in (0, 2.5, None)),
        *((kind, "window", bad) for kind in (*WINDOWED, RunningGaussian) for bad in (0, 2.5, None)),
        (Adaptive, "learning_rate", 1.1),
        (RunningGaussian, "memory", -0.1),
        (RunningGaussian, "k", -1),
    ],
)
def test_parameters_out_of_range_are_refused(kind, name, bad):
    with pytest.raises(InputError, match=name):
        kind(**{name: bad})
