"""What lies in an archive of labelled frames, and the draft of its manifest.

archive -> folder -> series of files -> kind of each -> manifest with questions

Files whose names differ in numbers alone are a series. A number in the file's name is
the frame, if several vary a bare one or that with most values; another one that varies
names the subset, such as V1. What a series holds is
told by the shape and the values of its first file. A manifest is drafted from that;
lines that the files do not decide end with a question.
"""

import re
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kilnflight.checks import InputError
from kilnflight.recording.frames import Frame
from kilnflight.recording.manifest import SUBSET
from kilnflight.recording.readers import (
    PICTURES,
    TEXTS,
    Anything,
    read_array,
    variables,
)
from kilnflight.store.cache import make_whole

ENDINGS = (*PICTURES, *TEXTS, ".npy", ".mat", ".h5", ".hdf5")
MOST_CLASSES = 16  # a picture with more values is no label picture
METRES_BELOW = 100.0  # a median depth below it is in m: no kiln is 100 mm long
CENTIMETRES_BELOW = 1500.0  # this one may be in cm
LARGEST_DEPTH = 65_535.0  # a depth of 16 bits that means none
CLASSES = {0, 1, 2, 3, 4}  # Table 5.1
BURNING = (2, 4)
SURE = 1.8  # sum of two correlations, at most 2
LEAST_POINTS = 10  # a correlation needs them
SHARED = 0.005  # share of equal depths that are no depths
# A lens of 85 mm over 11 um, as the thesis's camera (section 2.1.4, R12 data sheet).
FOCAL_LENGTH_PX = 85.0 / 0.011


@dataclass(frozen=True)
class Series:
    """Files of one kind.

    Parameters
    ----------
    pattern
        Their path, with ``{subset}`` and ``{frame}`` in place of what varies.
    files
        The files in order.
    key
        Variable or data set, where each file holds several.
    kind
        "gray", "coordinates", "labels", or "" if it is none of them.
    form
        Form of a table of a manifest; or why the file cannot be read.
    first
        Array of the first file.
    """

    pattern: str
    files: Sequence[Path]
    key: str | None
    kind: str
    form: str
    first: Anything

    def told(self) -> str:
        """Return what it holds, in one line."""
        known = self.first[np.isfinite(self.first)]
        if not self.first.size:
            return f"{self.pattern}: {len(self.files)} files, not read: {self.form}"
        values = "no numbers"
        if known.size:
            values = f"{known.min():g} to {known.max():g}"
        name = f"{self.pattern}, {self.key}" if self.key else self.pattern
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
    held = [each for each in path.iterdir() if not each.name.startswith((".", "__"))]
    others = [each for each in held if each.suffix.lower() in ENDINGS[len(PICTURES) :]]
    return bool(others) or any(each.is_dir() for each in held)


def unpack(archive: Path) -> Path:
    """Unpack a ZIP archive beside it, whole or not at all, and return its folder.

    Raises
    ------
    InputError
        If it is cut short, damaged, or has a password.
    """
    folder = archive.with_suffix("")
    if folder.is_dir():
        return folder
    try:
        with zipfile.ZipFile(archive) as content:
            damaged = content.testzip()
            if damaged:
                raise zipfile.BadZipFile(f"{damaged} is damaged")
            make_whole(folder, content.extractall)
    except NotImplementedError as error:
        raise InputError(f"{archive}: {error}. Unpack it yourself.") from error
    except RuntimeError as error:  # zipfile's, of a password
        raise InputError(f"{archive}: has a password. Unpack it yourself.") from error
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
    return [series for names in groups.values() for series in _series_of(folder, names)]


def _series_of(folder: Path, names: Sequence[str]) -> Iterator[Series]:
    """Yield a series for each array that the files of a group hold."""
    files = [folder / name for name in names]
    try:
        held = variables(files[0])
    except InputError as error:  # a readme, or damaged
        yield Series(_pattern(names, True), files, None, "", str(error), np.empty(0))
        return
    for key, first in held.items():
        kind, form = _kind(first)
        several = form == "table" and len(np.unique(first[:, 0])) > 1
        pattern = _pattern(names, one_frame=not several)
        yield Series(pattern, files, key, kind, form, first)


def _pattern(names: Sequence[str], one_frame: bool) -> str:
    """Return the pattern of names that differ in numbers alone.

    Without ``one_frame`` a file holds several, and no number is that of a frame.
    """
    words = [re.findall(r"[A-Za-z]*\d+|\D", name) for name in names]
    columns = list(zip(*words, strict=True))
    different = [len(set(column)) for column in columns]
    name = max((k for k, word in enumerate(words[0]) if word == "/"), default=-1)

    def likely(k: int) -> tuple[bool, bool, int, int]:
        """Return how likely a word counts frames: a bare number in the name does."""
        varies = different[k] > 1
        bare = columns[k][0].isdigit()
        return varies and k > name, varies and bare, different[k], k

    frame = max(range(len(columns)), key=likely)
    parts = list(words[0])
    for k, column in enumerate(columns):
        if k == frame and different[k] > 1 and one_frame:
            parts[k] = re.sub(r"\d+", "{frame}", column[0])
        elif different[k] > 1:
            parts[k] = SUBSET
    return "".join(parts)


def _kind(array: Anything) -> tuple[str, str]:
    """Return what an array holds and in which form, by its shape and its values."""
    if array.dtype.kind not in "buif":
        return "", ""
    known = array[np.isfinite(array)]
    whole = known.size > 0 and bool((known % 1 == 0).all())
    if array.ndim == 3 and array.shape[2] == 3 and array.dtype.kind in "fi":
        return "coordinates", "grid"
    if array.ndim == 3 and array.shape[2] in (3, 4):
        return "gray", "grid"
    if array.ndim != 2 or not known.size:
        return "", ""
    if array.shape[1] in (3, 5):
        return "coordinates", {3: "cloud", 5: "points"}[array.shape[1]]
    if array.shape[1] == 4 and whole:
        return "labels", "table"
    if whole and min(array.shape) > MOST_CLASSES:
        few = len(np.unique(known)) <= MOST_CLASSES
        return ("labels" if few else "gray"), "grid"
    return "", ""


def draft(folder: Path) -> tuple[list[str], str]:
    """Return what a folder holds, line by line, and the draft of a manifest.

    Raises
    ------
    InputError
        If no series looks like grey pictures, or a file cannot be read.
    """
    found = find_series(folder)
    # Previews are fewer, coloured, of less bits or smaller.
    found.sort(
        key=lambda series: (
            -len(series.files),
            series.first.ndim,
            -series.first.itemsize,
            -series.first.size,
        )
    )
    chosen: dict[str, Series] = {}
    for series in found:
        if series.kind:
            chosen.setdefault(series.kind, series)
    told = [series.told() for series in found]
    if "gray" not in chosen:
        raise InputError(f"{folder}: nothing looks like grey pictures. {told}")
    size = chosen["gray"].first.shape[:2]
    lines = [
        f'name = "{folder.name}"',
        "frame_rate_hz = 330.0  # ? the camera's; chapter 5.1 does not need it",
        'depth_calibration = "zhang-2023"  # ? as captured; "none" if depths are true',
        "# roi = [[0, 200], ...]  # ? corners row, col of the region, counted from 0",
        "# flame_roi = [900, 1200, 850, 1150]  # ? burner: rows 900 to 1199, cols ...",
    ]
    gray = np.asarray(chosen["gray"].first, np.float64)
    for kind in ("gray", "coordinates", "labels"):
        if kind not in chosen:
            continue
        series = chosen[kind]
        lines += ["", f"[{kind}]", f'pattern = "{series.pattern}"']
        lines += [
            f'# ? or pattern = "{other.pattern}"'
            for other in found
            if other.kind == kind and other is not series
        ]
        if series.key:
            lines.append(f'key = "{series.key}"')
        if kind == "coordinates":
            lines += _coordinate_lines(series, size)
        elif kind == "labels":
            lines += _label_lines(series, gray)
    return told, "\n".join(lines) + "\n"


def _coordinate_lines(series: Series, size: tuple[int, int]) -> list[str]:
    """Return the lines of a manifest on coordinates, by those of the first file."""
    array = np.asarray(series.first, np.float64)
    form = series.form
    if form == "cloud" and len(array) == size[0] * size[1]:
        form = "lines"
    xyz = array[..., -3:].reshape(-1, 3)
    invalid = _invalid(xyz[:, 2])
    known = np.isfinite(xyz).all(axis=1)
    if invalid != "nan":
        known &= xyz[:, 2] != invalid
    index = None
    if form == "cloud":
        index = _index_of(series)
        form = "indexed" if index else "cloud"
    lines = [f'form = "{form}"', f"invalid = {_toml(invalid)}"]
    depth = np.median(np.abs(xyz[known, 2])) if known.any() else np.inf
    if depth < METRES_BELOW:
        lines.append('unit = "m"')
    elif depth < CENTIMETRES_BELOW:
        lines.append('unit = "cm"  # ? or "mm"')
    else:
        lines.append('unit = "mm"')
    if form == "cloud":
        question = "# ? a lens of 85 mm over pixels of 11 um, in the middle"
        lines.append(f"focal_length_px = {FOCAL_LENGTH_PX:.1f}  {question}")
        return [*lines, 'y = "up"  # ? or "down"']
    if index:
        lines.append(f'index = "{index}"')
        number = read_array(series.files[0], index).ravel().astype(np.int64) - 1
        pairs = _numbered_pairs(number, size)
    else:
        pairs = _pixel_pairs(array, form, size)
    fits = {order: _follow(*pair, xyz, known) for order, pair in pairs.items()}
    order = max(fits, key=lambda name: sum(map(abs, fits[name])))
    down, _ = fits[order]
    unsure = "" if sum(map(abs, fits[order])) > SURE else "  # ? x, y and pixels differ"
    lines.append(f'order = "{order}"{unsure}')
    lines.append(f'y = "{"down" if down > 0 else "up"}"{unsure}')
    if form == "points":
        lines.append(_origin_line(array[:, :2], size, order))
    elif form == "indexed":
        lines.append("origin = 1  # MATLAB counts from 1")
    return lines


def _index_of(series: Series) -> str | None:
    """Return the name of the variable that numbers the pixels of a cloud, if any."""
    for name, array in variables(series.files[0]).items():
        whole = array.dtype.kind in "buif" and (array % 1 == 0).all()
        if array.size == len(series.first) and whole:
            return name
    return None


def _numbered_pairs(number: Any, size: tuple[int, int]) -> dict[str, tuple[Any, Any]]:
    """Return row and col (n,) of pixels by their number, by the order that is meant."""
    row, col = np.divmod(number, size[1])
    other_col, other_row = np.divmod(number, size[0])
    return {"row col": (row, col), "col row": (other_row, other_col)}


def _pixel_pairs(
    array: Anything, form: str, size: tuple[int, int]
) -> dict[str, tuple[Any, Any]]:
    """Return row and col (n,) of each coordinate, by the order that is possible."""
    if form == "points":
        first, second = array[:, :2].T
        return {"row col": (first, second), "col row": (second, first)}
    if form == "grid":
        first, second = np.indices(array.shape[:2]).reshape(2, -1)
        if array.shape[:2] != size:
            return {"col row": (second, first)}
        if size[0] != size[1]:
            return {"row col": (first, second)}
        return {"row col": (first, second), "col row": (second, first)}
    return _numbered_pairs(np.arange(len(array)), size)


def _follow(row: Any, col: Any, xyz: Any, known: Any) -> tuple[float, float]:
    """Return the correlations of y/z with the row and of x/z with the column.

    Both are near 1 or -1 in a picture of a camera, whatever the depths.
    """
    known = known & (xyz[:, 2] != 0)
    x, y, z = xyz[known].T
    if len(z) < LEAST_POINTS:
        return 0.0, 0.0
    down = np.corrcoef(row[known], y / z)[0, 1]
    right = np.corrcoef(col[known], x / z)[0, 1]
    return float(down), float(right)


def check_frame_fits(frame: Frame, where: str) -> None:
    """Raise an `InputError` where a frame contradicts the manifest it was read by.

    ``where`` begins the message, which names the line to change.
    """
    xyz = np.asarray(frame.xyz, np.float64)
    if len(xyz) >= LEAST_POINTS:
        row, col = frame.pixels.T
        down, right = _follow(row, col, xyz, np.ones(len(xyz), np.bool_))
        line = ""
        if _invalid(xyz[:, 2]) != "nan":
            line = "many points have one depth; set invalid"
        elif np.median(np.abs(xyz[:, 2])) < METRES_BELOW:
            line = "depths are below 100 mm; set unit"
        elif abs(down) + abs(right) < SURE:
            line = "x and y do not follow the pixels; set order"
        elif down > 0:
            line = "y grows down the picture; set y"
        elif right < 0:
            line = "x grows to the left, which no line turns: multiply it by -1"
        if line:
            raise InputError(f"{where}: {line} in [coordinates].")
    if frame.labels is None or len(frame.labels) != frame.labels.shape[1]:
        return  # of another form swapped labels would lie outside
    burning = np.isin(frame.labels, BURNING)
    if burning.any() and frame.gray[burning].mean() < frame.gray[burning.T].mean():
        raise InputError(
            f"{where}: what burns would be brighter with rows and columns swapped; set "
            "order in [labels]."
        )


def _invalid(depth: Any) -> float | str:
    """Return the depth of pixels that have none: NaN, or 0 or the like of many."""
    if np.isnan(depth).any():
        return "nan"
    values, counts = np.unique(depth, return_counts=True)
    most = counts.argmax()
    none = values[most] <= 0 or values[most] >= LARGEST_DEPTH
    if none and counts[most] > SHARED * len(depth):
        return float(values[most])
    return "nan"


def _origin_line(pixels: Any, size: tuple[int, int], order: str) -> str:
    """Return the line that says from which number rows and columns count."""
    ends = size if order == "row col" else size[::-1]
    if pixels.min() < 1:
        return "origin = 0"
    if (pixels.max(axis=0) >= ends).any():
        return "origin = 1"
    return "origin = 1  # ? MATLAB counts from 1; 0 if the first row is 0"


def _label_lines(series: Series, gray: Any) -> list[str]:
    """Return the lines of a manifest on labels, by those of the first file."""
    lines = [f'form = "{series.form}"']
    size = gray.shape[:2]
    if series.form == "table":
        frame, first, second, theirs = series.first.T
        of_picture = frame == frame[0]
        places = np.column_stack([first, second])[of_picture].astype(int)
        places -= min(places.min(), 1)
        orders = {"row col": places, "col row": places[:, ::-1]}
        order = max(orders, key=lambda name: _brightness(gray, orders[name]))
        lines += [f'order = "{order}"', _origin_line(series.first[:, 1:3], size, order)]
    else:
        theirs = series.first
        turned = theirs.shape != size
        lines.append(f'order = "{"col row" if turned else "row col"}"')
    values = {*np.unique(theirs).astype(int).tolist()}
    if series.form == "grid":  # the first file may lack a class
        for file in series.files:
            values.update(np.unique(read_array(file, series.key)).astype(int).tolist())
    classes: dict[int, int] = {}
    if values <= CLASSES:
        classes = {value: value for value in sorted(CLASSES)}
    elif len(values) == len(CLASSES):
        classes = dict(zip(sorted(values), sorted(CLASSES), strict=True))
    else:
        lines.append(f"# ? the files have {sorted(values)}")
    text = ", ".join(f"{theirs} = {ours}" for theirs, ours in classes.items())
    asked = "# ? ours: 0 wall, 1 flame, 2 burning in air, 3 unlit in air, 4 on the wall"
    return [*lines, asked, f"classes = {{ {text} }}  # theirs = ours"]


def _brightness(gray: Any, places: Any) -> float:
    """Return the mean grey value at places (n, 2); they lie on bright pixels."""
    inside = ((places >= 0) & (places < gray.shape[:2])).all(axis=1)
    if not inside.all():
        return 0.0
    return float(gray[tuple(places.T)].mean())


def _toml(value: float | str) -> str:
    return f'"{value}"' if isinstance(value, str) else f"{value:g}"
