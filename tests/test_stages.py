"""Detection of a stretch of the small twin, kept, killed and gone on with."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from kilnflight import kiln, stages
from kilnflight.background import Median
from kilnflight.checks import InputError
from kilnflight.experiments.differences import Differences
from kilnflight.project import cache as keeping
from kilnflight.project.parallel import Workers
from kilnflight.twin.scenes import open_scene

SCENE = "confetti-4.5-bar@small"


@pytest.fixture(autouse=True)
def _derived(monkeypatch, tmp_path):
    monkeypatch.setenv("KILNFLIGHT_DERIVED", str(tmp_path))
    monkeypatch.setattr(stages, "CHUNK", 4)


@pytest.fixture
def wanted():
    return stages.stretch(SCENE, range(202, 210), threshold=300.0)


def test_chunks_are_cut_at_fixed_frames(wanted):
    assert wanted.chunks == [range(202, 204), range(204, 208), range(208, 210)]
    assert stages.stretch(SCENE, range(4, 4), 300.0).chunks == []


def test_a_stretch_is_detected_as_its_frames_are_and_once(wanted, monkeypatch):
    found = stages.detections(wanted)
    recording = open_scene(SCENE)
    plain = kiln.detect(recording, range(202, 210), wanted.detector)
    pd.testing.assert_frame_equal(found, plain)
    assert len(found)
    monkeypatch.setattr(stages, "_detect", lambda *_: pytest.fail("made again"))
    pd.testing.assert_frame_equal(stages.detections(wanted), found)


def test_two_processes_find_the_same(wanted, monkeypatch, tmp_path):
    one = stages.detections(wanted)
    monkeypatch.setenv("KILNFLIGHT_DERIVED", str(tmp_path / "two"))
    pd.testing.assert_frame_equal(stages.detections(wanted, Workers(2)), one)


@pytest.mark.parametrize("processes", [False, True], ids=["threads", "a process"])
def test_a_cluster_finds_the_same_bytes(wanted, tmp_path, processes):
    distributed = pytest.importorskip("distributed")
    stages.detections(wanted)
    here = replace(wanted, folder=tmp_path / "cluster")
    options = {"processes": processes, "n_workers": 1, "threads_per_worker": 1 + (not processes)}
    with distributed.LocalCluster(**options, dashboard_address=None) as cluster:
        address = cluster.scheduler_address
        assert address.startswith("tcp://" if processes else "inproc://")
        stages.detections(here, Workers(scheduler=address, patience_s=60.0))
    for frames in wanted.chunks:
        assert here.table(frames).read_bytes() == wanted.table(frames).read_bytes()


def test_a_worker_that_is_another_version_or_elsewhere_is_told(wanted, monkeypatch):
    piece = (wanted, range(204, 208), stages.paths.derived() / "detections-0.parquet")
    with pytest.raises(InputError, match="another version of kilnflight"):
        stages._chunk(piece)
    monkeypatch.setattr(stages, "_chunk", lambda piece: None)
    with pytest.raises(InputError, match="a worker has made this, but not here"):
        stages.detect([wanted])


def test_without_differences_the_detections_are_the_same(wanted):
    bare = replace(wanted, differences=False, chunk=100)
    found = stages.detections(bare)
    assert not list(stages.paths.derived().glob("differences-*"))
    pd.testing.assert_frame_equal(found, stages.detections(wanted))


def test_what_a_kill_left_is_cleared_away(wanted):
    table = wanted.table(range(202, 204))
    wanted = replace(wanted, stop=204)
    rest = table.with_name(f".{table.name}.1.part")
    store = wanted.differences_of(range(202, 204))
    folder = store.with_name(f".{store.name}.1.part")
    folder.mkdir(parents=True)
    rest.write_bytes(b"PAR1")
    stages.detections(wanted)
    assert not rest.exists()
    assert not folder.exists()


def test_a_full_disk_is_told_and_leaves_nothing(wanted, monkeypatch):
    def full(self, content):
        with self.open("wb") as file:
            file.write(content[:10])
        raise OSError(28, "No space left on device")

    bare = replace(wanted, differences=False, stop=204)
    with monkeypatch.context() as patch:
        patch.setattr("pathlib.Path.write_bytes", full)
        with pytest.raises(InputError, match=r"cannot be written \(No space left .* make room"):
            stages.detections(bare)
    assert {file.suffix for file in stages.paths.derived().iterdir()} == {".lock"}
    assert len(stages.detections(bare))


def test_after_a_kill_only_what_is_missing_is_made(wanted, monkeypatch):
    real, made = stages._detect, []

    def dies(stretch, frames):
        if len(made) == 2:
            raise KeyboardInterrupt
        made.append(frames)
        return real(stretch, frames)

    monkeypatch.setattr(stages, "_detect", dies)
    with pytest.raises(KeyboardInterrupt):
        stages.detections(wanted)
    assert not list(stages.paths.derived().glob("*.part"))
    again = []
    monkeypatch.setattr(stages, "_detect", lambda s, f: again.append(f) or real(s, f))
    stages.detections(wanted)
    assert made + again == wanted.chunks


def test_another_threshold_scene_or_code_is_another_file(wanted, monkeypatch):
    frames = range(204, 208)
    names = {stages.place("detections", wanted.went_in(frames))}
    for other in (
        stages.stretch(SCENE, frames, 301.0),
        stages.stretch(SCENE, frames, 300.0, seed=1),
        stages.stretch("confetti-5.0-bar@small", frames, 300.0),
    ):
        names.add(stages.place("detections", other.went_in(frames)))
    monkeypatch.setattr(keeping, "_code_digest", lambda: b"other")
    names.add(stages.place("detections", wanted.went_in(frames)))
    assert len(names) == 5


def test_differences_are_sums_over_frames_and_chunks(wanted):
    stages.detections(wanted)
    recording = open_scene(SCENE)
    sums = Differences(wanted)
    assert sums.shape == (recording.attributes.rows, recording.attributes.columns)
    views = dict(kiln.views(recording, range(203, 209), Median()))
    plain = sum(view.foreground[50:90, 20:200].astype(float) for view in views.values())
    ours = sums(203, 208, 50, 20, 90, 200)
    np.testing.assert_allclose(ours, plain, atol=6 * 0.26, rtol=0.06)
    assert not sums(0, 100, 50, 20, 90, 200).any()


def test_lost_differences_are_made_again(wanted):
    stages.detections(wanted)
    folder = wanted.differences_of(range(204, 208))
    folder.rename(folder.with_name("lost"))
    with pytest.raises(InputError, match="frame differences cannot be read"):
        Differences(wanted)(204, 205, 0, 0, 5, 5)
    stages.detections(wanted)
    assert Differences(wanted)(204, 205, 0, 0, 5, 5).shape == (5, 5)


def test_a_damaged_table_is_told(wanted):
    stages.detections(wanted)
    stages.place("detections", wanted.went_in(range(204, 208))).write_bytes(b"PAR1")
    with pytest.raises(InputError, match=r"cannot be read .* Delete it"):
        stages.detections(wanted)


def test_true_trajectories_are_visible_in_the_air_and_long_enough():
    true = stages.trajectories("confetti-4.5-bar@small", range(200, 220))
    assert true["visible"].all()
    assert (true["label"] != 4).all()
    assert true.groupby("particle").size().min() >= 5
    assert not true.duplicated(["frame", "particle"]).any()
