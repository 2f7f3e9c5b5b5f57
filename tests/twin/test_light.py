import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kilnflight.twin import picture as drawing
from kilnflight.twin.camera import Optics
from kilnflight.twin.gas import Gas
from kilnflight.twin.light import (
    Light,
    band_radiance,
)
from kilnflight.twin.picture import Blobs, Veil

LIT = Optics()


def blobs(*given):
    """Return discs of 8 px at row and column 40 of (level, share that passes), far ones first."""
    m = len(given)
    return Blobs(
        np.arange(m),
        np.full(m, 40.0),
        np.full(m, 40.0),
        np.tile(64.0 * np.eye(2), (m, 1, 1)),
        np.array([level for level, _ in given]),
        np.array([passes for _, passes in given]),
        np.full(m, 0.02),
        np.ones(m),
        8000.0 - 100.0 * np.arange(m),
        np.zeros((m, 2)),
    )


def painted(*given, veil=None, behind=5000.0):
    picture = np.full((80, 80), behind, dtype=np.float32)
    several = blobs(*given)
    drawing.paint(picture, several, drawing.cover(several, 80, 80), LIT, veil)
    return picture


def test_planck_in_a_narrow_band_is_plancks_law():
    """Soot of 1800 to 2000 K is 14 to 41 times as bright as the wall, in the band."""
    wall = band_radiance(1423.0)
    ratio = band_radiance([1800.0, 2000.0]) / wall
    single = np.exp(14_388 / 0.4 * (1 / 1423 - 1 / 2000))  # the bluest light changes most
    assert 10 < ratio[0] < ratio[1] < single
    assert band_radiance(300.0) / wall < 1e-12


@given(st.lists(st.tuples(st.floats(0, 5e4), st.floats(0, 1)), min_size=1, max_size=6))
def test_transmittances_multiply(layers):
    expected = 5000.0
    for level, passes in layers:
        expected = expected * passes + level
    assert painted(*layers)[40, 40] == pytest.approx(expected, rel=1e-4, abs=0.1)


def test_what_is_behind_the_burners_flame_is_seen_through_it():
    parts = [np.full((80, 80), value, dtype=np.float32) for value in (0.25, 3000.0)]
    behind_all = Veil(1000.0, (0, 80, 0, 80), *parts)
    before_all = behind_all._replace(depth_mm=9000.0)
    # wall of 4000 behind a flame that passes a quarter: 4000; a body of 8000 in front, behind
    assert painted((8000.0, 0.0), veil=before_all, behind=4000.0)[40, 40] == 8000.0
    assert painted((8000.0, 0.0), veil=behind_all, behind=4000.0)[40, 40] == 5000.0


def test_flames_are_first_order_processes():
    """Variance, memory and mean of many flames, each by itself at any time."""
    fires = Light(flutter=(0.2, 0.2), flutter_hz=(20.0, 20.0)).fires(["confetti"] * 4000, 3)
    rows = np.arange(4000)
    now = np.log(fires.flutter(rows, 1.0, 1e-9))
    assert np.exp(now).mean() == pytest.approx(1.0, abs=0.01)
    assert now.std() == pytest.approx(0.2, rel=0.05)
    for lag_s in (2e-3, 8e-3, 20e-3):
        then = np.log(fires.flutter(rows, 1.0 + lag_s, 1e-9))
        memory = np.exp(-2 * np.pi * 20.0 * lag_s)
        assert np.corrcoef(now.ravel(), then.ravel())[0, 1] == pytest.approx(memory, abs=0.05)
    assert abs(np.corrcoef(now)[0, 1]) < 0.1  # luminosity and area apart
    np.testing.assert_array_equal(fires.flutter(rows[5:9], 1.0, 1e-9), np.exp(now[:, 5:9]))


def test_tails_lie_along_the_wind_on_a_particle_and_end():
    light, gas = Light(rise_m_s=1e-9), Gas(stream_m_s=1.5, jet_persistence=0.0)
    velocity = np.array([[1.5, 0.0, -2.0], [1.5, 3.0, 0.0], [80.0, 0.0, 0.0]])
    tails = light.tails(velocity, np.ones((3, 3)), gas)
    np.testing.assert_allclose(tails[0], [0.0, 0.0, 2000 * light.tail_s], atol=1e-6)
    assert tails[1, 1] == pytest.approx(-3000 * light.tail_s)
    assert np.linalg.norm(tails[2]) == pytest.approx(light.longest_tail_mm)
    np.testing.assert_array_equal(velocity[0], [1.5, 0.0, -2.0])
