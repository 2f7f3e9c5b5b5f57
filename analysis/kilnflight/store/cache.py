"""Complete files, one writer at a time, and tables that are computed once.

The name of a cached table holds a hash of its arguments and of the code that makes it
(`code_hash`), so a change of either gives another file. Among the arguments of a later
step are the names of its input tables. Beside it stands the hash of its bytes.
``make clean`` removes old files.
"""

from __future__ import annotations

import fcntl
import glob
import hashlib
import io
import json
import os
import re
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from kilnflight.checks import InputError
from kilnflight.store import paths

if TYPE_CHECKING:  # slow to import; executing a notebook needs files only
    import pandas as pd

PACKAGE = Path(__file__).parents[1]
# An import of this package: module and names. To parse all files takes half a second.
IMPORTS = re.compile(
    r"^ *(?:from|import) (kilnflight[\w.]*)(?: import (\([^)]*\)|.*))?", re.M
)
AGAIN = "Is there room, on disk and in memory? Finished parts are kept; run it again."


def write_whole(path: Path, content: bytes) -> None:
    """Write a file whole or not at all; errors as for `make_whole`."""
    make_whole(path, lambda part: part.write_bytes(content))


def make_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Call ``write`` with a temporary path, then rename that to ``path``.

    ``write`` makes a file or a folder. An existing one is replaced only when it is
    complete. Links are followed; a device or a pipe is written into.

    Raises
    ------
    InputError
        If it cannot be written, as on a full disk.
    """
    if is_device(path) and path.is_file():  # >> f, which would be replaced
        raise InputError(f"{path}: is a file by another name. Name it.")
    try:
        path = path.resolve()
        if path.exists() and not path.is_file() and not path.is_dir():
            write(path)
            return
        with TemporaryDirectory(".part", hidden(path), path.parent) as folder:
            part = Path(folder, path.name)
            write(part)
            if part.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                with part.open("rb") as file:
                    os.fsync(file.fileno())  # else a power cut leaves an empty file
            part.replace(path)
    except (OSError, RuntimeError) as error:  # links in a circle: RuntimeError
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot be written ({reason}). {AGAIN}") from error


def is_device(path: Path) -> bool:
    """Return whether a path, or a link at it, is below /dev or /proc, but /dev/shm."""
    link = path.readlink() if path.is_symlink() else path
    told = f"{path.absolute()} {link}"
    return re.search(r"(^| )/(dev/(?!shm)|proc/)", told) is not None


def hidden(path: Path) -> str:
    """Return how the names of hidden files of a path begin: in 52 signs at most."""
    return f".{path.name[-50:]}."


def clear_parts(path: Path) -> None:
    """Remove the temporary files of interrupted writers of ``path``.

    Call it only while its writers are `locked` out; a running one would lose its file.
    """
    for part in path.parent.glob(f"{glob.escape(hidden(path))}*.part"):
        shutil.rmtree(part, ignore_errors=True)


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold an exclusive lock on a file or folder; other processes wait (make -j).

    A missing file is created; one that is called .lock is removed afterwards.
    """
    flags = os.O_RDONLY
    if not path.is_dir():
        flags |= os.O_CREAT
    handle = os.open(path, flags)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        if path.suffix == ".lock":
            path.unlink(missing_ok=True)
        os.close(handle)


def code_hash(*objects: object) -> str:
    """Return a hash of the source code behind functions, classes and instances.

    The text of their modules counts, and of all modules of this package that these
    import. Objects of other packages or notebooks do not count.
    """
    files = set[Path]()
    for value in objects:
        made_by = value.func if isinstance(value, partial) else value
        files |= _module(getattr(made_by, "__module__", None) or "")
    return _closure_hash(frozenset(files))


@cache
def _closure_hash(files: frozenset[Path]) -> str:
    """Return a hash of the names and texts of files and of all that they import."""
    pending = set(files)
    texts = {}
    while pending:
        file = pending.pop()
        texts[file] = file.read_text("utf-8")
        pending |= _imports(texts[file]) - texts.keys()
    named = sorted(
        (str(file.relative_to(PACKAGE)), text) for file, text in texts.items()
    )
    return hashlib.sha256(repr(named).encode()).hexdigest()


def _imports(text: str) -> set[Path]:
    """Return the files of this package that a module with this text imports."""
    found = set[Path]()
    for base, names in IMPORTS.findall(text):
        for name in ["", *re.findall(r"\w+", names)]:
            found |= _module(f"{base}.{name}".rstrip("."))
    return found


def _module(name: str) -> set[Path]:
    """Return the file of a module of this package by dotted name, and tables beside."""
    package, *parts = name.split(".")
    base = PACKAGE.joinpath(*parts)
    tables = Path(PACKAGE, *parts[:-1]).glob("*.csv")
    files = {base / "__init__.py", base.with_suffix(".py"), *tables}
    return {file for file in files if package == PACKAGE.name and file.is_file()}


@dataclass(frozen=True, repr=False)
class CachedTable:
    """A table that is computed once and then read from its Parquet file.

    Parameters
    ----------
    name
        First part of the file's name.
    make
        Function or `functools.partial` without further arguments that returns the
        table.
    depends_on
        Everything that ``make`` depends on, by name. The ``repr`` of each value enters
        the file's name, so it must be complete and the same in every run. The code of
        its class enters, too.
    folder
        Folder of the file; data/derived if None.
    """

    name: str
    make: Callable[[], pd.DataFrame]
    depends_on: Mapping[str, object]
    folder: Path | None = None

    def __repr__(self) -> str:
        """Return the file's name. Tables that depend on this one are named by it."""
        return self.path.name

    @property
    def path(self) -> Path:
        """File of the table; its name holds a hash of arguments and code."""
        arguments = json.dumps(
            [self.name, dict(self.depends_on)], sort_keys=True, default=repr
        )
        text = arguments + code_hash(self.make, *self.depends_on.values())
        number = hashlib.sha256(text.encode()).hexdigest()[:12]
        return (self.folder or paths.derived()) / f"{self.name}-{number}.parquet"

    def __call__(self) -> pd.DataFrame:
        """Return the table, computed and written if its file is missing.

        One process computes it while others wait.

        Raises
        ------
        InputError
            If the file cannot be written or read.
        """
        import pandas as pd

        path = self.path
        stated = path.with_suffix(".sha256")
        path.parent.mkdir(parents=True, exist_ok=True)
        with locked(path.with_suffix(".lock")):
            if not path.is_file():
                clear_parts(path.with_suffix(""))
                made = self.make().to_parquet(index=False)
                write_whole(stated, hashlib.sha256(made).digest())
                write_whole(path, made)
            content = path.read_bytes()
            whole = stated.is_file() and stated.read_bytes()
        if hashlib.sha256(content).digest() != whole:
            raise InputError(f"{path}: is damaged. Delete it to continue.")
        return pd.read_parquet(io.BytesIO(content))


def cached(*depends_on: str) -> Callable[[Callable[[Any], pd.DataFrame]], property]:
    """Turn a method that returns a table into a property: a `CachedTable`.

    The method's name becomes the table's.

    Parameters
    ----------
    *depends_on
        Names of all attributes of the object that the table depends on. The object's
        attribute ``folder`` holds the file.
    """

    def decorate(make: Callable[[Any], pd.DataFrame]) -> property:
        def table(instance: Any) -> CachedTable:
            return CachedTable(
                name=make.__name__,
                make=partial(make, instance),
                depends_on={name: getattr(instance, name) for name in depends_on},
                folder=instance.folder,
            )

        return property(table, doc=make.__doc__)

    return decorate
