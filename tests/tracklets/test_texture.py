import numpy as np
import pytest
from scipy.ndimage import correlate1d

from kilnflight.checks import InputError
from kilnflight.tracklets import Connection, LevelEdge, energies, tracked
from kilnflight.tracklets.texture import MASKS


class Sums:
    """Sums of frame differences that are the same whatever the frames; ``asked`` lists them."""

    def __init__(self, image):
        self.image, self.shape, self.asked = image, image.shape, []

    def __call__(self, first_frame, last_frame, top, left, bottom, right):
        self.asked.append((first_frame, last_frame, top, left, bottom, right))
        assert 0 <= top < bottom <= self.shape[0]
        assert 0 <= left < right <= self.shape[1]
        return self.image[top:bottom, left:right]


def streak(angle_deg=0.0, size=101, noise=1.0):
    """A ridge through the middle, counted from straight down, on noise."""
    rows, cols = np.mgrid[:size, :size] - size // 2
    turned = np.deg2rad(angle_deg)
    across = cols * np.cos(turned) - rows * np.sin(turned)
    rng = np.random.default_rng(0)
    return 1000.0 * np.exp(-((across / 5.0) ** 2) / 2) + noise * rng.random((size, size))


def test_the_masks_are_eq_4_25():
    smooth, edge, spot = np.array([1, 2, 1]), np.array([-1, 0, 1]), np.array([-1, 2, -1])
    products = {"L": (smooth, smooth), "E": (smooth, edge), "S": (smooth, spot),
                "R": (spot, spot)}  # fmt: skip
    for name, (first, two) in products.items():
        np.testing.assert_array_equal(MASKS[name], np.convolve(first, two))
    np.testing.assert_array_equal(MASKS["W"], -np.convolve(edge, spot))  # printed with this sign


def test_fifteen_energies_are_those_of_scipy():
    image = streak(30.0)
    result = energies(image)
    assert len(result) == 15
    for name, value in result.items():
        both = [
            np.abs(correlate1d(correlate1d(image, MASKS[a], 0, mode="nearest"), MASKS[b], 1,
                               mode="nearest"))
            for a, b in (name, name[::-1])
        ]  # fmt: skip
        assert value == pytest.approx(np.mean(both), rel=1e-9)


@pytest.mark.parametrize("angle", [0.0, 30.0, 45.0, 90.0, 135.0])
def test_a_streak_shows_and_without_absolute_values_it_does_not(angle):
    with_streak, without = energies(streak(angle))["LE"], energies(streak(angle) * 0 + 3.0)["LE"]
    assert with_streak > 1000.0
    assert without == 0.0
    assert with_streak > 30 * energies(np.random.default_rng(1).random((101, 101)))["LE"]
    image = streak(angle, noise=0.0)
    signed = correlate1d(correlate1d(image, MASKS["L"], 0), MASKS["E"], 1)[20:-20, 20:-20]
    assert abs(signed.mean()) < 1e-6 * with_streak


def test_the_window_follows_the_connection():
    image = np.zeros((200, 200))
    image[20:181, 20:181] = streak(45.0, 161)  # from top left to bottom right
    down = LevelEdge()((30.0, 30.0), (170.0, 170.0), (0, 9), Sums(image))
    across = LevelEdge()((170.0, 30.0), (30.0, 170.0), (0, 9), Sums(image))
    assert down > 2 * across


@pytest.mark.parametrize(
    ("start", "end", "box", "pixels"),
    [
        ((50.0, 60.0), (70.0, 60.0), (48, 43, 73, 78), 21 * 31),  # down
        ((50.0, 60.0), (50.0, 80.0), (33, 58, 68, 83), 21 * 31),  # across
        ((70.0, 60.0), (50.0, 60.0), (48, 43, 73, 78), 21 * 31),  # up
        ((50.0, 60.0), (50.0, 60.0), (48, 43, 53, 78), 31),  # the same place: one line
        ((3.0, 4.0), (9.0, 4.0), (1, 0, 12, 22), 7 * 20),  # at the border of the image
    ],
)
def test_the_box_and_the_parallelogram(monkeypatch, start, end, box, pixels):
    detected = []
    monkeypatch.setattr(
        "kilnflight.tracklets.texture._energy", lambda *a: detected.append(a[1]) or 0.0
    )
    sums = Sums(np.zeros((100, 120)))
    LevelEdge()(start, end, (3, 8), sums)
    assert sums.asked == [(3, 8, *box)]
    assert detected[0].sum() == pixels


def test_a_window_outside_the_image_holds_nothing():
    sums = Sums(np.ones((50, 50)))
    assert LevelEdge()((500.0, 20.0), (520.0, 20.0), (0, 1), sums) == 0.0
    assert sums.asked == []
    assert LevelEdge()((0.0, 0.0), (9.0, 0.0), (0, 1), sums) == 0.0  # no edge anywhere


def test_the_streak_decides_which_tracklets_are_connected(table):
    """Two continue the first equally well; the picture shows which one it was."""
    frame = np.arange(6)
    parts = [(frame, 80.0 + 8 * frame, 150.0)]
    for side in (-1, 1):
        later = np.arange(12, 18)
        parts.append((later, 80.0 + 8 * later, 150.0 + side * 2.0 * (later - 5)))
    image = np.zeros((300, 300))
    for row in range(100, 260):
        centre = 150 + max(0.0, 0.25 * (row - 120))
        image[row] = 1e6 * np.exp(-(((np.arange(300) - centre) / 4) ** 2))
    tracks = table(*parts)
    for image_seen, joined in ((image, 2), (image[:, ::-1], 1)):
        sums = Sums(np.ascontiguousarray(image_seen))
        result = tracked(Connection()(tracks, sums))
        assert set(result.index[result["particle"] == 0] // 6) == {0, joined}
        assert {asked[:2] for asked in sums.asked} == {(0, 17)}  # of the pair's appearance


def test_what_is_no_picture_is_refused():
    with pytest.raises(InputError, match="energies: window"):
        energies([[np.nan, 1.0]])
    with pytest.raises(InputError, match="shape"):
        energies(np.ones(5))
    with pytest.raises(InputError, match="inside"):
        energies(np.ones((5, 5)), np.ones((4, 5), bool))
    with pytest.raises(InputError, match="half_width"):
        LevelEdge(half_width=0.0)
    sums = Sums(np.full((50, 50), np.nan))
    with pytest.raises(InputError, match="differences of frames 2 to 7"):
        LevelEdge()((5.0, 5.0), (20.0, 5.0), (2, 7), sums)


@pytest.mark.parametrize("end", [(50.0, 33.0), (33.0, 55.0)])
def test_the_vertices_bound_the_pixels_that_count(end):
    feature, start = LevelEdge(half_width=4.0), (30.0, 30.0)
    corners = feature.corners(start, end)
    lying = 0 if abs(end[0] - 30) >= abs(end[1] - 30) else 1
    corner = np.zeros(2, int)
    pixels = feature._inside(np.array(start), np.array(end), lying, corner, (90, 90))
    where = np.argwhere(pixels)
    np.testing.assert_allclose(where.min(axis=0), corners.min(axis=0), atol=1)
    np.testing.assert_allclose(where.max(axis=0), corners.max(axis=0), atol=1)
