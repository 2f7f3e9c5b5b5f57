import numpy as np
import pytest

from kilnflight.background import Adaptive, Mean


def random_stack(length, dtype=np.uint16):
    generator = np.random.default_rng(length)
    return generator.integers(0, 65536, (length, 3, 4)).astype(dtype)


def background_in_plain_code(stack, t, window, rate):
    """Eqs 2.7 and 2.8 for a frame far from the ends."""
    half = window // 2
    background = np.concatenate([stack[t - half : t], stack[t + 1 : t + half + 1]]).mean(axis=0)
    for image in stack[t - half : t + 1].astype(float):
        background = (1 - rate) * background + rate * image
    return background


@pytest.mark.parametrize("dtype", [np.uint16, np.float64])
@pytest.mark.parametrize(("window", "rate"), [(50, 0.05), (10, 0.5), (4, 0.0)])
def test_it_is_the_equations(window, rate, dtype):
    stack = random_stack(120, dtype)
    model = Adaptive(window, rate)
    for t, found in zip(range(40, 80), model.backgrounds(stack, range(40, 80)), strict=True):
        expected = background_in_plain_code(stack, t, window, rate)
        np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_with_no_learning_it_is_the_mean_and_with_full_learning_the_frame():
    stack = random_stack(90)
    np.testing.assert_array_equal(
        list(Adaptive(learning_rate=0.0)(stack, range(90))), list(Mean()(stack, range(90)))
    )
    assert not np.any(list(Adaptive(learning_rate=1.0)(stack, range(90))))


def test_the_first_frame_enters_once():
    stack = random_stack(60)
    (found,) = Adaptive().backgrounds(stack, [0])
    expected = 0.95 * stack[1:51].mean(axis=0) + 0.05 * stack[0]
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_it_follows_a_step_as_a_low_pass_does():
    """After the recursion over 26 bright frames, (1 - alpha)^26 of the old mean is left."""
    stack = np.zeros((200, 2, 2), np.uint16)
    stack[75:] = 1000
    (found,) = Adaptive().backgrounds(stack, [100])
    np.testing.assert_allclose(found, 1000.0, rtol=1e-6)
    (found,) = Adaptive().backgrounds(stack, [99])
    start = 1000 * 49 / 50
    np.testing.assert_allclose(found, 1000 + (0.95**26 * start - 0.95**25 * 1000), rtol=1e-6)
