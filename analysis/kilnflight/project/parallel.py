"""Pieces of work, done by processes of this machine or by a Dask cluster.

The results are the same.

joblib's own Dask backend is not used: it does the work here where the cluster has one core, and
waits for ever where a worker is killed (joblib 1.6).
"""

from __future__ import annotations

import ctypes
import gc
import os
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

import joblib
from tqdm import tqdm

from kilnflight.checks import InputError, check_count
from kilnflight.project import paths

Piece = TypeVar("Piece")
Made = TypeVar("Made")
LOGGED_S = 30.0  # between two states of the bar in a log


@dataclass(frozen=True)
class Workers:
    """Processes here or elsewhere.

    Parameters
    ----------
    jobs
        Processes of this machine; not asked with a scheduler.
    scheduler
        Address of a Dask scheduler, such as ``tcp://10.0.0.1:8786``. Its workers need the same
        kilnflight, and the folders that are read and written under the same names.
    patience_s
        How long to wait for the scheduler and its first worker.
    into_logs
        Whether the bar also goes to what is no terminal, such as a log: every `LOGGED_S`, of
        work that takes longer than that.
    """

    jobs: int = 1
    scheduler: str | None = None
    patience_s: float = 10.0
    into_logs: bool = False

    def __post_init__(self) -> None:
        """Raise an error for an invalid number of processes."""
        check_count(self.jobs, "workers: jobs")

    def __call__(
        self,
        make: Callable[[Piece], object],
        pieces: Sequence[Piece],
        frames: Sequence[int],
        label: str,
        before: int = 0,
    ) -> None:
        """Call ``make`` for every piece, with a bar of frames and the time that is left.

        Parameters
        ----------
        make
            Keeps what it makes on disk; nothing comes back.
        pieces
            Its arguments.
        frames
            How many frames each piece has.
        label
            Of the bar.
        before
            Frames that were finished by an earlier run; they do not count for the time left.

        Raises
        ------
        InputError
            If there is no scheduler or a process was killed; or what ``make`` raises.
        """
        if not pieces:
            return
        with (
            self._bar() as options,
            tqdm(
                total=before + sum(frames),
                initial=before,
                desc=label,
                unit="frame",
                smoothing=0,  # the mean rate: pieces end in bunches
                **options,
            ) as bar,
        ):
            finished = self._local if self.scheduler is None else self._cluster
            for k in finished(make, pieces, label):
                bar.update(frames[k])

    @contextmanager
    def _bar(self) -> Iterator[dict[str, Any]]:
        """Yield where the bar is shown, and how often."""
        if paths.PROGRESS in os.environ:  # of a notebook: `kilnflight.project.notebooks` reads it
            with open(os.environ[paths.PROGRESS], "a") as file:
                yield {"file": file}
        elif sys.stderr.isatty() or not self.into_logs:
            yield {"disable": None}
        else:
            yield dict.fromkeys(("delay", "mininterval", "maxinterval"), LOGGED_S)

    def _local(
        self, make: Callable[[Piece], object], pieces: Sequence[Piece], label: str
    ) -> Iterator[int]:
        """Yield the numbers of the pieces that processes of this machine have finished.

        One process is this one.
        """
        if min(self.jobs, len(pieces)) == 1:
            for k, piece in enumerate(pieces):
                make(piece)
                yield k
            return
        run = joblib.Parallel(n_jobs=min(self.jobs, len(pieces)), return_as="generator_unordered")
        calls = (joblib.delayed(_numbered)(make, k, piece) for k, piece in enumerate(pieces))
        with unwarned():
            try:
                yield from run(calls)
            except BrokenExecutor as error:
                raise InputError(
                    f"{label}: a process was killed (out of memory?). What was finished is kept: "
                    "run it again, perhaps with fewer jobs; it goes on from there."
                ) from error

    def _cluster(
        self, make: Callable[[Piece], object], pieces: Sequence[Piece], label: str
    ) -> Iterator[int]:
        """Yield the numbers of the pieces that the cluster has finished."""
        with self._client() as client:
            from distributed import KilledWorker, as_completed

            numbers = list(range(len(pieces)))
            futures = client.map(partial(_numbered, make), numbers, list(pieces), pure=False)
            try:
                for future in as_completed(futures, loop=client.loop):
                    yield future.result()
            except KilledWorker as error:
                raise InputError(
                    f"{label}: workers of {self.scheduler} were killed over one piece again and "
                    "again (out of memory?). What was finished is kept: give the workers more "
                    "memory or fewer threads and run it again; it goes on from there."
                ) from error
            finally:
                client.cancel(futures)

    @contextmanager
    def _client(self) -> Iterator[Any]:
        """Yield a client of the cluster."""
        try:
            from distributed import Client
        except ImportError as error:
            raise InputError(
                f"scheduler {self.scheduler}: the package distributed is not installed; "
                "pip install 'kilnflight[cluster]'."
            ) from error
        try:
            client = Client(self.scheduler, timeout=self.patience_s, set_as_default=False)
        except (OSError, ValueError, TypeError, ImportError) as error:
            raise InputError(
                f"scheduler {self.scheduler}: cannot be reached ({error}). Is the address right "
                "(tcp://host:8786), is dask scheduler running there?"
            ) from error
        with client:
            try:
                client.wait_for_workers(1, timeout=self.patience_s)
            except TimeoutError as error:
                raise InputError(
                    f"scheduler {self.scheduler}: it has no workers. Start some there: "
                    f"dask worker {self.scheduler}"
                ) from error
            self._check_installed(client)
            yield client

    def _check_installed(self, client: Any) -> None:
        """Raise an `InputError` if a worker has no kilnflight: it would never answer."""

        def installed() -> bool:  # within, so that it travels whole
            import importlib.util

            return importlib.util.find_spec("kilnflight") is not None

        for address, has_kilnflight in client.run(installed).items():
            if not has_kilnflight:
                raise InputError(
                    f"scheduler {self.scheduler}: worker {address} has no kilnflight. Install the "
                    "same version there as here."
                )


@contextmanager
def unwarned() -> Iterator[None]:
    """Keep joblib from warning when it renews a process that has grown."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "A worker stopped while some jobs", UserWarning)
        yield


def run_all(make: Callable[..., Made], pieces: Iterable[tuple[Any, ...]], jobs: int) -> list[Made]:
    """Return ``make(*piece)`` of every piece in order, from processes of this machine."""
    with unwarned():
        run = joblib.Parallel(n_jobs=jobs)
        return list(run(joblib.delayed(_returned)(make, piece) for piece in pieces))


def _returned(make: Callable[..., Made], piece: tuple[Any, ...]) -> Made:
    made = make(*piece)
    _give_back()
    return made


def _numbered(make: Callable[[Piece], object], number: int, piece: Piece) -> int:
    make(piece)
    _give_back()
    return number


def _give_back() -> None:
    """Give freed memory back to the system.

    joblib takes a process that keeps it for leaking, and would renew it after every piece.
    """
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if os.name == "posix" else None
    if trim is not None:  # a call of glibc
        trim(0)
