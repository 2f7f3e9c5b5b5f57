from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kilnflight.checks import InputError
from kilnflight.twin import picture as drawing
from kilnflight.twin.camera import FULL_SCALE, Optics
from kilnflight.twin.fitted import second_light
from kilnflight.twin.gas import Gas
from kilnflight.twin.light import (
    BAND_UM,
    PIXELS,
    RESPONSE,
    SECOND_RADIATION_UM_K,
    Light,
    band_radiance,
)
from kilnflight.twin.picture import Blobs, Veil
from kilnflight.twin.scene import Twin

LIT = Optics()
SHUTTER_S = LIT.exposure_s


def lit_scene(scene, wall_level=12_500.0):
    """Return a scene in a light darker than the fitted one: flames stay below full scale."""
    scene = second_light(scene)
    optics = {"light": Light(irradiance_spread=0.222), "irradiance": 1.2, "wall_level": wall_level}
    return replace(scene, optics=replace(scene.optics, **optics))


@pytest.fixture(scope="module")
def lit(small_scene):
    return Twin(lit_scene(small_scene()))


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


def test_a_picture_is_summed_in_pieces_to_the_same_bit():
    kelvin = np.random.default_rng(0).uniform(200.0, 2200.0, (3, PIXELS // 2 + 7))
    planck = BAND_UM**-5 / np.expm1(
        SECOND_RADIATION_UM_K / (BAND_UM * np.maximum(kelvin, 250.0)[..., None])
    )
    np.testing.assert_array_equal(band_radiance(kelvin), np.trapezoid(RESPONSE * planck, BAND_UM))
    assert band_radiance(1423.0).shape == ()


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


def test_overlapping_dark_bodies_never_subtract_twice():
    assert painted((0.0, 0.0), (0.0, 0.0), (0.0, 0.0)).min() >= 0


def test_what_is_behind_the_burners_flame_is_seen_through_it():
    parts = [np.full((80, 80), value, dtype=np.float32) for value in (0.25, 3000.0)]
    behind_all = Veil(1000.0, (0, 80, 0, 80), *parts)
    before_all = behind_all._replace(depth_mm=9000.0)
    # wall of 4000 behind a flame that passes a quarter: 4000; a body of 8000 in front, behind
    assert painted((8000.0, 0.0), veil=before_all, behind=4000.0)[40, 40] == 8000.0
    assert painted((8000.0, 0.0), veil=behind_all, behind=4000.0)[40, 40] == 5000.0


def test_a_longer_exposure_brightens_everything_alike(small_scene):
    scene = lit_scene(small_scene(), 6000.0)
    longer = replace(scene, optics=replace(scene.optics, exposure_s=3.0e-3))
    one, other = Twin(scene), Twin(longer)
    np.testing.assert_allclose(other.empty(20), 1.2 * one.empty(20), rtol=2e-3)
    before, after = one.view(20).blobs, other.view(20).blobs
    unlit = ~one.view(20).moment.burning
    np.testing.assert_allclose(after.brightness[unlit], 1.2 * before.brightness[unlit])
    burning = after.brightness[~unlit] / before.brightness[~unlit]
    assert np.all(np.abs(burning / 1.2 - 1) < 0.1)  # the shutter averages the flicker, too


def test_an_exposure_that_saturates_everything_is_refused():
    with pytest.raises(InputError, match="all is saturated"):
        Optics(wall_level=12_500.0, exposure_s=2.0e-2)


def test_an_exposure_longer_than_a_frame_is_refused(small_scene):
    with pytest.raises(InputError, match="does not fit into a frame"):
        small_scene(optics=replace(LIT, exposure_s=5e-3))


@pytest.mark.parametrize("name", ["soot_1_m", "shutter_s"])
def test_light_that_is_not_positive_is_refused(name):
    with pytest.raises(InputError, match=name):
        Light(**{name: 0.0})


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


def test_a_longer_shutter_averages_flames():
    fires = Light().fires(["confetti"] * 1000, 3)
    short, long = (fires.flutter(np.arange(1000), 0.5, shutter).std() for shutter in (1e-6, 1e-2))
    assert long < 0.8 * short


def test_tails_lie_along_the_wind_on_a_particle_and_end():
    light, gas = Light(rise_m_s=1e-9), Gas(stream_m_s=1.5, jet_persistence=0.0)
    velocity = np.array([[1.5, 0.0, -2.0], [1.5, 3.0, 0.0], [80.0, 0.0, 0.0]])
    tails = light.tails(velocity, np.ones((3, 3)), gas)
    np.testing.assert_allclose(tails[0], [0.0, 0.0, 2000 * light.tail_s], atol=1e-6)
    assert tails[1, 1] == pytest.approx(-3000 * light.tail_s)
    assert np.linalg.norm(tails[2]) == pytest.approx(light.longest_tail_mm)
    np.testing.assert_array_equal(velocity[0], [1.5, 0.0, -2.0])


def test_a_flame_narrows_towards_its_tail():
    single = blobs((1e4, 0.5))._replace(tail=np.array([[-1.0, 0.0]]))  # upwards
    pixels = drawing.cover(single, 80, 80)
    row, column = np.divmod(pixels.place[pixels.radius <= 1], 80)
    width = [np.ptp(column[row == at]) for at in (34, 46)]
    assert width[0] < 0.8 * width[1]


def test_char_is_dimmer_than_flame_and_flames_reach_three_walls(lit):
    view = lit.view(20)
    blobs, moment = view.blobs, view.moment
    char = lit.life.glowing(moment)
    flame = moment.burning & ~char
    assert char.any()
    assert flame.any()
    optics = lit.scene.optics
    assert blobs.brightness[char].max() < blobs.brightness[flame].mean()
    before_the_wall = blobs.brightness[flame] + blobs.passes[flame] * optics.at_wall
    assert np.median(before_the_wall) > 3 * optics.at_wall
    assert (blobs.passes[~moment.burning] == 0).all()  # no granules among them


def test_sheets_are_drawn_by_the_orientation_that_they_fly_with(lit):
    """Broadside to the camera a sheet has its whole area; edge-on it is a line."""
    moment = lit.life.at(lit.time_s(20))
    flying = np.flatnonzero(~moment.landed & ~moment.burning & lit._bodies.sheet[moment.particle])
    sheet = moment.take(flying[:1])
    half = lit._bodies.half_mm[sheet.particle[0]]

    def shape(normal, along):
        turned = sheet._replace(normal=np.array([normal]), along=np.array([along]))
        return drawing._ellipses(turned, lit._bodies, lit.scene.geometry)[0]

    facing = shape([1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    assert np.sqrt(np.linalg.det(facing)) == pytest.approx(half[0] * half[1], rel=0.05)
    edge_on = shape([0.0, 0.0, 1.0], [0.0, 1.0, 0.0])
    assert np.linalg.eigvalsh(edge_on)[0] < (half[2] + 0.1 * half[1]) ** 2


def test_granules_let_light_through(small_scene):
    scene = small_scene()
    feed = tuple(replace(burst, fraction="PE granule") for burst in scene.feed)
    view = Twin(lit_scene(replace(scene, feed=feed))).view(20)
    flying = ~view.moment.burning
    assert flying.any()
    np.testing.assert_allclose(view.blobs.passes[flying], 0.4)


def test_pictures_are_positive_end_at_full_scale_and_come_in_any_order(lit):
    late, early = lit.view(40).picture, lit.view(3).picture
    assert min(late.min(), early.min()) > 0
    assert lit.gray(20).max() == FULL_SCALE
    np.testing.assert_array_equal(early, Twin(lit.scene).view(3).picture)
    labels = [lit.view(t).labels for t in (20, 40, 55)]
    assert set(np.unique(labels)) == {0, 1, 2, 3, 4}
