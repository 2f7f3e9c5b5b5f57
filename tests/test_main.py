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
        tifffile.imwrite(tmp_path / f"{frame}.tif", np.full((4, 5), 1000 + frame, np.uint16))
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


def test_import_and_info_print_what_a_recording_holds(manifest, tmp_path, capsys):
    assert main(["import", str(manifest)]) == 0
    imported = capsys.readouterr().out.splitlines()
    assert imported[0] == "recording   mine"
    assert imported[2] == "gray        1000 to 1002 (10 bits)"
    assert len(open_recording(tmp_path / "mine.zarr")) == 3
    assert main(["import", str(manifest), "--to", str(tmp_path / "a" / "b")]) == 0
    for kind in ("mine.zarr", "a/b", "mine.toml", "?.tif"):
        capsys.readouterr()
        assert main(["info", str(tmp_path / kind)]) == 0
        assert capsys.readouterr().out.splitlines()[1:] == imported[1:-1]


@pytest.mark.parametrize("fault", [OSError(28, "No space left"), KeyboardInterrupt()])
def test_a_full_disk_and_a_stop_are_one_line(manifest, monkeypatch, capsys, fault):
    def fail(*_):
        raise fault

    monkeypatch.setattr("kilnflight.recording.store.write_recording", fail)
    assert main(["import", str(manifest)]) == 1
    assert len(capsys.readouterr().err.splitlines()) == 1


@pytest.mark.parametrize("extra", [["--frames", "1", "4", "--seed", "7"], []])
def test_export_with_truth(twin, tmp_path, capsys, same_frame, small, extra):
    assert main(["export", "small", str(tmp_path / "s"), *extra]) == 0
    stored = open_recording(tmp_path / "s")
    assert capsys.readouterr().out == f"exported {len(stored)} frames of small to {stored.path}\n"
    assert len(stored) == (3 if extra else 5)
    same_frame(stored.frame(2), small.frame(3 if extra else 2))
    truth = pd.read_parquet(stored.path / "truth/particles.parquet")
    pd.testing.assert_frame_equal(truth, TRUTH["particles"])
    assert twin == [7 if extra else None]


@pytest.mark.parametrize("frames", [(4, 2), (2, 2), (0, 6), (-1, 3)])
def test_frames_are_checked(twin, tmp_path, capsys, frames):
    assert main(["export", "small", str(tmp_path / "s"), "--frames", *map(str, frames)]) == 1
    assert "small" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "command",
    [
        *(["import", "gone.toml"], ["info", "gone"], ["run", "gone"], ["export", "gone", "a.zarr"]),
        *(["detect", "gone", "d.csv", "--threshold", "9"], ["detect", "gone", "no/d.csv"]),
        *(["track", "gone.csv", "t.csv"], ["track", ".", "t.csv"], ["track", "gone.csv", "no/t"]),
        *(["detect", "gone", "gone.xlsx"], ["run", "gone", "--exit-point", "-1", "2", "3e3"]),
    ],
)
def test_a_missing_input_is_one_line_that_names_it(command, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(command) == 1
    output = capsys.readouterr()
    assert output.out == ""
    assert output.err.startswith(f"kilnflight {command[0]}: ")
    assert any(word in output.err for word in ("gone", ".: ", "no/"))
    assert len(output.err.splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_a_recording_is_detected_and_tracked(small, tmp_path, capsys):
    folder, table, tracks = tmp_path / "a.zarr", tmp_path / "d.parquet", tmp_path / "t.csv"
    write_recording(small, folder)
    assert main(["detect", str(folder), str(table)]) == 0
    expected = kilnflight.detect(kilnflight.open(folder))
    assert "note" not in capsys.readouterr().out
    for number in (1, 2, 4):
        tifffile.imwrite(tmp_path / f"{number}.tif", np.full((9, 9), 1000, np.uint16))
    assert (
        main(["detect", str(tmp_path / "*.tif"), str(tmp_path / "n.csv"), "--threshold", "9"]) == 0
    )
    assert "note: 1 of the frames 1 to 4 are missing" in capsys.readouterr().out
    pd.testing.assert_frame_equal(pd.read_parquet(table), expected)
    for extra in ([], ["--raw"], ["--jpda", "--raw"]):
        assert main(["track", str(table), str(tracks), *extra]) == 0
        assert list(pd.read_csv(tracks).columns) == [*expected.columns, "particle"]


@pytest.mark.parametrize("form", ["csv", "challenge", "napari", "trackmate", "trackpy"])
def test_a_flight_is_tracked_in_any_form(form, tmp_path, capsys):
    flight = pd.DataFrame({"x": 40.0, "frame": np.arange(6.0), "y": np.arange(6) * 9.0})
    flight.to_csv(tmp_path / "d.csv", index=False)
    command = ["track", str(tmp_path / "d.csv"), str(tmp_path / "t"), "--format", form]
    assert main(command) == 0
    assert "1 tracks with 6 of 6 detections" in capsys.readouterr().out
    flight[:0].to_csv(tmp_path / "d.csv", index=False)
    assert main(command) == 0
    assert "0 tracks with 0 of 0 detections" in capsys.readouterr().out
    for table, named in [(flight / 2, "frame"), (flight.drop(columns="frame"), "frame")]:
        table.to_csv(tmp_path / "d.csv", index=False)
        assert main(command) == 1
        assert named in capsys.readouterr().err
