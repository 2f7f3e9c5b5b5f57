"""The three kinds of files a manifest names: one file -> the arrays of one frame.

The fields are the keys of the manifest's tables; `kilnflight.recording.importing` explains them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
import numpy.typing as npt

from kilnflight.checks import InputError, check_shape
from kilnflight.recording.frames import LABELS
from kilnflight.recording.readers import read_array, read_points

Source = TypeVar("Source", "Gray", "Coordinates", "Labels")
Points = tuple[npt.NDArray[np.int32], npt.NDArray[np.float32]]


@dataclass(frozen=True)
class Gray:
    """The manifest's ``[gray]``."""

    pattern: str
    key: str | None = None

    def read(self, path: Path, where: str) -> npt.NDArray[np.uint16]:
        """Return the image of one file."""
        image = read_array(path, self.key, where)
        if image.ndim != 2:
            raise InputError(f"{where}: {path} has shape {image.shape}, expected (rows, cols).")
        return image


@dataclass(frozen=True)
class Coordinates:
    """The manifest's ``[coordinates]``."""

    pattern: str
    form: Literal["grid", "points"]
    key: str | None = None
    invalid: float | str = "nan"
    unit: Literal["mm", "m"] = "mm"
    columns: tuple[str, ...] = ("row", "col", "x", "y", "z")
    origin: int = 0

    def __post_init__(self) -> None:
        for name, allowed in (("form", ("grid", "points")), ("unit", ("mm", "m"))):
            if getattr(self, name) not in allowed:
                raise InputError(f"{name} is {getattr(self, name)!r}, expected one of {allowed}")
        if self.invalid != "nan" and (
            isinstance(self.invalid, bool) or not isinstance(self.invalid, int | float)
        ):
            raise InputError(f"invalid is {self.invalid!r}, expected a number or 'nan'")
        if len(self.columns) != 5 or self.origin not in (0, 1):
            raise InputError("columns must be five names, origin 0 or 1")

    def read(self, path: Path, size: tuple[int, int], where: str) -> Points:
        """Return the pixels and positions of one file, those without depth left out."""
        if self.form == "grid":
            grid = read_array(path, self.key, where)
            check_shape(grid, (*size, 3), f"{where}: coordinates of {path}")
            xyz = grid.reshape(-1, 3)
        else:
            table = read_points(path, self.key, self.columns, where)
            xyz = table[:, 2:]
        if self.invalid == "nan" or np.isnan(float(self.invalid)):
            valid = np.flatnonzero(~np.isnan(xyz).any(axis=1))
            if len(xyz) and not len(valid):
                raise InputError(f"{where}: {path} holds no position, every one is NaN.")
        else:
            valid = np.flatnonzero(xyz[:, 2].astype(np.float32) != np.float32(self.invalid))
        pixels: npt.NDArray[Any] = (
            np.column_stack(np.divmod(valid, size[1]))
            if self.form == "grid"
            else table[valid, :2] - self.origin
        )
        return self._points(pixels, xyz[valid], f"{where}: {path}")

    def _points(self, pixels: npt.NDArray[Any], xyz: npt.NDArray[Any], where: str) -> Points:
        broken = np.flatnonzero((pixels != np.round(pixels)).any(axis=1))  # NaN is not equal
        if len(broken):
            row, col = pixels[broken[0]]
            raise InputError(
                f"{where}: row {row:g}, col {col:g} is no pixel; whole numbers expected."
            )
        limits = np.iinfo(np.int32)
        scale = 1000.0 if self.unit == "m" else 1.0
        with np.errstate(over="ignore"):  # what is too large becomes infinite and is told
            positions = (xyz * scale).astype(np.float32)
        return np.clip(pixels, limits.min, limits.max).astype(np.int32), positions


@dataclass(frozen=True)
class Labels:
    """The manifest's ``[labels]``."""

    pattern: str
    classes: Mapping[str, int]
    key: str | None = None

    def __post_init__(self) -> None:
        for theirs, ours in self.classes.items():
            if not re.fullmatch(r"-?\d+", theirs) or ours not in range(len(LABELS)):
                raise InputError(
                    f"classes has {theirs} = {ours!r}, expected their number = 0 to "
                    f"{len(LABELS) - 1} ({', '.join(LABELS)})"
                )

    def read(self, path: Path, size: tuple[int, int], where: str) -> npt.NDArray[np.uint8]:
        """Return the classes of Table 5.1 of one file."""
        image = read_array(path, self.key, where)
        check_shape(image, size, f"{where}: labels of {path}")
        labels = np.full(size, len(LABELS), np.uint8)
        for theirs, ours in self.classes.items():
            labels[image == int(theirs)] = ours
        unknown = np.argwhere(labels == len(LABELS))
        if len(unknown):
            row, col = unknown[0]
            raise InputError(
                f"{where}: {path} has the unknown class {image[row, col]} in {len(unknown)} "
                f"pixel(s), the first at row {row}, col {col}. Add it to classes."
            )
        return labels


def from_table(kind: type[Source], table: object, where: str) -> Source:
    """Return a source from its table in the manifest, or raise an `InputError`."""
    if not isinstance(table, dict):
        raise InputError(f"{where} is {table!r}, expected a table with a pattern.")
    known = {item.name: item for item in fields(kind)}
    unknown = [name for name in table if name not in known]
    missing = [
        name for name, item in known.items() if item.default is MISSING and name not in table
    ]
    if unknown or missing:
        said = [f"does not know {', '.join(unknown)}"] if unknown else []
        said += [f"lacks {', '.join(missing)}"] if missing else []
        raise InputError(f"{where} {' and '.join(said)}; its keys are {', '.join(known)}.")
    for name, wanted in (("pattern", str), ("key", str), ("columns", list), ("classes", dict)):
        if name in table and not isinstance(table[name], wanted):
            raise InputError(f"{where}: {name} is {table[name]!r}, expected {wanted.__name__}.")
    try:
        return kind(**table)
    except InputError as error:
        raise InputError(f"{where}: {error}.") from error
