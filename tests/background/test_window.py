import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from kilnflight.background.window import Held, difference, surrounding


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


def test_no_more_is_held_than_there_is_room_for():
    stack = np.arange(100, dtype=np.uint16).repeat(6).reshape(100, 2, 3)
    held = Held(stack, 5)
    for wanted in ([0, 1, 2], [2, 3, 4], [50], [3, 4, 5, 6, 7], [99, 7]):
        slots = held.fetch(wanted)
        assert held.pixels.shape == (5, 6)
        np.testing.assert_array_equal(held.pixels[slots, 0], wanted)
    np.testing.assert_array_equal(held[99], np.full((2, 3), 99))


def test_the_farthest_frame_goes_first():
    stack = np.zeros((100, 2, 3), np.uint16)
    read = []

    class Lazy:
        def __len__(self):
            return 100

        def __getitem__(self, index):
            read.append(index)
            return stack[index]

    held = Held(Lazy(), 3)
    for index in (10, 11, 50, 12, 11, 10):
        held.fetch([index])
    assert read == [10, 11, 50, 12]


def test_the_difference_of_unsigned_images_does_not_wrap():
    low, high = np.full((2, 2), 3, np.uint16), np.full((2, 2), 65535, np.uint16)
    np.testing.assert_array_equal(difference(low, high), np.full((2, 2), 65532))
    wide = np.full((2, 2), 2**31 + 1, np.uint32)
    np.testing.assert_array_equal(difference(wide, wide - np.float64(1)), np.ones((2, 2)))
