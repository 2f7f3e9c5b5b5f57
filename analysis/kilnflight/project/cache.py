"""The one way to keep things on disk: whole files, one writer, cached tables.

Tables are cached by their inputs.

A cached table that is there and whole is not made again. Its name holds a hash of the
arguments and of the code that makes it (`kilnflight.project.closure`); a change of either
gives another file. A later step counts the names, and so the hashes, of the tables that it
reads among its arguments. ``make clean`` removes old files.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from kilnflight.checks import InputError
from kilnflight.project import paths
from kilnflight.project.closure import code_hash

if TYPE_CHECKING:  # else imported where tables are read: to execute a notebook takes files only
    import pandas as pd

Inputs = TypeVar("Inputs")


def write_whole(path: Path, content: bytes) -> None:
    """Write a file under a temporary name and rename it."""
    make_whole(path, lambda part: part.write_bytes(content))


def make_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Let ``write`` make a file or a folder under a temporary name, then rename it."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        write(part)
        if part.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        part.replace(path)
    finally:
        _remove(part)


def clear_parts(path: Path) -> None:
    """Remove what killed processes have left of a file or folder; call it `locked`."""
    for part in path.parent.glob(f".{path.name}.*.part"):
        _remove(part)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    path.unlink(missing_ok=True)


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Let one process at a time work on a file or folder; the others wait (make -j)."""
    handle = os.open(path, os.O_RDONLY | (0 if path.is_dir() else os.O_CREAT))
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


@dataclass(frozen=True)
class CachedTable:
    """A table that is made once and then read from its file.

    Parameters
    ----------
    name
        First part of the file's name.
    make
        Makes the table: a function, also within a `functools.partial`, or an instance.
    depends_on
        All that the table depends on besides the code; the ``repr`` of each value counts.
    folder
        data/derived if None.
    whole
        Whether what ``make`` writes beside the table is there; else both are made again.
    """

    name: str
    make: Callable[[], pd.DataFrame]
    depends_on: Mapping[str, object]
    folder: Path | None = None
    whole: Callable[[], bool] = lambda: True

    @property
    def path(self) -> Path:
        """The file of the table."""
        arguments = json.dumps([self.name, dict(self.depends_on)], sort_keys=True, default=repr)
        code = code_hash(self.make, *self.depends_on.values())
        number = hashlib.sha256((arguments + code).encode()).hexdigest()[:12]
        return (self.folder or paths.derived()) / f"{self.name}-{number}.parquet"

    def __call__(self) -> pd.DataFrame:
        """Return the table.

        Raises
        ------
        InputError
            If the file cannot be written, as on a full disk, or not be read.
        """
        import pandas as pd
        from pyarrow import ArrowException

        path = self.path
        path.parent.mkdir(parents=True, exist_ok=True)
        with locked(path.with_suffix(".lock")):
            if not (path.is_file() and self.whole()):
                clear_parts(path)
                write_resumable(path, self.make().to_parquet(index=False))
        try:
            return pd.read_parquet(path)
        except (OSError, ArrowException) as error:
            again = "Delete it; it is made again."
            raise InputError(f"{path}: cannot be read ({error}). {again}") from error


def write_resumable(path: Path, content: bytes) -> None:
    """Write a file of a long run whole.

    If that fails, an `InputError` says how to go on.
    """
    try:
        write_whole(path, content)
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written ({error.strerror or error}). What was finished before is "
            "kept: make room and run it again; it goes on from there."
        ) from error


def content_hash(content: object) -> str:
    """Return the SHA-256 of something made of numbers and text, in one spelling."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def write_calibration(path: Path, content: dict[str, object]) -> str:
    """Write a calibration with its hash; return what came out, line by line."""
    content = json.loads(json.dumps(content))
    content["sha256"] = content_hash(content)
    write_resumable(path, (json.dumps(content, indent=1) + "\n").encode())
    names = ("inputs", "cost_inputs_only", "cost_calibrated", "evaluations", "sha256")
    return "\n".join(f"{name}: {content[name]}" for name in names if name in content)


def read_calibration(path: Path, targets: object | None, module: str) -> dict[str, Any]:
    """Return the content of a calibration file without its hash.

    Parameters
    ----------
    path
        The file.
    targets
        What the calibration was fitted to, as it would be hashed today; None: what the
        file itself states.
    module
        Makes the file, for the message.

    Raises
    ------
    InputError
        If it is missing or damaged, or was made for other targets.
    """
    again = f"Run `python -m {module}`, or take the file from the repository."
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        checksum = content.pop("sha256")
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"calibration {path}: cannot be read ({error}). {again}") from error
    if content_hash(content) != checksum:
        raise InputError(f"calibration {path}: damaged, its SHA-256 does not fit. {again}")
    targets = content.get("targets") if targets is None else targets
    if content.get("targets_sha256") != content_hash(targets):
        raise InputError(f"calibration {path}: made for other targets than published. {again}")
    return dict(content)


def calibrated(kind: Callable[..., Inputs], path: Path, content: dict[str, Any]) -> Inputs:
    """Return the fitted inputs of a calibration's content as the class they fill."""
    try:
        return kind(**content["inputs"])
    except (KeyError, TypeError) as error:
        raise InputError(f"calibration {path}: other inputs than here ({error}).") from error
