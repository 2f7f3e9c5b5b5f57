"""Numbers by which inputs were identified: hand-made paths, and the values that were
taken.
"""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from kilnflight.experiments.flights import identified
from kilnflight.publication import claims, notebooks
from kilnflight.simulated.kiln import scenes
from kilnflight.simulated.kiln.laws import LAWS
from kilnflight.simulated.kiln.scene import Twin


def test_a_parabola_is_regular_and_a_wave_is_not():
    frame = np.arange(40)
    parabola = pd.DataFrame(
        {"particle": 0, "frame": frame, "row": 0.1 * frame**2, "col": 3 * frame}
    )
    wave = parabola.assign(particle=1, row=20 * np.sin(frame), col=0.0)
    short = wave[:10].assign(particle=2)
    assert identified.regular_share(parabola) == 1
    assert identified.regular_share(pd.concat([parabola, wave, short])) == 0.5


def test_true_paths_begin_at_the_lance_and_lie_in_the_region_of_interest():
    scene = scenes.campaign("wood chip", 4.5)
    paths = identified.true_paths(LAWS["wood chip", 4.5], scene, count=20)
    first = paths.groupby("particle").first()
    assert (np.diff(paths["frame"])[np.diff(paths["particle"]) == 0] >= 1).all()
    assert (scene.geometry.lance_depth_mm - first["z"]).between(0, 50).all()
    assert first[["row", "col"]].to_numpy() == pytest.approx(
        np.tile(scene.geometry.lance_pixel, (len(first), 1)), abs=8
    )


@pytest.mark.parametrize("bar", [4.5, 5.0])
def test_one_path_of_a_shred_in_32_is_irregular(bar):
    law, scene = LAWS["paper shred", bar], scenes.campaign("paper shred", bar)
    share = identified.regular_share(identified.true_paths(law, scene, count=2000))
    assert share == pytest.approx(31 / 32, abs=0.015)
    wild = identified.true_paths(replace(law, flutter_m=0.038), scene)
    assert identified.regular_share(wild) < 0.93


def test_the_calibration_stays_and_the_rest_comes_anew():
    scene = scenes.campaign("PE granule", 4.5)
    places = pd.DataFrame({"row": 300.0, "col": 900.0, "z": 5000.0}, index=range(2000))
    seen = [
        identified.seen_by_camera(places, scene, 150.0, seed)["z"] for seed in (0, 1)
    ]
    fixed = scene.depth.calibration(1536, 2048, scene.calibration)[300, 900] * 110.0
    for each in seen:
        assert each.mean() == pytest.approx(5000.0 + fixed, abs=12)
        assert each.std() == pytest.approx(
            np.hypot(150.0, np.sqrt(0.9) * 110.0), rel=0.05
        )
    assert abs(np.corrcoef(*seen)[0, 1]) < 0.1


@pytest.mark.parametrize(
    "fraction", ["wood chip", "confetti", "paper shred", "PE granule"]
)
def test_rmse_in_depth_is_that_of_table_5_18(fraction):
    printed = claims.published("table_5.18").set_index(["fraction", "axis", "measure"])[
        "value"
    ]
    name = next(
        each
        for each in printed.index.levels[0]
        if each.lower().startswith(fraction.lower())
    )
    scene = scenes.campaign(fraction, 4.5)
    own = dict(scene.depth.particle_error_mm)[fraction]
    paths = identified.true_paths(LAWS[fraction, 4.5], scene, count=30)
    seen = identified.seen_by_camera(paths, scene, own)
    exit_point = Twin(scene).attributes.exit_point_mm
    found = identified.fit_medians(seen, exit_point, scene.frame_rate_hz)
    assert found["rmse_z_mm"] == pytest.approx(printed[name, "z", "RMSE_mm"], rel=0.08)


def test_a_third_of_the_wall_particles_count_as_in_the_air():
    chapter = notebooks.borrow("25_wall")
    subsets = [scenes.open_scene(name) for name in ("V1", "V3")]
    own_mm = subsets[0].scene.depth.wall_particle_mm
    taken = chapter.wall_distances(subsets, own_mm, seed=0)
    assert chapter.wall_share(*taken) == pytest.approx(263 / 838, abs=0.06)
    assert chapter.wall_share(*chapter.wall_distances(subsets, 150.0, seed=0)) > 0.9


def test_the_limit_lies_40_mm_beyond_the_crossing():
    spread = np.linspace(-2, 2, 4001)
    # equal spreads cross midway, at 600 mm; the limit is 640 mm
    chapter = notebooks.borrow("25_wall")
    share = chapter.wall_share(500 + 50 * spread, 700 + 50 * spread)
    assert share == pytest.approx((640 - 600) / 200, abs=0.002)
