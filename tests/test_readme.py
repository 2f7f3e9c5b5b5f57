"""README.md and docs: the example uses names that exist, links lead somewhere, it stays
short.
"""

import ast
import gc
import re
import shlex
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
from kilnflight.simulated.belt.rendering import BULKS, Pictures
from kilnflight.tables import BELT_PREDICTED

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


def test_the_sorter_of_ones_own_runs_as_written(tmp_path, monkeypatch, capsys):
    frame = np.tile(np.arange(5, 30), 40)
    start = np.repeat(np.random.default_rng(0).uniform(400, 550, 40), 25)
    columns = {
        "frame": frame,
        "particle": np.repeat(np.arange(40), 25),
        "time_s": 0.005 * frame,
    }
    columns |= {"x": start + 6.0 * frame, "y": np.repeat(np.linspace(5, 175, 40), 25)}
    np.save(
        tmp_path / "belt.npy",
        list(Pictures(pd.DataFrame(columns), BULKS["spheres"], 0).frames(range(30))),
    )
    monkeypatch.chdir(tmp_path)
    text, names = (PROJECT / "docs" / "own_recording.md").read_text(), {}
    for block in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
        if "belt import" in block or "sorter" in block:
            exec(block, names)
    gc.unfreeze()
    printed = capsys.readouterr().out
    assert "1203 mm/s" in printed
    assert "0 commands were late, 0 too late" in printed
    commands = len(re.findall(r"valve \d+: open", printed))
    rest = names["schedule"].step(30 * 0.005, 1.0, BELT_PREDICTED.empty())
    assert commands + len(rest) >= 5


@pytest.mark.parametrize("name", TEXTS)
def test_links_lead_somewhere(name):
    path = PROJECT / name
    for target in re.findall(r"\]\((?!http)([^)#]+)", path.read_text()):
        assert (path.parent / target).exists(), target


def test_the_readme_is_short():
    assert len((PROJECT / "README.md").read_bytes()) < 6500
