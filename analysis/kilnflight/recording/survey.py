"""The draft of a manifest of labelled frames.

archive -> folder -> series of files -> a table for each kind, with questions

What the values of the first files decide is written down: unit, order of rows and
columns, direction of y and z, classes. Other lines end with a question.
"""

from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from kilnflight.arrays import TwoInts
from kilnflight.checks import InputError
from kilnflight.recording.frames import Frame
from kilnflight.recording.manifest import ORDERS, SUBSET, TABLES, FileTable
from kilnflight.recording.readers import find_subsets, read_array, variables
from kilnflight.recording.series import Series, find_series, to_toml

METRES_BELOW = 100.0  # a median depth below it is in m: no kiln is 100 mm long
FARTHEST = 100_000.0  # mm
CENTIMETRES_BELOW = 1500.0  # this one may be in cm
LARGEST_DEPTH = 65_535.0  # a depth of 16 bits that means none
CLASSES = {0, 1, 2, 3, 4}  # Table 5.1
BURNING = 2  # in air
LEAST_WALL = 0.5  # share of pixels
# Burning particles are the brightest (5.1.1): of their pixels in the simulation 95 %
# and more are above this quantile of the picture, 12 % with another frame's labels.
BRIGHT = 0.9
BRIGHT_SHARE = 0.5
SURE = 1.8  # sum of two correlations, at most 2
LEAST_POINTS = 10  # a correlation needs them
SHARED = 0.005  # share of equal depths that are no depths
# A lens of 85 mm over 11 um, as the thesis's camera (section 2.1.4, R12 data sheet).
FOCAL_LENGTH_PX = 85.0 / 0.011


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
            -len(series.files) * series.layers,
            series.first.ndim,
            -series.first.itemsize,
            -series.first.size,
        )
    )
    chosen = {series.kind: series for series in reversed(found)}  # the first of each
    told = [series.told() for series in found]
    if "gray" not in chosen:
        listed = "\n".join(told)
        raise InputError(f"{folder}: nothing looks like grey pictures.\n{listed}")
    lines = [
        f'name = "{folder.name}"',
        "frame_rate_hz = 330.0  # ? the camera's; chapter 5.1 does not need it",
        'depth_calibration = "zhang-2023"  # ? if as captured; "none" if already true',
        "# roi = [[0, 200], ...]  # ? corners of the region: row, col, counted from 0",
        "# flame_roi = [900, 1200, 850, 1150]  # ? burner: rows 900 to 1199, columns "
        "850 to 1149, counted from 0",
    ]
    gray = np.asarray(chosen["gray"].first, float)
    size = gray.shape[:2]
    subsets = _subsets(chosen["gray"], folder)
    if not subsets:
        lines.append("# subsets = { V1 = [1, 10], V2 = [11, 20] }  # ? frames of each")
    for kind in TABLES:
        if kind not in chosen:
            lines += [
                "",
                f"# [{kind}]  # ? none was recognised: pattern, form, columns",
            ]
            continue
        series = chosen[kind]
        lines += ["", f"[{kind}]", f'pattern = "{series.pattern}"']
        lines += [
            f'# ? or pattern = "{other.pattern}"'
            for other in found
            if other.kind == kind and other is not series
        ]
        own = _subsets(series, folder)
        if own != subsets:
            lines.append(f"# ? its subsets are {own}, not {subsets}")
        lines += _key_lines(series)
        if kind == "coordinates":
            lines += _coordinate_lines(series, size)
        elif kind == "labels":
            lines += _label_lines(series, gray)
    return told, "\n".join(lines) + "\n"


def _key_lines(series: Series) -> list[str]:
    """Return the lines of a manifest on variables and stacks."""
    lines = []
    if series.key:
        lines.append(f"key = {to_toml(series.key)}")
    if series.form == "stack":
        numbers = _index_of(series, series.layers)
        if numbers:
            lines.append(f'numbers = "{numbers}"')
        if series.kind == "gray":
            lines.append('form = "stack"')
    return lines


def _subsets(series: Series, folder: Path) -> list[str]:
    """Return the subsets that the pattern of a series names, if any."""
    if SUBSET not in series.pattern:
        return []
    try:
        return find_subsets(series.pattern, folder)
    except InputError:  # its two numbers differ
        return []


def _coordinate_lines(series: Series, size: TwoInts) -> list[str]:
    """Return the lines of a manifest on coordinates, by those of the first file."""
    array = np.asarray(series.first, float)
    form = series.form
    if form == "cloud" and len(array) == size[0] * size[1]:
        form = "grid"
    xyz = array[..., -3:].reshape(-1, 3)
    invalid = _invalid(xyz[:, 2])
    index = None
    if form == "cloud":
        index = _index_of(series, len(series.first))
        if index:
            form = "indexed"
    lines = [f'form = "{form}"', f"invalid = {to_toml(invalid)}"]
    lines += _depth_lines(xyz, invalid)
    if form == "cloud":
        question = "# ? a lens of 85 mm over pixels of 11 um, in the middle"
        lines.append(f"focal_length_px = {FOCAL_LENGTH_PX:.1f}  {question}")
        return [*lines, 'y = "up"  # ? or "down"']
    origin = 0
    if index:
        lines.append(f'index = "{index}"')
        origin = 1
    fits = {}
    for order in ORDERS:
        table = FileTable(
            "", form=form, order=order, index=index, invalid=invalid, origin=origin
        )
        with suppress(InputError):  # its shape is that of the other order
            points = table.points_of(series.first, size, series.files[0])
            fits[order] = _follow(points["pixels"], points["xyz"])
    order = max(fits, key=lambda name: sum(map(abs, fits[name])), default=ORDERS[0])
    down, right = fits.get(order, (0.0, 0.0))
    unsure = "" if abs(down) + abs(right) > SURE else "  # ? x, y and pixels differ"
    lines.append(f'order = "{order}"{unsure}')
    lines.append(f'y = "{"down" if down > 0 else "up"}"{unsure}')
    if form == "points":
        lines.append(_origin_line(array[:, :2], size, order))
    elif form == "indexed":
        lines.append("origin = 1  # MATLAB counts from 1, down the columns")
    return lines


def _depth_lines(xyz: Any, invalid: float | str) -> list[str]:
    """Return the lines of a manifest that the median depth (n, 3) decides."""
    known = np.isfinite(xyz).all(axis=1) & (xyz[:, 2] != 0)
    if invalid != "nan":
        known &= xyz[:, 2] != invalid
    depth = np.median(xyz[known, 2]) if known.any() else np.inf
    line = 'unit = "mm"'
    if abs(depth) < METRES_BELOW:
        line = 'unit = "m"'
    elif abs(depth) < CENTIMETRES_BELOW:
        line = 'unit = "cm"  # ? or "mm"'
    if depth < 0:
        return ['z = "back"', line]
    return [line]


def _index_of(series: Series, count: int) -> str | None:
    """Return the name of a variable with that many whole numbers, if any."""
    for name, array in variables(series.files[0]).items():
        whole = array.dtype.kind in "buif" and (array % 1 == 0).all()
        if array.size == count and whole:
            return str(name)
    return None


def _follow(pixels: Any, xyz: Any) -> tuple[float, float]:
    """Return the correlations of y/z with the row and of x/z with the column.

    Both are near 1 or -1 in a picture of a camera, whatever the depths.
    """
    known = np.isfinite(xyz).all(axis=1) & (xyz[:, 2] != 0)
    if known.sum() < LEAST_POINTS:
        return 0.0, 0.0
    row, col = pixels[known].T
    x, y, z = xyz[known].T
    down = np.corrcoef(row, y / np.abs(z))[0, 1]
    right = np.corrcoef(col, x / np.abs(z))[0, 1]
    return down, right


def check_frame_fits(frame: Frame, where: str) -> None:
    """Raise an `InputError` where a frame contradicts the manifest it was read by.

    ``where`` begins the message, which names the line to change.
    """
    xyz = np.asarray(frame.xyz, float)
    if len(xyz) >= LEAST_POINTS:
        down, right = _follow(frame.pixels, xyz)
        line = ""
        if _invalid(xyz[:, 2]) != "nan":
            line = "many points have one depth; set invalid"
        elif not METRES_BELOW < np.median(xyz[:, 2]) < FARTHEST:
            line = "depths are below 0.1 m or above 100 m; set unit"
        elif abs(down) + abs(right) < SURE:
            line = "x and y do not follow the pixels; set order"
        elif down > 0:
            line = "y grows down the picture; set y"
        elif right < 0:
            line = "x grows to the left, which no line turns: multiply it by -1"
        if line:
            raise InputError(f"{where}: {line} in [coordinates].")
    if frame.labels is not None:
        _check_labels(frame.gray, frame.labels, where)


def _check_labels(gray: Any, labels: Any, where: str) -> None:
    """Raise an `InputError` where labels contradict the grey values."""
    if np.mean(labels == 0) < LEAST_WALL:
        raise InputError(f"{where}: most pixels are no wall; set classes in [labels].")
    burning = gray[labels == BURNING] > np.quantile(gray, BRIGHT)
    if burning.size and burning.mean() < BRIGHT_SHARE:
        raise InputError(
            f"{where}: what burns in air is not bright; set classes, pattern or order "
            "in [labels]."
        )


def _invalid(depth: Any) -> float | str:
    """Return the depth of pixels that have none: NaN, or 0 or the like of many."""
    if np.isnan(depth).any():
        return "nan"
    values, counts = np.unique(depth, return_counts=True)
    value = values[counts.argmax()]
    none = value == 0 or value < 0 < values[-1] or abs(value) >= LARGEST_DEPTH
    if none and counts.max() > SHARED * len(depth):
        return value
    return "nan"


def _origin_line(pixels: Any, size: TwoInts, order: str) -> str:
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
    asked = "# ours: 0 wall, 1 flame, 2 burning in air, 3 unlit in air, 4 on the wall"
    values = set[int]()
    if series.form == "table":
        listed = series.first[:, -3:-1]
        places = listed.astype(int)
        if series.first.shape[1] == 4:
            frame = series.first[:, 0]
            places = places[frame == frame[0]]
        places -= min(places.min(), 1)
        orders = {"row col": places, "col row": places[:, ::-1]}
        order = max(orders, key=lambda name: _brightness(gray, orders[name]))
        lines += [f'order = "{order}"', _origin_line(listed, size, order)]
        values.update(series.first[:, -1].astype(int).tolist())
    else:
        turned = series.first.shape != size
        lines.append(f'order = "{"col row" if turned else "row col"}"')
        for file in series.files:  # the first may lack a class
            values.update(np.unique(read_array(file, series.key)).astype(int).tolist())
    if values <= CLASSES:
        values = CLASSES
    text = ""
    if len(values) == len(CLASSES):
        pairs = zip(sorted(values), sorted(CLASSES), strict=True)
        text = ", ".join(f"{theirs} = {ours}" for theirs, ours in pairs)
    else:
        lines.append(f'# ? they have {sorted(values)}; if of one class: form = "masks"')
    return [*lines, asked, f"classes = {{ {text} }}  # theirs = ours"]


def _brightness(gray: Any, places: Any) -> float:
    """Return the mean grey value at places (n, 2); they lie on bright pixels."""
    inside = ((places >= 0) & (places < gray.shape[:2])).all(axis=1)
    if not inside.all():
        return 0.0
    return gray[tuple(places.T)].mean()
