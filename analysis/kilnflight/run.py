"""`kilnflight run`: all steps on a stored recording, with a summary and a report.

recording + `Options` -> `prepare` -> `kilnflight.kiln` -> `Results` -> tables, summary, page

What the user does not give is taken from the recording where that can be done, and noted:
the threshold from its noise, the kiln's wall from its clouds.
"""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import cv2
import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.figure import Figure

from kilnflight import __version__, kiln
from kilnflight.camera import calibrate_points
from kilnflight.checks import InputError, check_positive
from kilnflight.detection import DBSCAN, DoG
from kilnflight.detection.combination import Combination
from kilnflight.detection.wall import Cylinder, CylinderFit, InAir
from kilnflight.flight import Rules, remaining
from kilnflight.ignition import BEFORE, SEEN, TOO_FEW, Ignition
from kilnflight.kiln import KILN_STEPS, LONG_CHUNK, DetectionRun, KilnRun, Vector
from kilnflight.project import style
from kilnflight.project.cache import clear_parts, locked, parquet, save
from kilnflight.project.parallel import Workers
from kilnflight.recording.frames import PictureRecording
from kilnflight.recording.store import StoredRecording, open_recording
from kilnflight.scores.flights import ignition_histogram
from kilnflight.scores.intervals import Bootstrap, Interval, median, share
from kilnflight.tracklets import tracked

NOISE_FRAMES = 5  # spread over the first 150, the median's window
WALL_FRAMES = 5  # spread over the recording
PIECES = 8  # that a recording is detected in at least, if it is long enough: work for --jobs
LEAST_CHUNK = 25  # frames; every piece reads the median's window, 150 frames, anew
BLOCK_PX = 32  # side of the blocks in which noise is measured
NOISY_SHARE = 0.9  # of the blocks are quieter: noise grows with light, particles are few
TIMES_NOISE = 5.0  # as `Combination.prominence`: what stands out of the noise
LEAST_NOISE = 1.0  # a grey value; a picture without any noise is a made-up one
MEDIAN_TO_SIGMA = 1.4826  # median of |noise| -> standard deviation of Gaussian noise
UNEVEN = 0.01  # share by which intervals between frames may differ from the frame rate
SEED = 0  # of the bootstrap
DPI = 150
BIN_S = 0.1  # sec. 5.3.2
STYLE = """
body { font: 16px/1.5 sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; }
table { border-collapse: collapse; }
th, td { text-align: left; padding: 0.15rem 1rem 0.15rem 0; border-bottom: 1px solid #ccc; }
figure { margin: 2rem 0; } img { max-width: 100%; } figcaption { font-size: 0.9rem; }
"""

Row = tuple[str, str]  # what and value


@dataclass(frozen=True)
class Options:
    """What the user gives; None where it is left to the recording.

    Parameters
    ----------
    threshold
        Of DoG, grey values.
    exit_point_mm
        Outlet of the lance: camera coordinates as captured, before Eq. 2.4, as ``lance_mm`` of
        a manifest.
    in_air_mm
        Largest distance from the kiln's axis of what is in the air.
    bright
        Grey value that only what burns reaches, such as the camera's full scale: a particle whose
        first grey values reach it and that shows no step was alight when it was first seen. None:
        it counts as unlit, as in the thesis, which prints no such value
        (`kilnflight.ignition.Ignition`).
    above_background
        Whether ignition is a step of the grey values above those of the background, and not as
        they are (`kilnflight.kiln.background_gray`).
    """

    threshold: float | None = None
    exit_point_mm: Vector | None = None
    in_air_mm: float = 800.0  # sec. 5.1.4
    bright: float | None = None
    above_background: bool = False

    def __post_init__(self) -> None:
        """Refuse what is no threshold, no distance and no grey value."""
        for name in ("threshold", "in_air_mm", "bright"):
            if getattr(self, name) is not None:
                check_positive(getattr(self, name), name)


class Results(NamedTuple):
    """All tables of one recording, and what the reader is to know."""

    name: str
    frames: int
    detections: pd.DataFrame
    tracks: pd.DataFrame
    trajectories: pd.DataFrame
    flights: pd.DataFrame
    slices: pd.DataFrame
    notes: tuple[str, ...] = ()
    settings: tuple[Row, ...] = ()

    @property
    def counted(self) -> pd.DataFrame:
        """The flights that start at the lance; only these count (section 5.3.1)."""
        return self.flights[self.flights["from_lance"]]


def run(folder: Path, target: Path | None, options: Options, workers: Workers) -> None:
    """Make and print everything; a killed run goes on where it stopped.

    Raises
    ------
    InputError
        As `prepare` and `publish`.
    """
    target = target or beside(folder)
    prepared, notes = prepare(folder, target, options)
    for note in notes:
        print(f"note: {note}")
    kiln.make_tables([prepared], workers)
    jobs = str(workers.jobs) if workers.scheduler is None else f"those of {workers.scheduler}"
    found = results(prepared, notes, settings(prepared, options, jobs))
    for note in found.notes[len(notes) :]:
        print(f"note: {note}")
    report = publish(found, open_recording(folder), target)
    rows = summary(found)
    width = int(rows["what"].str.len().max())
    for what, value in rows.to_numpy().tolist():
        print(f"{what:<{width}}  {value}")
    print(f"tables and report: {report}")


def beside(folder: Path) -> Path:
    """Return the default folder of a run: beside the recording, ``-run`` after its name.

    Examples
    --------
    >>> beside(Path("kiln/chips.zarr")).as_posix()
    'kiln/chips-run'
    """
    named = folder if folder.name not in ("", "..") else folder.resolve()
    return named.with_name(named.name.removesuffix(".zarr") + "-run")


def prepare(folder: Path, target: Path, options: Options) -> tuple[KilnRun, tuple[str, ...]]:
    """Return how a stored recording is worked on, and notes for the reader.

    Raises
    ------
    InputError
        If there is no recording, it has depth and the lance's outlet is not known, or the
        target is in the recording's own folder.
    """
    source = kiln.stored_source(folder)
    if target.resolve().is_relative_to(folder.resolve()):
        raise InputError(
            f"--to {target}: lies in the recording {folder}, which is only read. Give a folder "
            f"of its own, such as {beside(folder)}."
        )
    if target.exists() and not target.is_dir():
        raise InputError(f"--to {target}: is a file. Give a folder, such as {beside(folder)}.")
    recording = source.recording()
    notes: list[str] = []
    threshold = options.threshold or _threshold(recording, notes)
    lance = wall = None
    if recording.per_frame["points"].any():
        captured = options.exit_point_mm or recording.attributes.lance_mm
        if captured is None:
            raise InputError(
                f"recording {source.name}: where the lance ends is not known. Give --exit-point "
                "x,y,z (mm, camera coordinates as captured), or lance_mm in its manifest."
            )
        x, y, z = calibrate_points([captured])[0].tolist()
        lance, wall = (x, y, z), _wall(recording, notes)
    else:
        notes.append(
            "The recording has no depth: tracks are 2D. Trajectories, dwell times, velocities "
            "and ignition times need depth and were not made."
        )
    _check_times(recording, notes)
    detection = DetectionRun(
        source,
        0,
        len(recording),
        Combination(DoG(threshold)),
        chunk=chunk(len(recording)),
        differences=False,
        folder=target / "parts",
    )
    ignition = Ignition(bright=options.bright)
    rules = Rules(ignition=ignition, above_background=options.above_background)
    prepared = KilnRun(detection, lance, wall, InAir(options.in_air_mm), rules=rules)
    return prepared, tuple(notes)


def chunk(frames: int) -> int:
    """Return how many frames are detected in one piece, for any number of workers.

    Examples
    --------
    >>> [chunk(frames) for frames in (10, 1001, 24_000)]
    [25, 126, 500]
    """
    return min(LONG_CHUNK, max(LEAST_CHUNK, -(-frames // PIECES)))


def _threshold(recording: PictureRecording, notes: list[str]) -> float:
    threshold = noise_threshold(recording)
    noise = "the noise of the first frames"
    if threshold <= TIMES_NOISE * LEAST_NOISE:
        noise = (
            "the least noise there is; the first frames have less (are they all of one grey "
            "value, saturated or made up?)"
        )
    notes.append(
        f"No threshold was given: {threshold:g} grey values are {TIMES_NOISE:g} times {noise}. It "
        "decides how much is found; compare others with --threshold."
    )
    return threshold


def noise_threshold(recording: PictureRecording) -> float:
    """Return a threshold of DoG from the noise of the first frames, in grey values.

    Notes
    -----
    The thesis tunes its threshold on labelled frames; without labels noise is all there is.
    In each of a few frames the finest difference of Gaussians, which is what the threshold is
    held against, is measured in small blocks: 1.4826 times the median of its absolute value
    is a standard deviation of Gaussian noise, and particles, which cover a small part of a
    block, hardly move it. Noise grows with light, so a noisy block counts, the one that nine
    tenths are quieter than. Of the frames the median is taken, times five. That bounds false
    alarms of noise; flicker of a flame's light is not noise of a pixel, and a higher threshold
    may be better.
    """
    spread = np.unique(np.linspace(0, min(len(recording), 150) - 1, NOISE_FRAMES).round())
    frames = [int(t) for t in spread]
    noise = [block_noise(view.foreground) for _, view in kiln.views(recording, frames)]
    return round(TIMES_NOISE * max(float(np.median(noise)), LEAST_NOISE), 1)


def block_noise(foreground: npt.NDArray[np.float32]) -> float:
    """Return the noise of a foreground's difference of Gaussians, in a noisy part of it."""
    finest = DoG()
    scales = (finest.sigma, finest.sigma * 2 ** (1 / finest.layers))
    blurred = [
        cv2.GaussianBlur(foreground, (0, 0), np.sqrt(scale**2 - finest.camera_blur**2))
        for scale in scales
    ]
    response = np.abs(blurred[0] - blurred[1])
    rows, cols = foreground.shape
    size = min(BLOCK_PX, rows, cols)
    cut = response[: rows // size * size, : cols // size * size]
    blocks = cut.reshape(rows // size, size, cols // size, size).swapaxes(1, 2)
    middle = np.median(blocks.reshape(-1, size * size), axis=1)
    return float(np.quantile(middle, NOISY_SHARE)) * MEDIAN_TO_SIGMA


def _wall(recording: StoredRecording, notes: list[str]) -> Cylinder | None:
    """Return the kiln, from a few frames with points; a note and None where it fails."""
    known = np.flatnonzero(recording.per_frame["points"])
    spread = np.unique(np.linspace(0, len(known) - 1, WALL_FRAMES).round().astype(int))
    try:
        return fitted_wall(recording, known[spread].tolist())
    except InputError as error:
        notes.append(
            f"The kiln's wall was not found ({error}) What lies on it was tracked like what "
            "flies; dwell times, velocities and ignition were not made."
        )
        return None


def fitted_wall(recording: PictureRecording, frames: Iterable[int]) -> Cylinder:
    """Return the cylinder of the largest cluster in some frames (sections 3.1 and 3.2).

    The clouds of the frames are put together: a still wall is denser so, what flies is not.
    """
    points = np.concatenate([calibrate_points(recording.frame(t).xyz) for t in frames])
    labels = DBSCAN(eps=50.0, min_points=10)(points)
    if not (labels >= 0).any():
        raise InputError(f"{len(points)} points make no cluster.")
    largest = np.bincount(labels[labels >= 0]).argmax()
    return CylinderFit()(points[labels == largest])


def _check_times(recording: StoredRecording, notes: list[str]) -> None:
    rate = recording.attributes.frame_rate_hz
    intervals = np.diff(recording.per_frame["time_s"]) * rate
    off = np.abs(intervals - 1.0)
    if off.size and off.max() > UNEVEN:
        worst = int(off.argmax())
        notes.append(
            f"Frames are not evenly spaced: after frame {worst} the next one comes "
            f"{intervals[worst]:.2f} intervals later. Times are counted as frames at {rate:g} Hz."
        )


def results(
    prepared: KilnRun, notes: tuple[str, ...] = (), settings: tuple[Row, ...] = ()
) -> Results:
    """Return the tables of a recording, made where they are not there, with more notes."""
    name, frames = prepared.detection.source.name, len(prepared.frames)
    detections = prepared.detection.detections()
    tracks, trajectories, flights, slices = (prepared.table(step)() for step in KILN_STEPS)
    found = Results(name, frames, detections, tracks, trajectories, flights, slices)
    notes = (*notes, *doubts(found, prepared.rules.above_background))
    return found._replace(notes=notes, settings=settings)


def doubts(found: Results, above_background: bool = False) -> Iterator[str]:
    """Yield notes on what is missing, or may not be what it seems."""
    tracks, flights, counted = tracked(found.tracks), found.flights, found.counted
    if found.detections.empty:
        yield "Nothing was detected: a lower --threshold may find more."
    elif tracks.empty:
        yield (
            f"No tracks: of {len(found.detections)} detections {len(found.tracks)} are in the air "
            "or without depth, and none of these follow each other. Do --threshold, --in-air and "
            "the kiln's wall fit the recording?"
        )
    if len(flights) and counted.empty:
        fitted = found.trajectories["particle"].isin(flights["particle"])
        early = int((found.trajectories.loc[fitted, "t0_at_bound"] < 0).sum())
        way = f"; of {early} no way back to it was found (t0 is the earliest that was searched)"
        yield (
            f"{len(flights)} trajectories were fitted, but none starts at the lance: the first "
            f"positions lie {flights['start_mm'].median():.0f} mm from it (median)"
            f"{way if early else ''}. Is the lance's outlet right (mm, as captured, before Eq. "
            "2.4)? Dwell times, velocities and ignition are of flights from the lance only."
        )
    behind = int((found.slices["slice_m"] < 0).sum())
    if 2 * behind > len(found.slices):
        yield (
            f"{behind} of {len(found.slices)} metres that were passed lie behind the lance. Is its "
            "outlet right (mm, as captured, before Eq. 2.4)?"
        )
    ignited = int((counted["ignition"] == SEEN).sum())
    if ignited and not above_background:
        yield (
            f"Ignition was seen in {ignited} of {len(counted)} flights as a step of the grey "
            "values as they are, as the thesis does. A particle that flies from before a dark part "
            "of the kiln to before a bright one shows such a step without burning: compare "
            "--above-background."
        )


def settings(prepared: KilnRun, options: Options, jobs: str) -> tuple[Row, ...]:
    """Return what a recording was worked on with; ``jobs`` says by whom, in a few words."""

    def listed(values: Iterable[float], digits: int) -> str:
        return ", ".join(f"{value:.{digits}f}" for value in values)

    lance, wall, detector = prepared.exit_point_mm, prepared.wall, prepared.detection.detector
    rows = []
    if isinstance(detector.detector, DoG):
        source = "given" if options.threshold else "not given, from the noise"
        value = f"{detector.detector.threshold:g} grey values ({source})"
        rows.append(("threshold of DoG", value))
    if lance is None:
        rows.append(("lance's outlet", "not used"))
    else:
        source = "given" if options.exit_point_mm else "as recorded"
        rows.append(("lance's outlet, after Eq. 2.4", f"{listed(lance, 1)} mm ({source})"))
    if wall is None:
        rows.append(("kiln's wall", "not used"))
    else:
        axis = f"through {listed(wall.centre_mm, 0)} mm along {listed(wall.direction, 4)}"
        bright = prepared.rules.ignition.bright
        level = "not asked" if bright is None else f"from {bright:g} grey values on (given)"
        above = "above the background" if prepared.rules.above_background else "as they are"
        limit = f"up to {prepared.in_air.threshold_mm:g} mm from the axis"
        rows += [
            ("kiln's axis", axis),
            ("kiln's radius", f"{wall.radius_mm:.0f} mm"),
            ("taken for in the air", limit),
            ("taken for alight when first seen", level),
            ("ignition", f"a step of the grey values {above}"),
        ]
    rows.append(("post-processing of tracks", "without the texture term of Eq. 4.24"))
    return (*rows, ("jobs", jobs))


def summary(found: Results) -> pd.DataFrame:
    """Return the results in rows of ``what`` and ``value``, both texts.

    In brackets: 95 % intervals, by bootstrap over particles and of shares by Wilson; none of
    fewer than six.
    """
    tracks, counted = tracked(found.tracks), found.counted
    reasons = found.trajectories["outcome"].value_counts().sort_index()
    endings = counted["ending"].value_counts().sort_index()
    depth = int(found.detections["z"].notna().sum())
    rows = [
        ("recording", found.name),
        ("frames", str(found.frames)),
        *found.settings,
        ("detections", f"{len(found.detections)}, with depth {depth}"),
        ("detections in the air or without depth", str(len(found.tracks))),
        ("tracks", f"{tracks['particle'].nunique()} with {len(tracks)} detections"),
        ("trajectories fitted", str(int(reasons.get("fitted", 0)))),
        *((f"not fitted: {why}", str(n)) for why, n in reasons.items() if why != "fitted"),
        ("flights from the lance", str(len(counted))),
        ("left out: not from the lance", str(len(found.flights) - len(counted))),
        *((f"flights {ending}", str(n)) for ending, n in endings.items()),
        *(_ignited(counted) if len(counted) else ()),
        *_velocities(found),
        *_outliers(found),
    ]
    return pd.DataFrame(rows, columns=["what", "value"])


def _ignited(counted: pd.DataFrame) -> list[Row]:
    """Return dwell time and share ignited; one row more where some were alight at first."""
    dwell = Bootstrap()(median, [counted["dwell_s"]], np.random.default_rng(SEED))
    rows, kinds = [("dwell time, median", f"{_text(dwell, 3)} s")], counted["ignition"]
    shares = [("ignition seen", [SEEN])]
    if (kinds == BEFORE).any():
        shares.append(("ignition seen, or alight when first seen", [SEEN, BEFORE]))
    for what, which in shares:
        interval = share(int(kinds.isin(which).sum()), len(counted))
        rows.append((what, f"{_text(interval, 0, 100)} %"))
    few = f"{int((kinds == TOO_FEW).sum())} of {len(counted)}"
    return [*rows, ("too few points to judge ignition", few)]


def _text(interval: Interval, digits: int, factor: float = 1.0) -> str:
    """Return an estimate with its interval, or without one if the sample is too small."""
    estimate, low, high = (f"{factor * value:.{digits}f}" for value in interval[:3])
    return f"{estimate} [{low}, {high}]" if np.isfinite(interval[1:3]).all() else estimate


def _velocities(found: Results) -> Iterator[Row]:
    """Yield the median velocity in each metre, and which share of the flights passed it."""
    groups, total = found.slices.groupby("slice_m")["velocity_m_s"], len(found.counted)
    for far, number in remaining(found.slices, total)[["slice_m", "number"]].to_numpy():
        middle = Bootstrap()(median, [groups.get_group(far)], np.random.default_rng(SEED))
        passed = _text(share(int(number), total), 0, 100)
        value = f"median {_text(middle, 1)} m/s, {passed} % of the flights"
        yield f"velocity in the metre up to {far:g} m", value


def _outliers(found: Results) -> Iterator[Row]:
    """Yield by what a reader sees that depths jumped, or that a flight is too fast to be true.

    Nothing is left out for it. The thesis sets no limit either.
    """
    fitted = found.trajectories[found.trajectories["particle"].isin(found.counted["particle"])]
    fitted = fitted.dropna(subset=["rmse_z_mm"])
    if len(fitted):
        each = (f"{fitted[f'rmse_{axis}_mm'].median():.0f}" for axis in "xyz")
        yield "RMSE of their fits in x, y, z, median", f"{', '.join(each)} mm"
        worst = fitted.iloc[int(np.argmax(fitted["rmse_z_mm"]))]
        value = f"{worst['rmse_z_mm']:.0f} mm (particle {worst['particle']})"
        yield "largest RMSE in depth", value
    if len(found.slices):
        fast = found.slices.iloc[int(np.argmax(found.slices["velocity_m_s"].abs()))]
        value = f"{fast['velocity_m_s']:.1f} m/s (particle {fast['particle']}, "
        yield "fastest metre", f"{value}up to {fast['slice_m']:g} m)"
        before = f"{int((~found.slices['observed']).sum())} of {len(found.slices)}"
        yield "metres passed before the particle was first seen", before


def publish(found: Results, recording: PictureRecording, folder: Path) -> Path:
    """Write the tables, the summary and the report; return the report.

    Each file is there whole or not at all; what ``parts`` holds lets a run go on.

    Raises
    ------
    InputError
        If a file cannot be written, as on a full disk.
    """
    folder.mkdir(parents=True, exist_ok=True)
    names = ("detections", *KILN_STEPS)
    contents = {f"{name}.parquet": parquet(getattr(found, name)) for name in names}
    contents["summary.csv"] = summary(found).to_csv(index=False).encode()
    contents["report.html"] = page(found, recording).encode()
    with locked(folder):
        for name, content in contents.items():
            clear_parts(folder / name)
            save(folder / name, content)
    return folder / "report.html"


def page(found: Results, recording: PictureRecording) -> str:
    """Return the report of a recording as one HTML page that needs no network."""
    name = html.escape(found.name)
    notes = "".join(f"<li>{html.escape(note)}</li>" for note in found.notes)
    rows = "".join(
        f"<tr><th>{html.escape(what)}</th><td>{html.escape(value)}</td></tr>"
        for what, value in summary(found).to_numpy().tolist()
    )
    figures = "".join(_embedded(*captioned) for captioned in _figures(found, recording))
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f"<title>{name}</title><style>{STYLE}</style></head><body><h1>{name}</h1>"
        + (f"<h2>To know</h2><ul>{notes}</ul>" if notes else "")
        + f"<h2>Summary</h2><table>{rows}</table>"
        + "<p>In brackets: 95 % intervals over particles; none of fewer than six.</p>"
        + f"<h2>Figures</h2>{figures}<p>kilnflight {__version__}</p></body></html>\n"
    )


Captioned = tuple[Figure, str]


def _figures(found: Results, recording: PictureRecording) -> Iterator[Captioned]:
    """Yield what can be drawn, each with its caption."""
    yield tracks_figure(found, recording)
    if len(found.counted):
        yield dwell_figure(found)
    if len(found.slices):
        yield velocity_figure(found)
    if len(found.counted):
        yield ignition_figure(found)


def _embedded(picture: Figure, caption: str) -> str:
    buffer = io.BytesIO()
    with style.style():
        picture.savefig(buffer, format="png", dpi=DPI, metadata={"Software": None})
    plt.close(picture)
    data, caption = base64.b64encode(buffer.getvalue()).decode(), html.escape(caption)
    return (
        f'<figure><img alt="{caption}" src="data:image/png;base64,{data}"/>'
        f"<figcaption>{caption}</figcaption></figure>"
    )


def tracks_figure(found: Results, recording: PictureRecording) -> Captioned:
    """Draw all tracks over the first frame."""
    picture, axes = style.canvas(width_mm=style.PAGE_MM, height_mm=130)
    style.frame(axes[0, 0], recording.gray(0))
    style.tracks(axes[0, 0], tracked(found.tracks))
    return picture, "Tracks after post-processing over the first frame (dark parts lifted)."


def dwell_figure(found: Results) -> Captioned:
    """Draw the dwell times, stacked by ending."""
    groups = dict(list(found.counted.groupby("ending")["dwell_s"]))
    edges = np.arange(0.0, found.counted["dwell_s"].max() + BIN_S, BIN_S / 2)
    picture, axes = style.canvas(width_mm=style.PAGE_MM * 2 / 3)
    look = {"color": style.COLOURS[1 : 1 + len(groups)], "hatch": style.HATCHES[: len(groups)]}
    axes[0, 0].hist(list(groups.values()), edges, stacked=True, label=list(groups), **look)
    axes[0, 0].set(xlabel="dwell time (s)", ylabel="flights")
    axes[0, 0].legend()
    return picture, "Dwell times of flights from the lance, by their ending."


def velocity_figure(found: Results) -> Captioned:
    """Draw median and middle half of the velocities, and the remaining share."""
    picture, axes = style.canvas(2, width_mm=style.PAGE_MM * 2 / 3, height_mm=90, sharex=True)
    groups = found.slices.groupby("slice_m")["velocity_m_s"]
    low, middle, high = (groups.quantile(part) for part in (0.25, 0.5, 0.75))
    reach = [middle - low, high - middle]
    axes[0, 0].errorbar(middle.index, middle, yerr=reach, fmt="o-", color="black", capsize=2)
    left = remaining(found.slices, len(found.counted))
    axes[1, 0].bar(left["slice_m"], 100 * left["share"], 0.6, color="0.7", edgecolor="black")
    axes[0, 0].set(ylabel="velocity (m/s)")
    axes[1, 0].set(ylabel="flights (%)", xlabel="distance from the lance, end of slice (m)")
    return picture, (
        "Velocity towards the camera in each metre from the lance: median, and the middle half "
        "of the flights; below, the share of flights that get as far."
    )


def ignition_figure(found: Results) -> Captioned:
    """Draw when flights ignite, as shares of all of them."""
    ignition_s = found.counted["ignition_s"].to_numpy(np.float64)
    bins = ignition_histogram(ignition_s, BIN_S)
    picture, axes = style.canvas(width_mm=style.PAGE_MM * 2 / 3)
    look = {"align": "edge", "color": "0.7", "edgecolor": "black"}
    axes[0, 0].bar(bins["from_s"], bins["percent"], BIN_S, **look)
    label = "ignition after leaving the lance (s); the last bin holds all later"
    axes[0, 0].set(xlabel=label, ylabel="flights (%)")
    return picture, (
        f"Ignition after leaving the lance, in bins of {BIN_S:g} s: shares of all "
        f"{len(ignition_s)} flights; in {np.isfinite(ignition_s).sum()} of them ignition was seen."
    )
