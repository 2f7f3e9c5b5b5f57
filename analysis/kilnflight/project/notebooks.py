"""Execution of a notebook's text (jupytext percent), or one line why it failed.

    notebooks/NN_name.py -> build/SCALE/NN_name.ipynb

The executed notebook appears under its name only when every cell has run. When one fails, what
was executed until then stays as ``NN_name.failed.ipynb``.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import logging
import os
import re
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import jupytext
import nbformat
import papermill
from nbclient.exceptions import DeadKernelError
from papermill.exceptions import PapermillExecutionError
from traitlets.config import Config

from kilnflight.checks import InputError
from kilnflight.project.cache import write_whole
from kilnflight.project.paths import NOTEBOOK, SAVED_LIST

SCALES = ("quick", "standard", "full")


def read_source(path: Path) -> nbformat.NotebookNode:
    """Return a notebook from its text, with cell ids that depend on the text alone."""
    notebook = jupytext.read(path)
    for position, cell in enumerate(notebook.cells):
        text = f"{position} {cell.cell_type} {cell.source}"
        cell["id"] = hashlib.sha256(text.encode()).hexdigest()[:8]
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    notebook.metadata["kernelspec"] = kernel
    return notebook


def known_parameters(path: Path) -> dict[str, object]:
    """Return the names and default values of a notebook's parameters cell."""
    if not path.is_file():
        raise InputError(f"{path}: no such notebook; see notebooks/.")
    text = path.read_text("utf-8")
    cell = re.search(r'^# %% tags=\["parameters"\]\n(.*?)(?=^# %%|\Z)', text, re.M | re.S)
    if cell is None:
        raise InputError(f'{path}: no cell is tagged parameters; add # %% tags=["parameters"].')
    lines = [line for line in ast.parse(cell[1]).body if isinstance(line, ast.Assign)]
    return {ast.unparse(line.targets[0]): ast.literal_eval(line.value) for line in lines}


def parse_parameters(items: Iterable[str], stem: str, stems: Iterable[str]) -> dict[str, object]:
    """Return the parameters that are meant for one notebook.

    Parameters
    ----------
    items
        ``name=value`` for every notebook, ``NN.name=value`` for notebook NN only; a value is a
        Python literal or else a string.
    stem
        The notebook, for example ``"02_depth_calibration"``.
    stems
        All notebooks.

    Examples
    --------
    >>> notebooks = ["02_depth_calibration", "40_belt_arrival"]
    >>> parse_parameters(["seed=3", "02.points=50", "40.draws=9"], notebooks[0], notebooks)
    {'seed': 3, 'points': 50}
    """
    values: dict[str, object] = {}
    for item in items:
        found = re.fullmatch(r"(?:(\w+)\.)?([A-Za-z]\w*)=(.*)", item)
        if not found or found[1] not in {None, *(name[:2] for name in stems)}:
            raise InputError(
                f"parameter {item!r}: write name=value, or NN.name=value for one notebook, with "
                f"NN among {', '.join(sorted(name[:2] for name in stems))}."
            )
        if found[1] in (None, stem[:2]):
            values[found[2]] = found[3]
            with suppress(ValueError, SyntaxError):
                values[found[2]] = ast.literal_eval(found[3])
    return values


def check_parameters(stem: str, known: Mapping[str, object], given: Mapping[str, object]) -> None:
    """Raise an `InputError` for a parameter that the notebook does not know or cannot take."""
    for name, value in given.items():
        if name not in known:
            raise InputError(
                f"{stem}: unknown parameter {name!r}; it knows {', '.join(known) or 'none'}. "
                f"For one notebook only, write {stem[:2]}.name=value."
            )
        kinds = (int, float) if isinstance(known[name], float) else (type(known[name]),)
        if type(value) not in kinds:
            raise InputError(
                f"{stem}: parameter {name} is {value!r}, expected {kinds[-1].__name__} "
                f"(the default is {known[name]!r})."
            )
    if given.get("scale", SCALES[0]) not in SCALES:
        raise InputError(f"{stem}: scale {given['scale']!r} is not one of {', '.join(SCALES)}.")


def run(source: Path, build: Path, given: Mapping[str, object]) -> None:
    """Execute a notebook in the current directory and write ``<build>/<stem>.ipynb``.

    Raises
    ------
    papermill.exceptions.PapermillExecutionError
        If a cell fails; what ran stays as ``<stem>.failed.ipynb``.
    """
    stem = source.stem
    build.mkdir(parents=True, exist_ok=True)
    whole, failed = build / f"{stem}.ipynb", build / f"{stem}.failed.ipynb"
    # not in TMPDIR: the path of a socket has at most 107 characters
    with tempfile.TemporaryDirectory(prefix="kilnflight-", dir="/tmp") as folder:
        partial, saved = Path(folder, whole.name), Path(folder, "saved")
        os.environ |= {SAVED_LIST: str(saved), NOTEBOOK: stem}
        try:
            papermill.execute_notebook(
                read_source(source),
                str(partial),
                parameters=dict(given),
                kernel_name="python3",
                cwd=str(Path.cwd()),
                progress_bar={"desc": stem, "unit": "cell"} if sys.stderr.isatty() else False,
                # kernels that start together may pick the same TCP port: sockets of its own
                config=Config({"KernelManager": {"transport": "ipc", "ip": f"{folder}/k"}}),
                # no traceback of an interruption; bars of long work go to the terminal
                extra_arguments=[
                    "--IPKernelApp.log_level=CRITICAL",
                    "--IPKernelApp.capture_fd_output=False",
                ],
            )
        except PapermillExecutionError:
            write_whole(failed, partial.read_bytes())
            raise
        finally:
            del os.environ[SAVED_LIST], os.environ[NOTEBOOK]
        failed.unlink(missing_ok=True)
        if saved.is_file():
            write_whole(build / f"{stem}.saved", saved.read_bytes())
        write_whole(whole, partial.read_bytes())


def main(arguments: Sequence[str] | None = None) -> int:
    """Execute one notebook (called by make)."""
    parser = argparse.ArgumentParser(prog="python -m kilnflight.project.notebooks")
    parser.add_argument("source", type=Path)
    parser.add_argument("--build", type=Path, default=Path("build"))
    parser.add_argument("-p", "--parameter", action="append", default=[], metavar="name=value")
    options = parser.parse_args(arguments)
    # on any signal clean up as after Ctrl-C
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    for name in ("asyncio", "papermill"):  # failures are reported below, in one line
        logging.getLogger(name).setLevel(logging.CRITICAL)
    warnings.simplefilter("ignore", DeprecationWarning)  # papermill's own
    stem, started = options.source.stem, time.monotonic()
    try:
        sources = {options.source, *options.source.parent.glob("[0-9][0-9]_*.py")}
        for path in sorted(sources):  # all before any runs
            stems = [each.stem for each in sources]
            given = parse_parameters(options.parameter, path.stem, stems)
            check_parameters(path.stem, known_parameters(path), given)
        given = parse_parameters(options.parameter, stem, stems)
        if given.get("scale") == "quick" and "jobs" in known_parameters(options.source):
            given = {"jobs": 1, **given}  # a process takes longer to start than its work
        shown = ", ".join(f"{name} = {value}" for name, value in given.items())
        print(f"{stem}: running ({shown})\n", end="", flush=True)  # one piece: lines stay whole
        run(options.source, options.build, given)
    except InputError as error:
        print(error if stem in str(error) else f"{stem}: {error}", file=sys.stderr)
        return 1
    except PapermillExecutionError as error:
        first = next((line for line in error.source.splitlines() if line.strip()), "")
        print(
            f"{stem}: cell {error.cell_index + 1} ({first}) failed: {error.ename}: {error.evalue} "
            f"(executed so far: {options.build / stem}.failed.ipynb)",
            file=sys.stderr,
        )
        return 1
    except (KeyboardInterrupt, DeadKernelError, RuntimeError) as error:
        why = "" if isinstance(error, KeyboardInterrupt) else " (its kernel was killed or died)"
        print(f"{stem}: interrupted{why}; the same make goes on from here", file=sys.stderr)
        return 130
    print(f"{stem}: done in {time.monotonic() - started:.0f} s\n", end="", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
