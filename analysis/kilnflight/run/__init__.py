"""A recording of one's own: open, detect, track and plot it, or run all steps with a report.

recording + `Options` -> `prepare` -> `kilnflight.kiln` -> `RunResults` -> tables, summary, page

`kilnflight.open`, `detect`, `track` and `plot_tracks` are the same steps in Python.
"""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from kilnflight import kiln, tracking
from kilnflight.association import GNN, Associator
from kilnflight.checks import InputError
from kilnflight.detection import DoG
from kilnflight.detection.combination import Combination
from kilnflight.kiln import KILN_STEPS
from kilnflight.project.cache import clear_parts, locked, write_whole
from kilnflight.project.parallel import Workers
from kilnflight.recording.files import FileRecording, open_any
from kilnflight.recording.frames import Recording
from kilnflight.recording.store import StoredRecording, open_recording, write_recording
from kilnflight.run.contents import aligned
from kilnflight.run.preparation import Inverted, Options, fitted_wall, noise_threshold, prepare
from kilnflight.run.report import RunResults, page, plot_tracks, read_results, summary
from kilnflight.tracklets import postprocess

__all__ = [
    "Options",
    "detect",
    "fitted_wall",
    "open_any",
    "plot_tracks",
    "run_recording",
    "track_detections",
]

_GNN = GNN()


def detect(
    recording: Recording,
    threshold: float | None = None,
    progress: bool = False,
    dark: bool = False,
) -> pd.DataFrame:
    """Return the detections in all frames (`kilnflight.tables.DETECTIONS`).

    Parameters
    ----------
    recording
        As `kilnflight.open` or `kilnflight.twin.scenes.open_scene` gives it.
    threshold
        Threshold of DoG in grey values; five times the noise if None (`noise_threshold`).
    progress
        Whether to show a bar in a terminal.
    dark
        Whether particles are darker than the background.
    """
    threshold = noise_threshold(recording) if threshold is None else threshold
    seen = Inverted(recording) if dark else recording
    frames, detector = range(len(recording)), Combination(DoG(threshold))
    return kiln.detect_frames(seen, frames, detector, progress=progress)


def track_detections(
    detections: pd.DataFrame, associator: Associator = _GNN, raw: bool = False
) -> pd.DataFrame:
    """Return detections with ``particle``, post-processed unless ``raw``.

    A ``particle`` of -1 means in no track. Parameters and errors are those of
    `kilnflight.tracking.track`.
    """
    tracks = tracking.track(detections, associator)
    return tracks if raw else postprocess(tracks)


def run_recording(path: Path, target: Path | None, options: Options, workers: Workers) -> None:
    """Run all steps on a recording of any kind and print the results.

    A killed run continues where it stopped.

    Raises
    ------
    InputError
        If the recording cannot be used, or a file cannot be written, as on a full disk.
    """
    target = target or beside(path)
    if target.resolve().is_relative_to(path.resolve()):
        raise InputError(
            f"--to {target}: lies in the recording {path}, which is only read. Give a folder "
            f"of its own, such as {beside(path)}."
        )
    recording = _stored(open_any(path), target / "parts")
    kiln_run, settings, notes = prepare(recording, target, options)
    print(*(f"note: {note}" for note in notes), sep="\n")
    kiln.make_tables([kiln_run], workers)
    results = read_results(kiln_run, settings, notes)
    print(*(f"note: {note}" for note in results.notes[len(notes) :]), sep="\n")
    report = publish(results, recording, target)
    print(aligned(summary(results)))
    print(f"tables and report: {report}")


def _stored(recording: FileRecording | StoredRecording, folder: Path) -> StoredRecording:
    """Return the recording, or its Zarr copy in a folder: films cannot be read at random."""
    if isinstance(recording, StoredRecording):
        return recording
    folder.mkdir(parents=True, exist_ok=True)
    copy = folder / f"recording-{recording.content()}.zarr"
    with locked(folder):
        return open_recording(copy) if copy.exists() else write_recording(recording, copy)


def beside(path: Path) -> Path:
    """Return a run's default folder, beside its recording.

    Examples
    --------
    >>> [beside(Path(name)).as_posix() for name in ("kiln/chips.zarr", "kiln/*.png")]
    ['kiln/chips-run', 'kiln-run']
    """
    path = path.parent if set(path.name) & set("*?{[") else path  # a pattern of names
    path = path.resolve() if path.name in ("", "..") else path
    name = path.stem if path.is_file() else path.name.removesuffix(".zarr")
    return path.with_name(f"{name}-run")


def publish(results: RunResults, recording: Recording, folder: Path) -> Path:
    """Write the tables, the summary and the report; return its path.

    Each file is written as a whole; the tables in ``parts`` let a run continue.
    """
    folder.mkdir(parents=True, exist_ok=True)
    names = ("detections", *KILN_STEPS)
    contents = {f"{name}.parquet": getattr(results, name).to_parquet(index=False) for name in names}
    contents["summary.csv"] = summary(results).to_csv(index=False).encode()
    contents["report.html"] = page(results, recording).encode()
    with locked(folder):
        for name, content in contents.items():
            clear_parts(folder / name)
            write_whole(folder / name, content)
    return folder / "report.html"
