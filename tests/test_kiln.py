"""From frames to flights: views and detections; runs that are cached, killed and gone on with."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from kilnflight import background, flight, kiln
from kilnflight.camera import EQUATION_2_4, calibrate_points
from kilnflight.checks import InputError
from kilnflight.detection import DBSCAN, DoG
from kilnflight.detection.combination import Combination
from kilnflight.detection.otsu import flame_mask
from kilnflight.experiments.tracking import StoredDifferences
from kilnflight.ignition import Ignition
from kilnflight.project import paths
from kilnflight.project.parallel import Workers
from kilnflight.tables import DETECTIONS
from kilnflight.twin.scenes import open_scene

MEDIAN = background.Median(window=20)
SCENE = "wood-chip-4.5-bar@small"


@pytest.fixture(scope="module")
def twin(kept_scene):
    return kept_scene("V3@small")


def test_a_view_is_the_frame_without_the_flame(twin):
    ((t, view),) = kiln.views(twin, [76], MEDIAN)
    frame = twin.frame(76)
    flame = flame_mask(frame.gray, twin.attributes.flame_roi)
    keep = ~flame[tuple(frame.pixels.T)]
    np.testing.assert_array_equal(view.gray, frame.gray)
    np.testing.assert_array_equal(view.previous, twin.gray(75))
    np.testing.assert_array_equal(view.pixels, frame.pixels[keep])
    np.testing.assert_array_equal(view.xyz, calibrate_points(frame.xyz, EQUATION_2_4)[keep])
    plain = next(iter(MEDIAN(kiln.FrameBuffer(twin), [76])))
    np.testing.assert_array_equal(view.foreground, np.where(flame, 0, plain))
    assert t == 76


def test_the_first_frame_looks_at_the_one_after(twin):
    ((_, view),) = kiln.views(twin, [0], MEDIAN)
    np.testing.assert_array_equal(view.previous, twin.gray(1))


def test_detections_do_not_depend_on_other_frames(twin):
    detector = Combination(DoG(1500.0), DBSCAN(60.0, 4), DBSCAN(200.0, 10))
    several = kiln.detect(twin, [75, 76, 77], detector, MEDIAN)
    alone = kiln.detect(twin, [76], detector, MEDIAN)
    assert len(DETECTIONS.check(several)) == len(several) > 0
    np.testing.assert_array_equal(several[several["frame"] == 76], alone)


def test_no_frames_give_an_empty_table_and_unknown_frames_are_refused(twin):
    assert len(DETECTIONS.check(kiln.detect(twin, [], background=MEDIAN))) == 0
    with pytest.raises(InputError):
        kiln.detect(twin, [len(twin)], background=MEDIAN)


def detection_run(start=202, stop=210, scene=SCENE, threshold=300.0, seed=0):
    detector = Combination(DoG(threshold))
    return kiln.DetectionRun(kiln.TwinSource(scene, seed), start, stop, detector, chunk=4)


@pytest.fixture
def run():
    return detection_run()


def test_chunks_are_cut_at_fixed_frames(run):
    assert run.chunks == [range(202, 204), range(204, 208), range(208, 210)]
    assert detection_run(4, 4).chunks == []


def test_a_run_detects_what_its_frames_give_and_once(run, monkeypatch):
    table = kiln.detections(run)
    plain = kiln.detect(open_scene(SCENE), range(202, 210), run.detector)
    pd.testing.assert_frame_equal(table, plain)
    assert len(table)
    monkeypatch.setattr(kiln, "detect", lambda *_, **__: pytest.fail("made again"))
    pd.testing.assert_frame_equal(kiln.detections(run), table)


def test_two_processes_find_the_same(run, monkeypatch, tmp_path):
    table = kiln.detections(run)
    monkeypatch.setenv("KILNFLIGHT_DERIVED", str(tmp_path / "two"))
    pd.testing.assert_frame_equal(kiln.detections(run, Workers(2)), table)


@pytest.mark.parametrize("processes", [False, True], ids=["threads", "a process"])
def test_a_cluster_finds_the_same_bytes(run, tmp_path, processes):
    distributed = pytest.importorskip("distributed")
    kiln.detections(run)
    elsewhere = replace(run, folder=tmp_path / "cluster")
    options = {"processes": processes, "n_workers": 1, "threads_per_worker": 1 + (not processes)}
    with distributed.LocalCluster(**options, dashboard_address=None) as cluster:
        address = cluster.scheduler_address
        assert address.startswith("tcp://" if processes else "inproc://")
        kiln.detections(elsewhere, Workers(scheduler=address))
    for frames in run.chunks:
        here, there = run.table(frames).path, elsewhere.table(frames).path
        assert here.name == there.name
        assert here.read_bytes() == there.read_bytes()


def test_a_worker_of_another_version_or_elsewhere_is_refused(run, monkeypatch):
    piece = (run, range(204, 208), paths.derived() / "detections-0.parquet")
    with pytest.raises(InputError, match="another version of kilnflight"):
        kiln._make_chunk(piece)
    monkeypatch.setattr(kiln, "_make_chunk", lambda piece: None)
    with pytest.raises(InputError, match="a worker has made this, but not here"):
        kiln.detect_all([run])


def test_without_differences_the_detections_are_the_same(run):
    bare = replace(run, differences=False, chunk=100)
    table = kiln.detections(bare)
    assert not list(paths.derived().glob("differences-*"))
    pd.testing.assert_frame_equal(table, kiln.detections(run))


def test_what_a_kill_left_is_cleared_away(run):
    frames = range(202, 204)
    table, store = run.table(frames).path, run.differences_of(frames)
    rest, folder = (path.with_name(f".{path.name}.1.part") for path in (table, store))
    folder.mkdir(parents=True)
    rest.write_bytes(b"PAR1")
    kiln.detections(replace(run, stop=204))
    assert not rest.exists()
    assert not folder.exists()


def test_a_full_disk_is_an_error_and_leaves_nothing(run, monkeypatch):
    def full(self, content):
        with self.open("wb") as file:
            file.write(content[:10])
        raise OSError(28, "No space left on device")

    bare = replace(run, differences=False, stop=204)
    bare.source.recording()  # so that only the table is to be written
    for file in paths.derived().glob("scene-*"):
        file.unlink()
    with monkeypatch.context() as patch:
        patch.setattr("pathlib.Path.write_bytes", full)
        with pytest.raises(InputError, match=r"cannot be written \(No space left .* make room"):
            kiln.detections(bare)
    assert {file.suffix for file in paths.derived().iterdir()} == {".lock"}
    assert len(kiln.detections(bare))


def test_after_a_kill_only_what_is_missing_is_made(run, monkeypatch):
    detect, chunks = kiln.detect, []

    def dies(recording, frames, *options, **where):
        if len(chunks) == 2:
            chunks.append("killed")
            raise KeyboardInterrupt
        chunks.append(frames)
        return detect(recording, frames, *options, **where)

    monkeypatch.setattr(kiln, "detect", dies)
    with pytest.raises(KeyboardInterrupt):
        kiln.detections(run)
    assert not list(paths.derived().glob("*.part"))
    kiln.detections(run)
    assert chunks == [*run.chunks[:2], "killed", run.chunks[2]]


def test_another_threshold_scene_or_seed_is_another_file(run):
    frames = range(204, 208)
    others = [
        run,
        detection_run(threshold=301.0),
        detection_run(seed=1),
        detection_run(scene="wood-chip-5.0-bar@small"),
        replace(run, background=MEDIAN),
    ]
    assert len({each.table(frames).path for each in others}) == 5


def test_differences_are_sums_over_frames_and_chunks(run):
    kiln.detections(run)
    recording = open_scene(SCENE)
    sums = StoredDifferences(run)
    assert sums.shape[1:] == (recording.attributes.rows, recording.attributes.columns)
    views = dict(kiln.views(recording, range(203, 209)))
    frames = np.array([view.foreground[50:90, 20:200] for view in views.values()], dtype=float)
    stored = sums(203, 208, 50, 20, 90, 200)
    # rounding the root r to r + e with |e| <= 1/2 changes the square by at most r + 1/4
    bound = (np.sqrt(frames) + 0.25).sum(axis=0)
    assert (np.abs(stored - frames.sum(axis=0)) <= bound + 1e-6).all()
    assert np.abs((stored - frames.sum(axis=0)).mean()) < 0.1 * bound.mean()
    assert not sums(0, 100, 50, 20, 90, 200).any()


def test_lost_differences_are_made_again(run):
    kiln.detections(run)
    folder = run.differences_of(range(204, 208))
    folder.rename(folder.with_name("lost"))
    with pytest.raises(InputError, match="frame differences cannot be read"):
        StoredDifferences(run)(204, 205, 0, 0, 5, 5)
    kiln.detections(run)
    assert StoredDifferences(run)(204, 205, 0, 0, 5, 5).shape == (5, 5)


def test_a_damaged_table_is_refused(run):
    kiln.detections(run)
    run.table(range(204, 208)).path.write_bytes(b"PAR1")
    with pytest.raises(InputError, match=r"cannot be read .* Delete it"):
        kiln.detections(run)


def test_a_rule_of_flights_leaves_earlier_tables_alone(run):
    plain = kiln.KilnRun(run)
    other = replace(plain, rules=flight.Rules(ignition=Ignition(above_background=True)))
    changed = {name for name in kiln.KILN_STEPS if plain.table(name).path != other.table(name).path}
    assert changed == {"flights", "slices"}


def test_only_flights_from_the_lance_that_are_not_refused_have_velocities(polynomials):
    fit = polynomials(((0.0,), (0.0,), (-8000.0,)))  # 3.0 m
    table = pd.DataFrame(
        {
            "particle": [1, 2, 3],
            "from_lance": [True, True, False],
            "refused": ["", "faster than the air", ""],
            "end_s": 0.4,
        }
    )
    passed = kiln.slices_from(table, dict.fromkeys((1, 2, 3), fit))
    assert passed["particle"].tolist() == [1, 1, 1]


def test_views_read_each_frame_once_and_its_cloud_with_it(twin, monkeypatch):
    model, frames = background.Median(window=6), range(20, 24)
    known = [view for _, view in kiln.views(twin, frames, model)]
    read, grey = [], []
    frame, gray = twin.frame, twin.gray
    monkeypatch.setattr(type(twin), "frame", lambda _, t: read.append(t) or frame(t))
    monkeypatch.setattr(type(twin), "gray", lambda _, t: grey.append(t) or gray(t))
    again = [view for _, view in kiln.views(twin, frames, model)]
    assert sorted(read) == [19, *frames]  # 19: the frame before
    assert not set(grey) & set(read)
    assert len(grey) == len(set(grey))
    for one, other in zip(known, again, strict=True):
        np.testing.assert_array_equal(one.xyz, other.xyz)
        np.testing.assert_array_equal(one.foreground, other.foreground)
