"""Manifests: facts about a recording, and the tables of its files.

`kilnflight.recording.files` shows one.
"""

import re
import tomllib
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.arrays import Facts, Named, Picture, Shape
from kilnflight.checks import InputError, check_shape, real_numbers
from kilnflight.recording.frames import LABELS
from kilnflight.recording.readers import (
    NAMED,
    POINT,
    Anything,
    Key,
    expression,
    read_array,
    read_layers,
)

# manifest.toml has what a manifest may state.
_STATED = tomllib.loads(Path(__file__).with_name("manifest.toml").read_text("utf-8"))
FACTS = _STATED["facts"]
FORMS = _STATED["forms"]
KEYS = _STATED["keys"]
COLUMNS = {  # of a table of text, by its form
    "points": POINT,
    "cloud": POINT[2:],
    "indexed": POINT[2:],
    "table": NAMED[1],
}
MM_PER_UNIT = _STATED["units"]
TABLES = tuple(FORMS)
ORDERS = ("row col", "col row")
SUBSET = "{subset}"  # stands for the name of a subset in a pattern
CLASS = "{class}"  # stands for the name of a class in the pattern of masks
LONGEST = 2**15  # characters; TOML of dots alone is read for hours


@dataclass(frozen=True)
class FileTable:
    """A table of a manifest: files of one kind and how to read them.

    Parameters
    ----------
    pattern
        Path or pattern, relative to the manifest.
    key
        Variable or data set, where a file holds several; a list where x, y, z are one
        by one.
    channel
        Of coloured pictures, one of red, green and blue.
    form
        Of coordinates ``"grid"``: (rows, cols, 3) x, y, z, or (rows * cols, 3), a line
        for each pixel; ``"points"``: (n, 5) row, col, x, y, z;
        ``"indexed"``: (n, 3) of the pixels that ``index`` numbers; ``"cloud"``: (n, 3)
        without pixels, which ``focal_length_px`` finds. Of labels ``"grid"``: (rows,
        cols), or ``"table"``: (n, 4) frame, row, col, class of labelled pixels, (n, 3)
        without frame where a file is of one, or ``"masks"``: a picture for each class,
        whose pixels are above 0. ``"stack"``: grids of all frames in one
        file, with a last axis that counts them.
    numbers
        Variable with the numbers of the frames of a stack; None: counted from 0.
    index
        Variable with the number of each point's pixel, as MATLAB's ``find`` gives it.
    order
        ``"row col"``, or ``"col row"`` where columns come before rows: in points and
        tables the first two columns, in grids the first two axes; lines and indices
        then go down the columns, as MATLAB's ``(:)`` does.
    y
        Whether y grows ``"up"`` or ``"down"``.
    z
        ``"ahead"``, or ``"back"`` where depths are below 0.
    focal_length_px
        Of a cloud: col = (cols - 1) / 2 + f x / z, row = (rows - 1) / 2 - f y / z.
    invalid
        Depth of a pixel that has none.
    unit
        Of coordinates, one of `MM_PER_UNIT`.
    columns
        Names of the columns of a table without or with another header, such as
        ``"x y z row col -"``; None: in the order of the form.
    origin
        Number of the first row and column of points, 0 or 1.
    classes
        Class of Table 5.1 (Zhang 2023) by the number that the files have, or by what
        stands for ``{class}`` in the pattern of masks.
    """

    pattern: str
    key: Key = None
    channel: str | None = None
    form: str = "grid"
    numbers: str | None = None
    order: str = "row col"
    y: str = "up"
    z: str = "ahead"
    index: str | None = None
    focal_length_px: float = 0.0
    invalid: float | str = "nan"
    unit: str = "mm"
    columns: str | None = None
    origin: int = 0
    classes: Mapping[str, int] = field(default_factory=dict)

    @classmethod
    def from_toml(cls, given: Any, name: str) -> Self:
        """Return the table ``name`` of a manifest, or raise an `InputError`."""
        if not isinstance(given, dict):
            raise _unusable(name, given)
        where = f"[{name}] "
        check_keys(given, known=KEYS[name], needed=["pattern"], where=where)
        table = cls(**given)
        length = table.focal_length_px
        fits = {
            "pattern": isinstance(table.pattern, str),
            "form": table.form in FORMS[name],
            "order": table.order in ORDERS,
            "y": table.y in ("up", "down"),
            "z": table.z in ("ahead", "back"),
            "invalid": table.invalid == "nan" or type(table.invalid) in (int, float),
            "unit": table.unit in tuple(MM_PER_UNIT),
            "origin": type(table.origin) is int and table.origin in (0, 1),
            "key": isinstance(table.key, str | list | None),
            "numbers": isinstance(table.numbers, str | None),
            "classes": _are_classes(table.classes, table.form),
            "focal_length_px": type(length) in (int, float)
            and (length > 0) == (table.form == "cloud"),
            "index": isinstance(table.index, str) == (table.form == "indexed"),
            "columns": table.columns is None or table.places() is not None,
        }
        for key, usable in fits.items():
            if not usable:
                raise _unusable(f"{where}{key}", given.get(key))
        return table

    def files(self, path: Path) -> list[Path]:
        """Return the files of one frame: all its masks, or ``path`` alone."""
        if self.form != "masks":
            return [path]
        first, *_ = self.classes
        parts_of = expression(str(Path(self.pattern))).split(re.escape(CLASS))
        between = f"){re.escape(first)}(".join(parts_of)
        place, *parts = re.split(f"({between})$", str(path))[:-1]
        return [Path(place + name.join(parts)) for name in self.classes]

    def of_subset(self, name: str) -> Self:
        """Return the table of one subset, for patterns with `SUBSET`."""
        return replace(self, pattern=self.pattern.replace(SUBSET, name))

    def places(self) -> list[int] | None:
        """Return where the columns of the form are in a file; None if one is missing.

        A table of labels may be without frames.
        """
        named = str(self.columns).split()
        wanted = COLUMNS.get(self.form, ["-1"])
        if {*wanted} - {*named} - {"frame"}:
            return None
        return [named.index(name) for name in wanted if name in named]

    def read_numbers(self, path: Path) -> list[int]:
        """Read the numbers of the frames of a stack."""
        if self.numbers is None:
            return [*range(read_layers(path, self.key).shape[-1])]
        numbers = real_numbers(read_array(path, self.numbers), str(path))
        return numbers.ravel().astype(int).tolist()

    def _read(self, path: Path, number: int) -> Anything:
        """Read the array of frame ``number``."""
        if self.form != "stack":
            array = read_array(path, self.key, named=self.columns is None)
            if self.columns is None:
                return array
            check_shape(array, (None, len(self.columns.split())), str(path))
            return array[:, self.places()]
        layers = read_layers(path, self.key)
        return layers[..., self.read_numbers(path).index(number)]

    def read_points(self, path: Path, size: Shape, number: int) -> Named:
        """Read pixels (n, 2) and positions (n, 3) in mm, where a position is known."""
        return self.points_of(self._read(path, number), size, path)

    def points_of(self, values: Anything, size: Shape, path: Path) -> Named:
        """Return what `read_points` does, of the values that a file holds."""
        array = real_numbers(values, str(path))
        if self.form in ("grid", "stack"):
            if array.shape == (size[0] * size[1], 3):
                lines_first = size if self.order == "row col" else size[::-1]
                array = array.reshape(*lines_first, 3)
            array = self._rows_first(array, (*size, 3), path)
        else:
            columns = 5 if self.form == "points" else 3
            check_shape(array, (None, columns), str(path))
        xyz = array[..., -3:].reshape(-1, 3)
        depth = xyz[:, 2].astype(np.float32)
        known = ~np.isnan(xyz).any(axis=1) & (depth != np.float32(self.invalid))
        with np.errstate(all="ignore"):  # what cannot be stated is refused
            positions = (xyz * MM_PER_UNIT[self.unit]).astype(np.float32)
            if self.y == "down":
                positions[:, 1] *= -1.0
            if self.z == "back":
                positions[:, 2] *= -1.0
            pixels = self._pixels(array, positions, size, path)[known]
            whole = pixels.astype(np.int32)
        if (whole != pixels).any() or (len(known) and not known.any()):
            raise InputError(
                f"{path}: row and col of a point are not whole, or none has a position."
            )
        return {"pixels": whole, "xyz": positions[known]}

    def _rows_first(self, array: Anything, shape: Shape, path: Path) -> Anything:
        """Return a grid of that shape; its first two axes are swapped if cols lead."""
        if self.order == "col row" and array.ndim > 1:
            array = np.swapaxes(array, 0, 1)
        check_shape(array, shape, str(path))
        return array

    def _pixels(
        self, array: Anything, xyz: Anything, size: Shape, path: Path
    ) -> Anything:
        """Return row and col (n, 2) of all points; ``xyz`` (n, 3) is in mm, y up."""
        if self.form == "cloud":
            x, y, z = xyz.astype(np.float64).T
            across = np.column_stack([-y, x]) * (self.focal_length_px / z)[:, None]
            return np.rint((np.array(size) - 1) / 2 + across)
        if self.form == "points":
            listed = array[:, :2] - self.origin
        elif self.form == "indexed":
            number = real_numbers(read_array(path, self.index), str(path)).ravel()
            check_shape(number, (len(xyz),), f"{path}, {self.index}")
            first_axis = size[1] if self.order == "row col" else size[0]
            listed = np.stack(np.divmod(number - self.origin, first_axis), axis=1)
        else:
            return np.indices(size).reshape(2, -1).T
        return listed if self.order == "row col" else listed[:, ::-1]

    def read_labels(self, path: Path, size: Shape, number: int) -> Named:
        """Read the classes (rows, cols) of Table 5.1 in frame ``number``."""
        if self.form == "table":
            image = self._painted(path, size, number)
        elif self.form == "masks":
            image = np.zeros(size, np.uint8)
            both = zip(self.files(path), self.classes.values(), strict=True)
            for file, ours in both:
                mask = self._rows_first(read_array(file, self.key), size, file)
                image[mask > 0] = ours
        else:
            grid = self._rows_first(self._read(path, number), size, path)
            image = self._classes_of(grid.ravel(), path).reshape(size)
        return {"labels": image}

    def read_table(self, path: Path, number: int = 0) -> pd.DataFrame:
        """Read labelled pixels: ``frame``, ``row``, ``col``, ``class`` of theirs.

        All are of frame ``number`` in a table without frames.
        """
        array = real_numbers(self._read(path, number), str(path))
        if array.shape[1:] == (3,):
            array = np.insert(array, 0, number, axis=1)
        check_shape(array, (None, 4), str(path))
        table = pd.DataFrame(array, columns=["frame", *self.order.split(), "class"])
        table[["row", "col"]] -= self.origin
        return table

    def _painted(self, path: Path, size: Shape, number: int) -> Picture:
        """Return the classes of the pixels that a table lists; all others are wall."""
        table = self.read_table(path, number)
        rows = table[table["frame"] == number]
        places = rows[["row", "col"]].to_numpy()
        wrong = (places % 1 != 0) | (places < 0) | (places >= size)
        if wrong.any():
            first = places[wrong.any(axis=1).argmax()]
            raise InputError(
                f"{path}, frame {number}: row and col {first.tolist()} are no pixel of "
                f"{size}. Change order or origin of [labels]."
            )
        image = np.zeros(size, np.uint8)
        image[tuple(places.astype(int).T)] = self._classes_of(rows["class"], path)
        return image

    def _classes_of(self, values: npt.ArrayLike, path: Path) -> Picture:
        """Return the classes of Table 5.1 (n,) by those of the files."""
        classes = {float(theirs): ours for theirs, ours in self.classes.items()}
        given = pd.Series(np.asarray(values))
        labels = given.map(classes)
        if labels.isna().any():
            unknown = given[labels.isna().argmax()]
            raise InputError(f"{path}: class {unknown:g} is not in classes. Add it.")
        return labels.to_numpy().astype(np.uint8)


def read_manifest(path: Path) -> tuple[Facts, dict[str, FileTable]]:
    """Read a manifest: its `FACTS` and its `TABLES`, by name.

    Raises
    ------
    OSError, ValueError, RecursionError
        If it cannot be read, or a key is missing, unknown or unusable.
    """
    with path.open(encoding="utf-8-sig") as file:
        text = file.read(LONGEST)
    facts = tomllib.loads(text.replace("\\", "/"))
    needed = ("name", "frame_rate_hz", "gray")
    check_keys(facts, known=(*FACTS, *TABLES), needed=needed)
    tables = {
        name: FileTable.from_toml(facts.pop(name), name)
        for name in TABLES
        if name in facts
    }
    for name, span in dict(facts.get("subsets", {})).items():
        whole = all(type(number) is int for number in span)
        if not whole or len(span) != 2 or not 0 <= span[0] <= span[1]:
            raise _unusable(f"subsets: {name}", span)
    return facts, tables


def _are_classes(classes: Any, form: str) -> bool:
    """Return whether classes of files are usable; those of masks have names."""
    if not isinstance(classes, dict) or (form == "masks" and not classes):
        return False
    named = form == "masks" or all(re.fullmatch(r"-?\d+", name) for name in classes)
    known = range(len(LABELS))
    return named and all(type(n) is int and n in known for n in classes.values())


def check_keys(
    given: Mapping[str, Any],
    known: Collection[str],
    needed: Collection[str] = (),
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
