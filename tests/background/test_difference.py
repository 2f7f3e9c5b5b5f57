import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from kilnflight.background import Mean, Median, ThreeFrame, TwoFrame
from kilnflight.background.difference import HeldFrames, difference, partner


def random_stack(length):
    return np.random.default_rng(length).integers(0, 65536, (length, 3, 4)).astype(np.uint16)


@given(st.integers(1, 6), st.integers(13, 20), st.data())
def test_they_are_the_equations(interval, length, data):
    stack = random_stack(length)
    image = stack.astype(float)
    t = data.draw(st.integers(interval, length - 1 - interval))
    (two,) = TwoFrame(interval)(stack, [t])
    np.testing.assert_array_equal(two, np.abs(image[t] - image[t - interval]))
    (three,) = ThreeFrame(interval)(stack, [t])
    both = np.abs(image[t] - image[t - interval]) + np.abs(image[t] - image[t + interval])
    np.testing.assert_array_equal(three, both / 2)


def test_at_the_ends_the_frame_on_the_other_side_is_taken():
    stack = random_stack(10)
    image = stack.astype(float)
    for model in (TwoFrame(), ThreeFrame()):
        (first,) = model(stack, [1])
        np.testing.assert_array_equal(first, np.abs(image[1] - image[4]))
    (last,) = ThreeFrame()(stack, [9])
    np.testing.assert_array_equal(last, np.abs(image[9] - image[6]))


def test_a_recording_shorter_than_the_interval_is_compared_with_its_farther_end():
    assert [partner(t, -3, 3) for t in range(3)] == [2, 2, 0]
    assert [partner(t, 3, 2) for t in range(2)] == [1, 0]
    assert partner(0, 3, 1) == 0


def test_only_the_frames_of_the_equation_are_read():
    stack = random_stack(100)
    read = []

    class Lazy:
        def __len__(self):
            return 100

        def __getitem__(self, index):
            read.append(index)
            return stack[index]

    list(ThreeFrame()(Lazy(), [50]))
    assert read == [47, 50, 53]


def test_no_more_is_held_than_there_is_room_for():
    stack = np.arange(100, dtype=np.uint16).repeat(6).reshape(100, 2, 3)
    held = HeldFrames(stack, 5)
    for indices in ([0, 1, 2], [2, 3, 4], [50], [3, 4, 5, 6, 7], [99, 7]):
        slots = held.fetch(indices)
        assert held.pixels.shape == (5, 6)
        np.testing.assert_array_equal(held.pixels[slots, 0], indices)
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

    held = HeldFrames(Lazy(), 3)
    for index in (10, 11, 50, 12, 11, 10):
        held.fetch([index])
    assert read == [10, 11, 50, 12]


def test_the_difference_of_unsigned_images_does_not_wrap():
    low, high = np.full((2, 2), 3, np.uint16), np.full((2, 2), 65535, np.uint16)
    np.testing.assert_array_equal(difference(low, high), np.full((2, 2), 65532))
    wide = np.full((2, 2), 2**31 + 1, np.uint32)
    np.testing.assert_array_equal(difference(wide, wide - np.float64(1)), np.ones((2, 2)))


def test_of_a_picture_and_a_float_background_it_is_the_equation():
    generator = np.random.default_rng(1)
    frame = generator.integers(0, 65536, (30, 41)).astype(np.uint16)
    image = generator.uniform(0, 65535, frame.shape).astype(np.float32)
    for seen in (frame, frame[::2, ::-1]):
        found = difference(seen, image[: len(seen)])
        assert found.dtype == np.float32
        np.testing.assert_array_equal(found, np.abs(seen.astype(np.float32) - image[: len(seen)]))


def test_frames_come_with_their_foregrounds_and_cannot_be_changed():
    stack = random_stack(30)
    wanted = [3, 17, 18, 29]
    for model in (Mean(window=6), Median(window=6)):
        plain = list(model(stack, wanted))
        pairs = list(model.with_frames(stack, wanted))
        for t, (frame, foreground), alone in zip(wanted, pairs, plain, strict=True):
            np.testing.assert_array_equal(frame, stack[t])
            np.testing.assert_array_equal(foreground, alone)
            assert not frame.flags.writeable
