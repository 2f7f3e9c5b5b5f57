"""`kilnflight run` that is killed, damaged, or short of disk, and two at once."""

import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from kilnflight import chain
from kilnflight.__main__ import main
from kilnflight.film import preparation

# Kills itself when a file, counted from 0, is renamed into place.
KILLED = """
import os, pathlib, sys
from kilnflight import chain
from kilnflight.__main__ import main

chain.CHUNK_FRAMES, real, done = 8, pathlib.Path.replace, []

def replace(self, target):
    if len(done) == int(sys.argv[1]):
        os.kill(os.getpid(), 9)
    done.append(target)
    return real(self, target)

pathlib.Path.replace = replace
main(sys.argv[2:])
"""


@pytest.fixture(autouse=True)
def _short_chunks(monkeypatch):
    monkeypatch.setattr(chain, "CHUNK_FRAMES", 8)


@pytest.fixture(scope="module")
def command(stored_flights):
    return lambda folder, *more: [
        *("run", str(stored_flights), "--to", str(folder), "--threshold", "200"),
        *("--background", "median", *more),
    ]


def contents(folder):
    files = (
        file for file in folder.rglob("*") if file.is_file() and file.suffix != ".lock"
    )
    return {file.relative_to(folder): file.read_bytes() for file in files}


@pytest.fixture(scope="module")
def expected(command, tmp_path_factory):
    """Files of a run that nothing stops, by one process."""
    folder, patch = tmp_path_factory.mktemp("whole"), pytest.MonkeyPatch()
    with patch.context() as patched:
        patched.setattr(chain, "CHUNK_FRAMES", 8)
        main(command(folder))
    return contents(folder)


@pytest.mark.parametrize("step", [0, 1, 4, 7, 12, 18])
def test_a_killed_run_continues_and_ends_in_the_same_bytes(
    step, command, expected, tmp_path
):
    call = [sys.executable, "-c", KILLED, str(step), *command(tmp_path)]
    assert subprocess.run(call, check=False).returncode == -9
    # the name of the film, and of each of eight tables its hash and its rows
    endings = [path.suffix for path in tmp_path.glob("parts/*")]
    whole = len(endings) - endings.count(".lock") - endings.count(".part")
    assert whole == min(step, 17)
    made = {path: path.stat().st_mtime_ns for path in tmp_path.glob("parts/*.parquet")}
    assert len(made) == (whole - 1) // 2 if whole else not made
    assert list(tmp_path.rglob(".*.part"))
    main(command(tmp_path))
    assert made.items() <= {path: path.stat().st_mtime_ns for path in made}.items()
    assert contents(tmp_path) == expected


def test_two_processes_write_the_same_bytes(command, expected, tmp_path):
    call = [sys.executable, "-c", KILLED, "-1", *command(tmp_path)]
    others = [
        subprocess.Popen([*call, "--jobs", jobs]) for jobs in "12"
    ]  # one folder, two runs
    assert [each.wait() for each in others] == [0, 0]
    assert contents(tmp_path) == expected


def test_a_run_goes_on_with_the_chunks_that_it_began_with(
    command, tmp_path, monkeypatch
):
    def chunks(frames, workers):
        return pd.DataFrame({"frames": [8 // workers.number()]})

    monkeypatch.setattr(preparation, "chunk_frames", chunks)
    main(command(tmp_path))
    made = set(tmp_path.glob("parts/detections-*"))
    for table in tmp_path.glob("parts/tracks-*"):
        table.unlink()
    main(command(tmp_path, "--jobs", "2"))
    assert set(tmp_path.glob("parts/detections-*")) == made


def test_a_run_that_is_done_needs_no_cluster(command, expected, tmp_path):
    main(command(tmp_path))
    main(command(tmp_path, "--scheduler", "127.0.0.1:9"))
    assert contents(tmp_path) == expected


def test_a_damaged_table_is_named(command, expected, tmp_path, capsys):
    main(command(tmp_path))
    (tracks,) = tmp_path.glob("parts/tracks-*.parquet")
    tracks.write_bytes(b"PAR1")
    capsys.readouterr()
    with pytest.raises(SystemExit, match="2"):
        main(command(tmp_path))
    (line,) = capsys.readouterr().err.splitlines()
    assert str(tracks) in line
    assert "Delete it" in line
    tracks.unlink()
    main(command(tmp_path))
    assert contents(tmp_path) == expected


def test_a_full_disk_loses_nothing(command, expected, tmp_path, monkeypatch, capsys):
    write_bytes = Path.write_bytes

    def full(self, content):
        if self.name.startswith("flights"):
            self.open("wb").close()
            raise OSError(28, "No space left on device")
        return write_bytes(self, content)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", full)
        with pytest.raises(SystemExit, match="2"):
            main(command(tmp_path))
    (line,) = capsys.readouterr().err.splitlines()
    assert "No space left on device" in line
    assert "room" in line
    assert not list(tmp_path.rglob("*.part"))
    assert not list(tmp_path.rglob("flights*.parquet"))
    main(command(tmp_path))
    assert contents(tmp_path) == expected
