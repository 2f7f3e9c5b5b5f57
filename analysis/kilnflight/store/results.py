"""Folders of results: each is of one input, and keeps the user's own files.

``parts/recording.txt`` lists the hash of the input and those of the files that runs
wrote. A file of a known name that is not among them is the user's.
"""

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from kilnflight.checks import InputError
from kilnflight.store.cache import clear_parts, locked, write_whole

OWNER = "parts/recording.txt"


@contextmanager
def claimed(target: Path, names: Sequence[str], content: str) -> Iterator[Path]:
    """Make a folder of results, or check that it is of the same input.

    Parameters
    ----------
    target
        The folder.
    names
        All that a run may write.
    content
        Hash of the input.

    Yields
    ------
    Path
        Folder ``parts`` in it, locked. The folder is the input's if no error is raised
        within; if there is one, nothing is left of a new folder.

    Raises
    ------
    InputError
        If it cannot be a folder, is of another input, or has a file of one of these
        names that no run wrote.
    """
    folder = target / "parts"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{target}: cannot be a folder ({error.strerror}). Name another one."
        ) from error
    try:
        with locked(folder):
            owner = target / OWNER
            known = _read(owner).split()
            told = ""
            if known[:1] not in ([], [content.encode()]):
                told = "a run of another input, or of this one before it changed"
            for name in names:
                path = target / name
                if path.exists() and _hash(_read(path)) not in known:
                    told = f"a {name} that is of no run, or was changed"
            if told:
                raise InputError(
                    f"{target}: has {told}. Name another folder, or empty it."
                )
            yield folder
            if not known:
                clear_parts(owner)
                write_whole(owner, content.encode())
    finally:  # nothing is left of an input that cannot be read
        with suppress(OSError):
            folder.rmdir()
            target.rmdir()


def publish(
    contents: Iterable[tuple[str, bytes]], target: Path, names: Sequence[str]
) -> None:
    """Write files by name into a folder that is `claimed`; remove others of ``names``.

    Each file is written as a whole.
    """
    owner = target / OWNER
    with locked(target):
        old = set(names)
        known = _read(owner).split()
        written = known[:1]
        for name, content in contents:
            clear_parts(target / name)
            written.append(_hash(content))
            write_whole(owner, b"\n".join(known + written))  # also if killed here
            write_whole(target / name, content)
            old.remove(name)
        for name in old:
            (target / name).unlink(missing_ok=True)
        write_whole(owner, b"\n".join(written))


def _read(path: Path) -> bytes:
    """Return the content of a file; nothing of a folder, or where nothing is."""
    return path.read_bytes() if path.is_file() else b""


def _hash(content: bytes) -> bytes:
    return hashlib.sha256(content).hexdigest().encode()
