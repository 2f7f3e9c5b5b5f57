"""Execution of a notebook's text (jupytext percent), or one line why it failed.

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
import tempfile
import threading
import time
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import jupytext
import nbformat
import papermill
from nbclient.exceptions import DeadKernelError
from papermill.exceptions import PapermillExecutionError
from traitlets.config import Config

from kilnflight.checks import InputError
from kilnflight.project.cache import write_whole
from kilnflight.project.paths import PROGRESS, SAVED_LIST

SCALES = ("quick", "standard", "full")
REPORT_S = 60.0  # between two lines on how far long work is


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
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    notebook.metadata["kernelspec"] = kernel
    return notebook


def known_parameters(notebook: nbformat.NotebookNode) -> dict[str, object]:
    """Return the names and default values of the notebook's parameters cell."""
    defaults = papermill.inspect_notebook(notebook)
    return {name: ast.literal_eval(parameter["default"]) for name, parameter in defaults.items()}


def parse_parameters(items: Iterable[str], stem: str, stems: Iterable[str]) -> dict[str, object]:
    """Return the parameters that are meant for one notebook.

    Parameters
    ----------
    items
        ``name=value`` for every notebook, ``NN.name=value`` for notebook NN only; a
        value is a Python literal or else a string.
    stem
        The notebook, for example ``"02_depth_calibration"``.
    stems
        All notebooks; a number that none of them has is an error.

    Examples
    --------
    >>> notebooks = ["02_depth_calibration", "40_belt_arrival"]
    >>> parse_parameters(["seed=3", "02.points=50", "40.draws=9"], notebooks[0], notebooks)
    {'seed': 3, 'points': 50}
    """
    values: dict[str, object] = {}
    numbers = sorted({name.split("_")[0] for name in stems})
    for item in items:
        target, equals, text = item.partition("=")
        number, dot, name = target.rpartition(".")
        if not equals or not name.isidentifier():
            raise InputError(
                f"parameter {item!r}: write name=value, or NN.name=value for one notebook."
            )
        if dot and number not in numbers:
            raise InputError(
                f"parameter {item!r}: {number!r} is no notebook's number ({', '.join(numbers)})."
            )
        if not dot or number == stem.split("_")[0]:
            values[name] = text
            with suppress(ValueError, SyntaxError):
                values[name] = ast.literal_eval(text)
    return values


def check_parameters(
    stem: str, defaults: Mapping[str, object], given: Mapping[str, object]
) -> None:
    """Raise an `InputError` for a parameter that the notebook does not know.

    The same holds for one that it cannot take.
    """
    for name, value in given.items():
        if name not in defaults:
            raise InputError(
                f"{stem}: unknown parameter {name!r}; it knows {', '.join(defaults) or 'none'}. "
                f"For one notebook only, write {stem.split('_')[0]}.name=value."
            )
        default = defaults[name]
        allowed = (int, float) if isinstance(default, float) else type(default)
        if not isinstance(value, allowed) or isinstance(value, bool) != isinstance(default, bool):
            raise InputError(
                f"{stem}: parameter {name} is {value!r}, expected {type(default).__name__} "
                f"(the default is {default!r})."
            )
    if given.get("scale", SCALES[0]) not in SCALES:
        raise InputError(f"{stem}: scale {given['scale']!r} is not one of {', '.join(SCALES)}.")


@contextmanager
def private_sockets() -> Iterator[Config]:
    """Yield the settings of a kernel that talks through a folder of its own.

    The folder is removed afterwards.

    Kernels that start together now and then pick the same TCP port, or the same name of a
    socket in a shared folder, and one of them dies.
    """
    # not in TMPDIR: the path of a socket has at most 107 characters
    with tempfile.TemporaryDirectory(prefix="kilnflight-", dir="/tmp") as folder:
        yield Config({"KernelManager": {"transport": "ipc", "ip": f"{folder}/k"}})


def run(source: Path, build: Path, given: Mapping[str, object]) -> Path:
    """Execute a notebook in the current directory and return the executed one.

    Raises
    ------
    InputError
        If the source or a parameter is wrong (nothing is executed then), or the kernel
        does not start.
    papermill.exceptions.PapermillExecutionError
        If a cell fails; what ran stays as ``<stem>.failed.ipynb``.
    """
    stem = source.stem
    notebook = read_source(source)
    defaults = known_parameters(notebook)
    check_parameters(stem, defaults, given)
    if given.get("scale") == "quick" and "jobs" in defaults:
        given = {"jobs": 1, **given}  # a process takes longer to start than its share of the work
    build.mkdir(parents=True, exist_ok=True)
    whole, failed = build / f"{stem}.ipynb", build / f"{stem}.failed.ipynb"
    with tempfile.TemporaryDirectory() as folder:
        partial, saved, progress = (
            Path(folder, name) for name in (whole.name, "saved", "progress")
        )
        # figures.save lists what it wrote, so that make sees when a figure goes missing
        os.environ |= {SAVED_LIST: str(saved), PROGRESS: str(progress)}
        try:
            with _printed_progress(stem, progress):
                _execute(notebook, partial, given)
        except PapermillExecutionError:
            write_whole(failed, partial.read_bytes())
            raise
        finally:
            del os.environ[SAVED_LIST], os.environ[PROGRESS]
        failed.unlink(missing_ok=True)
        if saved.is_file():
            write_whole(build / f"{stem}.saved", saved.read_bytes())
        write_whole(whole, partial.read_bytes())
    return whole


def _execute(notebook: nbformat.NotebookNode, target: Path, given: Mapping[str, object]) -> None:
    """Execute a notebook; start its kernel once more if it dies before it answers."""
    bar = {"desc": target.stem, "unit": "cell"} if sys.stderr.isatty() else False
    for last in (False, True):
        try:
            with private_sockets() as config:
                papermill.execute_notebook(
                    notebook,
                    str(target),
                    parameters=dict(given),
                    kernel_name="python3",
                    cwd=str(Path.cwd()),
                    progress_bar=bar,
                    config=config,
                    # of an interruption the kernel would log a traceback
                    extra_arguments=["--IPKernelApp.log_level=CRITICAL"],
                )
            return
        except DeadKernelError:  # it died at work: an interruption
            raise
        except RuntimeError as error:
            if last:
                raise InputError(
                    f"{target.stem}: its kernel died twice before it answered. Is there free "
                    "memory, and room in /tmp? Run the same make again; it goes on from here."
                ) from error


@contextmanager
def _printed_progress(stem: str, progress: Path) -> Iterator[None]:
    """Print every now and then how far a notebook's long work is."""
    ended = threading.Event()

    def report() -> None:
        before = ""
        while not ended.wait(REPORT_S):
            text = progress.read_text().rstrip() if progress.is_file() else ""
            last = text.rpartition("\n")[2].strip()
            if last not in ("", before):
                _say(f"{stem}: {last}")
                before = last

    printer = threading.Thread(target=report, daemon=True)
    printer.start()
    try:
        yield
    finally:
        ended.set()
        printer.join()  # it may be reading what is removed next


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
    for name in ("asyncio", "papermill"):  # what they would log is reported below, in one line
        logging.getLogger(name).setLevel(logging.CRITICAL)
    stem = options.source.stem
    started = time.monotonic()
    try:
        sources = sorted(options.source.parent.glob("[0-9][0-9]_*.py"))
        stems = [path.stem for path in sources]
        for path in sources:
            # all of them before any runs: half a set of new figures is worse than none
            given = parse_parameters(options.parameter, path.stem, stems)
            if path != options.source and given.keys() - {"scale"}:  # all know a scale (tested)
                check_parameters(path.stem, known_parameters(read_source(path)), given)
        given = parse_parameters(options.parameter, stem, stems)
        shown = ", ".join(f"{name} = {value}" for name, value in given.items())
        _say(f"{stem}: running ({shown})")
        with warnings.catch_warnings():
            # papermill's own use of a deprecated call; nothing a reader could act on
            warnings.simplefilter("ignore", DeprecationWarning)
            run(options.source, options.build, given)
    except InputError as error:
        print(f"{stem}: {error}" if stem not in str(error) else str(error), file=sys.stderr)
        return 1
    except PapermillExecutionError as error:
        first = next((line for line in error.source.splitlines() if line.strip()), "")
        print(
            f"{stem}: cell {error.cell_index + 1} ({first}) failed: {error.ename}: {error.evalue} "
            f"(executed so far: {options.build / stem}.failed.ipynb)",
            file=sys.stderr,
        )
        return 1
    except (KeyboardInterrupt, DeadKernelError) as error:
        why = "" if isinstance(error, KeyboardInterrupt) else " (its kernel was killed or died)"
        print(f"{stem}: interrupted{why}; the same make goes on from here", file=sys.stderr)
        return 130
    _say(f"{stem}: done in {time.monotonic() - started:.0f} s")
    return 0


def _say(line: str) -> None:
    """Print a line in one piece, so that notebooks side by side never share one."""
    print(f"{line}\n", end="", flush=True)


if __name__ == "__main__":
    raise SystemExit(main())
