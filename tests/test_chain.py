"""From frames to flights: views, detections and tables that depend on what they are
made of.
"""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from kilnflight import background, chain, flight
from kilnflight.camera import EQUATION_2_4, calibrate_points
from kilnflight.checks import InputError
from kilnflight.detection import DBSCAN, DoG
from kilnflight.detection.combination import Combination
from kilnflight.experiments.flights.differences import StoredDifferences
from kilnflight.ignition import Ignition
from kilnflight.recording.buffer import FrameBuffer
from kilnflight.simulated.kiln.scenes import TwinSource
from kilnflight.store import paths
from kilnflight.store.parallel import Workers
from kilnflight.tables import DETECTIONS

MEDIAN = background.Median(window=6)
SCENE = "wood-chip-4.5-bar@small"


@pytest.fixture(scope="module")
def twin(kept_scene):
    return kept_scene("V3@small")


@pytest.fixture
def run(twin):
    """Six frames of the small twin in two chunks."""
    source, detector = TwinSource(SCENE), Combination(DoG(300.0))
    return chain.Chain(
        chain.DetectionRun(source, range(202, 208), detector, MEDIAN, chunk=4)
    )


def test_a_view_is_the_frame_without_the_flame(twin):
    ((t, view),) = chain.views(twin, [76], MEDIAN)
    frame, (top, bottom, left, right) = twin.frame(76), twin.attributes.flame_roi
    np.testing.assert_array_equal(view.gray, frame.gray)
    np.testing.assert_array_equal(view.previous, twin.gray(75))
    plain = next(iter(MEDIAN(FrameBuffer(twin), [76])))
    changed = view.foreground != plain
    assert changed[top:bottom, left:right].any()
    assert not view.foreground[changed].any()
    changed[top:bottom, left:right] = False
    assert not changed.any()
    kept = (frame.pixels[:, None] == view.pixels[::50]).all(axis=2).argmax(axis=0)
    xyz = calibrate_points(frame.xyz, EQUATION_2_4)
    np.testing.assert_array_equal(view.xyz[::50], xyz[kept])
    assert (t, len(view.xyz) < len(frame.xyz)) == (76, True)


def test_each_frame_is_read_once(twin, monkeypatch):
    read, frame, gray = [], twin.frame, twin.gray
    monkeypatch.setattr(type(twin), "frame", lambda _, t: read.append(t) or frame(t))
    monkeypatch.setattr(type(twin), "gray", lambda _, t: read.append(t) or gray(t))
    views = dict(chain.views(twin, range(4), MEDIAN))
    assert sorted(read) == list(range(7))
    np.testing.assert_array_equal(views[0].previous, gray(1))  # no frame precedes it
    np.testing.assert_array_equal(views[3].previous, views[2].gray)


def test_detections_do_not_depend_on_other_frames(twin):
    detector = Combination(DoG(1500.0), DBSCAN(60.0, 4), DBSCAN(200.0, 10))
    several = chain.detect_frames(twin, [75, 76], detector, MEDIAN)
    alone = chain.detect_frames(twin, [76], detector, MEDIAN)
    assert len(DETECTIONS.check(several)) > 0
    np.testing.assert_array_equal(several[several["frame"] == 76], alone)
    assert DETECTIONS.check(chain.detect_frames(twin, [], background=MEDIAN)).empty
    with pytest.raises(InputError, match=f"frame {len(twin)}"):
        chain.detect_frames(twin, [len(twin)], background=MEDIAN)


def test_chunks_and_processes_do_not_change_the_detections(run, monkeypatch):
    assert run.detection.chunks == [range(202, 204), range(204, 208)]
    assert replace(run.detection, frames=range(202, 202)).chunks == []
    chain.make_tables([run], Workers(2))
    table = run.detection.detections()
    recording = run.detection.source.recording()
    plain = chain.detect_frames(recording, run.frames, run.detection.detector, MEDIAN)
    pd.testing.assert_frame_equal(table, plain)
    assert len(table)
    assert run.flights().empty  # without a wall
    assert run.slices().empty
    monkeypatch.setattr(chain, "detect_frames", lambda *_: pytest.fail("made again"))
    chain.make_tables([run])
    pd.testing.assert_frame_equal(run.detection.detections(), table)


def test_foregrounds_are_stored_beside_the_detections(run):
    detection = run.detection
    stored = StoredDifferences(detection.source, run.frames, detection.detector, MEDIAN)
    stored.make()
    pd.testing.assert_frame_equal(stored.table(), detection.detections())
    views = dict(chain.views(detection.source.recording(), range(203, 206), MEDIAN))
    frames = np.array([view.foreground[50:90, 20:200] for view in views.values()])
    roots = np.rint(np.sqrt(frames)).astype(np.uint8).astype(float)
    box = (slice(50, 90), slice(20, 200))
    squares = stored[203:206, *box]
    np.testing.assert_array_equal(squares, roots**2)
    assert squares.any()
    assert not stored[0:101, *box].any()
    stored.path.unlink()
    stored.make()
    np.testing.assert_array_equal(stored[203:206, *box], squares)


def test_another_threshold_scene_or_background_is_another_file(run):
    detection = run.detection
    others = [
        detection,
        replace(detection, detector=Combination(DoG(301.0))),
        replace(detection, source=TwinSource(SCENE, 1)),
        replace(detection, source=TwinSource("wood-chip-5.0-bar@small")),
        replace(detection, background=background.Median(window=8)),
    ]
    files = {each.table(range(204, 208)).path for each in others}
    assert len(files) == 5
    assert {file.parent for file in files} == {paths.derived()}


def test_a_rule_of_flights_leaves_earlier_tables_alone(run):
    other = replace(run, rules=flight.Rules(ignition=Ignition(above_background=False)))
    changed = {
        name
        for name in chain.CHAIN_STEPS
        if run.table(name).path != other.table(name).path
    }
    assert changed == {"flights", "slices"}


def test_a_worker_of_another_version_or_elsewhere_is_refused(run):
    def work_for_another_version(make, pieces, *_):
        make((paths.derived() / "detections-0.parquet", pieces[0][1]))

    run = replace(
        run, detection=replace(run.detection, detector=Combination(DoG(302.0)))
    )
    with pytest.raises(InputError, match=r"detections-0\.parquet"):
        chain.make_tables([run], work_for_another_version)
    with pytest.raises(
        InputError, match=run.detection.table(range(202, 204)).path.name
    ):
        chain.make_tables([run], lambda *_: None)


def test_a_run_of_words_and_of_no_frames_a_table_is_refused(run):
    wrong = [{"post_processing": "False"}, {"exit_point_mm": (0.0, np.nan, 1.0)}]
    wrong += [{"exit_point_mm": (0.0, 1.0)}, {"wall": 700.0}, {"tracker": None}]
    for each in wrong:
        (name,) = each
        with pytest.raises(InputError, match=f"Chain: {name}"):
            replace(run, **each)
    for chunk in (0, -1, 1.5, "4"):
        with pytest.raises(InputError, match="chunk"):
            replace(run.detection, chunk=chunk)
