from dataclasses import replace

import pandas as pd
import pytest

from kilnflight.checks import InputError
from kilnflight.twin import scenes, truth
from kilnflight.twin.life import Life
from kilnflight.twin.particles import Burst


def test_scenes_have_the_published_lengths_and_rates():
    run = scenes.campaign("PE granule", 5.0)
    assert (run.frames, run.frame_rate_hz, run.gas.pressure_bar) == (3113, 153.85, 5.0)
    assert scenes.campaign("wood chip", 4.5).frames == 3102
    assert len(scenes.open_scene("V3")) == 160
    total = sum(sum(lengths) for lengths in scenes.LENGTHS.values())
    assert total == 24_892


SCENE = "wood-chip-4.5-bar@small"


def test_a_kept_scene_is_the_same_to_the_bit(same_frame, monkeypatch):
    first = scenes.cached_scene(SCENE)
    monkeypatch.setattr("kilnflight.twin.scene.live", lambda *_: pytest.fail("worked out again"))
    kept = scenes.cached_scene(SCENE)
    assert isinstance(kept.life, Life)
    monkeypatch.undo()
    afresh = scenes.open_scene(SCENE)
    for t in (200, 205):
        same_frame(kept.frame(t), afresh.frame(t))
        same_frame(kept.frame(t), first.frame(t))
    pd.testing.assert_frame_equal(truth.marked(kept, [201]), truth.marked(first, [201]))


def test_a_scene_without_a_particle_in_view_says_so():
    late = replace(scenes.ground_truth("V3"), feed=(Burst("PE granule", 3, 10.0),))
    with pytest.raises(InputError, match="none of its 3 particles is in the picture in 160 frames"):
        _ = scenes.Twin(scenes.downscaled(late)).life
