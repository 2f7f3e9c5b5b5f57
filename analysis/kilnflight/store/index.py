"""The index of the folder of figures: captions, provenance, results, verdicts."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from kilnflight.arrays import Facts
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
        # a picture that has become too large has no PDF
        (folder / f"{name}.pdf").unlink(missing_ok=True)
        for file in contents:
            write_whole(folder / file, contents[file])
        known = load()
        known[part][name] = json.loads(json.dumps(entry, default=str))
        text = json.dumps(known, indent=1, sort_keys=True, ensure_ascii=False)
        write_whole(folder / "index.json", f"{text}\n".encode())
    listed = os.environ.get(paths.SAVED_LIST)
    if listed:
        with Path(listed).open("a") as saved:
            for file in contents:
                print((folder / file).resolve(), file=saved)


def load() -> dict[str, Facts]:
    """Return the entries of index.json whose figure or notebook still exists.

    Keys are "figures" (caption, provenance, kind by id) and "notebooks" (result,
    verdicts by stem).
    """
    folder = paths.figures()
    file = folder / "index.json"
    if not file.is_file():
        return {"figures": {}, "notebooks": {}}
    known = json.loads(file.read_text("utf-8"))
    return {
        "figures": _existing(known["figures"], folder, "csv"),
        "notebooks": _existing(known["notebooks"], paths.root() / "notebooks", "py"),
    }


def _existing(entries: Facts, folder: Path, ending: str) -> Facts:
    """Return the entries whose file exists."""
    return {
        name: entry
        for name, entry in entries.items()
        if (folder / f"{name}.{ending}").is_file()
    }


def rows(part: str) -> list[Facts]:
    """Return the verdicts or choices of all notebooks, each with its notebook."""
    found = []
    for stem, concluded in load()["notebooks"].items():
        found += [each | {"notebook": stem} for each in concluded[part]]
    return found
