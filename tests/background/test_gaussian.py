import numpy as np
import pytest

from kilnflight.background import RunningGaussian


def random_stack(length, dtype=np.uint16):
    generator = np.random.default_rng(length)
    return generator.integers(0, 65536, (length, 6, 7)).astype(dtype)


def plain(stack, t, window, memory, k):
    """Eqs 2.9 and 2.10, the learning rate as the weight of the previous average."""
    frames = stack[max(t - window + 1, 0) : t + 1].astype(float)
    mean, variance = frames[0], np.zeros(frames[0].shape)
    for image in frames[1:]:
        mean = memory * mean + (1 - memory) * image
        variance = memory * variance + (1 - memory) * (image - mean) ** 2
    deviation = np.abs(frames[-1] - mean)
    return mean, np.where(deviation > k * np.sqrt(variance), deviation, 0)


@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
@pytest.mark.parametrize("model", [RunningGaussian(), RunningGaussian(5, 0.5, 1.5)], ids=repr)
def test_it_is_the_equations(model, dtype):
    stack = random_stack(30, dtype)
    means = list(model.backgrounds(stack, range(30)))
    for t, found in zip(range(30), model(stack, range(30)), strict=True):
        mean, foreground = plain(stack, t, model.window, model.memory, model.k)
        np.testing.assert_allclose(means[t], mean, rtol=1e-6)
        np.testing.assert_allclose(found, foreground, rtol=1e-5, atol=1e-3)


def test_the_first_image_dominates_the_background():
    """As section 5.1.2 says; Eq. 2.9 as printed would leave 1e-18 of it."""
    stack = np.zeros((30, 2, 2), np.uint16)
    stack[11] = 1000
    (found,) = RunningGaussian().backgrounds(stack, [20])
    np.testing.assert_allclose(found, 1000 * 0.99**9, rtol=1e-6)


def test_what_stays_within_its_scatter_is_no_foreground():
    stack = np.zeros((40, 1, 2), np.uint16)
    stack[:, 0, 0] = 1000 + 100 * (np.arange(40) % 2)  # flickers
    stack[:, 0, 1] = 1000
    stack[39, 0, 1] = 3000  # a particle
    model = RunningGaussian(30, 0.9, 2.0)
    (found,) = model(stack, [39])
    assert found[0, 0] == 0
    assert found[0, 1] == pytest.approx(1800)


def test_the_first_frame_has_no_foreground_and_a_single_frame_no_past():
    stack = random_stack(5)
    assert not next(RunningGaussian()(stack, [0])).any()
    assert not next(RunningGaussian(1)(stack, [3])).any()
