"""Faults of input, one after another: each ends in one clear error, or changes nothing.

``make faults`` tries thousands of them and prints what became of each kind.
"""

import signal
import warnings
from collections import Counter
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.faults.kinds import BYTES, SAME, equal, faults
from tests.faults.runs import FAULTS
from tests.faults.steps import FILES, STEPS_AND_INPUT

from kilnflight.checks import InputError

LONGEST_S = 30  # of a call; longer is a hang
OF_STEPS = [
    (step, name, column, kind, right, make)
    for step, (_, arguments, _) in STEPS_AND_INPUT.items()
    for name, value in arguments.items()
    for column, kind, right, make in faults(value)
]
OF_FILES = [(name, kind) for name in FILES for kind in BYTES]
OF_RUNS = [(name,) for name in FAULTS for _ in range(5)]
OUTCOMES = ("clear", "survived", "traceback", "silent", "hang")


class TooLongError(BaseException):
    """A call that does not end."""


def stop(*_):
    raise TooLongError


def outcome(call, is_right):
    """Return what becomes of a call: an error, its right result, or a failure."""
    signal.signal(signal.SIGALRM, stop)
    signal.alarm(LONGEST_S)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return "survived" if is_right(call()) else "silent"
    except InputError as error:
        return "clear" if "\n" not in str(error) else "traceback"
    except TooLongError:
        return "hang"
    except Exception:
        return "traceback"
    finally:
        signal.alarm(0)


@cache
def clean(step):
    call, arguments, _ = STEPS_AND_INPUT[step]
    return call(**arguments)


def of_step(fault, seed):
    """Return what becomes of a step whose argument, or one column of it, is wrong."""
    step, name, column, kind, right, make = fault
    call, arguments, allowed = STEPS_AND_INPUT[step]
    wrong = make(arguments[name], np.random.default_rng(seed))
    words = {
        f"{of}:{what}"
        for of in (column or name, "*")
        for what in (kind.replace(" ", "+"), "*")
    }
    documented = bool(words & set(allowed.split()) - {"*:*"})
    expected = clean(step)
    return outcome(
        lambda: call(**{**arguments, name: wrong}),
        lambda result: documented or (right == SAME and equal(expected, result)),
    )


def of_file(fault, seed):
    """Return what becomes of a file of which some bytes are wrong.

    Most formats have no checksum, so grey values or cells may differ; of a recording
    none may.
    """
    name, kind = fault
    (make, read), rng = FILES[name], np.random.default_rng(seed)
    with TemporaryDirectory() as folder:
        make(path := Path(folder, name))
        whole = read(path)
        files = (
            [path]
            if path.is_file()
            else sorted(p for p in path.rglob("*") if p.is_file())
        )
        one = files[rng.integers(len(files))]
        one.write_bytes(BYTES[kind](one.read_bytes(), rng))
        same = (
            equal if name.endswith("zarr") else lambda a, b: np.shape(a) == np.shape(b)
        )
        return outcome(lambda: read(path), lambda result: same(whole, result))


def of_run(fault, seed):
    """Return what becomes of a run whose surroundings are wrong."""
    with TemporaryDirectory() as folder:
        rng = np.random.default_rng(seed)
        return outcome(lambda: FAULTS[fault[0]](Path(folder), rng), bool)


@given(st.sampled_from(OF_STEPS), st.integers(0, 2**32))
@settings(max_examples=400)
def test_a_fault_of_an_argument_is_refused_or_changes_nothing(fault, seed):
    assert of_step(fault, seed) in ("clear", "survived")


@given(st.sampled_from(OF_FILES), st.integers(0, 2**32))
@settings(max_examples=100)
def test_a_fault_of_a_file_is_refused_or_seen_in_values_only(fault, seed):
    assert of_file(fault, seed) in ("clear", "survived")


@given(st.sampled_from(OF_RUNS), st.integers(0, 2**32))
@settings(max_examples=30)
def test_a_fault_around_a_run_is_refused_or_changes_nothing(fault, seed):
    assert of_run(fault, seed) in ("clear", "survived")


def count(seeds):
    """Print what becomes of every fault, with several seeds, and return whether all is
    well.
    """
    rows = []
    for try_it, every in (
        (of_step, OF_STEPS),
        (of_file, OF_FILES),
        (of_run, OF_RUNS),
    ):
        for k, fault in enumerate(every):
            found = Counter(try_it(fault, seeds * k + n) for n in range(seeds))
            bad = {what: n for what, n in found.items() if what not in OUTCOMES[:2]}
            print(*fault[:4], bad) if bad else None
            rows.append(
                {
                    "of": fault[0].split(".")[-1] if try_it is of_file else fault[0],
                    **found,
                }
            )
    table = (
        pd.DataFrame(rows, columns=["of", *OUTCOMES]).groupby("of").sum().astype(int)
    )
    table.insert(0, "faults", table.sum(axis=1))
    print(pd.concat([table, table.sum().to_frame("all").T]).to_string())
    return not table[list(OUTCOMES[2:])].to_numpy().any()


if __name__ == "__main__":
    raise SystemExit(not count(8))
