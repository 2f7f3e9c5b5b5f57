"""The index of a folder of figures: captions, provenance, results and verdicts, as
JSON.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from kilnflight.store import paths
from kilnflight.store.cache import locked, write_whole


def write(
    contents: Mapping[str, bytes], part: str, name: str, entry: Mapping[str, Any]
) -> None:
    """Write files by name into the folder of figures, and an entry of its index.json.

    ``part`` is "figures" or "notebooks", ``name`` the key of ``entry`` in it. For make,
    the files are also listed in a file; the environment variable `SAVED_LIST` of
    `kilnflight.store.paths` names it.
    """
    folder = paths.figures()
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder):
        for file, content in contents.items():
            write_whole(folder / file, content)
        known = load()
        known[part][name] = json.loads(json.dumps(entry, default=str))
        text = json.dumps(known, indent=1, sort_keys=True, ensure_ascii=False)
        write_whole(folder / "index.json", f"{text}\n".encode())
    listed = os.environ.get(paths.SAVED_LIST)
    if listed:
        with Path(listed).open("a") as file_list:
            file_list.writelines(f"{(folder / file).resolve()}\n" for file in contents)


def load() -> dict[str, dict[str, Any]]:
    """Return the entries of index.json whose figure or notebook still exists.

    Keys are "figures" (caption, provenance, kind by id) and "notebooks" (result,
    verdicts by stem).
    """
    folder = paths.figures()
    notebooks = paths.root() / "notebooks"
    file = folder / "index.json"
    known: dict[str, dict[str, Any]] = {"figures": {}, "notebooks": {}}
    known |= json.loads(file.read_text("utf-8")) if file.is_file() else {}
    for part, place, kind in (
        ("figures", folder, "csv"),
        ("notebooks", notebooks, "py"),
    ):
        there = (name for name in known[part] if (place / f"{name}.{kind}").is_file())
        known[part] = {name: known[part][name] for name in there}
    return known
