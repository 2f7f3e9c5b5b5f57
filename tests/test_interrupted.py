"""`kilnflight run`, killed in every step and gone on with; two at once; a full disk."""

import subprocess
import sys

import pyarrow.parquet as pq
import pytest

from kilnflight.__main__ import main

# The process kills itself at the rename that gives a file its name: before it or after it.
KILLED = """
import os, sys
from pathlib import Path
from kilnflight import run
from kilnflight.__main__ import main

name, number, when = sys.argv[1], int(sys.argv[2]), sys.argv[3]
run.LONG_CHUNK = 8
real, seen = Path.replace, []

def replace(self, target):
    seen.extend([1] * Path(target).name.startswith(name))
    hit = Path(target).name.startswith(name) and len(seen) == number
    if hit and when == "before":
        os.kill(os.getpid(), 9)
    real(self, target)
    if hit:
        os.kill(os.getpid(), 9)

Path.replace = replace
main(sys.argv[4:])
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


def test_a_killed_run_goes_on_and_ends_in_the_same_bytes(command, tmp_path, capsys):
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    assert main(command(whole)) == 0
    expected = contents(whole)
    assert {"tracks.parquet", "report.html"} <= {path.name for path in expected}
    made = {}
    for name, number, when in KILLS:
        call = [sys.executable, "-c", KILLED, name, str(number), when, *command(killed)]
        ended = subprocess.run(call, capture_output=True, text=True, check=False)
        assert ended.returncode == -9, ended.stderr
        now = parts(killed)
        assert made.items() <= now.items(), f"made again before {name}"
        made = now
    assert main(command(killed)) == 0
    assert made == parts(killed)
    assert contents(killed) == expected
    assert capsys.readouterr().out.count("trajectories fitted") == 2


def test_two_runs_at_once_do_the_work_once(command, tmp_path):
    call = [sys.executable, "-m", "kilnflight", *command(tmp_path)]
    both = [subprocess.Popen(call, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    said = [run.communicate()[0] for run in both]
    assert [run.returncode for run in both] == [0, 0]
    assert said[0] == said[1]
    assert not list(tmp_path.rglob("*.part"))
    assert len(list(tmp_path.glob("parts/detections-*.parquet"))) == 1


@pytest.mark.parametrize("name", ["detections", "flights", "report"])
def test_a_full_disk_loses_nothing(name, command, tmp_path, monkeypatch, capsys):
    folder = tmp_path / "run"

    def full(self, content):
        if f".{name}" in self.name:
            self.open("wb").close()
            raise OSError(28, "No space left on device")
        return real(self, content)

    real = type(tmp_path).write_bytes
    with monkeypatch.context() as patch:
        patch.setattr(type(tmp_path), "write_bytes", full)
        assert main(command(folder)) == 1
    told = capsys.readouterr().err
    assert "cannot be written (No space left on device). What was finished before is kept" in told
    assert len(told.splitlines()) == 1
    assert not list(folder.rglob("*.part"))
    assert not [file for file in folder.rglob(f"{name}*") if file.suffix != ".lock"]
    for file in folder.rglob("*.parquet"):
        assert pq.read_table(file).num_columns
    made = parts(folder)
    assert main(command(folder)) == 0
    assert made.items() <= parts(folder).items()
