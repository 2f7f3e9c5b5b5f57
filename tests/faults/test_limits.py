"""Targets, names, processes and files that would do harm."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
import tifffile
from tests.recording.test_files import FILM, KINDS

from kilnflight.__main__ import main
from kilnflight.checks import InputError
from kilnflight.film.run import run_recording
from kilnflight.recording.files import open_any
from kilnflight.recording.store import open_recording, write_recording
from kilnflight.recording.track_files import csv_of
from kilnflight.store.cache import write_whole

BLACK = b"\x1b[30m"  # what a name must not do to a terminal


def test_a_device_and_a_link_stay_what_they_are(tmp_path):
    write_whole(Path("/dev/null"), b"gone")
    assert Path("/dev/null").is_char_device()
    (tmp_path / "link").symlink_to(tmp_path / "real")
    write_whole(tmp_path / "link", b"kept")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real").read_bytes() == b"kept"
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    for target in ("a", "no/b", "."):
        with pytest.raises(InputError, match=str(tmp_path)):
            write_whole(tmp_path / target, b"")
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "a",
        "b",
        "link",
        "real",
    ]


def test_names_are_printed_escaped_and_texts_do_not_compute(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    np.save(name := f"{BLACK.decode()}.npy", FILM)
    main(["info", name])
    with pytest.raises(SystemExit):
        main(["info", f"no{name}"])
    printed = capsys.readouterr()
    assert "\x1b" not in printed.out + printed.err
    assert "\\x1b[30m" in printed.out
    assert (
        csv_of(pd.DataFrame({"a": ["=1+1", "b"], "n": [-1.0, 2.0]}))
        == "a,n\n'=1+1,-1.0\nb,2.0\n"
    )


def bomb(path):
    tifffile.imwrite(path, np.zeros((100, 2_100_000), np.uint8), compression="zlib")


def elsewhere(path, virtual):
    raw = path.with_suffix(".raw")
    raw.write_bytes(FILM.tobytes())
    with h5py.File(path, "w") as file:
        if virtual:
            layout = h5py.VirtualLayout(FILM.shape, FILM.dtype)
            layout[:] = h5py.VirtualSource("other.h5", "film", FILM.shape)
            file.create_virtual_dataset("film", layout)
        else:
            file.create_dataset(
                "film", FILM.shape, "u1", external=[(raw, 0, FILM.size)]
            )


@pytest.mark.parametrize(
    ("name", "make"),
    [
        ("bomb.tif", bomb),
        ("a.h5", lambda path: elsewhere(path, virtual=False)),
        ("v.h5", lambda path: elsewhere(path, virtual=True)),
        ("deep.toml", lambda path: path.write_text("a = " + 5000 * "[" + 5000 * "]")),
        ("dots.toml", lambda path: path.write_text(".".join(100_000 * "a") + " = 1")),
        ("pipe", lambda path: os.mkfifo(path)),
    ],
)
def test_what_would_fill_the_memory_read_other_files_or_hang_is_refused(
    name, make, tmp_path
):
    make(tmp_path / name)
    with pytest.raises(InputError, match=name):
        open_any(tmp_path / name)


def test_a_recording_that_was_edited_or_mixed_is_told(tmp_path, capsys):
    one, two = (
        write_recording(open_any(film), tmp_path / f"{film[0, 0, 0]}.zarr")
        for film in (FILM, FILM[::-1])
    )
    chunk = "gray/c/1/0/0"
    (one.path / chunk).write_bytes((two.path / chunk).read_bytes())
    with pytest.raises(InputError, match="changed"):
        one.content()
    with pytest.raises(SystemExit, match="2"):
        main(["info", str(one.path)])
    assert "changed" in capsys.readouterr().err


def test_numbers_that_mean_other_pixels_are_refused(tmp_path):
    made = write_recording(
        open_any(FILM, frame_rate_hz=np.float64(50.0)), tmp_path / "a.zarr"
    )
    kept = (about := made.path / "gray" / "zarr.json").read_text()
    about.write_text(kept.replace('"little"', '"big"'))
    assert about.read_text() != kept
    with pytest.raises(InputError, match=r"a\.zarr"):
        open_recording(made.path).content()
    tifffile.imwrite(path := tmp_path / "a.tif", FILM, photometric="miniswhite")
    with pytest.raises(InputError, match=r"a\.tif"):
        open_any(path)


def test_a_film_runs_beside_its_tables_and_is_never_a_target(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    KINDS["film.avi"][0](film := Path("film.avi"))
    main(["run", "film.avi", "--to", "out"])
    assert Path("out", "tracks.csv").is_file()
    content = film.read_bytes()
    Path("tracks.csv").write_text("of another program")
    Path("frames").mkdir()
    tifffile.imwrite("frames/a_1.tif", FILM[0])
    for command, target in {
        "preview film.avi": "film.avi",
        "preview frames": "frames/a_1.tif",
        "run frames": "frames",
        "import frames": "frames/a.zarr",
        "preview no.avi": "new/a.png",
        "run film.avi": ".",
    }.items():
        with pytest.raises(SystemExit, match="2"):
            main([*command.split(), "--to", target])
    assert film.read_bytes() == content
    assert [path.name for path in Path("frames").iterdir()] == ["a_1.tif"]
    assert not Path("new").exists()
    assert Path("tracks.csv").read_text() == "of another program"
    with pytest.raises(InputError, match="out: has"):
        run_recording(FILM, "out")


@pytest.mark.parametrize(
    "number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGKILL]
)
def test_a_signal_ends_a_run_and_its_processes(number, stored_flights, tmp_path):
    command = [
        "run",
        str(stored_flights),
        "--to",
        str(tmp_path),
        "--jobs",
        "2",
        "--threshold",
        "9",
    ]
    code = (
        "from kilnflight import chain, __main__; chain.CHUNK_FRAMES = 2; "
        "__main__.main()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, *command],
        stdout=subprocess.PIPE,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    ) as run:
        while run.poll() is None and not list(tmp_path.glob("parts/*.lock")):
            time.sleep(0.05)
        run.send_signal(number)
        run.communicate(timeout=30)  # the pipe closes when no process holds it
    assert run.returncode in (2, -signal.SIGKILL)
    for _ in range(100):  # its workers end a moment later
        try:
            os.killpg(run.pid, 0)
        except ProcessLookupError:
            return
        time.sleep(0.05)
    pytest.fail("processes are left")
