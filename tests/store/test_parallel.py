"""Pieces of work, done here by one or two processes, or by a Dask cluster."""

import os
from functools import partial
from pathlib import Path

import cv2
import pytest

from kilnflight.checks import InputError
from kilnflight.store import parallel
from kilnflight.store.parallel import Workers


def note(folder: Path, piece: int) -> None:
    (folder / str(piece)).write_text(str(cv2.getNumThreads()))


def die(piece: int) -> None:
    os.kill(os.getpid(), 9)


def fails(piece: int) -> None:
    raise InputError(f"piece {piece} is bad.")


def test_every_piece_is_done_once_and_the_callers_threads_stay(tmp_path):
    threads = cv2.getNumThreads()
    for jobs, expected in ((1, threads), (2, 1)):
        folder = tmp_path / str(jobs)
        folder.mkdir()
        Workers(jobs)(partial(note, folder), [1, 2, 3], [4, 4, 2], "noting")
        assert {file.name for file in folder.iterdir()} == {"1", "2", "3"}
        assert {file.read_text() for file in folder.iterdir()} == {str(expected)}
        assert list(parallel.run_all(pow, [(2, 3), (3, 2)], jobs)) == [8, 9]
        with pytest.raises(InputError, match="piece 7 is bad"):
            Workers(jobs)(fails, [7, 7], [1, 1], "failing")
    assert cv2.getNumThreads() == threads
    Workers()(fails, [], [], "nothing")


def test_a_cluster_does_the_same(tmp_path):
    distributed = pytest.importorskip("distributed")
    threads = cv2.getNumThreads()
    with distributed.LocalCluster(
        processes=False, n_workers=3, threads_per_worker=1, dashboard_address=":0"
    ) as cluster:
        workers = Workers(jobs=2, scheduler=cluster.scheduler_address)
        assert (workers.number(), Workers(jobs=2).number()) == (3, 2)
        workers(partial(note, tmp_path), [1, 2, 3], [4, 4, 2], "noting")
        assert {file.name for file in tmp_path.iterdir()} == {"1", "2", "3"}
        with pytest.raises(InputError, match="piece 1 is bad"):
            workers(fails, [1], [5], "failing")
    cv2.setNumThreads(threads)  # this cluster is in the process of the test


def test_no_scheduler_is_one_clear_error(monkeypatch):
    monkeypatch.setattr(parallel, "PATIENCE_S", 0.5)
    with pytest.raises(InputError, match="scheduler"):
        Workers(scheduler="nonsense://here")(fails, [1], [1], "none")


def test_a_killed_process_is_told():
    with pytest.raises(InputError, match="killed"):
        Workers(2)(die, [1, 2], [1, 1], "dying")
