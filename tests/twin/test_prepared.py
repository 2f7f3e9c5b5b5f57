"""A scene whose flights and walls were kept gives the frames of one that was opened afresh."""

import pandas as pd
import pytest

from kilnflight.checks import InputError
from kilnflight.twin import prepared, truth
from kilnflight.twin.life import Life
from kilnflight.twin.scenes import open_scene

SCENE = "wood-chip-4.5-bar@small"


def test_a_kept_scene_is_the_same_to_the_bit(same_frame, monkeypatch):
    first = prepared.prepared_scene(SCENE)
    monkeypatch.setattr("kilnflight.twin.scene.live", lambda *_: pytest.fail("worked out again"))
    kept = prepared.prepared_scene(SCENE)
    assert isinstance(kept.life, Life)
    monkeypatch.undo()
    afresh = open_scene(SCENE)
    for t in (200, 205):
        same_frame(kept.frame(t), afresh.frame(t))
        same_frame(kept.frame(t), first.frame(t))
    pd.testing.assert_frame_equal(truth.marked(kept, [201]), truth.marked(first, [201]))


def test_another_scene_seed_or_code_is_another_file(monkeypatch):
    files = {prepared.cached_path(open_scene(name)) for name in (SCENE, "V4@small", "V3@axis-0")}
    files |= {prepared.cached_path(open_scene(SCENE, 1))}
    monkeypatch.setattr(prepared, "code_hash", lambda *_: "changed")
    files |= {prepared.cached_path(open_scene(SCENE))}
    assert len(files) == 5


def test_a_damaged_file_is_told():
    prepared.prepared_scene(SCENE)
    for content in (b"", b"\x80\x05", bytes(24)):
        prepared.cached_path(open_scene(SCENE)).write_bytes(content)
        with pytest.raises(InputError, match=r"cannot be read .* Delete it"):
            prepared.prepared_scene(SCENE)


@pytest.mark.parametrize(("name", "seed"), [("V9", 0), ("V3@nothing", 0), ("V3", -1)])
def test_a_scene_that_is_not_there_is_told_as_ever(name, seed):
    with pytest.raises(InputError):
        prepared.prepared_scene(name, seed)


def test_true_trajectories_are_visible_in_the_air_and_long_enough():
    true = prepared.true_trajectories(open_scene("confetti-4.5-bar@small"), range(200, 220))
    assert true["visible"].all()
    assert (true["label"] != 4).all()
    assert true.groupby("particle").size().min() >= 5
    assert not true.duplicated(["frame", "particle"]).any()
