"""The command line: import, export, info, preview, track, run."""

from __future__ import annotations

import argparse
import os
import signal
import warnings
from pathlib import Path
from typing import Any

from kilnflight import __version__

# The modules of a command are imported when it runs: they take time to load.


def main(arguments: list[str] | None = None) -> None:
    """Import, export and inspect recordings; preview, track or run it all."""
    options = (parser := _parser()).parse_args(arguments)
    for number in (
        signal.SIGTERM,
        signal.SIGHUP,
    ):  # as Ctrl-C, which ends all processes
        signal.signal(number, signal.default_int_handler)
    warnings.showwarning = lambda text, *_: print(f"warning: {text}")
    try:
        options.function(options)
    # ValueError: `InputError`, and what libraries say of settings; OSError: of a full
    # disk, too
    except (ValueError, OSError, KeyboardInterrupt) as error:
        parser.exit(2, f"kilnflight {options.command}: {str(error) or 'stopped'}\n")


def _opened(options: argparse.Namespace) -> Any:
    from kilnflight.film.run import check_apart
    from kilnflight.recording.files import open_any

    if not any(
        Path(os.environ.get("NUMBA_CACHE_DIR", Path(__file__).parent)).rglob("*.nbi")
    ):
        print("The first run compiles, which takes up to a minute.", flush=True)
    recording = open_any(options.recording, channel=options.channel)
    check_apart(
        getattr(options, "to", None) or Path(os.devnull), options.recording, recording
    )
    return recording


def _settings(options: argparse.Namespace) -> dict[str, Any]:
    from kilnflight.film.settings import Options

    return {
        k: v for k, v in vars(options).items() if hasattr(Options, k) and v is not None
    }


def _info(options: argparse.Namespace) -> None:
    from kilnflight.film.report import aligned, summarise_recording
    from kilnflight.recording.store import write_recording

    recording = _opened(options)
    if options.command == "import":
        recording = write_recording(
            recording, options.to or f"{recording.attributes.name}.zarr"
        )
        print(f"imported as {recording.path}")
    print(aligned(summarise_recording(recording)))


def _export(options: argparse.Namespace) -> None:
    from kilnflight.recording.store import write_recording
    from kilnflight.simulated.kiln import scenes, truth

    recording = scenes.open_scene(options.scene, seed=options.seed)
    frames = range(*options.frames or (len(recording),))
    stored = write_recording(
        recording, options.folder, frames, truth.tables(recording, frames)
    )
    print(
        f"exported {len(stored)} frames of {stored.attributes.name} to {options.folder}"
    )


def _preview(options: argparse.Namespace) -> None:
    from kilnflight.film.pictures import png, preview
    from kilnflight.store.cache import write_whole

    options.to = options.to or Path(
        "preview.png"
    )  # before it is opened: it is checked, too
    picture = png(preview(_opened(options), **_settings(options)))
    options.to.parent.mkdir(parents=True, exist_ok=True)
    write_whole(options.to, picture)
    print(f"three frames with the detections of three thresholds: {options.to}")


def _track(options: argparse.Namespace) -> None:
    from kilnflight.association import GNN, JPDA
    from kilnflight.film.doubts import doubtful_links
    from kilnflight.film.run import track_detections
    from kilnflight.film.spreading import followed
    from kilnflight.recording.track_files import (
        check_table_target,
        read_table,
        write_table,
    )

    check_table_target(options.tracks, options.format, options.detections)
    table = read_table(options.detections)
    associator = JPDA() if options.jpda else GNN()
    tracks = track_detections(table, associator, progress=True, **_settings(options))
    write_table(tracks, options.tracks, options.format)
    linked = followed(tracks)
    found = (
        f"{linked.particle.nunique()} tracks with {len(linked)} of {len(tracks)} "
        "detections"
    )
    print(found, *(f"warning: {doubt}" for doubt in doubtful_links(tracks)), sep="\n")


def _run(options: argparse.Namespace) -> None:
    from kilnflight.film.run import run_recording
    from kilnflight.store.parallel import Workers

    workers = Workers(options.jobs, options.scheduler, into_logs=True)
    run_recording(_opened(options), options.to, workers, **_settings(options))


FORMS = ("csv", "challenge", "napari", "trackmate", "trackpy")  # of tracks
_NUMBER = {"type": float}
_WHOLE = {"type": int}
_SWITCH = {"action": "store_true"}
ARGUMENTS: dict[str, Any] = {
    "recording": {
        "metavar": "PATH",
        "help": "film, stack, folder, pattern, array, manifest, Zarr",
    },
    "--channel": {
        "metavar": "COLOUR",
        "help": "red, green or blue (default: what varies most)",
    },
    "--to": {
        "type": Path,
        "help": "folder or picture to write; a stopped run goes on there",
    },
    "--detector": {"help": "dog for round spots (default), otsu for areas of any form"},
    "--background": {
        "help": "median of the frames around, or none (default: what fits)"
    },
    "--threshold": _NUMBER | {"metavar": "GREY", "help": "default: from the noise"},
    "--dark": _SWITCH | {"help": "particles are darker than the background"},
    "--small": _SWITCH
    | {"help": "search at least at twice the size (default: what finds most)"},
    "--size": _NUMBER
    | {"metavar": "PX", "help": "diameter of the particles, in place of --small"},
    "--roi": _WHOLE
    | {"nargs": 4, "metavar": "N", "help": "rows from, to; columns from, to"},
    "--frames": _WHOLE
    | {"nargs": 2, "metavar": ("A", "B"), "help": "A to B, B left out"},
    "--max-step": _NUMBER | {"metavar": "PX", "help": "longest step in a frame"},
    "--memory": _WHOLE
    | {"metavar": "N", "help": "frames that a track may miss (default: 5)"},
    "--post-processing": {
        "action": argparse.BooleanOptionalAction,
        "help": "default: with depth",
    },
    "--in-air": _NUMBER
    | {"metavar": "MM", "dest": "in_air_mm", "help": "from the kiln's axis"},
    "--jobs": _WHOLE | {"default": 1, "help": "processes side by side (default: 1)"},
    "--scheduler": {
        "metavar": "ADDRESS",
        "help": "Dask cluster that detects in their place",
    },
    "detections": {
        "type": Path,
        "metavar": "TABLE",
        "help": "frame, row, col or x, y (px)",
    },
    "tracks": {"type": Path, "metavar": "FILE", "help": "tracks to write"},
    "--jpda": _SWITCH | {"help": "associate by JPDA instead of GNN; slower"},
    "--format": {"choices": FORMS, "default": "csv", "help": "of FILE (default: csv)"},
    "scene": {"help": "such as confetti-4.5-bar; an unknown name lists all"},
    "folder": {"type": Path, "metavar": "FOLDER", "help": "folder to write"},
    "--seed": _WHOLE | {"help": "of the simulation (default: the scene's own)"},
}
_FOUND = (
    "recording --channel --to --detector --background --threshold --dark --small "
    "--size --roi"
)
_LINKED = "--max-step --memory --post-processing"
_WORKED = "--frames --in-air --jobs --scheduler"
COMMANDS = (
    (
        "import",
        _info,
        "store a recording of any kind as Zarr",
        "recording --channel --to",
    ),
    (
        "info",
        _info,
        "read every frame and print what a recording holds",
        "recording --channel",
    ),
    ("preview", _preview, "draw what three thresholds detect", f"{_FOUND} --frames"),
    ("run", _run, "all steps, to tracks and pictures", f"{_FOUND} {_LINKED} {_WORKED}"),
    (
        "track",
        _track,
        "link detections to tracks",
        f"detections tracks {_LINKED} --jpda --format",
    ),
    ("export", _export, "write a simulated recording", "scene folder --frames --seed"),
)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="kilnflight", description=main.__doc__)
    parser.add_argument(
        "--version", action="version", version=f"kilnflight {__version__}"
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, function, text, arguments in COMMANDS:
        command = commands.add_parser(name, help=text, description=text)
        command.set_defaults(function=function)
        for argument in arguments.split():
            command.add_argument(argument, **ARGUMENTS[argument])
    return parser


if __name__ == "__main__":
    main()
