import json
import os
import pickle
import signal
import subprocess
import sys
import zipfile
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import zarr

from kilnflight.checks import InputError
from kilnflight.film.report import summarise_recording
from kilnflight.recording import store
from kilnflight.recording.files import open_any
from kilnflight.recording.frames import Attributes, check_frame
from kilnflight.recording.store import open_recording, write_recording


@pytest.fixture
def target(tmp_path):
    return tmp_path / "small.zarr"


@pytest.mark.parametrize("chunk", [7, store.POINTS_PER_CHUNK])
def test_what_is_written_comes_back(small, target, same_frame, monkeypatch, chunk):
    monkeypatch.setattr(store, "POINTS_PER_CHUNK", chunk)
    table = pd.DataFrame(
        {"particle": [3, 5], "time_s": [0.1, np.nan], "end": ["wall", None]}
    )
    write_recording(small, target, truth={"particles": table})
    stored = open_any(target)
    assert stored.attributes == small.attributes
    assert (
        Attributes.from_json(json.loads(json.dumps(asdict(small.attributes))))
        == stored.attributes
    )
    assert len(stored) == 5
    for t in range(5):
        same_frame(stored.frame(t), check_frame(small.frame(t), small.attributes))
    same_frame(pickle.loads(pickle.dumps(stored)).frame(3), small.frame(3))
    pd.testing.assert_frame_equal(
        pd.read_parquet(target / "truth/particles.parquet"), table
    )
    assert [path.name for path in target.parent.iterdir()] == ["small.zarr"]
    part = write_recording(small, target.with_name("part"), frames=range(2, 4))
    same_frame(part.frame(0), small.frame(2))
    assert len(part) == 2
    (target / "gray/.DS_Store").write_text("left by a file browser")
    assert part.content() != stored.content() == open_recording(target).content()


def test_a_black_frame_is_no_damage(target):
    stored = write_recording(open_any(np.zeros((2, 24, 32), np.uint8)), target)
    assert not stored.gray(1).any()


def test_a_recording_written_before_stays_readable(tmp_path):
    with zipfile.ZipFile(Path(__file__).parent / "old.zarr.zip") as archive:
        archive.extractall(tmp_path / "old.zarr")
    recording = open_any(tmp_path / "old.zarr")
    assert recording.attributes.lance_mm == (-10.0, 240.0, 3950.0)
    assert recording.attributes.depth_calibration(np.array([1020.0])) == pytest.approx(
        [1000.0]
    )
    assert [recording.frame(t).index for t in range(5)] == [7, 8, 9, 10, 11]
    assert [recording.frame(t).labels is not None for t in range(5)] == [0, 1, 0, 1, 0]
    assert [len(recording.frame(t).xyz) for t in range(5)] == [120] * 5
    assert recording.gray(2)[5, 10] > 3500


@pytest.mark.parametrize("name", store.KINDS)
@pytest.mark.parametrize("fault", ["missing", "damaged"])
def test_a_missing_or_damaged_frame_is_refused_when_it_is_read(
    small, target, name, fault
):
    stored = write_recording(small, target)
    chunk = target / name / "c/3/0/0"
    content = chunk.read_bytes()
    chunk.unlink()
    if fault == "damaged":
        chunk.write_bytes(content[:-9] + bytes(9))
    with pytest.raises(InputError, match=rf"small\.zarr, frame 3: its {name}"):
        stored.frame(3)
    stored.frame(1)
    for t in (-1, 5):
        with pytest.raises(InputError, match=f"frame {t}"):
            stored.frame(t)


def test_the_summary_counts_what_the_frames_hold(small, capsys):
    facts = summarise_recording(small)
    value = dict(facts)
    frames = [small.frame(t) for t in range(5)]
    gray = np.stack([frame.gray for frame in frames])
    depths = np.concatenate([frame.xyz[:, 2] for frame in frames])
    assert value["gray"] == f"{gray.min()} to {gray.max()} (12 bits)"
    assert value["points"] == "0 to 40 per frame, median 20"
    assert value["depth"].startswith(f"{depths.min():.0f} to {depths.max():.0f} mm")
    assert (
        value["labels"]
        == f"of {sum(frame.labels is not None for frame in frames)} frames"
    )
    assert capsys.readouterr().out.splitlines()[:2] == [
        "recording        small",
        "frames           5 of 24 x 32 pixels",
    ]
    original = small.frame
    for edit, warning in [
        (lambda f: {"gray": np.minimum(f.gray, 2047)}, "of the pixels are 2047"),
        (
            lambda f: {"gray": f.gray * 0, "xyz": f.xyz[:0], "pixels": f.pixels[:0]},
            "are 0",
        ),
        (lambda f: {"xyz": f.xyz / 1000}, "unit"),
    ]:
        small.frame = lambda t, edit=edit: replace(original(t), **edit(original(t)))
        facts = summarise_recording(small)
        assert any(warning in text for what, text in facts if what == "warning")


def test_depths_at_the_limits_are_no_cause_for_a_warning(small):
    original = small.frame
    for nearest, farthest, warned in [(100, 50_000, 0), (99, 5e4, 1), (100, 50_001, 1)]:
        xyz = np.float32([[0.0, 0.0, nearest], [0.0, 0.0, farthest]])
        given = {"xyz": xyz, "pixels": np.int32([[0, 0], [0, 1]])}
        small.frame = lambda t, given=given: replace(original(t), **given)
        facts = summarise_recording(small)
        assert [what for what, _ in facts].count("warning") == warned


def test_a_killed_process_leaves_nothing_that_opens(small, target, same_frame):
    script = f"""
import os, signal, sys
sys.path.insert(0, {str(Path(__file__).parents[1])!r})
from conftest import SmallRecording
from kilnflight.recording.store import write_recording
class Killed(SmallRecording):
    def frame(self, t):
        if t == 2:
            os.kill(os.getpid(), signal.SIGKILL)
        return super().frame(t)
write_recording(Killed(), {str(target)!r})
"""
    process = subprocess.run(
        [sys.executable, "-c", script], env=os.environ, check=False
    )
    assert process.returncode == -signal.SIGKILL
    with pytest.raises(InputError, match=r"small\.zarr"):
        open_recording(target)
    stored = write_recording(small, target)
    for t in range(5):
        same_frame(stored.frame(t), small.frame(t))


@pytest.mark.parametrize(
    "change", [{"time_s": 0.0}, {"index": 2}, {"gray": np.zeros((2, 3, 4))}]
)
def test_a_wrong_frame_never_becomes_a_recording(small, target, change):
    original = small.frame
    small.frame = lambda t: replace(original(t), **change) if t == 3 else original(t)
    with pytest.raises((InputError, ValueError)):
        write_recording(small, target)
    assert not list(target.parent.iterdir())


@pytest.mark.parametrize("frames", [range(5, 6), range(-1, 2), range(3, 3)])
def test_frames_that_are_not_there(small, target, frames):
    with pytest.raises(InputError, match="small"):
        write_recording(small, target, frames)
    assert not list(target.parent.iterdir())


@pytest.mark.parametrize(
    "fault", ["none", "other", "rows", "size", "unknown", "array", "json", "there"]
)
def test_a_folder_without_a_whole_recording_is_refused(small, target, fault):
    if fault != "none":
        write_recording(small, target)
        group = zarr.open_group(target, mode="w" if fault == "other" else "r+")
        known = {"format": store.FORMAT, **asdict(small.attributes)}
        wrong = {
            "rows": {"rows": "many"},
            "size": {"rows": 7},
            "unknown": {"presure": 5},
        }
        if fault in wrong:
            group.attrs.put(known | wrong[fault])
    if fault == "array":
        (target / "index" / "zarr.json").unlink()
    elif fault == "json":
        (target / "zarr.json").write_text("{")
    with pytest.raises(InputError, match=r"small\.zarr"):
        write_recording(small, target) if fault == "there" else open_recording(target)
