import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
import tifffile

import kilnflight
from kilnflight.__main__ import COMMANDS, LISTED, main
from kilnflight.checks import InputError
from kilnflight.recording.store import open_recording

TRUTH = {"particles": pd.DataFrame({"particle": [1], "release_s": [0.5]})}


@pytest.fixture
def manifest(tmp_path):
    for frame in range(3):
        tifffile.imwrite(
            tmp_path / f"{frame}.tif", np.full((4, 5), 1000 + frame, np.uint16)
        )
    path = tmp_path / "mine.toml"
    path.write_text(
        'name = "mine"\nframe_rate_hz = 330\n[gray]\npattern = "{frame}.tif"\n'
    )
    return path


@pytest.fixture
def twin(monkeypatch, small):
    """A twin with one scene; the seeds it was asked for."""

    def open_scene(name, seed=None):
        seeds.append(seed)
        return small

    seeds = []
    monkeypatch.setattr("kilnflight.simulated.kiln.scenes.open_scene", open_scene)
    monkeypatch.setattr("kilnflight.simulated.kiln.truth.tables", lambda *_: TRUTH)
    return seeds


def test_import_and_info_print_what_a_recording_holds(
    manifest, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    main(["import", str(manifest)])
    imported = capsys.readouterr().out.splitlines()
    assert "mine.zarr" in imported[0]
    assert imported[1] == "recording        mine"
    assert imported[3] == "gray             1000 to 1002 (10 bits)"
    assert len(open_recording(tmp_path / "mine.zarr")) == 3
    main(["import", str(manifest), "--to", str(tmp_path / "a" / "b")])
    stated = {"?.tif": ["--rate", "330"]}  # the others state it themselves
    for kind in ("mine.zarr", "a/b", "mine.toml", "?.tif"):
        capsys.readouterr()
        main(["info", str(tmp_path / kind), *stated.get(kind, [])])
        assert capsys.readouterr().out.splitlines()[1:] == imported[2:]


@pytest.mark.parametrize("fault", [OSError(28, "No space left"), KeyboardInterrupt()])
def test_a_full_disk_and_a_stop_are_one_line(manifest, monkeypatch, capsys, fault):
    def fail(*_):
        raise fault

    monkeypatch.setattr("kilnflight.recording.store.write_recording", fail)
    with pytest.raises(SystemExit, match="2"):
        main(["import", str(manifest)])
    assert len(capsys.readouterr().err.splitlines()) == 1


@pytest.mark.parametrize("extra", [["--frames", "1", "4", "--seed", "7"], []])
def test_export_with_truth(twin, tmp_path, capsys, same_frame, small, extra):
    main(["export", "small", str(tmp_path / "s"), *extra])
    stored = open_recording(tmp_path / "s")
    assert (
        capsys.readouterr().out
        == f"exported {len(stored)} frames of small to {stored.path}\n"
    )
    assert len(stored) == (3 if extra else 5)
    same_frame(stored.frame(2), small.frame(3 if extra else 2))
    truth = pd.read_parquet(stored.path / "truth/particles.parquet")
    pd.testing.assert_frame_equal(truth, TRUTH["particles"])
    assert twin == [7 if extra else None]


@pytest.mark.parametrize(
    "command",
    [
        *(
            ["import", "gone.toml"],
            ["info", "gone"],
            ["run", "gone"],
            ["export", "gone", "a.zarr"],
        ),
        *(["preview", "gone"], ["track", "gone.csv", "t.csv"], ["track", ".", "t.csv"]),
        *(
            ["track", "gone.csv", "no/t"],
            ["track", "gone.csv", "t", "--format", "gone"],
        ),
        *(["detect", "gone"], ["run", "gone", "--size", "no/"], ["run"], []),
        *(
            ["export", "V1@small", "s", "--frames", *ends]
            for ends in (("4", "2"), ("0", "9999"))
        ),
    ],
)
def test_a_wrong_input_is_named_in_the_last_line(
    command, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit, match="2"):
        main(command)
    output = capsys.readouterr()
    assert output.out == ""
    assert output.err.splitlines()[-1].startswith("kilnflight")
    assert any(
        word in output.err
        for word in ("gone", ".: ", "no/", "detect", "required", "V1@")
    )
    assert not list(tmp_path.iterdir())


def test_the_version_and_every_command_explain_themselves(capsys):
    for command in (["--version"], *([name, "--help"] for name in COMMANDS)):
        with pytest.raises(SystemExit, match="0"):
            main(command)
    assert kilnflight.__version__ in capsys.readouterr().out


@pytest.mark.filterwarnings("default")  # the command prints them
@pytest.mark.parametrize("form", LISTED["arguments"]["--format"]["choices"])
def test_a_flight_is_tracked_in_any_form(form, tmp_path, capsys):
    flight = pd.DataFrame({"x": 40.0, "frame": np.arange(6.0), "y": np.arange(6) * 9.0})
    flight.to_csv(tmp_path / "d.csv", index=False)
    command = ["track", str(tmp_path / "d.csv"), str(tmp_path / "t"), "--format", form]
    for extra in (
        [],
        ["--jpda"],
        ["--post-processing"],
        ["--max-step", "12", "--memory", "2"],
    ):
        main([*command, *extra])
        printed = capsys.readouterr().out
        assert "1 tracks with 6 of 6 detections" in printed
        assert printed.startswith("warning: 6 particles")
    flight[:0].to_csv(tmp_path / "d.csv", index=False)
    main(command)
    assert "0 tracks with 0 of 0 detections" in capsys.readouterr().out
    for table, named in [
        (flight / 2, "frame"),
        (flight.drop(columns="frame"), "frame"),
    ]:
        table.to_csv(tmp_path / "d.csv", index=False)
        with pytest.raises(SystemExit, match="2"):
            main(command)
        assert named in capsys.readouterr().err


@pytest.mark.filterwarnings("default")
def test_what_is_done_with_a_depth_is_said(tmp_path, capsys):
    frame, particle = np.divmod(np.arange(200), 5)
    table = pd.DataFrame({"frame": frame, "row": 40.0 * particle, "col": 0.5 * frame})
    deep = table.assign(z=900.0 + particle)
    for each, named in (
        (deep, "--post-processing"),
        (deep.rename(columns={"row": "y", "col": "x"}), "z is not used"),
        (table, ""),
    ):
        each.to_csv(tmp_path / "d.csv", index=False)
        main(["track", str(tmp_path / "d.csv"), str(tmp_path / "t.csv")])
        printed = capsys.readouterr().out
        assert "5 tracks with 200 of 200 detections" in printed
        assert named in printed
        assert ("warning" in printed) == bool(named)


def test_label_pictures_are_tracked(tmp_path, capsys):
    """Two areas move by 1 px a frame; their labels change, frame 3 is missing."""
    labels = np.zeros((15, 30, 40), np.uint16)
    for t in range(15):
        labels[t, 4:7, t + 2 : t + 6] = 1 + t
        labels[t, 20:23, t + 5 : t + 8] = 700 - t
    (tmp_path / "labels").mkdir()
    for t in set(range(15)) - {3}:
        tifffile.imwrite(tmp_path / f"labels/{t:03d}.tif", labels[t])
    main(["track", str(tmp_path / "labels"), str(tmp_path / "t.csv")])
    assert "2 tracks with 28 of 28 detections" in capsys.readouterr().out
    found = pd.read_csv(tmp_path / "t.csv").sort_values(["row", "frame"])
    assert found["frame"].tolist() == 2 * [*range(3), *range(4, 15)]
    assert found["row"].tolist() == 14 * [5.0] + 14 * [21.0]
    first = found[found["row"] == 5.0]
    assert (first["col"] - first["frame"]).eq(3.5).all()
    tracks = kilnflight.track(labels)
    assert tracks["particle"].value_counts().tolist() == [15, 15]


def discs():
    """Return 6 frames of 12 discs, numbered from 1."""
    row, col = np.mgrid[:90, :120]
    numbers = 1 + row // 30 * 4 + col // 30
    inside = np.hypot(row % 30 - 15, col % 30 - 15) < 6
    return np.repeat((numbers * inside)[None], 6, axis=0).astype(np.uint16)


def noise(kind):
    """Return a film without particles, as its camera gives it."""
    film = np.random.default_rng(1).normal(100, 3, (4, 60, 80))
    return film if kind is float else np.rint(film).astype(kind)


@pytest.mark.parametrize(
    "source",
    [
        (discs() > 0).astype(np.uint8) * 255,
        discs() > 0,
        (discs() > 0) * (1 + discs() % 2),
        noise(np.uint8),
        noise(float),
        (1000 * noise(float) / 3).astype(np.uint16),
    ],
    ids=["mask", "truth", "classes", "film", "floats", "16 bit"],
)
def test_a_mask_or_a_film_is_no_label_pictures(source):
    with pytest.raises(InputError, match=r"skimage\.measure\.label.*kilnflight run"):
        kilnflight.track(source)


@pytest.mark.filterwarnings("ignore:6 particles")
def test_labels_of_any_size_are_read_also_of_one_middle():
    labels = discs()
    for each, count in (
        (labels, 12),
        (np.where(labels == 7, labels, 0), 1),
        (labels * (np.diff(labels.astype(int), axis=1, prepend=0) > 0), 12),  # thin
        (np.where(labels == 0, 20, labels), 13),  # no background
    ):
        assert len(kilnflight.track(each)) == 6 * count
    row, col = np.mgrid[:60, :60] - 30
    nested = np.sum([np.hypot(row, col) < radius for radius in (12, 5)], axis=0)
    tracks = kilnflight.track(np.repeat(nested[None], 5, axis=0).astype(np.uint8))
    assert tracks.groupby("label").size().to_dict() == {1: 5, 2: 5}
    assert (tracks[["row", "col"]] == 30).all(axis=None)


def test_the_package_itself_loads_nothing():
    code = "import kilnflight, sys; print('numpy' in sys.modules)"
    command = [sys.executable, "-c", code]
    process = subprocess.run(command, capture_output=True, text=True, check=True)
    assert process.stdout == "False\n"
    with pytest.raises(AttributeError, match="fly"):
        _ = kilnflight.fly


def test_compiled_functions_are_counted_in_a_terminal():
    script = (
        "import sys, numba; from kilnflight.compiled import show_compiling; "
        "sys.stderr.isatty = lambda: True; show_compiling(); "
        "numba.njit(lambda x: x + 1)(1); numba.njit(lambda x: x + 2)(1)"
    )
    call = [sys.executable, "-c", script]
    run = subprocess.run(call, capture_output=True, text=True, check=True)
    assert "compiling: 2 functions" in run.stderr
