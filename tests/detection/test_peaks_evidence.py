import numpy as np
import pytest

from kilnflight.checks import InputError
from kilnflight.detection.peaks import Evidence

ROW, COL = np.indices((120, 160))
AREA = np.array([40, 61, 60, 81])


def hill(row, col, top, sigma=3.0):
    return top * np.exp(-((ROW - row) ** 2 + (COL - col) ** 2) / (2 * sigma**2))


def frames(now, before, seed=0, noise=20.0):
    generator = np.random.default_rng(seed)
    return tuple(
        np.clip(5000 + picture + noise * generator.normal(size=ROW.shape), 0, 65535).astype(
            np.uint16
        )
        for picture in (now, before)
    )


def evidence(now, before, seed=0):
    return Evidence.of(*frames(now, before, seed), prominence=5.0, share=0.1)


def test_the_noise_sets_the_threshold():
    found = evidence(np.zeros(ROW.shape), np.zeros(ROW.shape))
    smoothed = 20.0 / (2 * np.sqrt(np.pi))  # white noise under a Gaussian of 1 px
    assert found.threshold == pytest.approx(5 * smoothed, rel=0.05)
    assert found.change_threshold == pytest.approx(5 * smoothed * np.sqrt(2), rel=0.05)


def test_noise_alone_is_hardly_ever_real():
    nothing = np.zeros(ROW.shape)
    assert sum(evidence(nothing, nothing, seed).real(AREA) for seed in range(20)) <= 1


@pytest.mark.parametrize("top", [600.0, -600.0])
def test_what_has_moved_is_real_bright_or_dark(top):
    assert evidence(hill(50, 70, top), hill(53, 70, top)).real(AREA)


def test_what_stays_is_not_real():
    assert not evidence(hill(50, 70, 600.0), hill(50, 70, 600.0)).real(AREA)


def test_brighter_light_moves_nothing():
    still = hill(50, 70, 600.0)
    assert not evidence(1.02 * (5000 + still) - 5000, still).real(AREA)


def test_peaks_are_counted_and_small_ones_beside_a_large_one_are_not():
    pair = evidence(hill(46, 66, 3000.0) + hill(55, 75, 2000.0), np.zeros(ROW.shape))
    assert pair.peaks(AREA)[:, :2].round().tolist() == [[46, 66], [55, 75]]
    small = evidence(hill(46, 66, 30_000.0) + hill(55, 76, 500.0), np.zeros(ROW.shape))
    assert len(small.peaks(AREA)) == 1
    assert evidence(np.zeros(ROW.shape), np.zeros(ROW.shape)).peaks(AREA).shape == (0, 3)


def test_a_constant_picture_has_no_evidence():
    flat = np.full((30, 40), 65535, np.uint16)
    found = Evidence.of(flat, flat, 5.0, 0.1)
    assert not found.real(np.array([5, 20, 5, 20]))
    assert not found.real(np.array([-4, 3, 38, 55]))


def test_frames_of_two_sizes_are_told():
    with pytest.raises(InputError, match="one size"):
        Evidence.of(np.zeros((4, 5)), np.zeros((4, 6)), 5.0, 0.1)
