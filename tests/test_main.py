import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
import tifffile

import kilnflight
from kilnflight.__main__ import main
from kilnflight.checks import InputError
from kilnflight.recording.store import open_recording, write_recording

TRUTH = {"particles": pd.DataFrame({"particle": [1], "release_s": [0.5]})}


@pytest.fixture
def manifest(tmp_path):
    for frame in range(3):
        gray = np.full((4, 5), 1000 + frame, np.uint16)
        tifffile.imwrite(tmp_path / f"{frame}.tif", gray)
    path = tmp_path / "mine.toml"
    path.write_text('name = "mine"\nframe_rate_hz = 330\n[gray]\npattern = "{frame}.tif"\n')
    return path


@pytest.fixture
def twin(monkeypatch, small):
    """A twin with one scene; the seeds it was asked for."""

    def open_scene(name, seed=None):
        if name != "small":
            raise InputError(f"unknown scene {name!r}; there is small.")
        seeds.append(seed)
        return small

    seeds = []
    monkeypatch.setattr("kilnflight.twin.scenes.open_scene", open_scene)
    monkeypatch.setattr("kilnflight.twin.truth.tables", lambda *_: TRUTH)
    return seeds


def test_import_prints_what_the_recording_holds(manifest, tmp_path, capsys):
    assert main(["import", str(manifest)]) == 0
    out = capsys.readouterr().out
    assert "recording   mine" in out
    assert "gray        1000 to 1002 (10 bits)" in out
    assert len(open_recording(tmp_path / "mine.zarr")) == 3


def test_import_to_another_folder(manifest, tmp_path):
    assert main(["import", str(manifest), "--to", str(tmp_path / "a" / "b")]) == 0
    assert len(open_recording(tmp_path / "a" / "b")) == 3


def test_an_error_is_one_line(manifest, tmp_path, capsys):
    (tmp_path / "1.tif").unlink()
    assert main(["import", str(manifest)]) == 1
    output = capsys.readouterr()
    assert output.out == ""
    assert output.err.startswith("kilnflight import: ")
    assert "frame 1 is missing" in output.err
    assert len(output.err.splitlines()) == 1


def test_a_full_disk_is_an_error(manifest, monkeypatch, capsys):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("kilnflight.recording.importing.import_recording", full)
    assert main(["import", str(manifest)]) == 1
    assert "No space left on device" in capsys.readouterr().err


def test_export_with_truth(twin, tmp_path, capsys, same_frame, small):
    assert main(["export", "small", str(tmp_path / "s"), "--frames", "1:4", "--seed", "7"]) == 0
    assert capsys.readouterr().out == f"exported 3 frames of small to {tmp_path / 's'}\n"
    stored = open_recording(tmp_path / "s")
    same_frame(stored.frame(2), small.frame(3))
    pd.testing.assert_frame_equal(stored.truth()["particles"], TRUTH["particles"])
    assert twin == [7]


@pytest.mark.parametrize("frames", [[], ["--frames", ":"], ["--frames", "0:5"]])
def test_export_of_everything(twin, tmp_path, frames):
    assert main(["export", "small", str(tmp_path / "s"), *frames]) == 0
    assert len(open_recording(tmp_path / "s")) == 5
    assert twin == [None]


@pytest.mark.parametrize("frames", ["3", "4:2", "2:2", "0:6", "-1:3", "a:b"])
def test_frames_are_checked(twin, tmp_path, capsys, frames):
    assert main(["export", "small", str(tmp_path / "s"), f"--frames={frames}"]) == 1
    assert "write A:B with 0 <= A < B <= 5" in capsys.readouterr().err


def test_an_unknown_scene_is_refused(twin, tmp_path, capsys):
    assert main(["export", "large", str(tmp_path / "s")]) == 1
    assert "unknown scene 'large'" in capsys.readouterr().err


def test_a_stopped_export_goes_on(twin, small, tmp_path, capsys):
    small.stops_at = 2
    assert main(["export", "small", str(tmp_path / "s")]) == 1
    assert capsys.readouterr().err == "kilnflight export: stopped\n"
    assert main(["info", str(tmp_path / "s")]) == 1
    assert "cut off after 2 of 5 frames" in capsys.readouterr().err
    small.stops_at = None
    assert main(["export", "small", str(tmp_path / "s")]) == 0


def test_info(small, tmp_path, capsys):
    write_recording(small, tmp_path / "s")
    assert main(["info", str(tmp_path / "s")]) == 0
    assert "frames      5 of 24 x 32 pixels" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (["import", "gone.toml"], "gone.toml: cannot be read (No such file or directory). Give"),
        (["info", "gone"], "gone: there is no recording (no folder with a zarr.json). Give"),
        (["detect", "gone", "d.csv", "--threshold", "9"], "gone: there is no recording (no folder"),
        (["track", "gone.csv", "t.csv"], "gone.csv: is no CSV table (No such file or directory). "),
        (["track", ".", "t.csv"], ".: is no CSV table (Is a directory). Give one that"),
        (["run", "gone"], "gone: there is no recording (no folder with a zarr.json). Give"),
        (["export", "gone", "a.zarr"], "no scene 'gone'; there are V1, V2"),
        (["detect", "gone", "no/d.csv", "--threshold", "9"], "no/d.csv: its folder does not exist"),
        (["track", "gone.csv", "no/t.csv"], "no/t.csv: its folder does not exist. Make it first."),
    ],
)
def test_a_missing_input_is_an_error_that_says_what_to_do(
    command, message, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    assert main(command) == 1
    output = capsys.readouterr()
    assert output.out == ""
    assert output.err.startswith(f"kilnflight {command[0]}: {message}")
    assert len(output.err.splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_a_table_without_rows_has_no_tracks(tmp_path, capsys):
    (tmp_path / "d.csv").write_text("frame,row,col,z\n")
    assert main(["track", str(tmp_path / "d.csv"), str(tmp_path / "t.csv")]) == 0
    assert "0 tracks with 0 of 0 detections" in capsys.readouterr().out
    assert (tmp_path / "t.csv").read_text() == "frame,row,col,z,particle\n"


def test_the_module_runs_as_a_command(tmp_path):
    command = [sys.executable, "-m", "kilnflight", "info", str(tmp_path / "gone")]
    process = subprocess.run(command, capture_output=True, text=True, check=False)
    assert process.returncode == 1
    assert process.stderr.startswith("kilnflight info: ")
    assert len(process.stderr.splitlines()) == 1


def test_a_recording_is_detected_and_tracked(small, tmp_path, capsys):
    folder, table, tracks = tmp_path / "a.zarr", tmp_path / "d.csv", tmp_path / "t.csv"
    write_recording(small, folder)
    assert main(["detect", str(folder), str(table), "--threshold", "200"]) == 0
    detections = pd.read_csv(table)
    assert f"{len(detections)} detections in 5 frames" in capsys.readouterr().out
    for extra in ([], ["--raw"], ["--jpda", "--raw"]):
        assert main(["track", str(table), str(tracks), *extra]) == 0
        linked = pd.read_csv(tracks)
        assert len(linked) == len(detections)
        assert list(linked.columns) == [*detections.columns, "particle"]
    assert main(["track", str(table), str(tmp_path / "t.xml"), "--format", "challenge"]) == 0
    assert "TrackContestISBI2012" in (tmp_path / "t.xml").read_text()
    flight = pd.DataFrame({"frame": range(6), "row": np.arange(6) * 9.0, "col": 40.0})
    flight.to_csv(table, index=False)
    assert main(["track", str(table), str(tracks)]) == 0
    assert "1 tracks with 6 of 6 detections" in capsys.readouterr().out


def test_a_file_that_is_no_table_is_one_line(tmp_path, capsys):
    (tmp_path / "d.csv").write_text("row,col\n1,2\n")
    assert main(["track", str(tmp_path / "d.csv"), str(tmp_path / "t.csv")]) == 1
    assert "frame missing" in capsys.readouterr().err
    (tmp_path / "d.csv").write_bytes(b"\xff\xfe\x00")
    assert main(["track", str(tmp_path / "d.csv"), str(tmp_path / "t.csv")]) == 1
    assert "is no CSV table" in capsys.readouterr().err
    assert not (tmp_path / "t.csv").exists()


def test_a_table_named_parquet_is_parquet(small, tmp_path, capsys):
    write_recording(small, tmp_path / "a")
    table, tracks = tmp_path / "d.parquet", tmp_path / "t.parquet"
    assert main(["detect", str(tmp_path / "a"), str(table), "--threshold", "300"]) == 0
    detections = pd.read_parquet(table)
    assert main(["detect", str(tmp_path / "a"), str(tmp_path / "d.csv"), "--threshold", "300"]) == 0
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "d.csv"), detections, check_dtype=False)
    assert main(["track", str(table), str(tracks), "--raw"]) == 0
    assert len(pd.read_parquet(tracks)) == len(detections)
    for name in ("d.xlsx", "d.json"):
        assert main(["detect", str(tmp_path / "a"), str(tmp_path / name)]) == 1
        assert f"{name}: name a table .csv or .parquet." in capsys.readouterr().err
        assert not (tmp_path / name).exists()


def test_without_a_threshold_it_is_that_of_python(small, tmp_path):
    write_recording(small, tmp_path / "a")
    assert main(["detect", str(tmp_path / "a"), str(tmp_path / "d.csv")]) == 0
    table = kilnflight.detect(kilnflight.open(tmp_path / "a"))
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "d.csv"), table, check_dtype=False)


@pytest.mark.parametrize("form", ["csv", "challenge", "napari", "trackmate", "trackpy"])
def test_whole_frames_may_be_written_as_floats(form, tmp_path, capsys):
    flight = pd.DataFrame({"frame": np.arange(6.0), "row": np.arange(6) * 9.0, "col": 40.0})
    flight.to_csv(tmp_path / "d.csv", index=False)
    command = ["track", str(tmp_path / "d.csv"), str(tmp_path / "t"), "--format", form]
    assert main(command) == 0
    assert "1 tracks with 6 of 6 detections" in capsys.readouterr().out
    flight.assign(frame=flight["frame"] / 2).to_csv(tmp_path / "d.csv", index=False)
    assert main(command) == 1
    assert "column frame: 0.5 in row 1 is no whole number" in capsys.readouterr().err
