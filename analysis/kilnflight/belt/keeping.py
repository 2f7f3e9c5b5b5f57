"""Simulated batches on disk: made once, kept under the hash of what went in."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Callable, Mapping
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from kilnflight import places
from kilnflight.checks import InputError
from kilnflight.files import locked, write_whole

CODE = (
    "batch.py",
    "bulk.py",
    "conveyor.py",
    "friction.py",
    "machine.py",
    "physics.py",
    "simulation.py",
    "slide.py",
)  # that a batch depends on


def kept(
    went_in: Mapping[str, object], make: Callable[[], pd.DataFrame], folder: Path | None = None
) -> pd.DataFrame:
    """Return a batch from data/derived, or make it and keep it there.

    Parameters
    ----------
    went_in
        All that the batch depends on besides the code; kept in the file.
    make
        Called if there is no such file; a killed run goes on with the first that is missing.
    folder
        data/derived if None.
    """
    said = json.dumps(dict(went_in), sort_keys=True, default=repr).encode()
    digest = hashlib.sha256(said)
    for name in CODE:
        digest.update(Path(__file__).with_name(name).read_bytes())
    path = (folder or places.derived()) / f"belt-{digest.hexdigest()[:12]}.parquet"
    path.parent.mkdir(parents=True, exist_ok=True)
    with locked(path.with_suffix(".lock")):
        if not path.is_file():
            table = pa.Table.from_pandas(make(), preserve_index=False)
            table = table.replace_schema_metadata({**(table.schema.metadata or {}), b"in": said})
            buffer = io.BytesIO()
            pq.write_table(table, buffer)
            write_whole(path, buffer.getvalue())
    try:
        return pd.read_parquet(path)
    except (OSError, pa.ArrowException) as error:
        raise InputError(
            f"{path}: cannot be read ({error}). Delete it; it is made again."
        ) from error
