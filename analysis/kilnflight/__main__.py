"""The command line: bring recordings in or out, look at one, detect, track, or do it all."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import pandas as pd
from tqdm import tqdm

from kilnflight import kiln
from kilnflight.association import GNN, JPDA
from kilnflight.checks import InputError
from kilnflight.detection import DoG
from kilnflight.detection.combination import Combination
from kilnflight.project.cache import write_whole
from kilnflight.recording.importing import import_recording
from kilnflight.recording.store import open_recording, write_recording
from kilnflight.recording.summary import summarise
from kilnflight.tables import DETECTIONS
from kilnflight.tracking import files as track_files
from kilnflight.tracking.tracker import track
from kilnflight.tracklets import postprocess, tracked

FORMATS = {
    "challenge": track_files.write_challenge,
    "napari": track_files.write_napari,
    "trackmate": track_files.write_trackmate,
    "trackpy": track_files.write_trackpy,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Import your own recordings, export the twin's, say what one holds, detect, track, or all."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if "--exit-point" in given[:-1]:  # argparse takes -77,250,6828 for an option
        k = given.index("--exit-point")
        given[k : k + 2] = [f"--exit-point={given[k + 1]}"]
    options = _parser().parse_args(given)
    try:
        if options.command == "import":
            target = options.to or options.manifest.with_suffix(".zarr")
            print(import_recording(options.manifest, target).text())
            print(f"imported as {target}")
        elif options.command == "export":
            _export(options.scene, options.folder, options.frames, options.seed)
        elif options.command == "detect":
            _detect(options.folder, options.table, options.threshold)
        elif options.command == "track":
            _track(options)
        elif options.command == "run":
            _run(options)
        else:
            print(summarise(open_recording(options.folder)).text())
    except (InputError, OSError) as error:  # OSError: a full disk, a folder without permission
        print(f"kilnflight {options.command}: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"kilnflight {options.command}: stopped", file=sys.stderr)
        return 1
    return 0


def _export(scene: str, folder: Path, part: str | None, seed: int | None) -> None:
    from kilnflight.twin import scenes, truth  # here: only this command needs the twin

    recording = scenes.open_scene(scene, seed=seed)
    frames = _frames(part, len(recording)) if part else None
    stored = write_recording(recording, folder, frames, truth.tables(recording, frames))
    print(f"exported {len(stored)} frames of {stored.attributes.name} to {folder}")


def _detect(folder: Path, target: Path, threshold: float) -> None:
    recording, detector = open_recording(folder), Combination(DoG(threshold))
    roi, wanted = recording.attributes.roi, range(len(recording))
    frames = tqdm(kiln.views(recording, wanted), total=len(wanted), unit="frame", disable=None)
    parts = [detector(view, roi, t) for t, view in frames]
    found = pd.concat([DETECTIONS.empty(), *parts], ignore_index=True)
    write_whole(target, found.to_csv(index=False).encode())
    print(
        f"{len(found)} detections in {len(wanted)} frames of {recording.attributes.name}: {target}"
    )


def _track(options: argparse.Namespace) -> None:
    try:
        detections = pd.read_csv(options.detections)
    except (ValueError, UnicodeDecodeError) as error:
        raise InputError(f"{options.detections}: is no CSV table ({error}).") from error
    if detections.empty:  # a CSV without rows has columns of no kind
        whole = [name for name in ("frame", "points") if name in detections]
        detections = detections.astype(float).astype(dict.fromkeys(whole, int))
    tracks = track(detections, JPDA() if options.jpda else GNN())
    if not options.raw:
        tracks = postprocess(tracks)
    if options.format == "csv":
        write_whole(options.tracks, tracks.to_csv(index=False).encode())
    else:
        FORMATS[options.format](tracks, options.tracks)
    kept = tracked(tracks)
    print(
        f"{kept['particle'].nunique()} tracks with {len(kept)} of {len(tracks)} detections: "
        f"{options.tracks}"
    )


def _run(options: argparse.Namespace) -> None:
    from kilnflight import outcome_page, own  # here: it takes time to load them
    from kilnflight.outcome import outcome, summary, text, used
    from kilnflight.project.parallel import Workers

    lance = own.point(options.exit_point) if options.exit_point else None
    wishes = own.Wishes(
        options.threshold, lance, options.in_air, options.bright, options.above_background
    )
    workers = Workers(options.jobs, options.scheduler, into_logs=True)
    target = options.to or own.beside(options.folder)
    prepared = own.prepare(options.folder, target, wishes)
    for note in prepared.notes:
        print(f"note: {note}")
    kiln.make_tables([prepared.run], workers)
    jobs = str(options.jobs) if options.scheduler is None else f"those of {options.scheduler}"
    told = used(prepared.run, wishes.given, jobs)
    found = outcome(prepared.run, prepared.notes, told)
    for note in found.notes[len(prepared.notes) :]:
        print(f"note: {note}")
    report = outcome_page.publish(found, open_recording(options.folder), target)
    print(text(summary(found)))
    print(f"tables and report: {report}")


def _frames(text: str, length: int) -> range:
    """Return the frames A to B, B excluded.

    Examples
    --------
    >>> _frames("100:110", 3000)
    range(100, 110)
    >>> _frames(":5", 3000)
    range(0, 5)
    """
    first, colon, last = text.partition(":")
    try:
        frames = range(int(first or 0), int(last or length))
    except ValueError:
        colon = ""
    if not colon or not frames or frames.start < 0 or frames.stop > length:
        raise InputError(
            f"--frames {text}: write A:B with 0 <= A < B <= {length}; B itself is left out."
        )
    return frames


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="kilnflight", description=main.__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    command = commands.add_parser("import", help="import the files that a manifest names")
    command.add_argument(
        "manifest", type=Path, help="TOML; see python -m pydoc kilnflight.recording.importing"
    )
    command.add_argument("--to", type=Path, metavar="DIR", help="default: <manifest>.zarr")
    command = commands.add_parser("export", help="write a scene of the twin to disk")
    command.add_argument("scene")
    command.add_argument("folder", type=Path, metavar="DIR")
    command.add_argument("--frames", metavar="A:B", help="only frames A to B, B excluded")
    command.add_argument("--seed", type=int, help="default: the scene's own")
    command = commands.add_parser("info", help="read every frame and say what a recording holds")
    command.add_argument("folder", type=Path, metavar="DIR")
    command = commands.add_parser("detect", help="detect particles in a recording, into a CSV")
    command.add_argument("folder", type=Path, metavar="DIR")
    command.add_argument("table", type=Path, metavar="CSV")
    command.add_argument(
        "--threshold", type=float, required=True, help="of DoG in grey values; depends on exposure"
    )
    command = commands.add_parser("track", help="link detections to tracks")
    command.add_argument("detections", type=Path, metavar="CSV", help="frame, row, col, maybe z")
    command.add_argument("tracks", type=Path, metavar="FILE")
    command.add_argument("--jpda", action="store_true", help="JPDA in place of GNN")
    command.add_argument(
        "--raw",
        action="store_true",
        help="no post-processing (which here lacks its texture term)",
    )
    command.add_argument("--format", choices=["csv", *FORMATS], default="csv")
    _add_run(commands.add_parser("run", help="all steps from a recording to flights, and a report"))
    return parser


def _add_run(command: argparse.ArgumentParser) -> None:
    command.add_argument("folder", type=Path, metavar="RECORDING")
    command.add_argument(
        "--to",
        type=Path,
        metavar="FOLDER",
        help="a killed run goes on there, from its folder parts, which may be deleted when all "
        "is done (default: <recording>-run)",
    )
    command.add_argument("--threshold", type=float, help="of DoG; default: five times the noise")
    command.add_argument(
        "--exit-point",
        metavar="x,y,z",
        help="where the lance ends, mm as captured (before Eq. 2.4); default: as recorded",
    )
    command.add_argument(
        "--in-air",
        type=float,
        default=800.0,
        metavar="MM",
        help="largest distance from the kiln's axis of what is in the air (default: 800)",
    )
    command.add_argument(
        "--bright",
        type=float,
        metavar="GRAY",
        help="grey value that only what burns reaches: alight when first seen (default: not asked)",
    )
    command.add_argument(
        "--above-background",
        action="store_true",
        help="ignition is a rise above the kiln behind a particle, which may itself be brighter "
        "on the way (default: of the grey values as they are, as in the thesis)",
    )
    command.add_argument("--jobs", type=int, default=1, help="processes (default: 1)")
    command.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask cluster that detects")


if __name__ == "__main__":
    raise SystemExit(main())
