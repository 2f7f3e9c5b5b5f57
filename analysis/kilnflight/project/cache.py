"""Whole files, one writer at a time, and tables that are made once.

The name of a cached table holds a hash of its arguments and of the code that makes it
(`code_hash`); a change of either gives another file. A later step counts the names of the tables
that it reads among its arguments. ``make clean`` removes old files.
"""

from __future__ import annotations

import ast
import fcntl
import hashlib
import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from kilnflight.checks import InputError
from kilnflight.project import paths

if TYPE_CHECKING:  # slow to import; executing a notebook needs files only
    import pandas as pd

PACKAGE = Path(__file__).parents[1]
AGAIN = "What was finished before is kept: make room (disk, memory) and run it again to go on."


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


def write_resumable(path: Path, content: bytes) -> None:
    """Write a file of a long run whole, or raise an `InputError` that says how to go on."""
    try:
        write_whole(path, content)
    except OSError as error:
        told = f"{path}: cannot be written ({error.strerror or error}). {AGAIN}"
        raise InputError(told) from error


def code_hash(*objects: object) -> str:
    """Return a hash of the modules of functions, classes and instances, and of their imports.

    Imports are followed within this package, whole modules at a time; JSON and CSV files beside
    a module count. Objects from elsewhere, as from a notebook, do not.
    """
    made_by = (getattr(value, "func", value) for value in objects)  # of a partial
    names = {getattr(value, "__module__", None) or "" for value in made_by}
    return _closure_hash(frozenset(file for name in names for file in _module(name)))


@cache
def _closure_hash(files: frozenset[Path]) -> str:
    pending, texts = set(files), {}
    while pending:
        file = pending.pop()
        texts[file] = file.read_text("utf-8")
        pending |= (_imports(file) if file.suffix == ".py" else set()) - texts.keys()
    named = sorted((str(file.relative_to(PACKAGE)), text) for file, text in texts.items())
    return hashlib.sha256(repr(named).encode()).hexdigest()


def _imports(file: Path) -> set[Path]:
    """Return the modules of this package that a module imports, and the data beside it."""
    found = {path for suffix in ("json", "csv") for path in file.parent.glob(f"*.{suffix}")}
    for node in ast.walk(ast.parse(file.read_text("utf-8"))):
        if isinstance(node, ast.Import | ast.ImportFrom):
            base = node.module if isinstance(node, ast.ImportFrom) else None
            names = [f"{base}.{alias.name}" if base else alias.name for alias in node.names]
            found.update(path for name in (base or "", *names) for path in _module(name))
    return found


def _module(name: str) -> list[Path]:
    """Return the file of a module of this package; nothing for any other name."""
    package, *parts = name.split(".")
    base = PACKAGE.joinpath(*parts)
    files = (base.with_suffix(".py"), base / "__init__.py") if package == PACKAGE.name else ()
    return [file for file in files if file.is_file()]


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
        text = arguments + code_hash(self.make, *self.depends_on.values())
        number = hashlib.sha256(text.encode()).hexdigest()[:12]
        return (self.folder or paths.derived()) / f"{self.name}-{number}.parquet"

    def __call__(self) -> pd.DataFrame:
        """Return the table; an `InputError` if the file cannot be written or read."""
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
            raise InputError(f"{path}: cannot be read ({error}). Delete it to go on.") from error
