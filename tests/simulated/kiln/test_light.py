"""The light of hand-made scenes: flames, unlit particles, clutter."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from identify import light

from kilnflight.simulated.kiln import picture as drawing
from kilnflight.simulated.kiln import scenes
from kilnflight.simulated.kiln.background import PLATE, Background, Interior
from kilnflight.simulated.kiln.fuel import FRACTIONS
from kilnflight.simulated.kiln.geometry import FULL_SCALE, Geometry
from kilnflight.simulated.kiln.life import Moment
from kilnflight.simulated.kiln.light import Optics, draw_looks
from kilnflight.simulated.kiln.scene import Twin

PLACE, OPTICS = Geometry(), Optics()


def painted(fraction, burning, count=40, time_s=0.0):
    """Return grey values at the centres of particles that fly apart before the wall,
    (count,).
    """
    table = FRACTIONS[fraction].draw(count, np.random.default_rng(1))
    bodies = drawing.draw_bodies(table, 1)
    looks = draw_looks(table["fraction"].to_numpy(object), OPTICS, 1)
    row, column = np.divmod(np.arange(count), 8)
    pixels = 200.0 + 200 * row, 200.0 + 200 * column
    moment = Moment(
        particle=np.arange(count),
        position_m=PLACE.to_kiln(PLACE.unproject(*pixels, np.full(count, 5000.0))),
        velocity_m_s=np.zeros((count, 3)),
        burning=np.full(count, burning),
        landed=np.zeros(count, bool),
        age_s=np.full(count, 0.1),
    )
    blobs = drawing.project(moment, bodies, looks, PLACE, OPTICS, time_s)
    picture = np.full((PLACE.rows, PLACE.columns), OPTICS.at_wall, np.float32)
    drawing.paint(picture, blobs, drawing.cover(blobs, *picture.shape), OPTICS)
    return picture[pixels[0].astype(int), pixels[1].astype(int)]


@pytest.mark.parametrize("fraction", ["confetti", "paper shred"])
def test_the_core_of_most_flames_is_overexposed(fraction):
    assert (painted(fraction, burning=True) >= FULL_SCALE).mean() > 0.5


@pytest.mark.parametrize("fraction", ["wood chip", "PE granule"])
def test_bodies_are_darker_than_the_wall_behind_them(fraction):
    level = painted(fraction, burning=False) / OPTICS.at_wall
    assert (level < 1).mean() > 0.75  # some flare as they tumble
    assert PLATE < np.median(level) < 0.9


def test_no_unlit_particle_reaches_full_scale():
    for optics in (OPTICS, scenes.campaign("PE granule", 4.5).optics):
        looks = draw_looks(np.repeat(list(FRACTIONS), 500), optics, 2)
        brightest = looks.level * (1 + optics.tumble) * optics.at_wall
        assert brightest.max() <= FULL_SCALE * (1 + 1e-9)


def test_a_flame_is_round_and_larger_than_what_does_not_burn():
    names = np.repeat(["confetti", "paper shred"], 200)
    table = pd.concat(
        [FRACTIONS[name].draw(1, np.random.default_rng(3)) for name in names]
    )
    bodies, looks = (
        drawing.draw_bodies(table, 3),
        draw_looks(names.astype(object), OPTICS, 3),
    )
    n, shapes = len(names), []
    for burning in (True, False):
        moment = Moment(
            particle=np.arange(n),
            position_m=np.tile([1.0, 0.0, 0.0], (n, 1)),
            velocity_m_s=np.tile([5.0, 0.0, 0.0], (n, 1)),
            burning=np.full(n, burning),
            landed=np.zeros(n, bool),
            age_s=np.full(n, 0.1),
        )
        shape = drawing.project(moment, bodies, looks, PLACE, OPTICS, 0.0).ellipse_px2
        shapes.append(np.sqrt(np.linalg.eigvalsh(shape)))
    flames, unlit = shapes
    assert (
        np.median(flames[:, 1] / flames[:, 0])
        < 1.5
        < np.median(unlit[:, 1] / unlit[:, 0])
    )
    areas = flames.prod(axis=1), unlit.prod(axis=1)
    assert np.median(areas[0]) > np.median(areas[1])


def test_an_unlit_particle_flickers_about_its_mean():
    looks = draw_looks(np.repeat("confetti", 30), OPTICS, 4)
    rows = np.arange(30)
    for row in rows:
        time_s = np.linspace(0, 3 / looks.tumble_hz[row], 300, endpoint=False)
        level = np.array(
            [looks.unlit(rows[[row]], t, OPTICS.tumble)[0] for t in time_s]
        )
        assert level.mean() == pytest.approx(looks.level[row])
        assert np.ptp(level) == pytest.approx(
            2 * OPTICS.tumble * looks.level[row], rel=0.01
        )


def without_particles(clutter):
    """Return a small scene in which nothing flies."""
    scene = scenes.downscaled(scenes.campaign("wood chip", 4.5))
    around = replace(scene.interior, clutter=clutter)
    return Twin(replace(scene, count=0, interior=around))


def test_clutter_is_slow_faint_and_belongs_to_no_particle():
    twin, plain = without_particles(80.0), without_particles(0.0)
    times = range(0, 300, 60)
    spots = [twin.empty(t) - plain.empty(t) for t in times]
    assert min(spot.min() for spot in spots) > -0.1
    assert all(1000 < spot.max() < 30_000 for spot in spots)
    step = np.abs(twin.empty(1) - plain.empty(1) - spots[0]).max()
    assert 0 < step < 0.1 * spots[0].max()
    assert set(np.unique(twin.view(60).labels)) <= {0, 1}


def test_clutter_has_the_asked_number_and_strength():
    around = replace(Interior(), clutter=400.0, clutter_gray=1000.0)
    spots = Background(PLACE, OPTICS, around, 5)._clutter
    assert len(spots.spot) == 1600  # a quarter of them shines at a time
    assert spots.spot.max(axis=(1, 2)).mean() == pytest.approx(1000, rel=0.1)


def test_clutter_is_the_same_whatever_frame_came_before():
    used = without_particles(80.0)
    for t in (200, 7, 150):
        used.empty(t)
    np.testing.assert_array_equal(used.empty(40), without_particles(80.0).empty(40))


def test_the_fit_of_the_light_counts_compares_and_improves():
    prepared = light.prepare([0], ["V4@small"])
    faint = replace(OPTICS, flame=0.6)
    counts = light.count(prepared, faint)
    assert (counts["seed"].tolist(), counts["subset"].tolist()) == ([0], ["V4"])
    assert counts["overexposed"].iloc[0] == 0 < counts["flames"].iloc[0]
    # Each marked particle has one class and is found or missed.
    for count in ("tp", "fn"):
        by_class = counts[[f"{count}_{kind}" for kind in (2, 3, 4)]]
        assert by_class.iloc[0].min() >= 0
        assert by_class.iloc[0].sum() == counts[count].iloc[0] > 0
    optics, off = light.fit(prepared, faint, steps=12)
    assert off == light.misfit(prepared, optics) < light.misfit(prepared, faint)
    assert optics.bodies == faint.bodies  # what is not fitted stays


def test_the_misfit_is_a_sum_of_squares_and_0_for_what_is_printed():
    counts = pd.DataFrame(
        {
            **{"seed": [0], "subset": ["V5"], "tp": [374], "fp": [3], "fn": [412]},
            **{"tp_2": [109], "fn_2": [0], "tp_3": [220], "fn_3": [409]},
            **{"tp_4": [45], "fn_4": [5], "radius": [7.7 * 786], "large": [0]},
            **{"flames": [116], "overexposed": [58]},
        }
    )
    table = light.compare(counts).set_index("quantity")
    off = (table["ours"] - table["printed"]) / table["sd"]
    assert off["share of flames overexposed"] == pytest.approx(-5.0)
    np.testing.assert_allclose(off.drop("share of flames overexposed"), 0.0, atol=0.01)
    shown = light.report(counts)
    assert shown["seed_0"].tolist() == table["ours"].tolist()
