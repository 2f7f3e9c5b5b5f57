"""A notebook's text (jupytext percent) becomes an executed notebook, or says why not.

    notebooks/NN_name.py -> build/NN_name.ipynb

The executed notebook appears under its name only when every cell has run. When one
fails, what was executed until then stays as ``build/NN_name.failed.ipynb``.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import logging
import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jupytext
import nbformat
import papermill
from nbclient.exceptions import DeadKernelError
from papermill.exceptions import PapermillExecutionError

from kilnflight.checks import InputError
from kilnflight.project.paths import PROGRESS, SAVED_LIST

SCALES = ("quick", "standard", "full")
TELL_S = 60.0  # between two words on how far long work is


def read_source(path: Path) -> nbformat.NotebookNode:
    """Return a notebook from its text, with cell ids that depend on the text alone.

    Raises
    ------
    InputError
        If there is no such file or it has no cell tagged ``parameters``.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such notebook; see notebooks/.")
    notebook = jupytext.read(path)
    for position, cell in enumerate(notebook.cells):
        text = f"{position} {cell.cell_type} {cell.source}"
        cell["id"] = hashlib.sha256(text.encode()).hexdigest()[:8]
    if not any("parameters" in cell.metadata.get("tags", []) for cell in notebook.cells):
        raise InputError(
            f'{path}: no cell is tagged parameters; start it with # %% tags=["parameters"].'
        )
    notebook.metadata["kernelspec"] = {
        "name": "python3",
        "display_name": "Python 3",
        "language": "python",
    }
    return notebook


def known_parameters(notebook: nbformat.NotebookNode) -> dict[str, object]:
    """Return the names and default values of the notebook's parameters cell."""
    values: dict[str, object] = {}
    for cell in notebook.cells:
        if "parameters" in cell.metadata.get("tags", []):
            for statement in ast.parse(cell.source).body:
                if isinstance(statement, ast.Assign) and isinstance(statement.targets[0], ast.Name):
                    values[statement.targets[0].id] = ast.literal_eval(statement.value)
    return values


def parse_parameters(
    items: Iterable[str], stem: str, notebooks: Iterable[str] = ()
) -> dict[str, object]:
    """Return the parameters that are meant for one notebook.

    Parameters
    ----------
    items
        ``name=value`` for every notebook, ``NN.name=value`` for notebook NN only; a
        value is a Python literal or else a string.
    stem
        The notebook, for example ``"02_depth_calibration"``.
    notebooks
        Stems of all notebooks; a number that none of them has is an error then.

    Examples
    --------
    >>> parse_parameters(["seed=3", "02.points=50", "40.draws=9"], "02_depth_calibration")
    {'seed': 3, 'points': 50}
    """
    values: dict[str, object] = {}
    numbers = {name.split("_")[0] for name in notebooks}
    for item in items:
        name, equals, text = item.partition("=")
        number, dot, rest = name.partition(".")
        if not equals or not (rest if dot else name).isidentifier():
            raise InputError(
                f"parameter {item!r}: write name=value, or NN.name=value for one notebook."
            )
        if dot and (not number.isdigit() or (numbers and number not in numbers)):
            known = f" ({', '.join(sorted(numbers))})" if numbers else ""
            raise InputError(f"parameter {item!r}: {number!r} is no notebook's number{known}.")
        if dot and number != stem.split("_")[0]:
            continue
        try:
            values[rest if dot else name] = ast.literal_eval(text)
        except (ValueError, SyntaxError):
            values[rest if dot else name] = text
    return values


def check_parameters(stem: str, known: Mapping[str, object], given: Mapping[str, object]) -> None:
    """Raise an `InputError` for a parameter that the notebook does not know or cannot take."""
    for name, value in given.items():
        if name not in known:
            raise InputError(
                f"{stem}: unknown parameter {name!r}; it knows {', '.join(known) or 'none'}. "
                f"For one notebook only, write {stem.split('_')[0]}.name=value."
            )
        default = known[name]
        same = isinstance(value, type(default)) or (
            isinstance(default, float) and isinstance(value, int)
        )
        if not same or isinstance(value, bool) != isinstance(default, bool):
            raise InputError(
                f"{stem}: parameter {name} is {value!r}, expected {type(default).__name__} "
                f"(the default is {default!r})."
            )
    if given.get("scale", SCALES[0]) not in SCALES:
        raise InputError(f"{stem}: scale {given['scale']!r} is none of {', '.join(SCALES)}.")


def run(source: Path, build: Path, given: Mapping[str, object]) -> Path:
    """Execute a notebook with papermill and return the executed one.

    The cells run in the project's folder (the current directory).

    Raises
    ------
    InputError
        If the source or a parameter is wrong; nothing is executed then.
    papermill.exceptions.PapermillExecutionError
        If a cell fails; what ran is kept as ``<stem>.failed.ipynb``.
    """
    stem = source.stem
    notebook = read_source(source)
    known = known_parameters(notebook)
    check_parameters(stem, known, given)
    if given.get("scale") == "quick" and "jobs" in known:
        given = {"jobs": 1, **given}  # a process takes longer to start than its share of the work
    build.mkdir(parents=True, exist_ok=True)
    for left_behind in build.glob(f".{stem}.*.ipynb"):  # of a run that was killed outright
        left_behind.unlink()
    whole, failed = build / f"{stem}.ipynb", build / f"{stem}.failed.ipynb"
    plain = build / f".{stem}.{os.getpid()}.source.ipynb"
    partial = build / f".{stem}.{os.getpid()}.partial.ipynb"
    # figures.save notes what it wrote here, so that make sees when a figure goes missing
    saved = build / f".{stem}.{os.getpid()}.saved.part"
    progress = build / f".{stem}.{os.getpid()}.progress"
    os.environ |= {SAVED_LIST: str(saved.resolve()), PROGRESS: str(progress.resolve())}
    ended = threading.Event()
    teller = threading.Thread(target=_tell, args=(stem, progress, ended), daemon=True)
    teller.start()
    try:
        nbformat.write(notebook, plain)
        papermill.execute_notebook(
            str(plain),
            str(partial),
            parameters=dict(given),
            kernel_name="python3",
            cwd=str(Path.cwd()),
            # the kernel talks on this machine only; its advice about encryption is noise here
            extra_arguments=["--IPKernelApp.log_level=CRITICAL"],
            progress_bar={"desc": stem, "unit": "cell"} if sys.stderr.isatty() else False,
        )
        failed.unlink(missing_ok=True)
        if saved.is_file():
            saved.replace(build / f"{stem}.saved")
        partial.replace(whole)
        return whole
    except PapermillExecutionError:
        partial.replace(failed)
        raise
    finally:
        ended.set()
        teller.join()  # it may be reading what is removed below
        del os.environ[SAVED_LIST], os.environ[PROGRESS]
        for temporary in (plain, partial, saved, progress):
            temporary.unlink(missing_ok=True)


def _tell(stem: str, progress: Path, ended: threading.Event) -> None:
    """Print every now and then how far a notebook's long work is, until it has ended."""
    before = ""
    while not ended.wait(TELL_S):
        drawn = progress.read_text().split("\n") if progress.is_file() else []
        last = next((line.strip() for line in reversed(drawn) if line.strip()), "")
        if last and last != before:
            print(f"{stem}: {last}", flush=True)
        before = last


def explain(stem: str, error: PapermillExecutionError, kept: Path) -> str:
    """Return one clear line about a failed cell: notebook, cell, error, where to look."""
    first = next((line for line in error.source.splitlines() if line.strip()), "")
    return (
        f"{stem}: cell {error.cell_index + 1} ({first}) failed: {error.ename}: {error.evalue} "
        f"(executed so far: {kept})"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Execute one notebook (called by make)."""
    parser = argparse.ArgumentParser(
        prog="python -m kilnflight.project.notebooks", description=main.__doc__
    )
    parser.add_argument("source", type=Path)
    parser.add_argument("--build", type=Path, default=Path("build"))
    parser.add_argument("-p", "--parameter", action="append", default=[], metavar="name=value")
    options = parser.parse_args(arguments)
    # asked to end, by whatever signal: clean up as after Ctrl-C (asyncio passes nothing else on)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    # what was under way when the kernel was killed is reported below, in one line
    logging.getLogger("asyncio").setLevel(logging.CRITICAL)
    stem = options.source.stem
    started = time.monotonic()
    try:
        notebooks = [path.stem for path in options.source.parent.glob("[0-9][0-9]_*.py")]
        given: dict[str, Any] = parse_parameters(options.parameter, stem, notebooks)
        for path in sorted(options.source.parent.glob("[0-9][0-9]_*.py")):
            # all of them before any runs: half a set of new figures is worse than none
            meant = parse_parameters(options.parameter, path.stem, notebooks)
            if path == options.source or meant.keys() - {"scale"}:  # all know a scale (tested)
                check_parameters(path.stem, known_parameters(read_source(path)), meant)
        shown = ", ".join(f"{name} = {value}" for name, value in given.items())
        print(f"{stem}: running ({shown})", flush=True)
        with warnings.catch_warnings():
            # papermill's own use of a deprecated call; nothing a reader could act on
            warnings.simplefilter("ignore", DeprecationWarning)
            run(options.source, options.build, given)
    except InputError as error:
        print(f"{stem}: {error}" if stem not in str(error) else str(error), file=sys.stderr)
        return 1
    except PapermillExecutionError as error:
        kept = options.build / f"{stem}.failed.ipynb"
        print(explain(stem, error, kept), file=sys.stderr)
        return 1
    except (KeyboardInterrupt, DeadKernelError) as error:
        why = "" if isinstance(error, KeyboardInterrupt) else " (its kernel was killed or died)"
        print(f"{stem}: interrupted{why}; the same make goes on from here", file=sys.stderr)
        return 130
    print(f"{stem}: done in {time.monotonic() - started:.0f} s", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
