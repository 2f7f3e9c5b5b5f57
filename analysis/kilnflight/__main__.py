"""The command line: import, export, info, detect, track, run."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from kilnflight.checks import InputError

FORMS = ("csv", "challenge", "napari", "trackmate", "trackpy")  # of tracks

# The modules of a command are imported when it runs: they take time to load.


def main(arguments: Sequence[str] | None = None) -> int:
    """Import, export and inspect recordings; detect, track or run it all."""
    options = _parser().parse_args(arguments)
    try:
        options.function(options)
    except (InputError, OSError, KeyboardInterrupt) as error:  # OSError: of a full disk, too
        print(f"kilnflight {options.command}: {str(error) or 'stopped'}", file=sys.stderr)
        return 1
    return 0


def _import(options: argparse.Namespace) -> None:
    from kilnflight.recording.files import open_any
    from kilnflight.recording.store import write_recording
    from kilnflight.run.contents import aligned, summarise_recording

    target = options.to or Path(options.recording).with_suffix(".zarr")
    print(aligned(summarise_recording(write_recording(open_any(options.recording), target))))
    print(f"imported as {target}")


def _info(options: argparse.Namespace) -> None:
    from kilnflight.recording.files import open_any
    from kilnflight.run.contents import aligned, summarise_recording

    print(aligned(summarise_recording(open_any(options.recording))))


def _export(options: argparse.Namespace) -> None:
    from kilnflight.recording.store import write_recording
    from kilnflight.twin import scenes, truth

    recording = scenes.open_scene(options.scene, seed=options.seed)
    frames = range(*options.frames or (len(recording),))
    if not frames or frames[0] < 0 or frames[-1] >= len(recording):
        raise InputError(f"--frames: {options.scene} has 0 to {len(recording)}; A is below B.")
    stored = write_recording(recording, options.folder, frames, truth.tables(recording, frames))
    print(f"exported {len(stored)} frames of {stored.attributes.name} to {options.folder}")


def _detect(options: argparse.Namespace) -> None:
    from kilnflight import run
    from kilnflight.recording.files import open_any
    from kilnflight.recording.track_files import check_table_target, write_table

    check_table_target(options.table)
    recording = open_any(options.recording)
    for note in recording.attributes.notes:
        print(f"note: {note}")
    table = run.detect(recording, options.threshold, progress=True)
    write_table(table, options.table)
    print(f"{len(table)} detections in {len(recording)} frames: {options.table}")


def _track(options: argparse.Namespace) -> None:
    from kilnflight import run
    from kilnflight.association import GNN, JPDA
    from kilnflight.recording.track_files import check_table_target, read_table, write_table
    from kilnflight.tracklets import tracked

    check_table_target(options.tracks, options.format)
    detections = read_table(options.detections)
    tracks = run.track_detections(detections, JPDA() if options.jpda else GNN(), options.raw)
    write_table(tracks, options.tracks, options.format)
    linked, all_rows = tracked(tracks)["particle"], len(tracks)
    counts = f"{linked.nunique()} tracks with {len(linked)} of {all_rows} detections"
    print(f"{counts}: {options.tracks}")


def _run(options: argparse.Namespace) -> None:
    from kilnflight import run
    from kilnflight.project.parallel import Workers

    lance = tuple(options.exit_point) if options.exit_point else None
    rules = options.in_air, options.bright, options.above_background, options.air, options.dark
    workers = Workers(options.jobs, options.scheduler, into_logs=True)
    settings = run.Options(options.threshold, lance, *rules)
    run.run_recording(Path(options.recording), options.to, settings, workers)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="kilnflight", description=main.__doc__)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    kinds = "film, TIFF stack, folder or pattern of pictures, array, manifest, Zarr recording"
    grey = "least response of a keypoint, grey values (default: five times the noise)"

    def add(name: str, function: Callable[[argparse.Namespace], None], text: str) -> Any:
        command = commands.add_parser(name, help=text, description=text)
        command.set_defaults(function=function)
        if name not in ("track", "export"):
            command.add_argument("recording", metavar="PATH", help=kinds)
        return command.add_argument

    argument = add("import", _import, "store a recording of any kind as Zarr")
    argument("--to", type=Path, metavar="FOLDER", help="default: <name of PATH>.zarr")

    add("info", _info, "read every frame and print what a recording holds")

    argument = add("run", _run, "all steps from a recording to flights, and a report")
    argument("--to", type=Path, metavar="DIR", help="of the results; a stopped run goes on there")
    argument("--threshold", type=float, metavar="GREY", help=grey)
    argument("--dark", action="store_true", help="particles are darker than the background")
    lance = {"nargs": 3, "type": float, "metavar": ("X", "Y", "Z")}
    argument("--exit-point", **lance, help="outlet of the lance, mm as captured")
    axis = "largest distance from the kiln's axis of a particle in the air (default: 800)"
    argument("--in-air", type=float, default=800.0, metavar="MM", help=axis)
    argument("--bright", type=float, metavar="GREY", help="value that only burning particles reach")
    argument("--above-background", action="store_true", help="find ignition above the background")
    air = "air of the lance (default: 16)"
    argument("--air", type=float, default=16.0, metavar="M/S", help=air)
    argument("--jobs", type=int, default=1, help="processes side by side (default: 1)")
    argument("--scheduler", metavar="ADDRESS", help="Dask cluster that detects in their place")

    argument = add("detect", _detect, "detect particles in a recording")
    argument("table", type=Path, metavar="TABLE", help="detections to write: .csv or .parquet")
    argument("--threshold", type=float, metavar="GREY", help=grey)

    argument = add("track", _track, "link detections to tracks")
    columns = "detections: frame, row, col or x, y (px); z (mm) beside row, points if known"
    argument("detections", type=Path, metavar="TABLE", help=columns)
    argument("tracks", type=Path, metavar="FILE", help="tracks to write")
    argument("--jpda", action="store_true", help="associate by JPDA instead of GNN; slower")
    argument("--raw", action="store_true", help="leave out post-processing")
    argument("--format", choices=FORMS, default="csv", help="of FILE (default: csv)")

    argument = add("export", _export, "write a simulated recording (the twin's) and its truth")
    argument("scene", help="such as confetti-4.5-bar; an unknown name lists all")
    argument("folder", type=Path, metavar="FOLDER", help="folder to write")
    frames = {"nargs": 2, "type": int, "metavar": ("A", "B")}
    argument("--frames", **frames, help="frames A to B, B left out (default: all)")
    argument("--seed", type=int, help="of the simulation (default: the scene's own)")
    return parser


if __name__ == "__main__":
    raise SystemExit(main())
