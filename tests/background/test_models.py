"""What all six models have in common."""

import inspect

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kilnflight.background import (
    MODELS,
    Adaptive,
    Mean,
    Median,
    RunningGaussian,
    StopsAtZero,
    TwoFrame,
)
from kilnflight.checks import InputError
from kilnflight.project import claims

every_model = pytest.mark.parametrize("model", MODELS, ids=lambda model: type(model).__name__)


def noise(length, shape=(5, 7), dtype=np.uint16, top=4096, seed=0):
    generator = np.random.default_rng(seed)
    return generator.integers(0, top, (length, *shape)).astype(dtype)


class Lazy:
    """A view of a stack that counts what is read."""

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
    two, three, mean, median, adaptive, gaussian = MODELS
    assert two.interval == int(value["2-frame difference", "Computing interval"])
    assert three.interval == int(value["3-frame difference", "Computing interval"])
    assert mean.window == int(value["Mean filter", "Number of frames"])
    assert median.window == int(value["Median filter", "Number of frames"])
    learning = value["Adaptive background learning"]
    assert adaptive.window == int(learning["Number of frames"])
    assert adaptive.learning_rate == float(learning["Learning rate alpha"])
    running = value["Running Gaussian average"]
    assert gaussian.window == int(running["Number of frames"])
    assert gaussian.memory == float(running["Learning rate alpha"])
    assert gaussian.k == float(running["Coefficient k"])


@every_model
def test_a_foreground_per_requested_frame_in_the_order_given(model):
    stack = noise(20)
    foregrounds = model(stack, iter([7, 3, 7]))
    assert inspect.isgenerator(foregrounds)
    foregrounds = list(foregrounds)
    assert [f.shape for f in foregrounds] == [(5, 7)] * 3
    assert {f.dtype for f in foregrounds} == {np.dtype(np.float32)}
    np.testing.assert_array_equal(foregrounds[0], foregrounds[2])
    assert (foregrounds[0] != foregrounds[1]).any()


@every_model
@pytest.mark.parametrize("length", [1, 2, 5, 60, 200])
@pytest.mark.parametrize("gray", [0, 700, 65535])
def test_a_still_recording_has_no_foreground(model, length, gray):
    stack = np.full((length, 3, 4), gray, np.uint16)
    for foreground in model(stack, {0, length // 2, length - 1}):
        np.testing.assert_array_equal(foreground, np.zeros((3, 4)))


@every_model
@settings(max_examples=20, deadline=None)
@given(st.floats(-1e6, 1e6))
def test_a_still_recording_of_floats_has_no_foreground(model, gray):
    for foreground in model(np.full((12, 2, 2), gray), [0, 5, 11]):
        assert not foreground.any()


@every_model
@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_the_foreground_of_a_frame_does_not_depend_on_the_others_asked_for(model, dtype):
    stack = noise(230, dtype=dtype)
    whole = list(model(stack, range(230)))
    for indices in ([0], [229], [100, 101], range(110, 50, -1), [0, 229, 3, 114, 20, 150]):
        for index, foreground in zip(indices, model(stack, indices), strict=True):
            assert foreground.tobytes() == whole[index].tobytes(), index


@every_model
def test_what_was_yielded_stays(model):
    stack = noise(30)
    kept = list(model(stack, range(10, 20)))
    copied = [foreground.copy() for foreground in model(stack, range(10, 20))]
    np.testing.assert_array_equal(kept, copied)


@every_model
def test_frames_are_read_once_and_only_where_needed(model):
    stack = Lazy(noise(400))
    list(model(stack, range(180, 260)))
    assert len(stack.read) == len(set(stack.read))
    assert min(stack.read) >= 180 - 75
    assert max(stack.read) <= 259 + 75


@every_model
def test_a_particle_appears_where_it_is_and_with_its_brightness(model):
    stack = np.full((200, 30, 40), 1000, np.uint16)
    stack[100, 20, 11] += 5000
    (foreground,) = model(stack, [100])
    assert np.unravel_index(foreground.argmax(), foreground.shape) == (20, 11)
    assert foreground[20, 11] == pytest.approx(5000, rel=0.06)
    assert (foreground > 0).sum() == 1
    dark = 65535 - stack
    np.testing.assert_allclose(next(iter(model(dark, [100]))), foreground, rtol=1e-6)


@every_model
def test_saturated_frames_do_not_overflow(model):
    stack = np.zeros((160, 2, 2), np.uint16)
    stack[::2] = 65535
    foregrounds = np.stack(list(model(stack, range(160))))
    assert foregrounds.min() >= 0
    assert foregrounds.max() <= 65535


@every_model
def test_no_indices_give_no_foregrounds_and_read_no_frames(model):
    stack = Lazy(noise(5))
    assert list(model(stack, [])) == []
    assert list(model(np.zeros((0, 4, 4), np.uint16), [])) == []
    assert stack.read == []


@every_model
@pytest.mark.parametrize("dtype", ["uint8", "int16", ">u2", "uint32", "int32", "float32"])
def test_other_gray_types_give_the_same(model, dtype):
    stack = noise(40, top=200)
    expected = list(model(stack, range(15, 25)))
    foregrounds = list(model(stack.astype(dtype), range(15, 25)))
    np.testing.assert_allclose(foregrounds, expected, atol=1e-3)


@every_model
@pytest.mark.parametrize("index", [-1, 20, 2**40])
def test_a_missing_frame_is_refused(model, index):
    with pytest.raises(InputError, match=f"there is no frame {index}; the stack has 20 frames"):
        model(noise(20), [3, index])


@every_model
@pytest.mark.parametrize("indices", [5, [1.5], ["a"], None])
def test_indices_that_are_no_whole_numbers_are_refused(model, indices):
    with pytest.raises(InputError, match="no series of frame numbers"):
        model(noise(20), indices)


@every_model
def test_a_frame_unlike_the_others_is_named(model):
    frames = list(noise(20))
    frames[10] = np.zeros((5, 8), np.uint16)
    with pytest.raises(InputError, match=r"frame \d+: uint16 of shape .* but frame \d+ is"):
        list(model(frames, [10]))
    frames[10] = np.zeros((5, 7), np.float32)
    with pytest.raises(InputError, match=r"frame \d+: \w+ of shape"):
        list(model(frames, [10]))


@every_model
def test_frames_that_are_no_gray_images_are_refused(model):
    with pytest.raises(InputError, match="one gray channel"):
        next(model(np.zeros((4, 5, 5, 3), np.uint16), [2]))
    with pytest.raises(InputError, match="complex64 are not supported"):
        next(model(np.zeros((4, 5, 5), np.complex64), [2]))
    stack = np.zeros((4, 5, 5), np.float32)
    stack[2, 1, 3] = np.nan
    with pytest.raises(InputError, match=r"frame 2: the gray value at row, col \(1, 3\) is nan"):
        next(model(stack, [2]))


@pytest.mark.parametrize("kind", [type(model) for model in MODELS])
@pytest.mark.parametrize("count", [0, -150, 2.5, True, None])
def test_a_window_without_frames_is_refused(kind, count):
    name = "interval" if "Frame" in kind.__name__ else "window"
    with pytest.raises(InputError, match=f"{kind.__name__}: {name}: must be a whole number"):
        kind(**{name: count})


def test_invalid_weights_and_thresholds_are_refused():
    for bad in (-0.1, 1.1, np.nan):
        with pytest.raises(InputError, match="Adaptive: learning_rate"):
            Adaptive(learning_rate=bad)
        with pytest.raises(InputError, match="RunningGaussian: memory"):
            RunningGaussian(memory=bad)
    for bad in (-1.0, np.inf, np.nan):
        with pytest.raises(InputError, match="k: must be"):
            RunningGaussian(k=bad)


@pytest.mark.parametrize("model", [Mean(), Median(), Adaptive()], ids=repr)
def test_the_foreground_is_the_difference_from_the_background(model):
    stack = noise(90)
    indices = range(30, 50)
    for t, image, foreground in zip(
        indices, model.backgrounds(stack, indices), model(stack, indices), strict=True
    ):
        np.testing.assert_allclose(foreground, np.abs(stack[t] - image.astype(float)), rtol=1e-6)


@pytest.mark.parametrize("model", [Mean(), Median(), Adaptive(), RunningGaussian()], ids=repr)
def test_backgrounds_stay_and_empty_is_normal(model):
    stack = noise(40)
    kept = list(model.backgrounds(stack, range(5)))
    (first,) = model.backgrounds(stack, [0])
    np.testing.assert_array_equal(kept[0], first)
    assert first.dtype == np.float32
    assert list(model.backgrounds(stack, [])) == []
    with pytest.raises(InputError, match="there is no frame 40"):
        model.backgrounds(stack, [40])


def test_a_list_of_frames_is_a_stack():
    stack = noise(9)
    np.testing.assert_array_equal(
        list(TwoFrame()(list(stack), range(9))), list(TwoFrame()(stack, range(9)))
    )


@pytest.mark.parametrize("dtype", [np.uint16, np.int32, np.float64])
@pytest.mark.parametrize("model", [Mean(), Median(), Adaptive()], ids=repr)
def test_a_difference_that_stops_at_zero_keeps_what_is_brighter_and_no_more(model, dtype):
    stack, indices = noise(90, dtype=dtype), [0, 40, 41, 89]
    every = zip(indices, model.backgrounds(stack, indices), model(stack, indices), strict=True)
    for (t, image, absolute), cut in zip(every, StopsAtZero(model)(stack, indices), strict=True):
        brighter = stack[t] > image
        np.testing.assert_array_equal(cut[brighter], absolute[brighter])
        assert (cut[~brighter] == 0).all()
        assert cut.dtype == np.float32


def test_a_dark_particle_is_deleted_where_differences_stop_at_zero():
    """Section 3.1, case 4: deleted "depending on the applied background model"."""
    stack = np.full((20, 3, 8), 2000, np.uint16)
    stack[10, 1, 2], stack[10, 1, 5] = 500, 3500
    (absolute,) = Median()(stack, [10])
    (cut,) = StopsAtZero(Median())(stack, [10])
    assert absolute[1, [2, 5]].tolist() == [1500, 1500]
    assert cut[1, [2, 5]].tolist() == [0, 1500]


@pytest.mark.parametrize("model", [MODELS[0], MODELS[1], MODELS[5]], ids=repr)
def test_equations_with_bars_do_not_stop_at_zero(model):
    with pytest.raises(InputError, match="absolute difference"):
        StopsAtZero(model)
