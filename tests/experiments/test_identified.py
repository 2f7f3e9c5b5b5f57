"""Numbers by which inputs were identified: hand-made paths, and the values that were taken."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from kilnflight.experiments import identified
from kilnflight.twin import scenes
from kilnflight.twin.flights import LAWS


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
