"""Recordings in films, stacks, pictures, arrays and manifests of other programs.

`open_any` takes

==========================  ========================================================
AVI, MP4, MOV, MKV          decoded by OpenCV, 8 bit; grey of 16 bit whole
TIFF of several pages       axis T of ImageJ and OME, z without time, or pages without a
                            name; channels are refused; sets of OME files
folder or pattern           PNG, TIFF, JPEG, NPY, ... one file a frame:
                            ``film/*.png`` or ``film/a_{frame}_8bit.png``; the
                            frame's number stands at ``{frame}``, or is the last one
                            in the name; or TIFFs with pages, one after the other
NPY, MAT, HDF5              (frame, row, col), also with a last axis of colours
array, or anything indexed  the same, or pictures (row, col) one by one
Zarr                        what ``kilnflight import``, ``export`` or ``run`` wrote
TOML                        a manifest, where depth, labels or metadata come in
==========================  ========================================================

A gap in the numbers is a gap in time; frames of a film have their numbers from time
stamps. Of coloured pictures one channel is read, by
default that which varies most in the first frame. Whole grey
values from 0 to 65535 are taken as they are (8, 10, 12, 16 bit); others, such as floats
from 0 to 1, are scaled linearly to that range, by the least and the largest value of
the recording. `Attributes.notes` says so.

A manifest says what lies where. Patterns are relative to it::

    name = "chips-4.5bar"             # every error names it
    frame_rate_hz = 330.0
    um_per_px = 650.0                 # where particles fly in one plane
    fraction = "wood chip"            # any text
    pressure_bar = 4.5
    lance_mm = [-10.0, 240.0, 8950.0]               # outlet: x, y, z
    roi = [[0, 200], [0, 1800], [1535, 1900], [1535, 100]]     # vertices: row, col
    flame_roi = [900, 1200, 850, 1150]              # row0, row1, col0, col1
    depth_calibration = [[1020, 1000], [2110, 2000]]           # captured, true depth

    [gray]                            # anything that `open_any` takes
    pattern = "gray/frame_{frame:04d}.tif"
    # channel = "red"                 # only of coloured pictures; refused for grey ones

    [coordinates]
    pattern = "xyz/frame_{frame:04d}.mat"
    key = "XYZ"                       # variable or data set, where a file holds several
    form = "grid"                     # (rows, cols, 3) in MAT, HDF5, NPY or TIFF
    invalid = "nan"                   # or a number: the depth of a pixel that has none
    unit = "mm"                       # or "m"

    [labels]                          # PNG, TIFF, NPY, MAT, HDF5
    pattern = "labels/frame_{frame:04d}.png"
    classes = { 0 = 0, 60 = 1, 120 = 2, 180 = 3, 240 = 4 }     # theirs = Table 5.1

Only ``name``, ``frame_rate_hz`` and ``[gray]`` are needed. Coordinates and labels may
cover some frames only. ``{subset}`` in all patterns stands for the name of a subset
(`open_subsets`); where frames are numbered through, ``subsets = { V1 = [1, 10] }``
names the first and the last of each. `kilnflight.recording.survey` drafts a manifest.

===========  ===========  ==========================================================
table        form         each file holds
===========  ===========  ==========================================================
any          ``stack``    grids of all frames, which the last axis counts;
                          ``numbers`` names a variable with their numbers
coordinates  ``grid``     (rows, cols, 3) x, y, z, or a line x y z for each pixel
coordinates  ``points``   lines row col x y z of pixels with depth
coordinates  ``indexed``  (n, 3) x, y, z; ``index`` names what numbers the pixels
coordinates  ``cloud``    lines x y z alone; ``focal_length_px`` finds the pixels
labels       ``grid``     (rows, cols) classes
labels       ``masks``    a picture for each class; ``{class}`` in the pattern
labels       ``table``    lines (frame) row col class of the labelled pixels
===========  ===========  ==========================================================

Text has spaces, tabs, commas or semicolons, and may name its columns in the first line.
``order = "col row"`` if columns come before rows; ``y = "down"`` if y grows downwards;
``z = "back"`` if depths are below 0; ``origin = 1`` if pixels count from 1;
``key = ["X", "Y", "Z"]`` if a file holds these one by one; ``columns = "x y z row col
-"`` if a text has its columns in another order, or more.

Classes of Table 5.1: 0 wall, 1 flame, 2 burning in air, 3 non-burning in air, 4 burning
on the wall. Coordinates, the lance's too, are those of the camera as captured.
``depth_calibration`` makes true depths of them: pairs of captured and true depth in mm,
a fit (``breakpoints_mm``, ``coefficients`` in mm, highest power first),
``"zhang-2023"`` (Eq. 2.4, which holds for that one camera), or ``"none"``, the default.
"""

import hashlib
import math
import mmap
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from kilnflight.arrays import Facts, Flags, Texts, Two
from kilnflight.checks import LARGEST_WHOLE, InputError, check_finite, check_shape
from kilnflight.recording.frames import (
    Attributes,
    Frame,
    Gray,
    check_frame,
    check_position,
    count_frames,
)
from kilnflight.recording.manifest import (
    CLASS,
    FACTS,
    SUBSET,
    FileTable,
    check_keys,
    read_manifest,
)
from kilnflight.recording.readers import (
    Anything,
    Layers,
    PictureFiles,
    find_file,
    find_subsets,
    forget,
    number_files,
    open_images,
)
from kilnflight.recording.store import StoredRecording, open_recording

EVERY = (0, 2**63)  # numbers of frames
CHANNELS = ("red", "green", "blue")
WHITE = 65_535  # largest grey value
MOST_SPAN = 4096  # of spans of values: the usual frame keeps 16 grey values; a choice
FEW = 3  # outermost values of a frame that may be of bad pixels
GIVEN = (*FACTS[:-1], "channel", "mask")  # what may be stated beside a path
SMALL_TYPES = (np.bool_, np.uint8, np.uint16)  # their values are never above it


class Part(NamedTuple):
    """Coordinates or labels: files by number of the frame, and how they are read."""

    kind: str
    files: Mapping[int, Path]
    table: FileTable


@dataclass(frozen=True, eq=False)
class FileRecording:
    """Frames in the files of other programs, or in memory.

    Parameters
    ----------
    attributes
        Facts about the whole recording.
    numbers
        Number of each frame in the files, ascending.
    index
        Number of each frame: ``numbers``, or counted from 0 where those go in longer
        steps.
    images
        Pictures (rows, cols) or (rows, cols, channels), read one by one.
    seen
        (rows, cols) whether a pixel is searched; False: it is masked.
    dtype
        Type of the first picture.
    channel
        Of coloured pictures, one of `CHANNELS`.
    scale
        Value that becomes 0, and grey values per unit; None: whole grey values stay.
    parts
        Coordinates and labels, of the frames that have any, and how grey values are
        read.
    """

    attributes: Attributes
    numbers: Sequence[int] = field(repr=False)
    index: Sequence[int] = field(repr=False)
    images: Any = field(repr=False)
    seen: Flags = field(repr=False)
    dtype: Any = field(repr=False)
    channel: str | None = None
    scale: Two | None = None
    parts: Sequence[Part] = field(default=(), repr=False)

    def __len__(self) -> int:
        return len(self.numbers)

    def gray(self, t: int) -> Gray:
        """Return the grey values (rows, cols) of frame ``t``, counted from 0."""
        check_position(t, len(self), self.attributes.name)
        where = f"recording {self.attributes.name}, frame {self.numbers[t]}"
        mapped = getattr(self.images, "_mmap", None)
        if mapped is not None:  # else all that was read stays in memory
            mapped.madvise(mmap.MADV_DONTNEED)
        image = _one_channel(self.images[t], self.channel, where, self.seen)
        # MATLAB saves each array in the smallest type
        if image.dtype != self.dtype and ".mat" not in f"{self.files[:1]}":
            raise InputError(f"{where}: {image.dtype}, but the first is {self.dtype}.")
        if self.scale is not None:
            low, factor = self.scale
            image = np.rint((image.astype(np.float64) - low) * factor)
        elif image.dtype not in SMALL_TYPES and not _is_whole(image):
            raise InputError(
                f"{where}: its values are not whole numbers from 0 to {WHITE}."
            )
        return np.ascontiguousarray(image, np.uint16)

    def frame(self, t: int) -> Frame:
        """Return frame ``t``, counted from 0, with its points and labels."""
        gray = self.gray(t)
        number = self.numbers[t]
        index = self.index[t]
        time_s = (index - self.index[0]) / self.attributes.frame_rate_hz
        frame = check_frame(
            Frame(index=index, time_s=time_s, gray=gray), self.attributes
        )
        for kind, files, table in self.parts:
            if number in files:
                read = table.read_labels if kind == "labels" else table.read_points
                try:
                    found: Any = read(files[number], gray.shape, number)
                    frame = check_frame(replace(frame, **found), self.attributes)
                except InputError as error:
                    raise InputError(
                        f"{error} See [{kind}] of the manifest: form, unit, invalid, "
                        "order, origin."
                    ) from error
        return frame

    @property
    def labelled(self) -> list[int]:
        """Positions of the frames with labels."""
        known = {n for part in self.parts if part.kind == "labels" for n in part.files}
        return [t for t, number in enumerate(self.numbers) if number in known]

    @property
    def files(self) -> list[Path]:
        """The files of single frames, and a film."""
        files = [*getattr(self.images, "files", ())]
        for _, first, table in self.parts:
            for path in first.values():
                files += table.files(path)
        return files

    def content(self) -> str:
        """Return a hash (12 hex digits) of attributes, tables and frames.

        Of files the names and the bytes count, of arrays in memory the values.
        """
        forget()
        tables = [part.table for part in self.parts]
        stated = f"{self}{self.attributes.stated}{[*self.numbers]}{tables}"
        digest = hashlib.sha256(stated.encode() + self.seen.tobytes())
        if not hasattr(self.images, "files"):
            for t in range(len(self)):
                digest.update(self.gray(t).tobytes())
        for path in dict.fromkeys(self.files):
            with _naming(path), path.open("rb") as file:
                digest.update(path.name.encode())
                digest.update(hashlib.file_digest(file, "sha256").digest())
        return digest.hexdigest()[:12]


def open_any(source: Any, **stated: Any) -> FileRecording | StoredRecording:
    """Open a recording of any kind.

    Parameters
    ----------
    source
        Path of a film, stack, folder, pattern, array, Zarr recording or manifest; or an
        array (frame, row, col), with colours (frame, row, col, 3); or anything
        indexable of pictures.
    **stated
        Attributes that a manifest may state, in place of what the files do, such as
        ``frame_rate_hz=50.0`` and ``um_per_px=0.65``. ``channel``: ``"red"``, green or
        blue of coloured pictures; by default that which varies most. ``mask``: picture
        (rows, cols); where it is 0, nothing is searched, nor where the first frame is
        NaN. Zarr recordings and manifests state all this; with them it is refused.

    Returns
    -------
    FileRecording or StoredRecording
        Frames are read when they are needed. An open recording is returned as it is.

    Raises
    ------
    InputError
        If it cannot be read; the message names the file or the frame.

    Examples
    --------
    >>> recording = open_any(np.linspace(0, 1, 3)[:, None, None] * np.ones((24, 32)))
    >>> len(recording), int(recording.gray(1)[0, 0])
    (3, 32768)
    """
    if hasattr(source, "attributes"):  # open already
        return source
    given = {name: value for name, value in stated.items() if value is not None}
    check_keys(given, known=GIVEN)
    if isinstance(source, str | Path):
        return _open_path(Path(source), given)
    indexed = hasattr(source, "__len__") and hasattr(source, "__getitem__")
    if not indexed or hasattr(source, "keys") or not getattr(source, "shape", True):
        raise InputError(
            f"source: {type(source).__name__} is no path and no array of frames."
        )
    return _recording(source, range(len(source)), {"name": "array"} | given)


def _open_path(path: Path, given: Facts) -> FileRecording | StoredRecording:
    is_manifest = path.suffix.lower() == ".toml"
    is_stored = (path / "zarr.json").is_file()
    if given and (is_manifest or is_stored):
        raise InputError(
            f"{path}: leave out {', '.join(given)}; it states that itself."
        )
    if is_manifest:
        return _open_manifest(path)
    is_pattern = re.search(r"[*?{\[]", str(path))
    if is_stored or not (path.exists() or is_pattern):
        return open_recording(path)  # raises the error where there is nothing
    folder = path if path.is_dir() else path.parent
    name = path.stem if path.is_file() else folder.resolve().name
    images, numbers, stated = open_images(str(path), Path())
    return _recording(images, numbers, {"name": name} | stated | given)


def _open_manifest(path: Path) -> FileRecording:
    with _naming(path):
        facts, tables = read_manifest(path)
        if SUBSET in tables["gray"].pattern:
            names = ", ".join(find_subsets(tables["gray"].pattern, path.parent))
            raise InputError(f"it has subsets. Write one of {names} for {SUBSET}.")
        facts.pop("subsets", None)
        return _put_together(path.parent, facts, tables)


def open_subsets(path: Path | str) -> dict[str, FileRecording]:
    """Open the subsets of a manifest, whose patterns hold ``{subset}``, by name.

    A manifest without subsets has one, under its own name. Errors are those of
    `open_any`.
    """
    path = Path(path)
    with _naming(path):
        facts, tables = read_manifest(path)
        pattern = tables["gray"].pattern
        spans = facts.pop("subsets", {})
        if SUBSET in pattern:
            spans = dict.fromkeys(find_subsets(pattern, path.parent), EVERY)
            for kind, table in tables.items():
                if SUBSET not in table.pattern:
                    told = f"all subsets would share it. Add {SUBSET}."
                    raise InputError(f"[{kind}]: {told}")
        recordings = {}
        for name, span in (spans or {facts["name"]: EVERY}).items():
            own = {kind: table.of_subset(name) for kind, table in tables.items()}
            facts["name"] = name
            recordings[name] = _put_together(path.parent, facts, own, span)
        return recordings


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Raise errors of a manifest as an `InputError` that names it."""
    try:
        yield
    # Not there, no text or TOML, nested too deep, a value of a wrong type.
    except (OSError, TypeError, ValueError, RecursionError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: {reason}") from error


def _put_together(
    folder: Path,
    facts: Facts,
    tables: Mapping[str, FileTable],
    span: Sequence[int] = EVERY,
) -> FileRecording:
    """Return the recording of a manifest's tables, whose files are in a folder.

    ``span`` are the first and the last number of its frames.
    """
    forget()
    least, most = span
    others = dict(tables)
    gray = others.pop("gray")
    facts = facts | {"channel": gray.channel}
    if gray.form == "stack":
        file = find_file(gray.pattern, folder)
        images: Any = Layers([file], gray.key)
        numbers: Sequence[int] = gray.read_numbers(file)
    else:
        images, numbers, stated = open_images(gray.pattern, folder, gray.key)
        facts = stated | facts
        if type(images) is PictureFiles:
            kept = [k for k, number in enumerate(numbers) if least <= number <= most]
            images = PictureFiles([images.files[k] for k in kept], gray.key)
            numbers = [numbers[k] for k in kept]
    parts = [Part("gray", {}, gray)]
    for kind, table in others.items():
        files = _files_of(table, folder)
        files = {n: path for n, path in files.items() if least <= n <= most}
        extra = files.keys() - set(numbers)
        if extra:
            raise InputError(
                f"{files[min(extra)]} is of frame {min(extra)}, without gray."
            )
        parts.append(Part(kind, files, table))
    return _recording(images, numbers, facts, parts)


def _files_of(table: FileTable, folder: Path) -> dict[int, Path]:
    """Return the file of each frame of a table; of masks those of the first class."""
    if table.form == "stack":
        file = find_file(table.pattern, folder)
        return dict.fromkeys(table.read_numbers(file), file)
    if table.form == "table" and "{frame" not in table.pattern:
        file = find_file(table.pattern, folder)
        listed = table.read_table(file)["frame"].unique()
        return dict.fromkeys(map(int, listed), file)
    words = table.classes or [""]
    named = [table.pattern.replace(CLASS, word) for word in words]
    found = [number_files(each, folder) for each in dict.fromkeys(named)]
    for masks in found:
        lost = masks.keys() ^ found[0].keys()
        if lost:
            raise InputError(f"[labels]: masks of frame {min(lost)} are lost.")
    return found[0]


def _recording(
    images: Any,
    numbers: Sequence[int],
    facts: Facts,
    parts: Sequence[Part] = (),
) -> FileRecording:
    """Return the recording of some images; the first decides size, channel and mask.

    ``facts`` are attributes, and channel, mask and length.
    """
    found: Facts = {"frame_rate_hz": 1.0, "timed": "frame_rate_hz" in facts} | facts
    where = f"recording {found['name']}"
    if not numbers:
        raise InputError(f"{where}: it has no frames.")
    first = np.asarray(images[0])
    channel, told = _choose_channel(first, found.pop("channel", None), where)
    notes = [*found.pop("notes", ()), *told]
    index, step = count_frames(numbers)
    if step != 1:
        notes.append(f"numbers go in steps of {step:g}: frames are counted from 0")
    length = max(index[-1] - index[0] + 1, found.pop("length", 0))
    if length > len(index):
        notes.append(f"{length - len(index)} of {length} frames are missing")
    first = _one_channel(first, channel, f"{where}, frame {numbers[0]}")
    seen = ~np.isnan(first)
    mask = found.pop("mask", None)
    if mask is not None:
        seen &= _one_channel(mask, "red", "mask", seen) != 0
    if not seen.any():
        raise InputError(f"{where}: every pixel is masked or NaN.")
    if not seen.all():
        notes.append(f"masked: {(~seen).mean():.3g} of the picture is not searched")
    scale = None
    if first.dtype not in SMALL_TYPES or first.max() <= 1:
        places = [f"{where}, frame {number}" for number in numbers]
        pictures = (
            _one_channel(images[t], channel, place, seen)
            for t, place in enumerate(places)
        )
        scale, told = _choose_scale(pictures, places)
        notes += told
    found["rows"], found["columns"] = first.shape
    return FileRecording(
        attributes=Attributes.from_json(found | {"notes": notes}),
        numbers=numbers,
        index=index,
        images=images,
        channel=channel,
        scale=scale,
        seen=seen,
        dtype=first.dtype,
        parts=parts,
    )


def _choose_channel(
    image: Anything, channel: str | None, where: str
) -> tuple[str | None, list[str]]:
    """Return the channel of a recording, and a note if it was not named."""
    if channel is not None:
        if image.ndim != 3 or channel not in CHANNELS[: image.shape[2]]:
            raise InputError(
                f"{where}: it has no channel {channel!r}. Leave it out, or name a "
                "colour."
            )
        return channel, []
    if not _is_coloured(image):
        return None, []
    varied = CHANNELS[image[..., :3].std(axis=(0, 1)).argmax()]
    return varied, [f"coloured pictures: channel {varied}, which varies most, is used"]


def _is_coloured(image: Anything) -> bool:
    return image.ndim == 3 and bool((image[..., :3] != image[..., :1]).any())


def _choose_scale(
    pictures: Iterable[Anything], places: Texts
) -> tuple[Two | None, list[str]]:
    """Return the scale of a recording, and a note; None where whole values stay.

    Raises an `InputError` if a few values, but for which frames span much less, would
    make the others one grey value.
    """
    ends = []
    spans = []
    whole = True
    for image in pictures:
        ends.append((float(image.min()), float(image.max())))
        usual = np.partition(image.ravel(), [FEW, -1 - FEW])
        spans.append(float(usual[-1 - FEW]) - float(usual[FEW]))
        whole = whole and _is_whole(image)
    low = min(ends)[0]
    high = max(end for _, end in ends)
    if whole and high != 1:
        return None, []
    varied = [span for span in spans if span > 0] or [math.inf]
    if high - low > MOST_SPAN * np.quantile(varied, 0.9, method="lower"):
        worst = np.ptp(ends, axis=1).argmax()
        raise InputError(
            f"{places[worst]}: values from {low:g} to {high:g}, beside which most are "
            "one grey value. Clip the outermost, or mask their pixels."
        )
    scale = (low, WHITE / ((high - low) or 1.0))
    return scale, [f"grey values: {low:g} to {high:g} are scaled to 0 to {WHITE}"]


def _is_whole(image: Anything) -> bool:
    """Return whether all values are whole numbers of 16 bits."""
    return image.min() >= 0 and image.max() <= WHITE and not (image % 1).any()


def _one_channel(
    image: Any, channel: str | None, where: str, seen: Flags | None = None
) -> Anything:
    """Return one channel of a picture, or raise an `InputError`.

    With ``seen`` it is finite and as large: what is masked gets the median of the rest.
    """
    array = np.asarray(image)
    if array.ndim == 3 and array.shape[2] <= 4:
        if channel is None and _is_coloured(array):
            raise InputError(f"{where}: coloured, as the first is not. Name a channel.")
        array = array[..., CHANNELS.index(channel or "red")]
    usable = (
        array.ndim == 2
        and array.shape[1] > 4  # else it is a row of one coloured picture
        and array.size
        and array.dtype.kind in "buif"
        and not np.ma.isMaskedArray(image)
    )
    if not usable:
        kind = f"{array.dtype} of shape {np.shape(image)}"
        raise InputError(f"{where}: {kind}. Give pictures (rows, cols), a mask apart.")
    array = array.astype(array.dtype.newbyteorder("="))
    if seen is None:
        return array
    check_shape(array, seen.shape, where)
    if not seen.all():
        array[~seen] = np.quantile(array[seen], 0.5, method="lower")
    if array.dtype.kind == "f":
        check_finite(array, where)
    elif array.itemsize == 8:
        check_finite(array, where, most=LARGEST_WHOLE)
    return array
