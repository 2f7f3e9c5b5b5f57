"""Execution of a notebook's text (jupytext percent); of a failure it prints one line.

    notebooks/NN_name.py -> build/SCALE/NN_name.ipynb

The executed notebook appears under its name only when every cell has run. When one
fails, what was executed until then stays as ``NN_name.failed.ipynb``.
"""

from __future__ import annotations

import ast
import logging
import os
import re
import signal
import sys
import tempfile
import time
import warnings
from argparse import ArgumentParser
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import jupytext
import papermill
from papermill.exceptions import PapermillExecutionError
from traitlets.config import Config

from kilnflight.checks import InputError
from kilnflight.store.cache import write_whole
from kilnflight.store.paths import NOTEBOOK, SAVED_LIST

SCALES = ("quick", "standard", "full")
# The parameters cell, and name=value or NN.name=value.
CELL = re.compile(r'^# %% tags=\["parameters"\]\n(.*?)(?=^# %%|\Z)', re.M | re.S)
NAMED = re.compile(r"(?:(\w+)\.)?([A-Za-z]\w*)=(.*)")
# no traceback of an interruption; bars of long work go to the terminal
QUIET = ["--IPKernelApp.log_level=CRITICAL", "--IPKernelApp.capture_fd_output=False"]
# nor what asyncio and tornado log of tasks and sockets that are left when a kernel ends
QUIET.append("--IPKernelApp.exec_lines=__import__('logging').disable()")


def known_parameters(path: Path) -> dict[str, object]:
    """Return the default values in a notebook's parameters cell by name.

    The cell assigns Python literals only. Raises an `InputError` if no cell has that
    tag.
    """
    cell = CELL.search(path.read_text("utf-8"))
    if cell is None:
        raise InputError(
            f'{path}: no cell is tagged parameters; add # %% tags=["parameters"].'
        )
    lines = [line for line in ast.parse(cell[1]).body if isinstance(line, ast.Assign)]
    return {
        ast.unparse(line.targets[0]): ast.literal_eval(line.value) for line in lines
    }


def parse_parameters(
    items: Iterable[str], stem: str, stems: Iterable[str]
) -> dict[str, object]:
    """Return the parameters for one notebook from command-line arguments.

    Parameters
    ----------
    items
        ``name=value`` for every notebook, ``NN.name=value`` for notebook NN only; a
        value is a Python literal or else a string.
    stem
        Stem of the notebook, for example ``"02_depth_calibration"``.
    stems
        Stems of all notebooks.

    Raises
    ------
    InputError
        If an item has another form, or names a notebook that does not exist.

    Examples
    --------
    >>> notebooks = ["02_depth_calibration", "40_belt_arrival"]
    >>> parse_parameters(["seed=3", "02.points=50", "40.draws=9"], notebooks[0], notebooks)
    {'seed': 3, 'points': 50}
    """
    values: dict[str, object] = {}
    for item in items:
        found = NAMED.fullmatch(item)
        if not found or found[1] not in {None, *(name[:2] for name in stems)}:
            raise InputError(
                f"parameter {item!r}: write name=value, or NN.name=value for one."
            )
        if found[1] in (None, stem[:2]):
            values[found[2]] = found[3]
            with suppress(ValueError, SyntaxError):
                values[found[2]] = ast.literal_eval(found[3])
    return values


def check_parameters(
    stem: str, known: Mapping[str, object], given: Mapping[str, object]
) -> None:
    """Raise an `InputError` if a parameter is unknown or of another type.

    ``known`` holds the defaults by name, whose types count, ``given`` the values. An
    int is taken where the default is a float. A scale must be one of `SCALES`.
    """
    for name, value in given.items():
        if name not in known:
            told = f"{stem}: unknown parameter {name!r}; it knows {', '.join(known)}."
            raise InputError(f"{told} For one notebook only, write NN.name=value.")
        kinds = (int, float) if isinstance(known[name], float) else (type(known[name]),)
        if type(value) not in kinds:
            wanted = f"{kinds[-1].__name__} (the default is {known[name]!r})"
            raise InputError(
                f"{stem}: parameter {name} is {value!r}, expected {wanted}."
            )
    if given.get("scale", SCALES[0]) not in SCALES:
        raise InputError(
            f"{stem}: scale {given['scale']!r} is not one of {', '.join(SCALES)}."
        )


def run(source: Path, build: Path, given: Mapping[str, object]) -> None:
    """Execute a notebook in the current directory and write ``<build>/<stem>.ipynb``.

    The names of the figures it saved go to ``<build>/<stem>.saved``, for make.

    Parameters
    ----------
    source
        Text of the notebook (jupytext percent).
    build
        Folder of the executed notebook, made if missing.
    given
        Values of parameters by name. ``jobs`` is 1 at scales quick and full, unless
        given.

    Raises
    ------
    papermill.exceptions.PapermillExecutionError
        If a cell fails; what ran stays as ``<stem>.failed.ipynb``.
    """
    stem = source.stem
    # quick: a process takes longer to start than its share of the work; full: make runs
    # others
    if given.get("scale") in ("quick", "full") and "jobs" in known_parameters(source):
        given = {"jobs": 1, **given}
    build.mkdir(parents=True, exist_ok=True)
    whole = build / f"{stem}.ipynb"
    failed = build / f"{stem}.failed.ipynb"
    # not in TMPDIR: the path of a socket has at most 107 characters
    with tempfile.TemporaryDirectory(prefix="kilnflight-", dir="/tmp") as folder:
        partial = Path(folder, whole.name)
        saved = Path(folder, "saved")
        os.environ |= {SAVED_LIST: str(saved), NOTEBOOK: stem}
        # joblib's workers outlive their kernel for a moment, and what they held is
        # cleaned up
        os.environ.setdefault("PYTHONWARNINGS", "ignore:resource_tracker:UserWarning")
        # kernels that start together may pick the same TCP port: sockets of its own
        config = Config({"KernelManager": {"transport": "ipc", "ip": f"{folder}/k"}})
        python = {
            "kernel_name": "python3",
            "language": "python",
            "extra_arguments": QUIET,
        }
        try:
            text = jupytext.read(source)
            run_with = {"progress_bar": False, "config": config}
            papermill.execute_notebook(
                text, str(partial), dict(given), **run_with, **python
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
    """Execute one notebook (called by make) and return the exit status.

    The parameters are checked for all notebooks of the folder before this one runs. A
    failure is printed in one line. The status is 1 after an error, 130 after an
    interruption.
    """
    parser = ArgumentParser(prog="python -m kilnflight.publication.notebooks")
    parser.add_argument("source", type=Path)
    parser.add_argument("--build", type=Path, default=Path("build"))
    parser.add_argument(
        "-p", "--parameter", action="append", default=[], metavar="name=value"
    )
    options = parser.parse_args(arguments)
    # on any signal clean up as after Ctrl-C
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    logging.disable()  # failures are reported below, in one line
    warnings.simplefilter("ignore", DeprecationWarning)  # papermill's own
    stem = options.source.stem
    started = time.monotonic()
    try:
        paths = {*options.source.parent.glob("[0-9][0-9]_*.py"), options.source}
        stems = [path.stem for path in paths]
        for path in sorted(paths):  # all before any runs
            given = parse_parameters(options.parameter, path.stem, stems)
            check_parameters(path.stem, known_parameters(path), given)
        given = parse_parameters(options.parameter, stem, stems)
        shown = ", ".join(f"{name} = {value}" for name, value in given.items())
        print(
            f"{stem}: running ({shown})\n", end="", flush=True
        )  # one piece: lines stay whole
        run(options.source, options.build, given)
    except (InputError, OSError) as error:
        told = str(error)
        code = 1
    except PapermillExecutionError as error:
        first = next((line for line in error.source.splitlines() if line.strip()), "")
        told = (
            f"cell {error.cell_index + 1} ({first}) failed: {error.ename}: "
            f"{error.evalue}"
        )
        told = f"{told} (executed so far: {options.build / stem}.failed.ipynb)"
        code = 1
    except (KeyboardInterrupt, RuntimeError) as error:
        why = (
            ""
            if isinstance(error, KeyboardInterrupt)
            else " (its kernel was killed or died)"
        )
        told = f"interrupted{why}; the same make goes on from here"
        code = 130
    else:
        print(
            f"{stem}: done in {time.monotonic() - started:.0f} s\n", end="", flush=True
        )
        return 0
    print(told if re.match(r"\d\d_\w+: ", told) else f"{stem}: {told}", file=sys.stderr)
    return code


if __name__ == "__main__":
    raise SystemExit(main())
