"""Films of other kinds than the kiln's: particles that are found, tracked, or warned
about.
"""

from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
from tests.definitions.films import film

import kilnflight
from kilnflight.__main__ import main
from kilnflight.film.preparation import choose
from kilnflight.film.settings import Options
from kilnflight.scores import score_detections, score_tracks

ROD, OTSU = {"kind": "rod", "size": (20, 3)}, {"detector": "otsu"}
# film, options, least recall and precision (where nothing is warned about), what the
# summary says
KINDS = {
    "resting": ({"drift": (0, 0)}, {}, 0.95, "none"),
    "nearly resting": ({"drift": (0, 0), "diffusion": 0.1}, {}, 0.9, ""),
    "faint in 16 bit": (
        {"amplitude": 10, "base": 500, "dtype": np.uint16},
        {},
        0.9,
        "",
    ),
    "flicker": ({"flicker": 0.05, "base": 150, "amplitude": 40}, {}, 0.9, "brought to"),
    "shaking texture": (
        {"texture": 10, "shake": 1.0, "frames": 25},
        {},
        0.8,
        "shakes by",
    ),
    "discs": ({"kind": "disc", "size": 5}, {"size": 10}, 0.9, ""),
    "discs by area": ({"kind": "disc", "size": 5, "frames": 25}, OTSU, 0.9, ""),
    "rings": ({"kind": "ring", "size": 4}, {"size": 8}, 0.9, ""),
    "rods by area": (ROD, OTSU, 0.8, ""),
    "streaks by area": (ROD | {"size": (14, 2), "drift": (0, 5)}, OTSU, 0.8, ""),
    "rods as spots": (ROD, {}, 0.0, "--detector otsu"),
    "flow of 120": (
        {"cells": (10, 12), "pitch": 18, "drift": (0, 11), "frames": 9},
        {},
        0.9,
        "",
    ),
    "two frames": ({"frames": 2}, {}, 0.9, "none (only 2"),
    "one frame": ({"frames": 1}, {}, 0.9, "none (only 1"),
    "dark": ({"amplitude": -60}, {"dark": True}, 0.9, ""),
    "small": ({"size": 0.9}, {}, 0.9, "4 times (spots"),
    "three pixels": ({"size": 0.9}, {"size": 3}, 0.9, ""),
}
PIXEL = ["row", "col"]
WARNED = ("shaking texture", "rods as spots")


def rates(truth, found):
    """Return recall and precision of detections."""
    frames = set(truth["frame"])
    both = [
        [table[table["frame"] == t][PIXEL] for table in (truth, found)] for t in frames
    ]
    right = sum(score_detections(*each, gate=3.0).tp for each in both)
    return right / len(truth), right / max(len(found), 1)


@pytest.mark.parametrize("name", KINDS)
def test_particles_of_other_kinds_are_found_or_warned_about(name):
    given, options, least, said = KINDS[name]
    pictures, truth = film(**{"frames": 12, "cells": (3, 4)} | given)
    if name in WARNED:
        with pytest.warns(UserWarning, match=said):
            found = kilnflight.detect(pictures, **options)
    else:
        found = kilnflight.detect(pictures, **options)
    recall, precision = rates(truth, found)
    assert recall >= least
    assert precision >= least or name in WARNED
    if said or name.endswith("area"):
        rows = []
        choose(kilnflight.open(pictures), Options(**options), rows)
        assert said in str(rows)
        assert ("warning" in dict(rows)) == (name in WARNED)


@pytest.fixture(scope="module")
def small():
    """A film of six particles, and its detections."""
    pictures, truth = film(frames=12, cells=(2, 3), pitch=30, drift=(0.0, 1.0))
    return pictures, kilnflight.detect(pictures), truth


def write(path, pictures, numbers=range(999)):
    """Write a film as the ending asks for; a folder has the name of its pictures'
    ending.
    """
    if path.suffix == ".npy":
        np.save(path, pictures)
    elif path.suffix:
        codec = cv2.VideoWriter_fourcc(*("FFV1" if path.suffix == ".avi" else "mp4v"))
        writer = cv2.VideoWriter(
            str(path), codec, 25.0, pictures.shape[2:0:-1], isColor=False
        )
        for picture in pictures:
            writer.write(picture)
        writer.release()
    else:
        path.mkdir()
        for number, picture in zip(numbers, pictures, strict=False):
            assert cv2.imwrite(f"{path}/a_{number:05d}.{path.name}", picture)


def test_a_pattern_and_a_manifest_of_times_give_what_the_array_gives(small, tmp_path):
    write(tmp_path / "png", small[0], np.arange(7000, 9000, 100) // 3)  # ms
    text = "name = 'a'\nframe_rate_hz = 9\n[gray]\npattern = 'png\\a_{frame}.png'\n"
    (tmp_path / "a.toml").write_text(text, "utf-8-sig")
    for source in ("png/a_*.png", "a.toml"):
        pd.testing.assert_frame_equal(kilnflight.detect(tmp_path / source), small[1])


@pytest.mark.parametrize("name", ["jpg", "a.mp4", "a.npy"])
def test_what_is_compressed_or_scaled_is_found_as_well(name, small, tmp_path):
    write(tmp_path / name, small[0] / 255 if name == "a.npy" else small[0])
    assert min(rates(small[2], kilnflight.detect(tmp_path / name))) > 0.9


def test_a_film_of_0_and_1_is_scaled_and_particles_that_rest_among_others_are_told_of(
    small,
):
    masks = small[0] > 125
    for source in (masks, masks.astype(np.uint8)):
        assert rates(small[2], kilnflight.detect(source))[0] > 0.9
    moving, resting = (
        film(frames=12, cells=(4, 4), drift=(0, step))[0] for step in (3, 0)
    )
    both = np.concatenate([moving, resting], axis=2)
    rows = []
    choose(kilnflight.open(both), Options(), rows)
    assert "count as background" in str(rows)


def test_a_table_in_steps_is_linked_and_keeps_its_numbers(small):
    table = small[1][["frame", "row", "col"]]  # of another program
    stepped = table.assign(frame=table["frame"] * 33 + 5)
    with pytest.warns(UserWarning, match="steps of 33"):
        tracks = kilnflight.track(stepped)
    assert tracks.pop("number").tolist() == stepped["frame"].tolist()
    pd.testing.assert_frame_equal(tracks, kilnflight.track(table))


def test_frames_of_a_film_keep_their_numbers(small):
    """What is detected in every second frame is linked as in a run: by memory alone."""
    found = small[1][small[1]["frame"] % 2 == 0]
    tracks = kilnflight.track(found)
    assert tracks["particle"].value_counts().tolist() == 6 * [6]
    assert tracks["frame"].tolist() == found["frame"].tolist()
    with pytest.warns(UserWarning, match="linked"):
        tracks = kilnflight.track(found, memory=0)
    assert not tracks["particle"].duplicated().any()


def test_doubts_are_said_in_python_as_by_the_command(small):
    apart = small[1][small[1]["frame"].isin([0, 11])]
    with pytest.warns(UserWarning, match="0 of 12"):
        kilnflight.track(apart, memory=0)
    with pytest.warns(UserWarning, match="3 particles"):
        kilnflight.track(small[1].head(3))


def test_a_run_writes_tables_and_pictures_and_keeps_to_its_options(
    small, tmp_path, monkeypatch
):
    pictures, found, truth = small
    monkeypatch.chdir(tmp_path)
    write(Path("png"), pictures)
    main(["run", "png"])
    tracks = pd.read_csv("png-run/tracks.csv")
    assert score_tracks(truth, tracks, 3.0, columns=PIXEL).tp == len(truth)
    pd.testing.assert_frame_equal(pd.read_parquet("png-run/detections.parquet"), found)
    part = ["--roi", "0", "44", "10", "88", "--frames", "2", "10", "--max-step", "4"]
    main(["run", "png", *part, "--background", "none", "--size", "5"])
    assert (
        len(list(Path("png-run/parts").glob("recording-*.zarr"))) == 1
    )  # one copy serves both
    found = pd.read_parquet("png-run/detections.parquet")
    words = {
        "roi": (0, 44, 10, 88),
        "frames": (2, 10),
        "background": "none",
        "size": 5.0,
    }
    pd.testing.assert_frame_equal(found, kilnflight.detect(pictures, **words))
    assert found["row"].max() < 44
    assert found["frame"].agg(["min", "max"]).tolist() == [2, 9]
    main(["preview", "png", "--to", "p/seen.png", "--size", "5"])
    assert cv2.imread("p/seen.png") is not None
    assert [path.name for path in Path("p").iterdir()] == ["seen.png"]


def test_a_track_goes_on_over_frames_that_are_missing(small, tmp_path):
    there = [t for t in range(12) if t not in (5, 6, 9)]
    write(tmp_path / "png", small[0][there], there)
    tracks = kilnflight.track(kilnflight.detect(tmp_path / "png"))
    assert sorted(set(tracks["frame"])) == there
    assert tracks["particle"].value_counts().tolist() == 6 * [len(there)]
    apart = kilnflight.track(tracks.drop(columns="particle"), memory=1)
    assert apart["particle"].nunique() > 6


def spoiled(pictures):
    return np.where(
        np.arange(pictures.size).reshape(pictures.shape) == 5e4, np.nan, pictures / 255
    )


BAD = [  # the film, its change, options, what the line names
    ("png", lambda film: [*film[:5], film[5, 1:]], "", "frame 5"),
    (
        "png",
        lambda film: [*film[:5], np.dstack([film[5], film[5], film[6]])],
        "",
        "frame 5",
    ),
    ("a.npy", np.array, "--channel red", "red"),
    ("a.npy", spoiled, "", "frame 4"),
    ("a.npy", np.array, "--to a.npy", "a.npy"),  # a file is in the way
    ("a.npy", np.array, "--to a.npy/results", "a.npy"),
    ("a.npy", np.array, "--frames 3 99", "frames"),
    ("a.npy", np.array, "--roi 0 9 5 2", "roi"),
    ("a.npy", np.array, "--size -1", "size"),
    ("a.npy", np.array, "--detector sift", "sift"),
    ("a.avi", lambda film: film[:0], "", "a.avi"),
]


@pytest.mark.parametrize(("name", "change", "options", "named"), BAD)
def test_bad_input_is_one_line_and_no_result(
    name, change, options, named, small, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    write(Path(name), change(small[0]))
    with pytest.raises(SystemExit, match="2"):
        main(["run", name, "--to", "out", *options.split()])
    (line,) = capsys.readouterr().err.splitlines()
    assert named in line
    assert not Path("out").exists()


def test_several_films_run_into_a_folder_each_and_a_bad_one_is_told(
    small, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    for name in ("a.npy", "c.npy"):
        write(Path(name), small[0])
    Path("b.tif").write_text("no film")
    with pytest.raises(SystemExit, match="2"):
        main(["run", "a.npy", "b.tif", "c.npy", "--to", "all", "--threshold", "1"])
    (line,) = capsys.readouterr().err.splitlines()
    assert "b.tif" in line
    assert sorted(path.name for path in Path("all").iterdir()) == ["a", "c"]
    tables = [pd.read_csv(f"all/{name}/tracks.csv") for name in "ac"]
    pd.testing.assert_frame_equal(*tables)
    write(Path("png"), small[0])
    pictures = sorted(map(str, Path("png").iterdir()))
    with pytest.raises(SystemExit, match="2"):  # a pattern without quotes
        main(["run", *pictures])
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert not [*Path().glob("*-run")]


def test_rate_and_scale_make_a_speed_in_um(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    pictures, _ = film(frames=12, cells=(2, 3), pitch=30, drift=(0.0, 1.5))
    write(Path("a.npy"), pictures)
    main(["run", "a.npy", "--to", "a", "--rate", "200", "--scale", "0.65"])
    known = pd.read_csv("a/summary.csv").set_index("what")["value"]
    assert known["frame rate"] == "200 Hz"
    assert known["scale"] == "0.65 um/px"
    pixels, um = known["speed, median"].split(", ")
    assert float(pixels.split()[0]) == pytest.approx(1.5, abs=0.02)
    assert float(um.split()[0]) == pytest.approx(1.5 * 0.65 * 200, rel=0.02)
    main(["run", "a.npy", "--to", "b", "--scale", "0.65"])
    known = pd.read_csv("b/summary.csv").set_index("what")["value"]
    assert "frame rate" not in known
    assert "um/s" not in known["speed, median"]
    with pytest.raises(SystemExit, match="2"):  # a run of the film at another scale
        main(["run", "a.npy", "--to", "b", "--scale", "0.7"])
    assert len(capsys.readouterr().err.splitlines()) == 1


@pytest.mark.parametrize("kind", [{}, {"drift": (0.0, 0.0)}, {"flicker": 0.03}])
def test_a_round_field_is_searched_as_far_as_it_goes(kind, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    pictures, truth = film(**{"frames": 12, "cells": (6, 10)} | kind)
    row, col = np.indices(pictures.shape[1:])
    middle = np.array(pictures.shape[1:]) / 2
    far = np.hypot(row - middle[0], col - middle[1])
    seen = (far < 80) & ~((far < 20) & (row > middle[0]))  # round, and a hole
    assert 0.5 < np.mean(~seen) < 0.6
    dimmed = np.rint(pictures * (1 - 0.3 * (far / 80) ** 2).clip(0))
    holes = dimmed.astype(np.float32)
    holes[:, ~seen] = np.nan
    found = kilnflight.detect(holes)
    there = seen[tuple(truth[PIXEL].to_numpy().round().astype(int).T)]
    recall, precision = rates(truth[there], found)
    assert recall > 0.97
    _, precision = rates(truth, found)  # one cut by the edge may be found
    assert precision > 0.99
    assert seen[tuple(found[PIXEL].to_numpy().round().astype(int).T)].all()
    write(Path("a.npy"), dimmed.astype(np.uint8))
    cv2.imwrite("mask.png", np.dstack(3 * [255 * seen.astype(np.uint8)]))
    main(["run", "a.npy", "--mask", "mask.png", "--to", "results"])
    by_mask = pd.read_parquet("results/detections.parquet")
    pd.testing.assert_frame_equal(by_mask, found)


TABLES = {  # of other programs, made of frame, particle, row, col
    "x, y": lambda table: table.rename(columns={"row": "y", "col": "x"}),
    "index": lambda table: table.set_index("frame"),
    "index and column": lambda table: table.set_index("frame", drop=False),
    "levels": lambda table: table.set_index(["frame", "particle"]),
    "levels and columns": lambda table: table.set_index(
        ["frame", "particle"], drop=False
    ),
    "Int64": lambda table: table.astype(
        {"frame": "Int64", "particle": "Int64", "col": "Float64"}
    ),
    "category": lambda table: table.astype(
        {"frame": "category", "particle": "category"}
    ),
    "floats": lambda table: table.astype(float),
}


@pytest.mark.parametrize("kind", TABLES)
def test_tables_of_other_programs_are_tracked_scored_and_drawn(kind, small, tmp_path):
    pictures, _, truth = small
    table = TABLES[kind](truth)
    score = score_tracks(truth, table, 3.0, columns=PIXEL)
    tracks = kilnflight.track(table.drop(columns="particle", errors="ignore"))
    assert len(tracks) == len(truth)
    assert score.alpha == score_tracks(truth, tracks, 3.0, columns=PIXEL).alpha == 1
    (axes,) = kilnflight.plot_tracks(pictures, table).axes
    assert len(axes.lines) == 6
