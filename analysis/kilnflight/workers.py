"""Who does the work: processes of this machine, or a Dask cluster; the outcome is the same."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeVar

import joblib
from tqdm import tqdm

from kilnflight.checks import InputError, check_count

Piece = TypeVar("Piece")


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
    """

    jobs: int = 1
    scheduler: str | None = None
    patience_s: float = 10.0

    def __post_init__(self) -> None:
        """Refuse a number of processes that is none."""
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
            self._cluster() as jobs,
            warnings.catch_warnings(),
            tqdm(
                total=before + sum(frames),
                initial=before,
                desc=label,
                unit="frame",
                smoothing=0,  # the mean rate: pieces end in bunches
                disable=None,
            ) as bar,
        ):
            # joblib renews a process that has grown, and tells
            warnings.filterwarnings("ignore", "A worker stopped while some jobs", UserWarning)
            run = joblib.Parallel(n_jobs=min(jobs, len(pieces)), return_as="generator_unordered")
            calls = (joblib.delayed(_numbered)(make, k, piece) for k, piece in enumerate(pieces))
            try:
                for k in run(calls):
                    bar.update(frames[k])
            except BrokenExecutor as error:
                raise InputError(
                    f"{label}: a process was killed (out of memory?). What was finished is kept: "
                    "run it again, perhaps with fewer jobs; it goes on from there."
                ) from error

    @contextmanager
    def _cluster(self) -> Iterator[int]:
        """Let joblib work on the cluster; yield the number of jobs."""
        if self.scheduler is None:
            yield self.jobs
            return
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
            with joblib.parallel_config(backend="dask", client=client):
                yield sum(client.ncores().values())


def _numbered(make: Callable[[Piece], object], number: int, piece: Piece) -> int:
    make(piece)
    return number
