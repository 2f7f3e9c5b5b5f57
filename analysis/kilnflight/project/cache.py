"""Tables that are made once and kept, under the hash of what went in.

A table that is there and whole is not made again. The hash covers the arguments and the
code that a table depends on, so a change of either gives another file; what a later step
makes counts the names, and so the hashes, of what it was made from among its arguments.
Old files go with `make clean`.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from kilnflight.checks import InputError
from kilnflight.project import paths
from kilnflight.project.files import clear_parts, locked, write_whole


def fingerprint(content: object) -> str:
    """Return twelve digits that stand for the arguments and the code."""
    digest = hashlib.sha256(json.dumps(content, sort_keys=True, default=repr).encode())
    digest.update(_code_digest())
    return digest.hexdigest()[:12]


@lru_cache(maxsize=1)
def _code_digest() -> bytes:
    """Return a hash of the package as this process has them: read once, asked often."""
    digest = hashlib.sha256()
    for file in sorted(Path(__file__).parents[1].rglob("*")):
        if file.suffix in (".py", ".json"):
            digest.update(file.read_bytes())
    return digest.digest()


def place(
    name: str,
    went_in: Mapping[str, object],
    folder: Path | None = None,
) -> Path:
    """Return the file that a table is kept in, in data/derived unless told otherwise."""
    number = fingerprint([name, dict(went_in)])
    return (folder or paths.derived()) / f"{name}-{number}.parquet"


def kept(
    name: str,
    went_in: Mapping[str, object],
    make: Callable[[], pd.DataFrame],
    folder: Path | None = None,
    whole: Callable[[], bool] = lambda: True,
) -> pd.DataFrame:
    """Return a table that is kept, or make it and keep it.

    Parameters
    ----------
    name
        Of the kind of table, the first part of the file's name.
    went_in
        All that it depends on besides the code; kept in the file.
    make
        Called if there is no such file.
    folder
        data/derived if None.
    whole
        Whether what ``make`` keeps beside the table is there; else both are made again.

    Raises
    ------
    InputError
        If the file cannot be written, as on a full disk, or not be read.
    """
    path = place(name, went_in, folder)
    path.parent.mkdir(parents=True, exist_ok=True)
    with locked(path.with_suffix(".lock")):
        if not (path.is_file() and whole()):
            clear_parts(path)
            keep(path, parquet(make(), went_in))
    try:
        return pd.read_parquet(path)
    except (OSError, pa.ArrowException) as error:
        raise InputError(
            f"{path}: cannot be read ({error}). Delete it; it is made again."
        ) from error


def parquet(made: pd.DataFrame, went_in: Mapping[str, object] | None = None) -> bytes:
    """Return a table as the bytes of a Parquet file; the same table gives the same bytes."""
    table = pa.Table.from_pandas(made, preserve_index=False)
    said = json.dumps(dict(went_in or {}), sort_keys=True, default=repr).encode()
    table = table.replace_schema_metadata({**(table.schema.metadata or {}), b"went_in": said})
    buffer = io.BytesIO()
    pq.write_table(table, buffer)
    return buffer.getvalue()


def keep(path: Path, content: bytes) -> None:
    """Write a file of a long run whole, or raise an `InputError` that says how to go on."""
    try:
        write_whole(path, content)
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written ({error.strerror or error}). What was finished before is "
            "kept: make room and run it again; it goes on from there."
        ) from error
