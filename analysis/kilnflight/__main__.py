"""The command line: import, export, info, preview, track, run, belt."""

import argparse
import atexit
import gc
import signal
import tomllib
import warnings
from pathlib import Path
from typing import Any

import kilnflight
from kilnflight.arrays import Facts
from kilnflight.checks import InputError

# The modules of a command are imported when it runs: they take time to load. So are the
# public names of kilnflight.

LISTED = tomllib.loads(Path(__file__).with_name("commands.toml").read_text("utf-8"))
# What words of commands.toml stand for.
WORDS: dict[Any, Any] = {
    "int": int,
    "float": float,
    "path": Path,
    "yes or no": argparse.BooleanOptionalAction,
}


def main(arguments: list[str] | None = None) -> None:
    """Import, export and inspect recordings; preview, track, run it all; sort."""
    parser = _parser()
    options = parser.parse_args(arguments)
    for number in (signal.SIGTERM, signal.SIGHUP):
        # like Ctrl-C, which ends all processes
        signal.signal(number, signal.default_int_handler)
    atexit.register(gc.freeze)  # else the end of the process takes half a second
    warnings.showwarning = lambda text, *_: print(f"warning: {text}")
    from kilnflight.compiled import show_compiling

    show_compiling()
    try:
        options.function(options)
    # ValueError: `InputError`, and what libraries say of settings; OSError: a full disk
    except (ValueError, OSError, ImportError, MemoryError, KeyboardInterrupt) as error:
        reason = "no memory is left. Close other programs, or take fewer --frames"
        if not isinstance(error, MemoryError):
            reason = str(error) or "stopped"
        parser.exit(2, f"kilnflight {options.command}: {reason}\n")


def _opened(options: argparse.Namespace) -> Any:
    """Return the recording of a command."""
    from kilnflight.recording.readers import read_array

    return kilnflight.open(
        options.recording,
        channel=options.channel,
        frame_rate_hz=options.rate,
        um_per_px=options.scale,
        mask=options.mask and read_array(options.mask),
    )


def _settings(options: argparse.Namespace, kind: Any = None) -> Facts:
    """Return the given settings of a kind, or of `Options`, by name."""
    return {
        name: value
        for name, value in vars(options).items()
        if value is not None and hasattr(kind or kilnflight.Options, name)
    }


def _info(options: argparse.Namespace) -> None:
    """Read every frame and print what a recording, or each subset of one, holds."""
    from kilnflight.film.report import summarise_recording
    from kilnflight.recording.files import open_subsets
    from kilnflight.recording.survey import check_frame_fits

    if Path(options.recording).suffix.lower() != ".toml":
        summarise_recording(_opened(options))
        return
    for name, recording in open_subsets(options.recording).items():
        if recording.labelled:
            first = recording.frame(recording.labelled[0])
            check_frame_fits(first, f"{options.recording}, {name}")
        summarise_recording(recording)


def _import(options: argparse.Namespace) -> None:
    """Store a recording as Zarr; of an archive of many, draft the manifest."""
    from kilnflight.film.report import summarise_recording
    from kilnflight.film.run import check_apart
    from kilnflight.recording.series import is_archive

    if is_archive(Path(options.recording)):
        _draft(Path(options.recording), options.to)
        return
    recording = _opened(options)
    target = options.to or Path(f"{recording.attributes.name}.zarr")
    check_apart(target, options.recording, recording)
    stored = kilnflight.write_recording(recording, target)
    print(f"imported as {stored.path}")
    summarise_recording(stored)


def _draft(source: Path, target: Path | None) -> None:
    """Say what an archive or folder holds, and write the draft of its manifest."""
    from kilnflight.recording import series, survey
    from kilnflight.store.cache import write_whole

    folder = source if source.is_dir() else series.unpack(source)
    target = target or folder / "labelled.toml"
    if target.exists() or target.parent.resolve() != folder.resolve():
        raise InputError(f"{target}: name a new file in {folder}.")
    told, text = survey.draft(folder)
    write_whole(target, text.encode())
    print("\n".join(told))
    print(f"\n{text}\nwritten as {target}. Answer the lines with a question mark.")


def _export(options: argparse.Namespace) -> None:
    """Write a simulated recording."""
    from kilnflight.simulated.kiln import scenes, truth

    recording = scenes.open_scene(options.scene, seed=options.seed)
    frames = range(*options.frames or (len(recording),))
    tables = truth.tables(recording, frames)
    stored = kilnflight.write_recording(recording, options.folder, frames, tables)
    what = f"{len(stored)} frames of {stored.attributes.name}"
    print(f"exported {what} to {options.folder}")


def _preview(options: argparse.Namespace) -> None:
    """Draw what five thresholds detect."""
    from kilnflight.film.pictures import png
    from kilnflight.film.run import check_apart
    from kilnflight.store.cache import write_whole

    target = options.to or Path("preview.png")
    if target.suffix.lower() != ".png":
        raise InputError(f"{target}: name a picture .png.")
    recording = _opened(options)
    check_apart(target, options.recording, recording)
    picture = png(kilnflight.preview(recording, **_settings(options)))
    target.parent.mkdir(parents=True, exist_ok=True)
    write_whole(target, picture)
    print(f"three frames with the detections of five thresholds: {target}")


def _track(options: argparse.Namespace) -> None:
    """Link detections to tracks."""
    from kilnflight.film.spreading import followed
    from kilnflight.recording import track_files

    track_files.check_table_target(options.tracks, options.format, options.detections)
    associator = kilnflight.JPDA() if options.jpda else kilnflight.GNN()
    tracks = kilnflight.track(
        options.detections,
        associator,
        progress=True,
        **_settings(options),
    )
    track_files.write_table(tracks, options.tracks, options.format)
    linked = followed(tracks)
    share = f"{len(linked)} of {len(tracks)} detections"
    print(f"{linked['particle'].nunique()} tracks with {share}")


def _run(options: argparse.Namespace) -> None:
    """Run all steps, to tracks and pictures; of several films each in its folder."""
    from kilnflight.film.run import check_apart

    workers = kilnflight.Workers(options.jobs or 1, options.scheduler, into_logs=True)
    several = len(options.recordings) > 1
    failed = []
    for path in options.recordings:
        options.recording = path
        try:
            recording = _opened(options)
            name = recording.attributes.name
            target = options.to or Path(f"{name}-run")
            if several and len(recording) == 1:
                failed = [f"{path}: one picture is no film. Put a pattern in quotes."]
                break
            if several and options.to:
                target /= name
            check_apart(target, path, recording)
            kilnflight.run(recording, target, workers, **_settings(options))
        except (ValueError, OSError) as error:  # as in `main`
            failed.append(f"{error}")
    if failed:
        raise InputError("\n".join(failed))


def _belt(options: argparse.Namespace) -> None:
    """Predict when particles reach a sorter's valves, from a table of their places."""
    line = kilnflight.Line(**_settings(options, kilnflight.Line))
    target = options.to or Path(f"{Path(options.spots).stem}-belt")
    kilnflight.run_belt(options.spots, target, line, options.calibration)


COMMANDS: Facts = {
    "info": _info,
    "import": _import,
    "export": _export,
    "preview": _preview,
    "track": _track,
    "run": _run,
    "belt": _belt,
}


def _parser() -> argparse.ArgumentParser:
    """Return the parser of all commands."""
    parser = argparse.ArgumentParser(prog="kilnflight", description=main.__doc__)
    version = f"kilnflight {kilnflight.__version__}"
    parser.add_argument("--version", action="version", version=version)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, arguments in LISTED["commands"].items():
        function = COMMANDS[name]
        does = function.__doc__
        added = commands.add_parser(name, help=does, description=does)
        added.set_defaults(function=function)
        for argument in arguments:
            given = LISTED["arguments"][argument].items()
            added.add_argument(argument, **{key: _value(each) for key, each in given})
    return parser


def _value(given: Any) -> Any:
    """Return a value of commands.toml as argparse takes it."""
    if isinstance(given, list):
        return tuple(given)
    return WORDS.get(given, given)


if __name__ == "__main__":
    main()
