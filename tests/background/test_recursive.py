"""The two recursive backgrounds against their equations in plain code."""

import numpy as np
import pytest

from kilnflight.background import Adaptive, Mean, RunningGaussian


def random_stack(length, dtype=np.uint16):
    generator = np.random.default_rng(length)
    return generator.integers(0, 65536, (length, 6, 7)).astype(dtype)


def learnt(stack, t, window, rate):
    """Eqs 2.7 and 2.8 for a frame far from the ends."""
    half = window // 2
    background = np.concatenate([stack[t - half : t], stack[t + 1 : t + half + 1]]).mean(axis=0)
    for image in stack[t - half : t + 1].astype(float):
        background = (1 - rate) * background + rate * image
    return background


def averaged(stack, t, window, memory, k):
    """Eqs 2.9 and 2.10, the learning rate as the weight of the previous average."""
    frames = stack[max(t - window + 1, 0) : t + 1].astype(float)
    mean, variance = frames[0], np.zeros(frames[0].shape)
    for image in frames[1:]:
        mean = memory * mean + (1 - memory) * image
        variance = memory * variance + (1 - memory) * (image - mean) ** 2
    deviation = np.abs(frames[-1] - mean)
    return mean, np.where(deviation > k * np.sqrt(variance), deviation, 0)


@pytest.mark.parametrize("dtype", [np.uint16, np.float64])
@pytest.mark.parametrize(("window", "rate"), [(50, 0.05), (10, 0.5), (4, 0.0)])
def test_adaptive_is_its_equations(window, rate, dtype):
    stack = random_stack(120, dtype)
    model = Adaptive(window, rate)
    for t, image in zip(range(40, 80), model.backgrounds(stack, range(40, 80)), strict=True):
        np.testing.assert_allclose(image, learnt(stack, t, window, rate), rtol=1e-6)


def test_with_no_learning_it_is_the_mean_and_with_full_learning_the_frame():
    stack = random_stack(90)
    np.testing.assert_array_equal(
        list(Adaptive(learning_rate=0.0)(stack, range(90))), list(Mean()(stack, range(90)))
    )
    assert not np.any(list(Adaptive(learning_rate=1.0)(stack, range(90))))


def test_the_first_frame_enters_once():
    stack = random_stack(60)
    (background,) = Adaptive().backgrounds(stack, [0])
    expected = 0.95 * stack[1:51].mean(axis=0) + 0.05 * stack[0]
    np.testing.assert_allclose(background, expected, rtol=1e-6)


def test_it_follows_a_step_as_a_low_pass_does():
    """After the recursion over 26 bright frames, (1 - alpha)^26 of the old mean is left."""
    stack = np.zeros((200, 2, 2), np.uint16)
    stack[75:] = 1000
    (background,) = Adaptive().backgrounds(stack, [100])
    np.testing.assert_allclose(background, 1000.0, rtol=1e-6)
    (background,) = Adaptive().backgrounds(stack, [99])
    start = 1000 * 49 / 50
    np.testing.assert_allclose(background, 1000 + (0.95**26 * start - 0.95**25 * 1000), rtol=1e-6)


@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
@pytest.mark.parametrize("model", [RunningGaussian(), RunningGaussian(5, 0.5, 1.5)], ids=repr)
def test_running_gaussian_is_its_equations(model, dtype):
    stack = random_stack(30, dtype)
    means = list(model.backgrounds(stack, range(30)))
    for t, foreground in zip(range(30), model(stack, range(30)), strict=True):
        mean, expected = averaged(stack, t, model.window, model.memory, model.k)
        np.testing.assert_allclose(means[t], mean, rtol=1e-6)
        np.testing.assert_allclose(foreground, expected, rtol=1e-5, atol=1e-3)


def test_the_first_image_dominates_the_background():
    """As section 5.1.2 says; Eq. 2.9 as printed would leave 1e-18 of it."""
    stack = np.zeros((30, 2, 2), np.uint16)
    stack[11] = 1000
    (background,) = RunningGaussian().backgrounds(stack, [20])
    np.testing.assert_allclose(background, 1000 * 0.99**9, rtol=1e-6)


def test_what_stays_within_its_scatter_is_no_foreground():
    stack = np.zeros((40, 1, 2), np.uint16)
    stack[:, 0, 0] = 1000 + 100 * (np.arange(40) % 2)  # flickers
    stack[:, 0, 1] = 1000
    stack[39, 0, 1] = 3000  # a particle
    model = RunningGaussian(30, 0.9, 2.0)
    (foreground,) = model(stack, [39])
    assert foreground[0, 0] == 0
    assert foreground[0, 1] == pytest.approx(1800)


def test_the_first_frame_has_no_foreground_and_a_single_frame_no_past():
    stack = random_stack(5)
    assert not next(RunningGaussian()(stack, [0])).any()
    assert not next(RunningGaussian(1)(stack, [3])).any()
