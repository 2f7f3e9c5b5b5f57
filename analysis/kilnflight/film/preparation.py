"""Options and recording -> `Chain`, with all settings, warnings and notes for the
reader.

`choose` estimates from some frames what is not given; `prepare` adds lance and wall.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from kilnflight import chain
from kilnflight.arrays import Array, Single
from kilnflight.background import BackgroundModel
from kilnflight.chain import Vector
from kilnflight.checks import InputError
from kilnflight.detection import DBSCAN, DoG, Otsu
from kilnflight.detection.combination import Combination, Planar
from kilnflight.detection.wall import Cylinder, InAir, fit_cylinder
from kilnflight.film.motion import more_rests, shaken_px
from kilnflight.film.noise import block_noise, pixel_noise
from kilnflight.film.settings import BACKGROUNDS, Options
from kilnflight.recording.files import WHITE
from kilnflight.recording.frames import (
    Attributes,
    Frame,
    Gray,
    Recording,
    calibrated_cloud,
)
from kilnflight.recording.store import StoredRecording
from kilnflight.tracking.tracker import Management

Rows = list[
    tuple[str, str]
]  # name of a setting, or "note"; value and why, for the reader
EXPLAINED = ("in_air_mm", "background", "threshold", "post_processing")  # or not used
SHAKEN = "The picture shakes by {:.1f} px a frame: edges may count as particles. Register it first."
LONG = "Areas have a radius of {:.1f} px, round spots {:.1f} px: try --detector otsu, by preview."
NO_LANCE = "unknown, so there are no flights; a manifest has lance_mm"
RESTING = (
    "{} of {} spots stay in place and count as background; --background none keeps them"
)
REASON = (
    "from the noise",
    "from the noise, at least that of the thesis",
)  # without, with depth
# grey values, of the finest difference of Gaussians; made-up pictures have none
LEAST_NOISE = 0.1
MIDDLE_PX = (
    2048,
    3072,
)  # rows and columns of the enlarged picture in which settings are tried
FEW_FRAMES = 5  # a median of fewer shows the particles themselves


@dataclass(frozen=True)
class Prepared:
    """A recording whose dark particles become bright, whose light becomes even, or cut
    to a part.

    It is a `kilnflight.chain.Source`, identified by its content and not by its place.

    Parameters
    ----------
    original
        The recording.
    content
        Its `StoredRecording.content`, where tables are stored.
    dark
        Whether grey values are inverted.
    level
        Median grey value that every frame is brought to; None: frames stay.
    roi
        First row, row after the last, first column, column after the last; None: all.
    """

    original: Recording = field(repr=False, compare=False)
    content: str = ""
    dark: bool = False
    level: float | None = None
    roi: tuple[int, int, int, int] | None = None

    @property
    def name(self) -> str:
        """Name of the recording."""
        return self.original.attributes.name

    @property
    def attributes(self) -> Attributes:
        """Facts about the recording."""
        if self.roi is None:
            return self.original.attributes
        top, bottom, left, right = self.roi
        corners = ((top, left), (top, right), (bottom, right), (bottom, left))
        return replace(self.original.attributes, roi=corners)

    def __len__(self) -> int:
        return len(self.original)

    def recording(self) -> Recording:
        """Return the recording, changed."""
        return self

    def gray(self, t: int) -> Gray:
        """Return the grey values (rows, cols) of frame ``t``."""
        return self._changed(self.original.gray(t))

    def frame(self, t: int) -> Frame:
        """Return frame ``t``, its grey values changed."""
        frame = self.original.frame(t)
        return replace(frame, gray=self._changed(frame.gray))

    def _changed(self, gray: Gray) -> Gray:
        if self.level is not None:
            even = gray * (self.level / max(level_of(gray), 1.0))
            gray = np.minimum(np.rint(even), WHITE).astype(np.uint16)
        return np.subtract(WHITE, gray, dtype=np.uint16) if self.dark else gray


def choose(
    recording: Recording, options: Options
) -> tuple[chain.DetectionRun, Options, Rows]:
    """Return how a recording is detected: what is given, and else what the frames tell.

    Recordings with depth are taken as the thesis takes them: median, combined detector
    and at least its threshold (section 5.1.2), which is scaled by the brightest pixel.
    The options come back with background and threshold.

    Raises
    ------
    InputError
        If frames or region are not in the recording.
    """
    options.check(recording)
    length = len(recording)
    attributes = recording.attributes
    areas = options.detector == "otsu"
    start, stop = options.frames or (0, length)
    deep = any(len(recording.frame(t).pixels) for t in spread(length, 5))
    level = None if deep else mean_level(recording)
    content = recording.content() if isinstance(recording, StoredRecording) else ""
    seen = Prepared(recording, content, options.dark, level, options.roi)
    rows = [
        ("recording", attributes.name),
        *(("note", note) for note in attributes.notes),
    ]
    rows += [
        (k, f"{v}")
        for k, v in asdict(options).items()
        if v and k not in EXPLAINED[deep:]
    ]
    look = cache(lambda word: sample(seen, BACKGROUNDS[word]))
    spots = cache(lambda word, times: _spots(look(word), times))
    word = options.background
    why = "given"
    if word is None:
        rest = length < FEW_FRAMES or (
            not deep and more_rests(*(spots(w, 2) for w in BACKGROUNDS))
        )
        word, why = ("none", "most rests") if rest else ("median", "most moves")
        why = why if length >= FEW_FRAMES else f"only {length} frame(s)"
        moving, every = (sum(map(len, spots(each, 2))) for each in BACKGROUNDS)
        if word == "median" and not deep and every > 1.25 * moving:
            rows.append(("note", RESTING.format(every - moving, every)))
    rows.append(("background", f"{word} ({why})"))
    if level is not None:
        rows.append(
            ("light", f"every frame brought to a median of {level:g} grey values")
        )
    enlarge = 1
    size = options.size
    if size is not None:
        enlarge = 4 if size < 4 else 2 if size < 8 else 1
    elif not (deep or areas):
        one, two, four = (sum(map(len, spots(word, times))) for times in (1, 2, 4))
        enlarge = (
            4
            if four > 2 * max(one, two)
            else 2
            if two > 1.4 * one or options.small
            else 1
        )
        rows.append(
            (
                "enlarged",
                f"{enlarge} times (spots: {one}, 2 times {two}, 4 times {four})",
            )
        )
    if not (deep or areas):
        rows += [
            ("warning", doubt)
            for doubt in _doubts(seen, look(word), spots(word, enlarge))
        ]
    threshold, why = (
        options.threshold or 0.0,
        "given" if options.threshold else REASON[deep],
    )
    if not threshold:
        threshold = (
            area_threshold(seen) if areas else noise_threshold(look(word), enlarge)
        )
        threshold = max(
            threshold, deep * DoG().threshold * float(seen.gray(start).max()) / WHITE
        )
    rows.append(("threshold", f"{threshold:g} grey values ({why})"))
    single: DoG | Otsu = Otsu(threshold) if areas else DoG(threshold, enlarge=enlarge)
    detector = Combination(single) if deep else Planar(single, size)
    # Eight chunks show progress; below 25 frames the background's window outweighs a
    # chunk.
    part = min(chain.CHUNK_FRAMES, max(25, -(-(stop - start) // 8)))
    run = chain.DetectionRun(
        seen, start, stop, detector, BACKGROUNDS[word], part, Path()
    )
    return run, replace(options, background=word, threshold=threshold), rows


def prepare(
    stored: StoredRecording, target: Path, options: Options
) -> tuple[chain.Chain, Rows]:
    """Return the run of a stored recording, and its settings.

    Its motion is that of the kiln.
    """
    detection, _, rows = choose(stored, options)
    detection = replace(detection, folder=target.absolute() / "parts")
    lance, wall = _geometry(stored, rows)
    joined = (
        lance is not None
        if options.post_processing is None
        else options.post_processing
    )
    rows.append(
        ("post-processing", "as in chapter 4.2 of the thesis" if joined else "none")
    )
    run = chain.Chain(
        detection, lance, wall, InAir(options.in_air_mm), post_processing=joined
    )
    return replace(run, management=Management(invisible=options.memory)), rows


def spread(length: int, number: int) -> list[int]:
    """Return ``number`` indices, or all, spread evenly over a length."""
    return np.unique(np.linspace(0, length - 1, number).round().astype(int)).tolist()


def sample(recording: Recording, background: BackgroundModel) -> list[Single]:
    """Return the foregrounds (rows, cols) of five frames of the median's first window."""
    frames = spread(min(len(recording), 150), 5)
    return [view.foreground for _, view in chain.views(recording, frames, background)]


def noise_threshold(foregrounds: Sequence[Single], enlarge: int = 1) -> float:
    """Return a threshold of DoG in grey values, five times the noise.

    Notes
    -----
    The thesis tunes its threshold on labelled frames; without labels only noise is
    known. The finest difference of Gaussians is measured in five frames, in small
    blocks. The median of its absolute value, times 1.4826, is the standard deviation of
    Gaussian noise; particles cover too little of a block to change it. Noise grows with
    light, so the 90 % quantile over blocks counts, and the median over frames. Five
    times the noise bounds its false alarms. Flicker of a flame is not noise of a pixel;
    a higher threshold may be better there.
    """
    noise = np.median(
        [block_noise(_middle(each, enlarge), enlarge) for each in foregrounds]
    )
    return float(f"{5.0 * max(float(noise), LEAST_NOISE):.3g}")


def area_threshold(recording: Recording) -> float:
    """Return a threshold of areas in grey values, four times the noise of a pixel."""
    noise = [float(pixel_noise(recording.gray(t))) for t in spread(len(recording), 5)]
    return float(f"{max(4 * np.median(noise), 1.0):.3g}")


def mean_level(recording: Recording) -> float | None:
    """Return the level of the light if it changes by more than 1 % over the frames,
    else None.
    """
    levels = [level_of(recording.gray(t)) for t in spread(len(recording), 30)]
    return mean if np.std(levels) > 0.01 * (mean := float(np.mean(levels))) else None


def level_of(gray: npt.NDArray[Any]) -> float:
    """Return the median grey value of every fourth pixel of every fourth row."""
    return float(np.median(gray[::4, ::4]))


def _doubts(
    seen: Recording, looks: Sequence[Single], spots: Sequence[Array]
) -> Iterator[str]:
    """Yield warnings on frames that shake and on particles that are no round spots.

    In a short film slow particles look like a ground that shakes.
    """
    # known from 15 frames and px; above 0.5 px edges of a textured ground stand out
    if min(len(seen), *seen.attributes.size) >= 15 and (shake := shaken_px(seen)) > 0.5:
        yield SHAKEN.format(shake)
    areas = list(map(Otsu(area_threshold(seen)), (_middle(each, 2) for each in looks)))
    radii = [np.median([0.0, *np.concatenate(found)[:, 2]]) for found in (areas, spots)]
    if radii[0] > 1.5 * radii[1]:
        yield LONG.format(*radii)


def _spots(foregrounds: Sequence[Single], enlarge: int) -> list[Array]:
    """Return row, col, radius and strength (n, 4) of the spots in the middle of
    pictures.
    """
    detector = DoG(noise_threshold(foregrounds, enlarge), enlarge=enlarge)
    return [detector.graded(_middle(each, enlarge)) for each in foregrounds]


def _middle(picture: Single, enlarge: int) -> Single:
    """Return the middle of a picture that is `MIDDLE_PX` at most when enlarged."""
    rows, cols = (most // enlarge for most in MIDDLE_PX)
    top = max(picture.shape[0] - rows, 0) // 2
    left = max(picture.shape[1] - cols, 0) // 2
    return np.ascontiguousarray(picture[top : top + rows, left : left + cols])


def _geometry(
    recording: StoredRecording, rows: Rows
) -> tuple[Vector | None, Cylinder | None]:
    """Return outlet of the lance and wall, None if unknown; add to the settings."""
    deep = np.flatnonzero(recording.per_frame["points"])
    lance = recording.attributes.exit_point_mm
    if not len(deep):
        return None, None
    rows.append(
        ("lance", f"{np.round(lance, 1)} mm, depth calibrated" if lance else NO_LANCE)
    )
    try:
        wall = fitted_wall(recording, deep[spread(len(deep), 5)].tolist())
    except InputError as error:
        rows.append(
            (
                "note",
                f"no flights, no wall was found: {error} What lies on it is tracked.",
            )
        )
        return lance, None
    axis = f"{np.round(wall.centre_mm)} mm, {np.round(wall.direction, 4)}"
    rows.append(("kiln", f"radius {wall.radius_mm:.0f} mm, axis {axis}"))
    return lance, wall


def fitted_wall(recording: Recording, frames: Sequence[int]) -> Cylinder:
    """Return the cylinder of the largest cluster in the clouds of some frames.

    Sections 3.1 and 3.2 of the thesis. Together the clouds make a still wall denser
    than what flies.
    """
    points = np.concatenate([calibrated_cloud(recording, t) for t in frames])
    labels = DBSCAN(eps=50.0, min_points=10)(points)  # wall pass, sec. 5.1.3
    if not (labels >= 0).any():
        raise InputError(f"{len(points)} points make no cluster.")
    return fit_cylinder(points[labels == np.bincount(labels[labels >= 0]).argmax()])
