"""Shared ground of the tests: no display, own folders, and the authors' data where it is."""

import os
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest

from kilnflight import external
from kilnflight.tables import BELT_TRACKS

mpl.use("Agg")
PROJECT = Path(__file__).resolve().parents[1]


@pytest.fixture(autouse=True)
def own_folders(tmp_path, monkeypatch):
    """Keep every test away from the project's figures and from the caller's settings."""
    monkeypatch.setenv("KILNFLIGHT_FIGURES", str(tmp_path / "figures"))
    monkeypatch.delenv("KILNFLIGHT_EXTERNAL", raising=False)
    monkeypatch.setenv("KILNFLIGHT_ROOT", str(PROJECT))


def _authors_data() -> Path | None:
    named = os.environ.get("KILNFLIGHT_EXTERNAL")
    folders = [Path(named)] if named else []
    folders += [PROJECT / "data" / "external", PROJECT.parent / "shared" / "data" / "belt_dem"]
    wanted = [file.name for file in external.FILES]
    return next((f for f in folders if all((f / name).is_file() for name in wanted)), None)


AUTHORS_DATA = _authors_data()


@pytest.fixture
def authors_data(monkeypatch) -> Path:
    """The folder with the authors' DEM tracks."""
    if AUTHORS_DATA is None:
        pytest.skip("the authors' DEM tracks are not here (make data fetches them)")
    monkeypatch.setenv("KILNFLIGHT_EXTERNAL", str(AUTHORS_DATA))
    return AUTHORS_DATA


@pytest.fixture
def seeds() -> Path:
    """The folder with the three publications."""
    folder = PROJECT.parent / "shared" / "seeds"
    if not folder.is_dir():
        pytest.skip("the publications' texts are not here (they are not ours to ship)")
    return folder


def make_tracks(
    x0=400.0, velocity=1000.0, acceleration=1500.0, y0=90.0, lateral=50.0, braking=-100.0, **more
) -> pd.DataFrame:
    """Return one track of exactly constant acceleration, sampled at 100 Hz up to 900 mm."""
    particle, start = more.get("particle", 0), more.get("start", 0)
    time = np.arange(200) / 100.0
    x = x0 + velocity * time + acceleration * time**2 / 2
    on = x < 900.0
    y = y0 + lateral * time + braking * time**2 / 2
    frame = start + np.arange(200)
    table = pd.DataFrame(
        {"frame": frame, "particle": particle, "time_s": frame / 100.0, "x": x, "y": y}
    )
    return table[on][BELT_TRACKS.names].reset_index(drop=True)


@pytest.fixture
def constant_acceleration() -> pd.DataFrame:
    """Three particles that every model with its own acceleration predicts exactly."""
    return pd.concat(
        [
            make_tracks(particle=3),
            make_tracks(particle=5, velocity=1200.0, acceleration=800.0, lateral=-20.0, start=7),
            make_tracks(particle=8, velocity=900.0, acceleration=0.0, braking=0.0, start=2),
        ],
        ignore_index=True,
    )
