"""README.md and docs: the example uses names that exist, links lead somewhere, it stays
short.
"""

import ast
import gc
import re
import shlex
import time
from functools import reduce
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
import tifffile
from tests.definitions import films

import kilnflight
from kilnflight.__main__ import main
from kilnflight.belt import online
from kilnflight.simulated.belt.rendering import BULKS, Pictures

PROJECT = Path(__file__).resolve().parents[1]
TEXTS = ("README.md", "CONTRIBUTING.md", "data/README.md")


def test_the_example_imports_and_calls_what_is_there():
    text = (PROJECT / "docs" / "own_recording.md").read_text()
    example = re.findall(r"```python\n(.*?)```", text, re.DOTALL)[-1]
    tree = ast.parse(example)
    imports = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
    names = {}
    exec(compile(ast.Module(imports, []), "own_recording.md", "exec"), names)
    for node in ast.walk(tree):
        path = ast.unparse(node).split(".") if isinstance(node, ast.Attribute) else []
        if path and path[0] in names and all(part.isidentifier() for part in path):
            assert reduce(getattr, path[1:], names[path[0]]) is not None


@pytest.fixture
def film(tmp_path, monkeypatch):
    """Write a film of three spots that cross 12 frames, as one TIFF and as files, and
    be there.
    """
    frames, _ = films.film(
        frames=12, cells=(1, 3), pitch=30, drift=(0.0, 1.0), dtype=np.uint16
    )
    monkeypatch.chdir(tmp_path)
    tifffile.imwrite("film.tif", frames, photometric="minisblack")
    for t, frame in enumerate(frames):
        tifffile.imwrite(f"frame_{t:04d}.tif", frame)
    gray = '[gray]\npattern = "frame_{frame:04d}.tif"\n'
    Path("chips.toml").write_text(f'name = "chips"\nframe_rate_hz = 330.0\n{gray}')


def test_the_steps_on_a_film_of_ones_own_run_as_written(film):
    text = (PROJECT / "docs" / "own_recording.md").read_text()
    first, *others = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    exec(first, names := {})
    assert names["tracks"]["particle"].max() == 2
    assert all(Path(f"{name}.png").is_file() for name in ("preview", "tracks"))
    names["tracks"].to_csv("labels.csv")
    for named in ("square_displacements", "labels.csv"):
        (block,) = (block for block in others if named in block)
        exec(block, names)
    assert names["fit"].exponent >= 0 or np.isnan(names["fit"].exponent)
    assert names["score"].alpha == names["scores"][0].f1 == 1
    commands = re.findall(r"^[ `]*\.venv/bin/kilnflight ([^`#\n]+)", text, re.MULTILINE)
    steps = [shlex.split(command) for command in commands if "ADDRESS" not in command]
    assert [step[0] for step in steps] == [
        "preview",
        "run",
        "track",
        "import",
        "info",
        "run",
    ]
    assert not any(main(step) for step in steps)
    assert all(
        Path(name).is_file() for name in ("results/tracks.png", "chips/tracks.csv")
    )
    assert pd.read_csv("tracks.csv", skiprows=[1, 2, 3])["TRACK_ID"].max() == 2


def test_maps_of_depth_get_x_and_y_as_written(film):
    text = (PROJECT / "docs" / "own_recording.md").read_text()
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    (block,) = (each for each in blocks if "depth maps" in each)
    Path("depth").mkdir()
    depth = np.full(tifffile.imread("frame_0000.tif").shape, 3000, np.uint16)
    depth[:, 0] = 0
    for t in range(12):
        cv2.imwrite(f"depth/{t:04d}.png", depth)
    exec(block, {})
    with open("chips.toml", "a") as file:
        file.write('[coordinates]\npattern = "xyz/{frame}.npy"\ninvalid = "nan"\n')
    frame = kilnflight.open("chips.toml").frame(5)
    middle = (np.array(depth.shape) - 1) / 2
    assert len(frame.pixels) == depth[:, 1:].size
    away = (frame.pixels - middle)[:, ::-1] * [1, -1] * 5.0  # 3000 mm / 600 px
    np.testing.assert_allclose(frame.xyz[:, :2], away, rtol=1e-5)
    assert set(frame.xyz[:, 2]) == {3000.0}


@pytest.fixture(scope="module")
def belt_film():
    """Return pictures of 60 spheres that all run as fast."""
    frame = np.tile(np.arange(75), 60)
    start = np.repeat(np.linspace(50, 390, 60), 75)
    x = start + 6.0 * frame
    y = np.repeat(np.random.default_rng(0).permuted(np.linspace(5, 175, 60)), 75)
    table = pd.DataFrame({"frame": frame, "time_s": 0.005 * frame, "x": x, "y": y})
    table["particle"] = np.repeat(np.arange(60), 75)
    table = table[(x > 388) & (x < 800)]
    return np.array(list(Pictures(table, BULKS["spheres"], 0).frames(range(75))))


def test_the_sorter_of_ones_own_runs_as_written(
    tmp_path, monkeypatch, capsys, belt_film
):
    monkeypatch.chdir(tmp_path)
    np.save("belt.npy", belt_film)
    for sorter in (online.sort_spots, online.sort_pictures):  # time stands still
        defaults = [
            (lambda: 0.0) if each is time.perf_counter else each
            for each in sorter.__defaults__
        ]
        monkeypatch.setattr(sorter, "__defaults__", tuple(defaults))
    text = (PROJECT / "docs" / "sorter.md").read_text()
    names = {}
    for block in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
        exec(block, names)
    gc.unfreeze()
    printed = capsys.readouterr().out
    assert "0 late, 0 too late" in printed
    assert len(re.findall(r"valve \d+: ", printed)) > 20
    cuboids = int(re.search(r"(\d+) cuboids are blown out", printed)[1])
    assert cuboids == pytest.approx(200, abs=3)
    commands = re.findall(r"^    \.venv/bin/kilnflight (.*)", text, re.MULTILINE)
    for command in commands:
        main(shlex.split(command))
    assert len(commands) == 1
    assert Path("results/predictions.parquet").is_file()


def test_the_windows_of_the_sample_are_as_told():
    line = kilnflight.Line(until_mm=688.0, spread_mm=0.1)
    tables, _ = kilnflight.predict_line(kilnflight.sample_spots(), line)
    text = (PROJECT / "docs" / "sorter.md").read_text()
    row = r"^\|[\w ,]*\| [\w ]+ \| (\d+) % \| ([\d.]+) % \| ([\d.]+) ms \|"
    told = re.findall(row, text, re.MULTILINE)
    found = tables["hits"][["hit_percent", "wrong_percent", "air_ms"]].to_numpy()
    assert len(told) == len(found)
    assert (np.abs(np.array(told, float) - found) < [0.51, 0.051, 0.051]).all()


def test_the_warnings_of_the_sorter_are_explained():
    source = PROJECT / "analysis/kilnflight"
    told = (PROJECT / "docs" / "sorter.md").read_text()
    words = (
        "lie in the tracked",
        "taken for",
        "lost or leave",
        "there twice",
        "pass the",
    )
    for word in words:
        assert word in told
        assert word in (source / "belt/watch.py").read_text()


@pytest.mark.parametrize("name", TEXTS)
def test_links_lead_somewhere(name):
    path = PROJECT / name
    for target in re.findall(r"\]\((?!http)([^)#]+)", path.read_text()):
        assert (path.parent / target).exists(), target


def test_the_readme_is_short():
    assert len((PROJECT / "README.md").read_bytes()) < 6500
