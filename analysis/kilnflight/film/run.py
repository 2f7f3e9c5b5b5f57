"""The steps on a recording of one's own: detect, track, or all of them."""

import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from skimage.measure import label

from kilnflight import chain, tracking
from kilnflight.association import GNN, Associator
from kilnflight.chain import CHAIN_STEPS
from kilnflight.checks import InputError, check_columns, check_flags, check_whole
from kilnflight.film.doubts import doubtful_links, doubts
from kilnflight.film.motion import motion_of
from kilnflight.film.preparation import choose, prepare
from kilnflight.film.report import PICTURES, Rows, Tables, speed, summary, units
from kilnflight.film.settings import Options
from kilnflight.recording.files import FileRecording, open_any
from kilnflight.recording.frames import Recording, count_frames
from kilnflight.recording.store import StoredRecording, open_recording, write_recording
from kilnflight.recording.track_files import csv_of, read_table
from kilnflight.scores.detections import particle_centroids
from kilnflight.store.results import claimed, publish
from kilnflight.tables import with_pixels
from kilnflight.tracking.filter import ConstantVelocity, Motion
from kilnflight.tracking.tracker import Management
from kilnflight.tracklets import postprocess

_GNN = GNN()
DEPTHS = {  # warnings about a column of depth
    "z": "z limits links; for particles from a lance add --post-processing",
    "plane": "z is not used, only x and y; a depth in mm is z beside row, col",
}
ALWAYS = ("detections", "tracks")  # the other tables are written only with rows
WRITTEN = (  # all that a run may write
    *(f"{name}.parquet" for name in ("detections", *CHAIN_STEPS)),
    "tracks.csv",
    "summary.csv",
    *(f"{name}.png" for name in PICTURES),
)


def detect(source: Any, progress: bool = False, **options: Any) -> pd.DataFrame:
    """Return the detections in all frames.

    Parameters
    ----------
    source
        A recording, or anything that `kilnflight.open` takes.
    progress
        Whether to show a bar in a terminal.
    **options
        Those of `Options`, such as ``threshold=20``, ``dark=True`` or ``size=10``.

    Returns
    -------
    DataFrame
        Columns of `kilnflight.tables.DETECTIONS`: frame, row, col, radius_px ...

    Raises
    ------
    InputError
        If the recording cannot be read, or an option does not fit it.

    Warns
    -----
    UserWarning
        If particles are no round spots, or the picture shakes.

    Examples
    --------
    >>> import kilnflight
    >>> film = kilnflight.sample_film()
    >>> found = kilnflight.detect(film.frames, threshold=500)
    >>> found.columns[:4].tolist(), found["frame"].nunique()
    (['frame', 'row', 'col', 'radius_px'], 16)
    """
    check_flags("progress", progress)
    rows: Rows = []
    run = choose(open_any(source), Options(**options), rows)
    for what, text in rows:
        if what == "warning":
            warnings.warn(text, stacklevel=2)
    return chain.detect_frames(
        run.source.recording(), run.frames, run.detector, run.background, progress
    )


def track_detections(
    detections: Any,
    associator: Associator = _GNN,
    post_processing: bool | None = None,
    max_step: float | None = None,
    memory: int = Management.invisible,
    progress: bool = False,
) -> pd.DataFrame:
    """Link detections to tracks.

    Parameters
    ----------
    detections
        Columns frame and row, col (px), or those of another program; depth z (mm)
        beside row, col. Or label pictures, as anything that `kilnflight.open` takes:
        each whole number is an area, ``label`` in the tracks; 0 is background.
    associator
        Association of a frame, such as ``kilnflight.JPDA()``.
    post_processing
        Whether tracklets are joined and filtered as in the kiln. None: no, and with
        depth a warning says so.
    max_step
        Longest step of a particle in px a frame. None: estimated, or, with
        post-processing, that of the kiln.
    memory
        Frames in a row that a track may miss.
    progress
        Whether to show a bar in a terminal.

    Returns
    -------
    DataFrame
        The detections with the column ``particle``; -1 means in no track. Columns y and
        x become row and col. Frames in steps are counted from 0, and ``number`` is the
        one that was given; tables with radius_px keep their numbers. Without
        post-processing ``link`` says how sure the link to the track is, from 1 to 0:
        1 minus the distance from where it was expected over the gate, or the weight of
        `JPDA`. It is empty where a track begins. Post-processing averages positions
        that tracklets share.

    Warns
    -----
    UserWarning
        If frames are renumbered, z is not used, or links are doubtful.

    Raises
    ------
    InputError
        If a column is missing or there twice, a frame is below 0 or no whole number, a
        position is not finite, or label pictures are a mask or a film.

    Examples
    --------
    >>> import kilnflight
    >>> truth = kilnflight.sample_film().truth
    >>> tracks = kilnflight.track(truth[["frame", "row", "col"]])
    >>> round(kilnflight.score_tracks(truth, tracks, gate=5.0).jsc_theta, 2)
    0.96
    """
    if post_processing is not None:
        check_flags("post_processing", post_processing)
    table = _table(detections)
    check_columns(table, ["frame"], "detections")
    frames, step = count_frames(check_whole(table["frame"], "detections: column frame"))
    if step != 1 and "radius_px" not in table:
        if "number" in table:
            raise InputError("detections: column number is for frames. Rename it.")
        told = f"frames go in steps of {step:g}: they are counted from 0"
        warnings.warn(told, stacklevel=2)
        table = table.assign(frame=frames, number=table["frame"])
    for name, told in DEPTHS.items():
        varies = name in table and len(table[name].value_counts()) > 1
        if varies and post_processing is None:
            warnings.warn(told, stacklevel=2)
    motion: Motion = ConstantVelocity()
    if max_step is not None or not post_processing:
        motion = motion_of(table, max_step)
    tracks = tracking.track(
        table,
        associator,
        motion,
        management=Management(invisible=memory),
        progress=progress,
        link=not post_processing,
    )
    for doubt in doubtful_links(tracks):
        warnings.warn(doubt, stacklevel=2)
    if post_processing:
        return postprocess(tracks)
    return tracks


def _table(source: Any) -> pd.DataFrame:
    """Return detections in memory, of a file, or of label pictures: their areas."""
    if isinstance(source, pd.DataFrame):
        return with_pixels(source)
    if getattr(source, "suffix", "") in (".csv", ".txt", ".xml", ".parquet"):
        return read_table(source)
    recording = open_any(source)
    first = recording.frame(0).index
    parts = []
    areas = 0
    for t in range(len(recording)):
        frame = recording.frame(t)
        held = np.unique(frame.gray[frame.gray > 0])
        middles = particle_centroids(frame.gray, held)
        parts.append(middles.assign(frame=frame.index - first, label=held))
        areas += label(frame.gray, connectivity=2).max()
    table = pd.concat(parts, ignore_index=True)
    # Labels broken by others have up to 1.5 areas each, and of noise a quarter of the
    # pixels is an area; choices.
    if areas > min(1.5 * len(table), len(parts) * frame.gray.size / 4):
        raise InputError(
            f"{recording.attributes.name}: {len(table)} labels are {areas} areas. A "
            "mask? Number them: skimage.measure.label. A film? kilnflight run."
        )
    return table


def run_recording(
    source: Any, target: Path | str | None = None, workers: Any = None, **options: Any
) -> dict[str, pd.DataFrame]:
    """Run all steps on a recording, print what was found and return all tables.

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

    Returns
    -------
    dict
        Tables by name: detections, tracks, trajectories, flights, slices, summary.

    Raises
    ------
    InputError
        If the recording cannot be used, or a file cannot be written, as on a full disk.

    Examples
    --------
    >>> import kilnflight, tempfile
    >>> film = kilnflight.sample_film()
    >>> with tempfile.TemporaryDirectory() as folder:  # doctest: +ELLIPSIS
    ...     tables = kilnflight.run(film.frames, f"{folder}/results", threshold=500)
    recording        array
    ...
    >>> tables["tracks"]["frame"].nunique()
    16
    """
    given = Options(**options)
    recording = open_any(source)
    given.check(recording)
    target = Path(target or f"{recording.attributes.name}-run")
    check_apart(target, source, recording)
    stored = _stored(recording, target)
    workers = chain.workers_of(workers)
    run, rows = prepare(stored, target, given, workers)
    chain.make_tables([run], workers, steps=())
    if given.max_step or not run.post_processing:
        motion = motion_of(run.detection.detections(), given.max_step)
        run = replace(run, motion=motion)
        steps = f"expected step {motion.velocity} px; change {motion.noise:g} px"
        rows.append(("motion", steps))
    chain.make_tables([run], workers)
    tables = {"detections": run.detection.detections()}
    for step in CHAIN_STEPS:
        tables[step] = run.table(step)()
    rows.extend(units(stored.attributes))
    rows.extend(summary(tables).items())
    rows.extend(speed(tables["tracks"], stored.attributes))
    rows.extend(("warning", doubt) for doubt in doubts(tables))
    tables["summary"] = pd.DataFrame(rows, columns=["what", "value"])
    index = stored.per_frame["index"]
    contents = _contents(tables, stored, index[run.frames] - index[0])
    publish(contents, target, WRITTEN)
    rows.append(("written to", f"{target}"))
    return tables


def check_apart(
    target: Path, source: Any, recording: FileRecording | StoredRecording
) -> None:
    """Raise an `InputError` if a target is the recording, or lies in it."""
    place = target.resolve()
    own = [*getattr(recording, "files", ())]
    if isinstance(source, str | Path):
        own.append(Path(source))
    elif isinstance(recording, StoredRecording):
        own.append(recording.path)
    for path in own:
        inside = path.resolve() in (place, *place.parents)
        if not path.exists():  # a pattern
            inside = place.match(f"{path.absolute()}")
        if inside:
            raise InputError(
                f"{target}: is or lies in the recording. Name another place to write "
                "to."
            )


def _stored(
    recording: FileRecording | StoredRecording, target: Path
) -> StoredRecording:
    """Return a recording as Zarr; of a film a copy in ``target``, made if missing."""
    # What a stored one states is compared when it is opened, and by `prepare`.
    content = getattr(recording, "stated", None) or recording.content()
    with claimed(target, WRITTEN, content) as parts:
        copy = parts / f"recording-{content}.zarr"
        if isinstance(recording, StoredRecording):
            return recording
        if copy.exists():
            return open_recording(copy)
        return write_recording(recording, copy)


def _contents(
    tables: Tables, recording: Recording, frames: Any
) -> Iterator[tuple[str, bytes]]:
    """Yield names and contents of files, the tables first: no picture prevents them."""
    for name in ("detections", *CHAIN_STEPS):
        if name in ALWAYS or len(tables[name]):
            content = tables[name].to_parquet(index=False, write_page_checksum=True)
            yield f"{name}.parquet", content
    # Empty columns, such as millimetres of a film, are left out.
    for name in ("tracks", "summary"):
        known = tables[name].dropna(axis=1, thresh=min(1, len(tables[name])))
        yield f"{name}.csv", csv_of(known).encode()
    # Imported late: it imports matplotlib.
    from kilnflight.film.pictures import pictures, png

    for name, figure in pictures(recording, tables, frames):
        yield f"{name}.png", png(figure)
