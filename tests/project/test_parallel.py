"""Pieces of work, done here by one or two processes, or by a Dask cluster."""

import os
import sys
from functools import partial
from pathlib import Path

import pytest
from tqdm import tqdm

from kilnflight.checks import InputError
from kilnflight.project import parallel
from kilnflight.project.parallel import Workers


def note(folder: Path, piece: int) -> None:
    (folder / str(piece)).write_text(str(os.getpid()))


def die(piece: int) -> None:
    os.kill(os.getpid(), 9)


def fails(piece: int) -> None:
    raise InputError(f"piece {piece} is bad.")


@pytest.fixture
def cluster():
    """A scheduler of Dask with one worker process, without its web page."""
    distributed = pytest.importorskip("distributed")
    options = {"n_workers": 1, "threads_per_worker": 2, "dashboard_address": None}
    with distributed.LocalCluster(processes=False, **options) as found:
        yield found.scheduler_address


def test_every_piece_is_done_once(tmp_path):
    for jobs in (1, 2):
        folder = tmp_path / str(jobs)
        folder.mkdir()
        Workers(jobs)(partial(note, folder), [1, 2, 3], [4, 4, 2], "noting")
        assert sorted(file.name for file in folder.iterdir()) == ["1", "2", "3"]
    Workers()(fails, [], [], "nothing")


def test_a_cluster_does_the_same(cluster, tmp_path):
    Workers(scheduler=cluster)(partial(note, tmp_path), [1, 2, 3], [4, 4, 2], "noting")
    assert sorted(file.name for file in tmp_path.iterdir()) == ["1", "2", "3"]
    with pytest.raises(InputError, match="piece 1 is bad"):
        Workers(scheduler=cluster)(fails, [1], [5], "failing")


def test_results_are_in_order():
    for jobs in (1, 2):
        assert list(parallel.run_all(pow, [(2, 3), (3, 2)], jobs)) == [8, 9]


@pytest.fixture
def process(monkeypatch):
    """A cluster of one process with one thread, which is given up when it dies once."""
    distributed = pytest.importorskip("distributed")
    import dask

    options = {"n_workers": 1, "threads_per_worker": 1, "dashboard_address": None}
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        distributed.LocalCluster(processes=True, **options) as found,
    ):
        yield found.scheduler_address


def test_a_cluster_of_one_core_does_the_work_itself(process, tmp_path):
    def note_there(piece):  # a worker cannot import this file
        (tmp_path / str(piece)).write_text(str(os.getpid()))

    Workers(scheduler=process)(note_there, [1, 2], [4, 4], "noting")
    ids = {(tmp_path / name).read_text() for name in ("1", "2")}
    assert len(ids) == 1
    assert str(os.getpid()) not in ids


def test_a_worker_of_the_cluster_that_is_killed_is_told(process):
    def die_there(piece):
        os.kill(os.getpid(), 9)

    with pytest.raises(
        InputError, match=r"workers of tcp://.* were killed. What was finished before is kept"
    ):
        Workers(scheduler=process)(die_there, [1], [1], "dying")


def test_a_worker_without_kilnflight_is_told(cluster, monkeypatch):
    monkeypatch.setattr("distributed.Client.run", lambda *_: exec("import gone"))
    with pytest.raises(InputError, match=r"the same kilnflight"):
        Workers(scheduler=cluster)(fails, [1], [1], "none")


def test_the_bar_counts_frames_and_what_was_there(tmp_path, capsys, monkeypatch):
    def always(**options):
        return tqdm(**{**options, "disable": False, "mininterval": 0})

    monkeypatch.setattr("kilnflight.project.parallel.tqdm", always)
    Workers()(partial(note, tmp_path), [1, 2], [30, 10], "noting", before=60)
    shown = capsys.readouterr().err
    assert "noting:  60%" in shown
    assert "100/100" in shown
    assert "frame/s" in shown


def test_a_killed_process_is_told():
    with pytest.raises(
        InputError, match=r"a process was killed .* What was finished before is kept"
    ):
        Workers(2)(die, [1, 2], [1, 1], "dying")


def test_an_error_of_a_piece_comes_through():
    for jobs in (1, 2):
        with pytest.raises(InputError, match="piece 7 is bad"):
            Workers(jobs)(fails, [7], [1], "failing")


def test_no_scheduler_is_one_clear_error(monkeypatch):
    for address in ("tcp://127.0.0.1:9", "nonsense://here"):
        with pytest.raises(InputError, match=r"scheduler .* needs dask scheduler and"):
            Workers(scheduler=address)(fails, [1], [1], "none")
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"kilnflight\[cluster\]"):
        Workers(scheduler="tcp://127.0.0.1:9")(fails, [1], [1], "none")


def test_a_scheduler_without_workers_is_told():
    distributed = pytest.importorskip("distributed")
    options = {"n_workers": 0, "dashboard_address": None, "processes": False}
    with (
        distributed.LocalCluster(**options) as empty,
        pytest.raises(InputError, match="dask worker"),
    ):
        Workers(scheduler=empty.scheduler_address)(fails, [1], [1], "none")


@pytest.mark.parametrize("jobs", [0, -1, 1.5])
def test_a_number_of_processes_that_is_none(jobs):
    with pytest.raises(InputError, match="workers: jobs"):
        Workers(jobs)


def test_a_log_has_the_bar_of_long_work_where_it_is_asked_for(tmp_path, capsys, monkeypatch):
    Workers(into_logs=True)(partial(note, tmp_path), [1], [30], "noting")
    assert capsys.readouterr().err == ""  # over before it is worth a word
    monkeypatch.setattr("kilnflight.project.parallel.LOGGED_S", 1e-6)
    Workers()(partial(note, tmp_path), [1], [30], "noting")
    assert capsys.readouterr().err == ""
    Workers(into_logs=True)(partial(note, tmp_path), [1], [30], "noting")
    assert "noting: 100%" in capsys.readouterr().err
