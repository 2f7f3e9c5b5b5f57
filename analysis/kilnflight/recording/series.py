"""Files of an archive that belong together, and what they hold.

Files whose names differ in numbers alone are a series. A number in the file's name is
the frame, if several vary a bare one or that with most values; another one that varies
names the subset, such as V1. What a series holds is told by the shape and the values
of its first file. Series that one word tells apart, such as wood, are subsets of one,
if series of another kind have the same words.
"""

import json
import re
import zipfile
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from string import digits
from typing import Any

import numpy as np

from kilnflight.checks import InputError
from kilnflight.recording.manifest import SUBSET
from kilnflight.recording.readers import (
    PICTURES,
    POINT,
    TEXTS,
    Anything,
    Key,
    variables,
)
from kilnflight.store.cache import make_whole

ENDINGS = (*PICTURES, *TEXTS, ".npy", ".mat", ".h5", ".hdf5")
# Words before the number of a frame, as in Frame0081 or, without one, in 0081.
COUNTERS = ("", "f", "frame", "img", "image", "bild")
MOST_CLASSES = 16  # a picture with more values is no label picture


@dataclass(frozen=True, eq=False)
class Series:
    """Files of one kind.

    Parameters
    ----------
    pattern
        Their path, with ``{subset}`` and ``{frame}`` in place of what varies.
    files
        The files in order.
    key
        Variable or data set, where each file holds several; or those that belong
        together.
    kind
        "gray", "coordinates", "labels", or "" if it is none of them.
    form
        Form of a table of a manifest; or why the file cannot be read.
    first
        Array of the first file, or of its first frame.
    layers
        Number of frames in a file with ``form`` "stack", else 1.
    """

    pattern: str
    files: Sequence[Path]
    key: Key
    kind: str
    form: str
    first: Anything
    layers: int = 1

    def told(self) -> str:
        """Return what it holds, in one line."""
        if not self.first.size:
            return f"{self.pattern}: no numbers; look yourself ({self.form})"
        values = "no numbers"
        known = np.empty(0)
        if self.first.dtype.kind in "buif":
            known = self.first[np.isfinite(self.first)]
        if known.size:
            values = f"{known.min():g} to {known.max():g}"
        name = self.pattern
        if self.key:
            name += f", {to_toml(self.key)}"
        return (
            f"{name}: {len(self.files)} files, {self.first.dtype} "
            f"{self.first.shape}, {values}: {self.kind or 'not recognised'}"
        )


def is_archive(path: Path) -> bool:
    """Return whether a path holds more than the frames of one film.

    That is a ZIP archive, or a folder with files of coordinates or with subfolders.
    """
    if path.suffix.lower() == ".zip":
        return path.is_file()
    if not path.is_dir() or (path / "zarr.json").is_file():
        return False
    for each in path.iterdir():
        other = each.is_dir() or each.suffix.lower() in ENDINGS[len(PICTURES) :]
        if other and not each.name.startswith((".", "__")):
            return True
    return False


def unpack(archive: Path) -> Path:
    """Unpack a ZIP archive beside it, whole or not at all, and return its folder.

    Raises
    ------
    InputError
        If it is cut short, damaged, or has a password, or its folder is another one.
    """
    folder = archive.with_suffix("")
    try:
        with zipfile.ZipFile(archive) as content:
            if folder.exists():
                if all((folder / name).exists() for name in content.namelist()):
                    return folder
                raise InputError(f"{folder}: is not of {archive}. Move it away.")
            damaged = content.testzip()
            if damaged:
                raise zipfile.BadZipFile(f"{damaged} is damaged")
            make_whole(folder, content.extractall)
    except RuntimeError as error:  # zipfile's, of what it cannot do
        raise InputError(
            f"{archive}: has a password or an unknown packing ({error}). Unpack it "
            "yourself."
        ) from error
    except (OSError, zipfile.BadZipFile, EOFError) as error:
        raise InputError(
            f"{archive}: no whole ZIP archive ({error}). Fetch it again."
        ) from error
    return folder


def find_series(folder: Path) -> list[Series]:
    """Find the series of a folder and say what each holds.

    Raises
    ------
    InputError
        If there is no file that can be read.
    """
    groups: dict[str, list[str]] = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        hidden = any(part.startswith((".", "__")) for part in name.split("/"))
        if path.suffix.lower() in ENDINGS and not hidden and path.is_file():
            groups.setdefault(re.sub(r"\d+", "#", name), []).append(name)
    if not groups:
        raise InputError(f"{folder}: no pictures, arrays or tables of numbers.")
    found = [
        series for names in groups.values() for series in _series_of(folder, names)
    ]
    return _join(found)


def _series_of(folder: Path, names: Sequence[str]) -> Iterator[Series]:
    """Yield a series for each array that the files of a group hold."""
    files = [folder / name for name in names]
    try:
        held = _together(variables(files[0]))
    except InputError as error:  # a readme, or damaged
        yield Series(_pattern(names, True), files, None, "", str(error), np.empty(0))
        return
    layers = {array.shape[3] for array in held.values() if array.ndim == 4}
    for key, array in held.items():
        first = array
        count = 1
        if array.ndim == 4 or (array.ndim == 3 and array.shape[2] in layers):
            first = array[..., 0]
            count = array.shape[-1]
        kind, form = _kind(first)
        if count > 1:
            form = "stack"
        with_frames = form == "table" and first.shape[1] == 4
        several = with_frames and len(np.unique(first[:, 0])) > 1
        pattern = _pattern(names, one_frame=form != "stack" and not several)
        yield Series(pattern, files, key, kind, form, first, count)


def _together(held: Mapping[Key, Anything]) -> dict[Key, Anything]:
    """Return arrays by name; x, y, z, and row and col with them, are one array."""
    arrays = dict(held)
    named = {str(name).lower().split("/")[-1]: name for name in held}
    for names in (POINT, POINT[2:]):
        keys = tuple(str(named.get(name)) for name in names)
        if arrays.keys() >= {*keys} and len({arrays[key].shape for key in keys}) == 1:
            columns = np.stack([arrays.pop(key) for key in keys], axis=-1)
            arrays[keys] = np.squeeze(columns)
    return arrays


def _join(found: list[Series]) -> list[Series]:
    """Join series that one word tells apart, where several kinds have these words."""
    groups = defaultdict[Any, dict[str, Series]](dict)
    for series in found:
        words = re.findall(r"[^/{}.]+(?=[/.])", series.pattern)  # folders, file
        words += re.findall(r"[A-Za-z]+", series.pattern)
        for word in words:
            whole = rf"(?<![A-Za-z\d{{]){re.escape(word)}(?![A-Za-z\d}}])"
            pattern = re.sub(whole, SUBSET, series.pattern)
            if pattern != series.pattern:
                groups[series.kind, series.form, series.key, pattern][word] = series
    kinds = defaultdict[Any, set[str]](set)
    for (kind, *_), group in groups.items():
        if kind and len(group) > 1:
            kinds[frozenset(group)].add(kind)
    for (*_, pattern), group in groups.items():
        if len(kinds[frozenset(group)]) > 1:
            parts = [*group.values()]
            files = [file for part in parts for file in part.files]
            joined = replace(parts[0], pattern=pattern, files=files)
            found = [joined, *(each for each in found if each not in parts)]
    return found


def _pattern(names: Sequence[str], one_frame: bool) -> str:
    """Return the pattern of names that differ in numbers alone.

    Without ``one_frame`` a file holds several, and no number is that of a frame.
    """
    words = [re.findall(r"[A-Za-z]*\d+|\D", name) for name in names]
    columns = list(zip(*words, strict=True))
    different = [len(set(column)) for column in columns]
    name = max((k for k, word in enumerate(words[0]) if word == "/"), default=-1)

    def likely(k: int) -> tuple[int, ...]:
        """Return how likely a word counts frames: a long number in the name does."""
        word = columns[k][0]
        before = word.rstrip(digits)
        named = before.lower() in COUNTERS
        return k > name, named, len(word) - len(before), different[k], k

    varying = [k for k, count in enumerate(different) if count > 1]
    parts = list(words[0])
    if one_frame and varying:
        frame = max(varying, key=likely)
        parts[frame] = re.sub(r"\d+", "{frame}", parts[frame])
        varying.remove(frame)
        for k in varying:
            if 2 * different[k] > len(names):  # a time, not a subset
                parts[k] = "*"
        varying = [k for k in varying if parts[k] != "*"]
    if not varying:
        return "".join(parts)
    # Of numbers that differ together one is the subset's: V1 in V1_2021/V1_01.png.
    counts = Counter(columns[k] for k in varying)
    chosen = max(counts, key=lambda column: (len(set(column)), counts[column]))
    alone = len(set(zip(*counts, strict=True))) == len(set(chosen))
    for k in varying:
        parts[k] = SUBSET if columns[k] == chosen or not alone else "*"
    return re.sub(r"(\{subset\}[^/{}]*)*\{subset\}", SUBSET, "".join(parts))


def _kind(array: Anything) -> tuple[str, str]:
    """Return what an array holds and in which form, by its shape and its values."""
    if array.dtype.kind not in "buif":
        return "", ""
    known = array[np.isfinite(array)]
    whole = (known % 1 == 0).all()
    if array.ndim == 3 and array.shape[2] == 3 and array.dtype.kind in "fi":
        return "coordinates", "grid"
    if array.ndim == 3 and array.shape[2] in (3, 4):
        return "gray", "grid"
    if array.ndim != 2 or len(array) < 2 or not known.size:
        return "", ""
    of_classes = whole and known.min() >= 0
    of_classes &= len(np.unique(array[:, -1])) <= MOST_CLASSES
    if array.shape[1] in (3, 4) and of_classes:
        return "labels", "table"
    if array.shape[1] in (3, 5):
        return "coordinates", {3: "cloud", 5: "points"}[array.shape[1]]
    if whole and min(array.shape) > MOST_CLASSES:
        few = len(np.unique(known)) <= MOST_CLASSES
        return ("labels" if few else "gray"), "grid"
    return "", ""


def to_toml(value: float | Key) -> str:
    """Return a value as a manifest has it."""
    if isinstance(value, float | int):
        return f"{value:g}"
    return json.dumps(value)
