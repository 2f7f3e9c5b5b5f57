"""The wheel, installed in an environment of its own: all commands run, away from the
clone.
"""

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from tests.definitions.films import film

from kilnflight import __version__

PROJECT = Path(__file__).resolve().parents[1]
COMMANDS = {
    "preview film.npy --to preview.png": "preview.png",
    "run film.npy --to results": "6 with 72 detections",
    "track results/detections.parquet tracks.csv": "6 tracks with 72 of 72 detections",
    "import film.npy --to film.zarr": "film.zarr",
    "info film.zarr": "12 of 88 x 118 pixels",
    "export confetti-4.5-bar kiln --frames 0 1": "1 frames",
}
MAIN = (
    "import sys; from kilnflight.__main__ import main; [main(c.split()) for c in "
    "sys.argv[1:]]"
)


def called(*command, folder):
    """Return what a command prints, with nothing of this project in its
    surroundings.
    """
    kept = {
        k: v
        for k, v in os.environ.items()
        if not k.startswith(("KILNFLIGHT", "PYTHON"))
    }
    done = subprocess.run(command, cwd=folder, env=kept, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture
def installed(tmp_path):
    """A folder with a film, and an environment in which only the wheel's dependencies
    are.
    """
    source, python = tmp_path / "source", tmp_path / "env" / "bin" / "python"
    shutil.copytree(
        PROJECT / "analysis", source / "analysis", ignore=lambda *_: ["__pycache__"]
    )
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(PROJECT / name, source)
    build = "import setuptools.build_meta as b; b.build_wheel('..')"
    called(sys.executable, "-c", build, folder=source)
    called(sys.executable, "-m", "venv", "--without-pip", "env", folder=tmp_path)
    (packages,) = (tmp_path / "env").glob("lib/*/site-packages")
    (packages / "others.pth").write_text(sysconfig.get_path("purelib"))
    pip = (
        sys.executable,
        "-m",
        "pip",
        "--python",
        python,
        "install",
        "--no-deps",
        "--no-index",
    )
    called(*pip, *tmp_path.glob("*.whl"), folder=tmp_path)
    shutil.rmtree(source)
    here = PROJECT / "analysis"
    for path in here.rglob(
        "*.py"
    ):  # what is compiled already, of a source of the same age
        shutil.copystat(path, packages / path.relative_to(here))
        for made in path.parent.glob(f"__pycache__/{path.stem}.*.nb[ci]"):
            shutil.copy(made, packages / made.relative_to(here).parent)
    np.save(
        tmp_path / "film.npy",
        film(frames=12, cells=(2, 3), pitch=30, drift=(0.0, 1.0))[0],
    )
    return tmp_path


def test_every_command_runs_away_from_the_clone(installed):
    version = called(installed / "env/bin/kilnflight", "--version", folder=installed)
    assert version == f"kilnflight {__version__}\n"
    printed = called(
        installed / "env/bin/python", "-c", MAIN, *COMMANDS, folder=installed
    )
    assert [told for told in COMMANDS.values() if told not in printed] == []
    assert set(pd.read_csv(installed / "tracks.csv")["particle"]) == set(range(6))
