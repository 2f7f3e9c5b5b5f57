"""The command line: import, export, info, detect, track, run."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kilnflight.checks import InputError, check_target

if TYPE_CHECKING:
    import pandas as pd

FORMATS = ("csv", "challenge", "napari", "trackmate", "trackpy")

# The modules of a command are imported when it is asked for: they take time to load.


def main(arguments: Sequence[str] | None = None) -> int:
    """Import, export and inspect recordings; detect, track or run it all."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    if "--exit-point" in words[:-1]:  # argparse takes -77,250,6828 for an option
        k = words.index("--exit-point")
        words[k : k + 2] = [f"--exit-point={words[k + 1]}"]
    options = _parser().parse_args(words)
    try:
        options.function(options)
    except (InputError, OSError) as error:  # OSError: a full disk, a folder without permission
        print(f"kilnflight {options.command}: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"kilnflight {options.command}: stopped", file=sys.stderr)
        return 1
    return 0


def _import(options: argparse.Namespace) -> None:
    from kilnflight.recording.importing import import_recording
    from kilnflight.recording.summary import aligned

    target = options.to or options.manifest.with_suffix(".zarr")
    print(aligned(import_recording(options.manifest, target)))
    print(f"imported as {target}")


def _info(options: argparse.Namespace) -> None:
    from kilnflight.recording.store import open_recording
    from kilnflight.recording.summary import aligned, summarise

    print(aligned(summarise(open_recording(options.folder))))


def _export(options: argparse.Namespace) -> None:
    from kilnflight.recording.store import write_recording
    from kilnflight.twin import scenes, truth

    recording = scenes.open_scene(options.scene, seed=options.seed)
    frames = _frames(options.frames, len(recording)) if options.frames else None
    stored = write_recording(recording, options.folder, frames, truth.tables(recording, frames))
    print(f"exported {len(stored)} frames of {stored.attributes.name} to {options.folder}")


def _detect(options: argparse.Namespace) -> None:
    from kilnflight import run
    from kilnflight.project.cache import write_whole
    from kilnflight.recording.store import open_recording

    check_target(options.table)
    parquet = _is_parquet(options.table)
    recording = open_recording(options.folder)
    table = run.detect(recording, options.threshold, progress=True)
    write_whole(options.table, table.to_parquet() if parquet else _csv(table))
    where = f"{len(recording)} frames of {recording.attributes.name}: {options.table}"
    print(f"{len(table)} detections in {where}")


def _track(options: argparse.Namespace) -> None:
    import pandas as pd

    from kilnflight import run
    from kilnflight.association import GNN, JPDA
    from kilnflight.project.cache import write_whole
    from kilnflight.recording import track_files
    from kilnflight.tracklets import tracked

    check_target(options.tracks)
    to_parquet = options.format == "csv" and _is_parquet(options.tracks)
    parquet = _is_parquet(options.detections)
    try:
        detections = (pd.read_parquet if parquet else pd.read_csv)(options.detections)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        kind = "Parquet" if parquet else "CSV"
        raise InputError(
            f"{options.detections}: is no {kind} table ({reason}). Give one that kilnflight detect "
            "wrote, or with the columns frame, row, col."
        ) from error
    if detections.empty:  # a CSV without rows has columns of no kind
        detections = detections.astype(int)
    tracks = run.track(detections, JPDA() if options.jpda else GNN(), options.raw)
    if options.format == "csv":
        write_whole(options.tracks, tracks.to_parquet() if to_parquet else _csv(tracks))
    else:
        getattr(track_files, f"write_{options.format}")(tracks, options.tracks)
    linked = tracked(tracks)
    counts = f"{linked['particle'].nunique()} tracks with {len(linked)} of {len(tracks)}"
    print(f"{counts} detections: {options.tracks}")


def _is_parquet(path: Path) -> bool:
    """Return whether a table is Parquet by its name, or CSV.

    Examples
    --------
    >>> _is_parquet(Path("found.parquet"))
    True
    """
    if path.suffix.lower() not in ("", ".csv", ".txt", ".parquet"):
        raise InputError(f"{path}: name a table .csv or .parquet.")
    return path.suffix.lower() == ".parquet"


def _csv(table: pd.DataFrame) -> bytes:
    return table.to_csv(index=False).encode()


def _run(options: argparse.Namespace) -> None:
    from kilnflight import run
    from kilnflight.project.parallel import Workers

    lance = _point(options.exit_point) if options.exit_point else None
    rules = options.in_air, options.bright, options.above_background, options.air
    workers = Workers(options.jobs, options.scheduler, into_logs=True)
    run.run(options.folder, options.to, run.Options(options.threshold, lance, *rules), workers)


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


def _point(text: str) -> tuple[float, float, float]:
    """Return x, y, z of a text, or raise an `InputError`.

    Examples
    --------
    >>> _point("-77, 250.7,6828")
    (-77.0, 250.7, 6828.0)
    """
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        x = y = z = math.nan
    if not all(map(math.isfinite, (x, y, z))):
        raise InputError(f"--exit-point {text}: write x,y,z in mm, such as -77,250.7,6828.")
    return x, y, z


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="kilnflight", description=main.__doc__)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def add(name: str, function: Callable[[argparse.Namespace], None], text: str) -> Any:
        command = commands.add_parser(name, help=text, description=text)
        command.set_defaults(function=function)
        return command.add_argument

    recording = "folder that import or export wrote"

    argument = add("import", _import, "import your own images, coordinates and labels")
    manifest = "TOML file; python -m pydoc kilnflight.recording.importing shows one"
    argument("manifest", type=Path, help=manifest)
    argument("--to", type=Path, metavar="FOLDER", help="default: <name of the manifest>.zarr")

    argument = add("info", _info, "read every frame and print what a recording holds")
    argument("folder", type=Path, metavar="RECORDING", help=recording)

    argument = add("run", _run, "all steps from a recording to flights, and a report")
    argument("folder", type=Path, metavar="RECORDING", help=recording)
    target = (
        "folder of the tables and the report; a stopped run goes on there (default: "
        "<recording>-run). Its folder parts may be deleted at the end"
    )
    argument("--to", type=Path, metavar="FOLDER", help=target)
    threshold = "least response of a keypoint, grey values (default: five times the noise)"
    argument("--threshold", type=float, metavar="GREY", help=threshold)
    lance = "outlet of the lance, mm as captured (default: as recorded)"
    argument("--exit-point", metavar="x,y,z", help=lance)
    axis = "largest distance from the kiln's axis of a particle in the air (default: 800)"
    argument("--in-air", type=float, default=800.0, metavar="MM", help=axis)
    burning = "grey value that only burning particles reach: alight when first seen (default: none)"
    argument("--bright", type=float, metavar="GREY", help=burning)
    above = "find ignition above the background (default: in the grey values as they are)"
    argument("--above-background", action="store_true", help=above)
    air = "velocity of the lance's air; what is over twice as fast is refused (default: 16)"
    argument("--air", type=float, default=16.0, metavar="M/S", help=air)
    argument("--jobs", type=int, default=1, help="processes side by side (default: 1)")
    argument("--scheduler", metavar="ADDRESS", help="Dask cluster that detects in their place")

    argument = add("detect", _detect, "detect particles in a recording")
    argument("folder", type=Path, metavar="RECORDING", help=recording)
    argument("table", type=Path, metavar="TABLE", help="detections to write: .csv or .parquet")
    argument("--threshold", type=float, metavar="GREY", help=threshold)

    argument = add("track", _track, "link detections to tracks")
    detections = "table of detections: frame, row, col (px); z (mm), points if known"
    argument("detections", type=Path, metavar="TABLE", help=detections)
    argument("tracks", type=Path, metavar="FILE", help="tracks to write")
    argument("--jpda", action="store_true", help="associate by JPDA instead of GNN; slower")
    raw = "leave out post-processing, which without images has no texture term"
    argument("--raw", action="store_true", help=raw)
    argument("--format", choices=FORMATS, default="csv", help="of FILE (default: csv)")

    argument = add("export", _export, "write a simulated recording (the twin's) and its truth")
    argument("scene", help="such as confetti-4.5-bar; an unknown name lists all")
    argument("folder", type=Path, metavar="FOLDER", help="folder to write")
    argument("--frames", metavar="A:B", help="frames A to B, B left out (default: all)")
    argument("--seed", type=int, help="of the simulation (default: the scene's own)")
    return parser


if __name__ == "__main__":
    raise SystemExit(main())
