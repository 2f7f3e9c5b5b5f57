"""`kilnflight run`, killed in every step and gone on with; two at once; a full disk."""

import io
import subprocess
import sys
from contextlib import redirect_stdout
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from kilnflight.__main__ import main

# Reads which file it is to be killed at, as below, and starts a run that kills itself at the
# rename that gives the file its name: before it or after it. Prints the signal that ended it.
KILLED = """
import os, sys
from pathlib import Path
from kilnflight import run
from kilnflight.__main__ import main

run.LONG_CHUNK = 8
real, renamed = Path.replace, []

def replace(self, target):
    renamed.extend([1] * Path(target).name.startswith(name))
    hit = Path(target).name.startswith(name) and len(renamed) == int(number)
    if hit and when == "before":
        os.kill(os.getpid(), 9)
    real(self, target)
    if hit:
        os.kill(os.getpid(), 9)

Path.replace = replace
for name, number, when in map(str.split, iter(sys.stdin.readline, "")):
    child = os.fork()
    if not child:
        sys.stdout = open(os.devnull, "w")
        os._exit(main(sys.argv[1:]))
    print(os.WTERMSIG(os.waitpid(child, 0)[1]), flush=True)
"""
# Which file, the how manieth of its kind in this run, and when. One after the other: each run
# goes on where the one before was killed.
KILLS = [
    ("detections", 2, "before"),
    ("tracks", 1, "before"),
    ("trajectories", 1, "after"),
    ("flights", 1, "before"),
    ("slices", 1, "before"),
    ("report", 1, "before"),
]


@pytest.fixture(autouse=True)
def _short_chunks(monkeypatch):
    monkeypatch.setattr("kilnflight.run.LONG_CHUNK", 8)


@pytest.fixture(scope="module")
def command(stored_flights):
    return lambda folder: [
        *("run", str(stored_flights), "--to", str(folder), "--threshold", "200"),
    ]


def contents(folder):
    return {
        file.relative_to(folder): file.read_bytes()
        for file in folder.rglob("*")
        if file.is_file() and file.suffix != ".lock"
    }


def parts(folder):
    """Return when each part was made."""
    return {file.name: file.stat().st_mtime_ns for file in folder.glob("parts/*.parquet")}


@pytest.fixture(scope="module")
def expected(command, tmp_path_factory):
    """What a run leaves that nothing stops, and what it prints."""
    folder, patch, output = tmp_path_factory.mktemp("whole"), pytest.MonkeyPatch(), io.StringIO()
    with patch.context() as patched, redirect_stdout(output):
        patched.setattr("kilnflight.run.LONG_CHUNK", 8)
        assert main(command(folder)) == 0
    files = contents(folder)
    assert {"tracks.parquet", "report.html"} <= {path.name for path in files}
    assert "trajectories fitted" in output.getvalue()
    return files


def test_a_killed_run_goes_on_and_ends_in_the_same_bytes(command, expected, tmp_path, capsys):
    finished = {}
    call = [sys.executable, "-c", KILLED, *command(tmp_path)]
    with subprocess.Popen(call, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as runs:
        for name, number, when in KILLS:
            print(name, number, when, file=runs.stdin, flush=True)
            assert runs.stdout.readline() == "9\n"
            now = parts(tmp_path)
            assert finished.items() <= now.items(), f"made again before {name}"
            finished = now
        runs.stdin.close()
    assert main(command(tmp_path)) == 0
    assert finished == parts(tmp_path)
    assert contents(tmp_path) == expected
    assert "trajectories fitted" in capsys.readouterr().out


def test_two_runs_at_once_do_the_work_once(command, tmp_path):
    call = [sys.executable, "-m", "kilnflight", *command(tmp_path)]
    processes = [subprocess.Popen(call, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    outputs = [run.communicate()[0] for run in processes]
    assert [run.returncode for run in processes] == [0, 0]
    assert outputs[0] == outputs[1]
    assert not list(tmp_path.rglob("*.part"))
    assert len(list(tmp_path.glob("parts/detections-*.parquet"))) == 1


def test_a_full_disk_loses_nothing(command, expected, tmp_path, monkeypatch, capsys):
    write_bytes, finished = Path.write_bytes, {}
    for name in ("detections", "flights", "report"):

        def full(self, content, name=name):
            if f".{name}" in self.name:
                self.open("wb").close()
                raise OSError(28, "No space left on device")
            return write_bytes(self, content)

        with monkeypatch.context() as patch:
            patch.setattr(Path, "write_bytes", full)
            assert main(command(tmp_path)) == 1
        error = capsys.readouterr().err
        assert "cannot be written (No space left on device). What was finished before" in error
        assert "before is kept" in error
        assert len(error.splitlines()) == 1
        assert not list(tmp_path.rglob("*.part"))
        assert not [file for file in tmp_path.rglob(f"{name}*") if file.suffix != ".lock"]
        for file in tmp_path.rglob("*.parquet"):
            assert pq.read_table(file).num_columns
        assert finished.items() <= parts(tmp_path).items()
        finished = parts(tmp_path)
    assert main(command(tmp_path)) == 0
    assert finished.items() <= parts(tmp_path).items()
    assert contents(tmp_path) == expected
