"""The six background models of Table 5.4 as the equations stand, a frame at a time."""

import numpy as np


def others(length, t, window):
    """The frames nearest in time to t, as many before as after, shifted at the ends."""
    first = max(min(t - (window + 1) // 2, length - window - 1), 0)
    return [j for j in range(first, min(first + window + 1, length)) if j != t]


def difference(frame, background, absolute):
    """The difference of two pictures: with bars, or as 16 bits without a sign
    have it.
    """
    apart = frame.astype(np.float64) - background
    return np.abs(apart) if absolute else np.where(apart > 0, apart, 0)


def frame_difference(stack, t, beside, absolute):
    """Eqs 2.5 and 2.6: mean difference from the frames ``beside``."""
    return np.mean(
        [difference(stack[t], stack[other], absolute) for other in beside], axis=0
    )


def mean(stack, t, window):
    return stack[others(len(stack), t, window)].mean(axis=0, dtype=np.float64)


def median(stack, t, window):
    return np.median(stack[others(len(stack), t, window)].astype(np.float64), axis=0)


def adaptive(stack, t, window, rate):
    """Eqs 2.7 and 2.8 over the first half of the window and the frame itself."""
    background = mean(stack, t, window)
    for image in stack[max(t - window // 2, 0) : t + 1].astype(np.float64):
        background = (1 - rate) * background + rate * image
    return background


def running_gaussian(stack, t, window, memory, k, absolute):
    """Eqs 2.9 and 2.10, the learning rate as the weight of the previous average."""
    frames = stack[max(t - window + 1, 0) : t + 1].astype(np.float64)
    average, variance = frames[0], np.zeros(frames[0].shape)
    for image in frames[1:]:
        average = memory * average + (1 - memory) * image
        variance = memory * variance + (1 - memory) * (image - average) ** 2
    selected = np.abs(frames[-1] - average) > k * np.sqrt(variance)
    return average, np.where(selected, difference(frames[-1], average, absolute), 0)
