"""Execute the text of a notebook (jupytext percent); a failure is printed in one line.

    notebooks/NN_name.py -> build/SCALE/NN_name.ipynb

The executed notebook appears under its name only when every cell has run. When one
fails, what was executed until then stays as ``NN_name.failed.ipynb``.
"""

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
from types import MappingProxyType

import jupytext
import papermill
from papermill.exceptions import PapermillExecutionError
from traitlets.config import Config

from kilnflight.checks import InputError
from kilnflight.store.cache import write_whole
from kilnflight.store.paths import NOTEBOOK, SAVED_LIST

SCALES = ("quick", "standard", "full")
PARAMETERS_CELL = re.compile(
    r'^# %% tags=\["parameters"\]\n(.*?)(?=^# %%|\Z)', re.M | re.S
)
GIVEN = re.compile(r"(?:(\w+)\.)?([A-Za-z]\w*)=(.*)")  # name=value, NN.name=value
QUIET = [
    "--IPKernelApp.log_level=CRITICAL",  # no traceback of an interruption
    "--IPKernelApp.capture_fd_output=False",  # bars of long work go to the terminal
    # asyncio and tornado log tasks and sockets that are left when a kernel ends
    "--IPKernelApp.exec_lines=__import__('logging').disable()",
]


def known_parameters(path: Path) -> dict[str, object]:
    """Return the default values in a notebook's parameters cell by name.

    The cell assigns Python literals only. Raises an `InputError` if no cell has that
    tag.
    """
    cell = PARAMETERS_CELL.search(path.read_text("utf-8"))
    if cell is None:
        raise InputError(
            f'{path}: no cell is tagged parameters; add # %% tags=["parameters"].'
        )
    lines = [line for line in ast.parse(cell[1]).body if isinstance(line, ast.Assign)]
    return {
        ast.unparse(line.targets[0]): ast.literal_eval(line.value) for line in lines
    }


def parse_parameters(
    items: Iterable[str],
    stem: str,
    stems: Iterable[str],
    known: Mapping[str, object] = MappingProxyType({}),
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
    known
        The notebook's defaults by name. Where one is a string, the value is a string:
        a folder may be called 2024.

    Raises
    ------
    InputError
        If an item has another form, or names a notebook that does not exist.

    Examples
    --------
    >>> items = ["seed=3", "02.points=50", "40.draws=9"]
    >>> parse_parameters(items, "02_depth", ["02_depth", "40_belt"], {"seed": 0})
    {'seed': 3, 'points': 50}
    >>> parse_parameters(["recording=2024"], "60_film", [], {"recording": ""})
    {'recording': '2024'}
    """
    values: dict[str, object] = {}
    for item in items:
        found = GIVEN.fullmatch(item)
        if not found or found[1] not in {None, *(name[:2] for name in stems)}:
            raise InputError(
                f"parameter {item!r}: write name=value, or NN.name=value for one."
            )
        number, name, value = found.groups()
        if number in (None, stem[:2]):
            values[name] = value
            with suppress(ValueError, SyntaxError):
                literal = ast.literal_eval(value)
                if type(literal) is str or type(known.get(name)) is not str:
                    values[name] = literal
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
        default = known[name]
        kind = type(default)
        if type(value) is not kind and (type(value), kind) != (int, float):
            raise InputError(
                f"{stem}: parameter {name} is {value!r}, expected {kind.__name__} "
                f"(the default is {default!r})."
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
    # At scale quick a process takes longer to start than its share of the work; at full
    # make runs other notebooks beside this one.
    if given.get("scale") in ("quick", "full") and "jobs" in known_parameters(source):
        given = {"jobs": 1, **given}
    build.mkdir(parents=True, exist_ok=True)
    failed = build / f"{stem}.failed.ipynb"
    # TMPDIR may be too long: the path of a socket has at most 107 characters.
    with tempfile.TemporaryDirectory(prefix="kilnflight-", dir="/tmp") as folder:
        executed = Path(folder, "executed.ipynb")
        saved = Path(folder, "saved")
        os.environ |= {SAVED_LIST: str(saved), NOTEBOOK: stem}
        try:
            _execute(source, executed, given)
        except PapermillExecutionError:
            write_whole(failed, executed.read_bytes())
            raise
        finally:
            del os.environ[SAVED_LIST], os.environ[NOTEBOOK]
        failed.unlink(missing_ok=True)
        if saved.is_file():
            write_whole(build / f"{stem}.saved", saved.read_bytes())
        write_whole(build / f"{stem}.ipynb", executed.read_bytes())


def _execute(source: Path, executed: Path, given: Mapping[str, object]) -> None:
    """Execute a notebook with papermill, in a kernel of its own."""
    # joblib's workers outlive their kernel for a moment; what they held is cleaned up.
    os.environ.setdefault("PYTHONWARNINGS", "ignore:resource_tracker:UserWarning")
    # Kernels that start together may choose the same TCP port, but not the same socket.
    sockets = {"transport": "ipc", "ip": str(executed.with_name("k"))}
    papermill.execute_notebook(
        jupytext.read(source),
        str(executed),
        dict(given),
        kernel_name="python3",
        language="python",
        progress_bar=False,
        extra_arguments=QUIET,
        config=Config({"KernelManager": sockets}),
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Execute one notebook (called by make) and return the exit status.

    The parameters are checked for all notebooks of the folder before this one runs. A
    failure is printed in one line. The status is 1 after an error, 130 after an
    interruption.
    """
    parser = ArgumentParser(prog="python tools/execute.py")
    parser.add_argument("source", type=Path)
    parser.add_argument("--build", type=Path, default=Path("build"))
    parser.add_argument(
        "-p", "--parameter", action="append", default=[], metavar="name=value"
    )
    options = parser.parse_args(arguments)
    # Any signal cleans up as Ctrl-C does.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    logging.disable()  # failures are reported below, in one line
    warnings.simplefilter("ignore", DeprecationWarning)  # papermill's own
    stem = options.source.stem
    started = time.monotonic()
    try:
        given = _given_parameters(options.source, options.parameter)
        shown = ", ".join(f"{name} = {value}" for name, value in given.items())
        # One piece, so that lines of parallel notebooks stay whole.
        print(f"{stem}: running ({shown})\n", end="", flush=True)
        run(options.source, options.build, given)
    except (InputError, OSError) as error:
        told = str(error)
        code = 1
    except PapermillExecutionError as error:
        lines = (line for line in error.source.splitlines() if line.strip())
        told = (
            f"cell {error.cell_index + 1} ({next(lines, '')}) failed: {error.ename}: "
            f"{error.evalue} (executed so far: {options.build / stem}.failed.ipynb)"
        )
        code = 1
    except KeyboardInterrupt:
        told = "interrupted; the same make goes on from here"
        code = 130
    except RuntimeError:
        told = "interrupted (its kernel died); the same make goes on from here"
        code = 130
    else:
        seconds = time.monotonic() - started
        print(f"{stem}: done in {seconds:.0f} s\n", end="", flush=True)
        return 0
    if not re.match(r"\d\d_\w+: ", told):  # an error may name another notebook
        told = f"{stem}: {told}"
    print(told, file=sys.stderr)
    return code


def _given_parameters(source: Path, items: Sequence[str]) -> dict[str, object]:
    """Return the parameters of a notebook, checked for all notebooks beside it."""
    every = {*source.parent.glob("[0-9][0-9]_*.py"), source}
    stems = [path.stem for path in every]
    given = {}
    for path in sorted(every):
        known = known_parameters(path)
        given[path] = parse_parameters(items, path.stem, stems, known)
        check_parameters(path.stem, known, given[path])
    return given[source]


if __name__ == "__main__":
    raise SystemExit(main())
