"""Whole files, one writer at a time, and tables that are made once.

The name of a cached table holds a hash of its arguments and of the code that makes it
(`code_hash`), so a change of either gives another file. Among the arguments of a later step are
the names of its input tables. ``make clean`` removes old files.
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
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kilnflight.checks import InputError
from kilnflight.project import paths

if TYPE_CHECKING:  # slow to import; executing a notebook needs files only
    import pandas as pd

PACKAGE = Path(__file__).parents[1]
AGAIN = "Finished parts are kept: make room (disk, memory) and run it again to continue."


def write_whole(path: Path, content: bytes) -> None:
    """Write a file under a temporary name and rename it; errors as in `make_whole`."""
    make_whole(path, lambda part: part.write_bytes(content))


def make_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Let ``write`` make a file or a folder under a temporary name, then rename it.

    Raises
    ------
    InputError
        If it cannot be written, as on a full disk.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        write(part)
        if part.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        part.replace(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}). {AGAIN}") from error
    finally:
        _remove(part)


def clear_parts(path: Path) -> None:
    """Remove unfinished copies of a file or folder; only while it is `locked`."""
    for part in path.parent.glob(f".{path.name}.*.part"):
        _remove(part)


def _remove(path: Path) -> None:
    shutil.rmtree(path, ignore_errors=True)  # a folder
    path.unlink(missing_ok=True)


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Lock a file or folder for one process; others wait (make -j)."""
    handle = os.open(path, os.O_RDONLY | (0 if path.is_dir() else os.O_CREAT))
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def code_hash(*objects: object) -> str:
    """Return a hash of the modules of functions, classes and instances, and of their imports.

    Imports are followed within this package, whole modules at a time, with JSON and CSV files
    beside them. Objects from elsewhere, as from a notebook, do not count.
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


@dataclass(frozen=True, repr=False)
class CachedTable:
    """A table that is made once and then read from its file.

    Parameters
    ----------
    name
        First part of the file's name.
    make
        Function of no arguments, also a `functools.partial`, that makes the table.
    depends_on
        Arguments of the table; the ``repr`` of each value counts, and the code of its class.
    folder
        data/derived if None.
    """

    name: str
    make: Callable[[], pd.DataFrame]
    depends_on: Mapping[str, object]
    folder: Path | None = None

    def __repr__(self) -> str:
        """Return the file's name, the identity of the table."""
        return self.path.name

    @property
    def path(self) -> Path:
        """File of the table."""
        arguments = json.dumps([self.name, dict(self.depends_on)], sort_keys=True, default=repr)
        text = arguments + code_hash(self.make, *self.depends_on.values())
        number = hashlib.sha256(text.encode()).hexdigest()[:12]
        return (self.folder or paths.derived()) / f"{self.name}-{number}.parquet"

    def __call__(self) -> pd.DataFrame:
        """Return the table; an `InputError` if the file cannot be written or read."""
        import pandas as pd
        from pyarrow import ArrowException

        (path := self.path).parent.mkdir(parents=True, exist_ok=True)
        with locked(path.with_suffix(".lock")):
            if not path.is_file():
                clear_parts(path)
                write_whole(path, self.make().to_parquet(index=False))
        try:
            return pd.read_parquet(path)
        except (OSError, ArrowException) as error:
            raise InputError(f"{path}: cannot be read ({error}). Delete it to continue.") from error


def cached(*depends_on: str) -> Callable[[Callable[[Any], pd.DataFrame]], property]:
    """Turn a method that makes a table into a property: the `CachedTable` of that name.

    Parameters
    ----------
    *depends_on
        Attributes of the object that the table depends on; its ``folder`` holds the file.
    """

    def decorate(make: Callable[[Any], pd.DataFrame]) -> property:
        def table(instance: Any) -> CachedTable:
            values = {name: getattr(instance, name) for name in depends_on}
            return CachedTable(make.__name__, partial(make, instance), values, instance.folder)

        return property(table, doc=make.__doc__)

    return decorate
