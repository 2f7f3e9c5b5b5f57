"""Manifests: facts about a recording, and the tables of its files."""

import re
import tomllib
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Self

import numpy as np
import pandas as pd

from kilnflight.checks import InputError, check_shape, real_numbers
from kilnflight.recording.frames import LABELS
from kilnflight.recording.readers import Anything, read_array

FACTS = (  # attributes that a manifest states
    "name",
    "frame_rate_hz",
    "fraction",
    "pressure_bar",
    "lance_mm",
    "roi",
    "flame_roi",
    "depth_calibration",
)
TABLES = ("gray", "coordinates", "labels")
MM_PER_UNIT = {"mm": 1.0, "m": 1000.0}
LONGEST = 2**15  # characters; TOML of dots alone is read for hours


@dataclass(frozen=True)
class FileTable:
    """A table of a manifest: files of one kind and how to read them.

    Parameters
    ----------
    pattern
        Path or pattern, relative to the manifest.
    key
        Variable or data set, where a file holds several.
    channel
        Of coloured pictures, one of red, green and blue.
    form
        ``"grid"``: (rows, cols, 3) x, y, z; ``"points"``: (n, 5) row, col, x, y, z.
    invalid
        Depth of a pixel that has none.
    unit
        Of coordinates, one of `MM_PER_UNIT`.
    origin
        Number of the first row and column of points, 0 or 1.
    classes
        Class of Table 5.1 (Zhang 2023) by the number that the files have.
    """

    pattern: str
    key: str | None = None
    channel: str | None = None
    form: str = "grid"
    invalid: float | str = "nan"
    unit: str = "mm"
    origin: int = 0
    classes: Mapping[str, int] = field(default_factory=dict)

    @classmethod
    def from_toml(cls, given: Any, name: str) -> Self:
        """Return the table ``name`` of a manifest, or raise an `InputError`."""
        if not isinstance(given, dict):
            raise _unusable(name, given)
        where = f"[{name}] "
        known = [each.name for each in fields(cls)]
        _check_keys(given, known=known, needed=["pattern"], where=where)
        table = cls(**given)
        fits = {
            "pattern": isinstance(table.pattern, str),
            "form": table.form in ("grid", "points"),
            "invalid": table.invalid == "nan" or type(table.invalid) in (int, float),
            "unit": table.unit in tuple(MM_PER_UNIT),
            "origin": table.origin in (0, 1),
            "classes": _are_classes(table.classes),
        }
        for key, usable in fits.items():
            if not usable:
                raise _unusable(f"{where}{key}", given[key])
        return table

    def read_points(self, path: Path, size: tuple[int, ...]) -> dict[str, Anything]:
        """Read pixels (n, 2) and positions (n, 3) in mm, where a position is known."""
        where = str(path)
        array = real_numbers(read_array(path, self.key), where)
        if self.form == "grid":
            check_shape(array, (*size, 3), where)
            pixels = np.indices(size).reshape(2, -1).T
        else:
            check_shape(array, (None, 5), where)
            pixels = array[:, :2] - self.origin
        xyz = array[..., -3:].reshape(-1, 3)
        depth = xyz[:, 2].astype(np.float32)
        known = ~np.isnan(xyz).any(axis=1) & (depth != np.float32(self.invalid))
        with np.errstate(all="ignore"):  # what cannot be stored is refused
            whole = pixels[known].astype(np.int32)
            positions = (xyz[known] * MM_PER_UNIT[self.unit]).astype(np.float32)
        if (whole != pixels[known]).any() or (len(known) and not known.any()):
            raise InputError(
                f"{path}: row and col of a point are not whole, or none has a position."
            )
        return {"pixels": whole, "xyz": positions}

    def read_labels(self, path: Path, size: tuple[int, ...]) -> dict[str, Anything]:
        """Read the classes (rows, cols) of Table 5.1."""
        image = read_array(path, self.key)
        check_shape(image, size, str(path))
        classes = {int(theirs): ours for theirs, ours in self.classes.items()}
        values = pd.Series(image.ravel())
        labels = values.map(classes)
        if labels.isna().any():
            unknown = values[labels.isna().argmax()]
            raise InputError(f"{path}: class {unknown} is not in classes. Add it.")
        return {"labels": labels.to_numpy(np.uint8).reshape(size)}


def read_manifest(path: Path) -> tuple[dict[str, Any], dict[str, FileTable]]:
    """Read a manifest: its `FACTS` and its `TABLES`, by name.

    Raises
    ------
    OSError, ValueError, RecursionError
        If it cannot be read, or a key is missing, unknown or unusable.
    """
    text = path.read_text("utf-8-sig")[:LONGEST]
    facts = tomllib.loads(text.replace("\\", "/"))
    needed = ("name", "frame_rate_hz", "gray")
    _check_keys(facts, known=(*FACTS, *TABLES), needed=needed)
    tables = {
        name: FileTable.from_toml(facts.pop(name), name)
        for name in TABLES
        if name in facts
    }
    for key in ("name", "fraction"):
        if not isinstance(facts.get(key, ""), str):
            raise _unusable(key, facts[key])
    if "/" in facts["name"]:  # folders are named by it
        raise _unusable("name", facts["name"])
    return facts, tables


def _are_classes(classes: Any) -> bool:
    return isinstance(classes, dict) and all(
        re.fullmatch(r"-?\d+", theirs) and ours in range(len(LABELS))
        for theirs, ours in classes.items()
    )


def _check_keys(
    given: Mapping[str, Any],
    known: Collection[str],
    needed: Collection[str],
    where: str = "",
) -> None:
    """Raise an `InputError` that names the first key that is missing or unknown."""
    for key in (*needed, *given):
        if key not in given:
            raise InputError(
                f"{where}{key} is missing; see pydoc kilnflight.recording.files."
            )
        if key not in known:
            raise _unusable(f"{where}{key}", given[key])


def _unusable(key: str, value: Any) -> InputError:
    return InputError(
        f"{key} = {value!r:.80} cannot be used; see pydoc kilnflight.recording.files."
    )
