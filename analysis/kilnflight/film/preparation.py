"""Options and recording -> `Chain`, with what a reader is told of the settings.

`choose` estimates from some frames what is not given; `prepare` adds lance and wall.
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from functools import cache, partial
from pathlib import Path

import numpy as np
from pandas import DataFrame

from kilnflight import chain
from kilnflight.arrays import Array, Single
from kilnflight.chain import Vector
from kilnflight.checks import InputError
from kilnflight.detection import DoG, Otsu
from kilnflight.detection.combination import (
    WALL_PASS,
    Combination,
    Planar,
    largest_cluster,
)
from kilnflight.detection.wall import Cylinder, InAir, fit_cylinder
from kilnflight.film.motion import more_rests, shaken_px
from kilnflight.film.noise import (
    area_threshold,
    middle,
    noise_threshold,
    spot_detector,
)
from kilnflight.film.prepared import Kept, Prepared, mean_level, spread
from kilnflight.film.report import Printed, Rows
from kilnflight.film.settings import BACKGROUNDS, Background, Options
from kilnflight.recording.files import WHITE, open_any
from kilnflight.recording.frames import Recording, calibrated_cloud
from kilnflight.recording.store import StoredRecording
from kilnflight.store.cache import CachedTable
from kilnflight.store.parallel import Workers
from kilnflight.tracking.tracker import Management

EXPLAINED = {"background", "threshold", "post_processing"}  # by `choose` itself
SHAKEN = (
    "The picture shakes by {:.1f} px a frame: edges may count as particles. "
    "Register it first."
)
LONG = (
    "Areas have a radius of {:.1f} px, round spots {:.1f} px: "
    "try --detector otsu, by preview."
)
NO_LANCE = "unknown, so there are no flights; a manifest has lance_mm"
RESTING = (
    "most moves; {} of {} spots stay in place and count as background; --background "
    "none keeps them"
)
COUNTS = (
    "{}, {}, {} and {} at half, once, twice and four times the threshold (inverted "
    "film: {}, {}, {} and {})"
)
LOOSE = (
    "Twice the threshold leaves {} of {} spots: it decides what is found. Spots of the "
    "inverted film are noise, or darker particles. Compare `kilnflight preview`."
)
DARKER = (
    "Inverted, the film shows stronger spots: are particles darker than the ground? "
    "Then --dark; else leave it out."
)
LARGE = (
    "Four times its size would take long, so the film is searched at twice its size. "
    "--size 3 finds the smaller spots, too."
)
STEPS = (0.5, 1.0, 2.0, 4.0)  # multiples of the threshold
TRIED = 150  # frames at the start, and rows and columns, that settings are tried on
MIDDLE_PX = (512, 768)
MOST_PX = 4_200_000  # of a picture that is enlarged four times
NARROW_PX = 3.2  # enlarged radius; below it some simulated spots are missed
LOOKS = 3  # frames of those, that are looked at
PLAIN = 1.25  # threshold over that with a median, up to which ground is plain; choice
_ONE = Workers()
FEW = 10  # spots that tell nothing
FEW_FRAMES = 5  # a median of fewer shows the particles themselves
LEAST_SHAKEN = 15  # frames and px; in a shorter film slow particles look like shaking
SHAKEN_PX = 0.5  # above it edges of a textured ground stand out

Told = Iterator[tuple[str, str]]  # what a row is, and its text


class Looks:
    """`LOOKS` frames as they look over each background; each look is made once.

    Parameters
    ----------
    seen
        Recording on which settings are tried.
    inverse
        Looks of the inverted recording, which has the noise without the particles.
    """

    def __init__(self, seen: Recording, inverse: "Looks | None" = None) -> None:
        self.seen = seen
        self.inverse = inverse or Looks(Prepared(seen, dark=True), self)
        self.foregrounds = cache(self._foregrounds)
        self.threshold = cache(self._threshold)
        self.spots = cache(self._spots)

    def _foregrounds(self, background: str) -> list[Single]:
        """Return the foregrounds (rows, cols) in the median's first window."""
        frames = spread(min(len(self.seen), TRIED), LOOKS)
        views = chain.views(self.seen, frames, BACKGROUNDS[background])
        return [view.foreground for _, view in views]

    def _threshold(self, background: str, enlarge: int) -> float:
        """Return the threshold of spots in grey values, from the noise."""
        inverted = self.inverse.foregrounds(background)
        return noise_threshold(self.foregrounds(background), enlarge, inverted)

    def _spots(self, background: str, enlarge: int) -> list[Array]:
        """Return row, col, radius and strength (n, 4) of the spots of each frame."""
        single = spot_detector(self.threshold(background, enlarge), enlarge)
        return [single.graded(each) for each in self.foregrounds(background)]

    def count(self, background: str, enlarge: int) -> int:
        """Return the number of spots of `spots`."""
        return sum(map(len, self.spots(background, enlarge)))


def choose(recording: Recording, options: Options, rows: Rows) -> chain.DetectionRun:
    """Return how a recording is detected: what is given, else what the frames tell.

    Each setting is added to ``rows`` when it is chosen.

    Recordings with depth are taken as the thesis takes them: median, combined detector
    and at least its threshold (section 5.1.2), which is scaled by the brightest pixel.

    Raises
    ------
    InputError
        If frames or region are not in the recording.
    """
    options.check(recording)
    deep = any(len(recording.frame(t).pixels) for t in spread(len(recording), 5))
    content = ""
    if isinstance(recording, StoredRecording):
        content = recording.content()
    level = None
    if not deep:  # the light of depth's stays as it is
        recording = Kept(recording)
        level = mean_level(recording)
    seen = Prepared(recording, content, options.dark, level, options.roi)
    rows.extend(_given(recording, options, deep))
    looks = Looks(seen)
    if not deep:
        tried = [
            middle(seen.gray(t), MIDDLE_PX).copy() for t in range(min(len(seen), TRIED))
        ]
        looks = Looks(open_any(np.stack(tried)))
        rows.append(("tried on", f"the middle {looks.seen.attributes.size} px"))
    background, reason = choose_background(looks, options, deep)
    rows.append(("background", f"{background} ({reason})"))
    if level is not None:
        told = f"every frame brought to a median of {level:g} grey values"
        rows.append(("light", told))
    enlarge = 1
    planar = not deep and options.detector == "dog"
    if options.size is not None:
        enlarge = _enlarged_for(options.size)
    elif planar:
        enlarge, reason = choose_enlargement(looks, background)
        rows.append(("enlarged", reason))
        if enlarge > 2 and np.prod(recording.attributes.size) > MOST_PX:
            enlarge = 2
            rows.append(("warning", LARGE))
    threshold, reason = choose_threshold(looks, background, enlarge, options, deep)
    rows.append(("threshold", f"{threshold:g} grey values ({reason})"))
    spots = spot_detector(threshold, enlarge)
    if planar:
        rows.extend(_found(looks, background, spots))
        rows.extend(_doubts(looks, background, enlarge))
    return _detection(seen, options, background, spots, deep)


def _given(recording: Recording, options: Options, deep: bool) -> Rows:
    """Return what is told of the recording, and the options that were given."""
    attributes = recording.attributes
    rows = [("recording", attributes.name)]
    rows += [("note", note) for note in attributes.notes]
    given = asdict(options)
    if not deep:
        del given["in_air_mm"]  # it says something only of depth
    for name, value in given.items():
        if value and name not in EXPLAINED:
            rows.append((name, f"{value}"))
    return rows


def choose_background(
    looks: Looks, options: Options, deep: bool
) -> tuple[Background, str]:
    """Return the background that shows most particles, and why.

    It is "median" or "none".
    """
    if options.background is not None:
        return options.background, "given"
    frames = len(looks.seen)
    if frames < FEW_FRAMES:
        return "none", f"only {frames} frame(s)"
    if deep:
        return "median", "as in the thesis"
    times = 2
    if looks.count("none", 4) > 2 * looks.count("none", times):  # they are small
        times = 4
    if more_rests(looks.spots("median", times), looks.spots("none", times)):
        return "none", "most rests"
    moving = looks.count("median", times)
    every = looks.count("none", times)
    if every > 1.25 * moving + FEW:
        return "median", RESTING.format(every - moving, every)
    plain, cleared = (looks.threshold(each, times) for each in ("none", "median"))
    if min(moving, every) > LOOKS / 2 and plain <= PLAIN * cleared:
        return "none", "the ground is plain"
    return "median", "most moves"


def choose_enlargement(looks: Looks, background: Background) -> tuple[int, str]:
    """Return at how many times its size a picture shows most spots, and the counts."""
    one, two, four = (looks.count(background, times) for times in (1, 2, 4))
    if four > 2 * max(one, two, 1):
        enlarge = 4
    elif not one or two > 1.4 * one:
        enlarge = 2
    else:
        enlarge = 1
    radius = _median_radius(looks.spots(background, enlarge))
    if 0 < enlarge * radius < NARROW_PX:
        enlarge = min(2 * enlarge, 4)
    return enlarge, f"{enlarge} times (spots: {one}, 2 times {two}, 4 times {four})"


def _enlarged_for(diameter_px: float) -> int:
    """Return at how many times its size a picture is searched for a diameter."""
    if diameter_px < 4:
        return 4
    if diameter_px < 8:
        return 2
    return 1


def choose_threshold(
    looks: Looks, background: str, enlarge: int, options: Options, deep: bool
) -> tuple[float, str]:
    """Return the threshold in grey values, and where it is from."""
    if options.threshold is not None:
        return options.threshold, "given"
    if options.detector == "otsu":
        threshold = area_threshold(looks.seen)
    else:
        threshold = looks.threshold(background, enlarge)
    if not deep:
        return threshold, "from the noise"
    start = (options.frames or (0,))[0]
    brightest = float(looks.seen.gray(start).max())
    least = DoG.threshold * brightest / WHITE
    return max(threshold, least), "from the noise, at least that of the thesis"


def _detection(
    seen: Prepared, options: Options, background: Background, spots: DoG, deep: bool
) -> chain.DetectionRun:
    """Return the detection of a recording, without a folder.

    ``spots`` has the threshold, of areas, too.
    """
    single: DoG | Otsu = spots
    if options.detector == "otsu":
        single = Otsu(spots.threshold)
    detector: Combination | Planar = Planar(single, options.size)
    if deep:
        detector = Combination(single)
    frames = range(*(options.frames or (0, len(seen))))
    return chain.DetectionRun(
        source=seen,
        frames=frames,
        detector=detector,
        background=BACKGROUNDS[background],
        chunk=chain.CHUNK_FRAMES,
        folder=Path(),
    )


def _found(looks: Looks, background: Background, single: DoG) -> Told:
    """Yield the numbers of spots at several thresholds, and what they make doubtful.

    Spots of the inverted frames are noise, or particles that are darker.
    """
    levels = single.threshold * np.array(STEPS)
    lowest = replace(single, threshold=levels[0])
    counts = []
    for side in (looks, looks.inverse):
        graded = [lowest.graded(each)[:, 3] for each in side.foregrounds(background)]
        counts += [np.sum(np.concatenate(graded) >= level) for level in levels]
    yield "spots", COUNTS.format(*counts)
    if counts[1] > FEW and 2 * counts[2] < counts[1]:
        yield "warning", LOOSE.format(counts[2], counts[1])


def _doubts(looks: Looks, background: Background, enlarge: int) -> Told:
    """Yield warnings on dark particles, frames that shake and what is no round spot."""
    bright, dark = (
        np.concatenate(each.spots("none", 2))[:, 3] for each in (looks, looks.inverse)
    )
    if len(dark) > FEW and dark.sum() > 2 * bright.sum():
        yield "warning", DARKER
    seen = looks.seen
    if min(len(seen), *seen.attributes.size) >= LEAST_SHAKEN:
        shake = shaken_px(seen)
        if shake > SHAKEN_PX:
            yield "warning", SHAKEN.format(shake)
    by_area = Otsu(area_threshold(seen))
    areas = [*map(by_area, looks.foregrounds(background))]
    area = _median_radius(areas)
    spot = _median_radius(looks.spots(background, enlarge))
    if sum(map(len, areas)) > FEW and area > 1.5 * spot:
        yield "warning", LONG.format(area, spot)


def _median_radius(found: Sequence[Array]) -> float:
    """Return the median radius in px of all found, row, col and radius (n, 3 or 4)."""
    return np.median([0.0, *np.concatenate(found)[:, 2]])


def chunk_frames(frames: int, workers: Workers) -> DataFrame:
    """Return the frames of a chunk, as a table: all workers get as many chunks.

    A worker gets as few chunks as `chain.CHUNK_FRAMES` allows; eight in all at least
    show progress. Each reads the median's window, so none has fewer than 32 frames.
    """
    count = workers.number()
    each = np.ceil(max(8, frames / chain.CHUNK_FRAMES) / count)
    chunk = max(32, int(np.ceil(frames / (each * count))))
    return DataFrame({"frames": [min(chunk, chain.CHUNK_FRAMES)]})


def prepare(
    stored: StoredRecording, target: Path, options: Options, workers: Workers = _ONE
) -> tuple[chain.Chain, Rows]:
    """Return the run of a stored recording, and its settings, which are printed.

    Its motion is that of the kiln. A run that goes on keeps the chunks that it began
    with, whatever the number of ``workers`` is now.
    """
    rows = Printed()
    found = choose(stored, options, rows)
    lance, wall = _geometry(stored, rows)
    joined = options.post_processing
    if joined is None:
        joined = lance is not None
    how = "none"
    if joined:
        how = "as in chapter 4.2 of the thesis"
    rows.append(("post-processing", how))
    folder = target.absolute() / "parts"
    make = partial(chunk_frames, len(found.frames), workers)
    chunk = CachedTable("chunk", make, vars(found), folder)()["frames"]
    run = chain.Chain(
        detection=replace(found, folder=folder, chunk=chunk[0]),
        exit_point_mm=lance,
        wall=wall,
        in_air=InAir(options.in_air_mm),
        management=Management(invisible=options.memory),
        post_processing=joined,
    )
    return run, rows


def _geometry(
    recording: StoredRecording, rows: Rows
) -> tuple[Vector | None, Cylinder | None]:
    """Return outlet of the lance and wall, None if unknown; add to the settings."""
    deep = np.flatnonzero(recording.per_frame["points"])
    if not len(deep):
        return None, None
    lance = recording.attributes.exit_point_mm
    told = NO_LANCE
    if lance:
        told = f"{np.round(lance, 1)} mm, depth calibrated"
    rows.append(("lance", told))
    try:
        wall = fitted_wall(recording, deep[spread(len(deep), 5)].tolist())
    except InputError as error:
        told = f"no flights, no wall was found: {error} What lies on it is tracked."
        rows.append(("note", told))
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
    labels = WALL_PASS(points)
    if not (labels >= 0).any():
        raise InputError(f"{len(points)} points make no cluster.")
    return fit_cylinder(points[labels == largest_cluster(labels)])
