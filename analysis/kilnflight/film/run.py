"""The steps on a recording of one's own: detect, track, or all of them with tables and
pictures.
"""

from __future__ import annotations

import warnings
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from kilnflight import chain, tracking
from kilnflight.association import GNN, Associator
from kilnflight.chain import CHAIN_STEPS
from kilnflight.checks import InputError, check_columns, check_whole
from kilnflight.film.doubts import doubts
from kilnflight.film.motion import motion_of
from kilnflight.film.pictures import pictures, png
from kilnflight.film.preparation import choose, prepare
from kilnflight.film.report import Tables, aligned, summary
from kilnflight.film.settings import Options
from kilnflight.recording.files import FileRecording, open_any
from kilnflight.recording.frames import Recording, count_frames
from kilnflight.recording.store import StoredRecording, open_recording, write_recording
from kilnflight.recording.track_files import csv_of
from kilnflight.store.cache import clear_parts, locked, write_whole
from kilnflight.tables import with_pixels
from kilnflight.tracking.filter import ConstantVelocity
from kilnflight.tracking.tracker import Management
from kilnflight.tracklets import postprocess

_GNN = GNN()
ALWAYS = ("detections", "tracks")  # the other tables only if they have rows


def detect(source: Any, progress: bool = False, **options: Any) -> pd.DataFrame:
    """Return the detections in all frames (`kilnflight.tables.DETECTIONS`).

    Parameters
    ----------
    source
        A recording, or anything that `kilnflight.open` takes.
    progress
        Whether to show a bar in a terminal.
    **options
        Those of `Options`, such as ``threshold=20``, ``dark=True`` or ``size=10``.
    """
    run, *_ = choose(open_any(source), Options(**options))
    seen = run.source.recording()
    frames = range(run.start, run.stop)
    return chain.detect_frames(seen, frames, run.detector, run.background, progress)


def track_detections(
    detections: pd.DataFrame,
    associator: Associator = _GNN,
    post_processing: bool | None = None,
    max_step: float | None = None,
    memory: int = Management.invisible,
    progress: bool = False,
) -> pd.DataFrame:
    """Return detections with ``particle``; -1 means in no track.

    Parameters
    ----------
    detections
        Columns frame and row, col or y, x (px); depth z (mm) beside row, col.
    associator
        Association of a frame, such as ``kilnflight.association.JPDA()``.
    post_processing
        Whether tracklets are joined and filtered. None: where there is depth.
    max_step
        Longest step of a particle in px a frame; None: estimated without depth.
    memory
        Frames in a row that a track may miss.
    progress
        Whether to show a bar in a terminal.

    Raises
    ------
    InputError
        As `kilnflight.tracking.track`.
    """
    table = with_pixels(detections)
    check_columns(table, ["frame"], "detections")
    frames, step = count_frames(check_whole(table["frame"], "detections: column frame"))
    if step != 1:
        warnings.warn(
            f"frames go in steps of {step:g}: they are counted from 0", stacklevel=2
        )
        table = table.assign(frame=frames, number=table["frame"])
    deep = "z" in table and bool(table["z"].notna().any())
    processed = deep if post_processing is None else post_processing
    motion = (
        ConstantVelocity()
        if processed and max_step is None
        else motion_of(table, max_step)
    )
    patience = Management(invisible=memory)
    tracks = tracking.track(
        table, associator, motion, management=patience, progress=progress
    )
    return postprocess(tracks) if processed else tracks


def run_recording(
    source: Any, target: Path | str | None = None, workers: Any = None, **options: Any
) -> dict[str, pd.DataFrame]:
    """Run all steps on a recording, print what was found and return all tables by name.

    A killed run continues where it stopped.

    Parameters
    ----------
    source
        A recording, or anything that `kilnflight.open` takes.
    target
        Folder of tables and pictures; None: ``NAME-run`` in the working folder.
    workers
        Processes, or a cluster that detects; None: this process.
    **options
        Those of `Options`.

    Raises
    ------
    InputError
        If the recording cannot be used, or a file cannot be written, as on a full disk.
    """
    (given := Options(**options)).check(recording := open_any(source))
    target = Path(target or f"{recording.attributes.name}-run")
    check_apart(target, source, recording)
    if (target / "tracks.csv").exists() and not (target / "parts").is_dir():
        raise InputError(
            f"{target}: has a tracks.csv but no parts of a run. Name another folder."
        )
    stored = (
        recording
        if isinstance(recording, StoredRecording)
        else _stored(recording, target)
    )
    kiln_run, rows = prepare(stored, target, given)
    chain.make_tables([kiln_run], workers, ())
    if not kiln_run.post_processing or given.max_step:
        motion = motion_of(kiln_run.detection.detections(), given.max_step)
        kiln_run = replace(kiln_run, motion=motion)
        rows.append(
            (
                "motion",
                f"expected step {motion.velocity} px; change {motion.noise:g} px",
            )
        )
    chain.make_tables([kiln_run], workers)
    tables = {"detections": kiln_run.detection.detections()}
    tables |= {step: kiln_run.table(step)() for step in CHAIN_STEPS}
    rows += [
        *summary(tables).items(),
        *(("warning", doubt) for doubt in doubts(tables)),
    ]
    tables["summary"] = pd.DataFrame(rows, columns=(names := ["what", "value"]))
    index = stored.per_frame["index"]
    publish(tables, stored, target, index[kiln_run.frames] - index[0])
    print(aligned(pd.DataFrame([*rows, ("written to", f"{target}")], columns=names)))
    return tables


def check_apart(
    target: Path, source: Any, recording: FileRecording | StoredRecording
) -> None:
    """Raise an `InputError` if a target is the recording, or lies in it."""
    path = (
        source
        if isinstance(source, str | Path)
        else getattr(recording, "path", target / "none")
    )
    own = {Path(each).resolve() for each in (path, *getattr(recording, "files", ()))}
    if own & {place := target.resolve(), *place.parents} or place.match(
        f"{Path(path).absolute()}"
    ):
        raise InputError(
            f"{target}: is or lies in the recording. Name another place to write to."
        )


def _stored(recording: FileRecording, target: Path) -> StoredRecording:
    """Return the Zarr copy of a recording, made if it is not there: films are read in
    order.
    """
    (folder := target / "parts").mkdir(parents=True, exist_ok=True)
    copy = folder / f"recording-{recording.content()}.zarr"
    try:
        with locked(folder):
            if any(path != copy for path in folder.glob("recording-*.zarr")):
                raise InputError(
                    f"{target}: has the run of another film. Name another folder."
                )
            return (
                open_recording(copy)
                if copy.exists()
                else write_recording(recording, copy)
            )
    finally:  # of a film that cannot be read nothing is left
        with suppress(OSError):
            folder.rmdir()
            target.rmdir()


def publish(tables: Tables, recording: Recording, folder: Path, frames: Any) -> None:
    """Write the tables and the pictures.

    Each file is written as a whole; the tables in ``parts`` let a run continue.
    """
    names = [
        name
        for name in ("detections", *CHAIN_STEPS)
        if len(tables[name]) or name in ALWAYS
    ]
    contents = {
        f"{name}.parquet": tables[name].to_parquet(index=False) for name in names
    }
    for name in ("tracks", "summary"):  # without empty columns, such as mm of a film
        known = tables[name].dropna(axis=1, thresh=min(1, len(tables[name])))
        contents[f"{name}.csv"] = csv_of(known).encode()
    contents |= {
        f"{name}.png": png(it) for name, it in pictures(recording, tables, frames)
    }
    with locked(folder):
        (folder / "mean-square-displacement.png").unlink(
            missing_ok=True
        )  # of another run
        for name, content in contents.items():
            clear_parts(folder / name)
            write_whole(folder / name, content)
