"""Work in pieces for processes of this machine or of a Dask cluster.

joblib's own Dask back end is not used: it works in this process where the cluster has
one core, and waits for ever where a worker is killed (joblib 1.6).
"""

import ctypes
import gc
import os
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import Any

import joblib
from tqdm import tqdm

from kilnflight.arrays import Facts
from kilnflight.checks import Count, InputError, Settings
from kilnflight.store import paths
from kilnflight.store.cache import AGAIN

Make = Callable[..., Any]  # computes one piece
PATIENCE_S = 10.0  # the scheduler and its first worker have this time to answer
LOGGED_S = 60.0  # a log shows the bar once in this time
PR_SET_PDEATHSIG = 1  # see prctl(2)


class Workers(Settings):
    """Processes of this machine or of a Dask cluster that compute pieces of work.

    Parameters
    ----------
    jobs
        Number of processes of this machine; not used with a scheduler.
    scheduler
        Address of a Dask scheduler, such as ``tcp://10.0.0.1:8786``. Its workers need
        the same kilnflight, and the folders that are read and written under the same
        names.
    into_logs
        Whether the progress bar is printed if standard error is no terminal, every
        `LOGGED_S`.

    Examples
    --------
    >>> made = []
    >>> Workers(jobs=1)(made.append, pieces=["a", "b"], frames=[300, 40], label="run")
    >>> made
    ['a', 'b']
    """

    jobs: Count = 1
    scheduler: str | None = None
    into_logs: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.scheduler is not None and ":" not in self.scheduler:
            raise InputError(
                f"scheduler {self.scheduler!r}: give host:port or tcp://host:port."
            )

    def __call__(
        self,
        make: Make,
        pieces: Sequence[Any],
        frames: Sequence[int],
        label: str,
        before: int = 0,
    ) -> None:
        """Call ``make(piece)`` for every piece, with a progress bar of frames.

        Parameters
        ----------
        make
            Function that stores its result on disk; its return value is dropped.
        pieces
            Argument of each call.
        frames
            Number of frames in each piece, as many as there are pieces.
        label
            Text of the bar.
        before
            Number of frames finished in an earlier run; they do not count for the time
            left.

        Raises
        ------
        InputError
            If the scheduler does not answer or a process was killed. Errors of ``make``
            are raised as they are.
        """
        if not pieces:
            return
        compute = self._local if self.scheduler is None else self._cluster
        numbered = partial(_numbered, make, os.getpid())
        total = before + sum(frames)
        with tqdm(total=total, initial=before, **self._bar(label)) as bar:
            for k in compute(numbered, pieces):
                bar.update(frames[k])

    def number(self) -> int:
        """Return how many pieces are computed at a time."""
        if self.scheduler is None:
            return self.jobs
        with self._client() as client:
            return sum(client.ncores().values())

    def _bar(self, label: str) -> Facts:
        """Return the options of `tqdm`: where the bar is shown, and how often."""
        # smoothing 0: the mean rate
        options: Facts = {"desc": label, "unit": "frame", "smoothing": 0}
        stem = os.environ.get(paths.NOTEBOOK)
        if stem:  # lines among those of make
            options["desc"] = f"{stem}: {label}"
            options["bar_format"] = "{l_bar}{r_bar}\n"
            options["file"] = sys.__stdout__
        elif sys.stderr.isatty() or not self.into_logs:
            return options | {"disable": None}
        return options | dict.fromkeys(
            ("delay", "mininterval", "maxinterval"), LOGGED_S
        )

    def _local(self, make: Make, pieces: Sequence[Any]) -> Iterator[int]:
        """Yield the index of each piece that a process of this machine has finished.

        ``make`` is `_numbered`, which takes the index and the piece.
        """
        jobs = min(self.jobs, len(pieces))
        try:
            yield from run_all(make, enumerate(pieces), jobs, "generator_unordered")
        except BrokenExecutor as error:
            raise InputError(
                f"a process was killed (out of memory?). {AGAIN}"
            ) from error

    @contextmanager
    def _client(self) -> Iterator[Any]:
        """Connect to the scheduler, which has a worker at least."""
        with ExitStack() as stack:
            try:
                from distributed import Client

                client = Client(
                    self.scheduler, timeout=PATIENCE_S, set_as_default=False
                )
                stack.enter_context(client)
                client.wait_for_workers(1, timeout=PATIENCE_S)
                client.run(_one_thread, 0)
            except (ImportError, OSError, ValueError, TypeError) as error:
                raise InputError(
                    f"scheduler {self.scheduler}: {error}. It needs dask scheduler and "
                    "dask worker with the same kilnflight[cluster]."
                ) from error
            yield client

    def _cluster(self, make: Make, pieces: Sequence[Any]) -> Iterator[int]:
        """Yield the index of each piece that the cluster has finished.

        ``make`` is `_numbered`, which takes the index and the piece.
        """
        with self._client() as client:
            from distributed import KilledWorker, as_completed

            futures = client.map(make, range(len(pieces)), list(pieces), pure=False)
            try:
                for future in as_completed(futures, loop=client.loop):
                    yield future.result()
            except KilledWorker as error:
                raise InputError(
                    f"workers of {self.scheduler} were killed. {AGAIN}"
                ) from error


def run_all(
    make: Make, pieces: Iterable[Any], jobs: int, kind: str = "generator"
) -> Iterator[Any]:
    """Yield ``make(*piece)`` of every piece, computed by ``jobs`` processes.

    ``kind`` is joblib's ``return_as``: "generator" keeps the order of the pieces,
    "generator_unordered" yields results as they finish.
    """
    with warnings.catch_warnings():  # joblib's when it renews a process that has grown
        warnings.filterwarnings(
            "ignore", "A worker stopped while some jobs", UserWarning
        )
        calls = (joblib.delayed(make)(*piece) for piece in pieces)
        yield from joblib.Parallel(
            n_jobs=jobs, return_as=kind, initializer=_one_thread
        )(calls)


def _one_thread(orphaned: int = 15) -> None:
    """Limit OpenCV to one thread, so that other workers keep their cores.

    On Linux the process gets the signal ``orphaned`` (SIGTERM) when its parent is
    killed; 0: none.
    """
    import cv2

    cv2.setNumThreads(1)
    libc = ctypes.CDLL(None)
    if hasattr(libc, "prctl"):
        libc.prctl(PR_SET_PDEATHSIG, orphaned)


def _numbered(make: Make, caller: int, number: int, piece: object) -> int:
    """Call ``make(piece)`` and return the piece's index ``number``.

    Workers free their memory; the calling process (its id is ``caller``) keeps it for
    the next one.
    """
    make(piece)
    if os.getpid() != caller:  # joblib would take what is kept for a leak
        gc.collect()
        libc = ctypes.CDLL(None)
        if hasattr(libc, "malloc_trim"):  # glibc
            libc.malloc_trim(0)
    return number
