"""Shared ground of the tests: no display, own folders, and the authors' data where it
is.

Plain definitions that tests compare with stand in tests/definitions/ and import nothing
of the package: ``from tests.definitions.dbscan import clusters`` (`pythonpath` in
pyproject.toml).
"""

import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, settings

from kilnflight.publication import data, style
from kilnflight.recording.frames import Attributes, Frame
from kilnflight.recording.store import write_recording
from kilnflight.regression import Fit
from kilnflight.simulated.kiln import scenes
from kilnflight.store.cache import locked
from kilnflight.tables import BELT_TRACKS

mpl.use("Agg")
PROJECT = Path(__file__).resolve().parents[1]
# No test asserts a time: on a busy machine the first example may wait for the compiler.
settings.register_profile(
    "untimed",
    deadline=None,
    max_examples=15,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("untimed")


FIRST = ("test_site_pages.py", "test_makefile.py")  # take longest
LAST = ("test_notebooks.py",)  # waits for what the first of them runs


def pytest_collection_modifyitems(items):
    """Begin with the longest files, so that processes end together."""

    def rank(item):
        name = item.path.name
        return (name in LAST) - (name in FIRST)

    items.sort(key=rank)


@pytest.fixture(autouse=True)
def own_folders(tmp_path, monkeypatch):
    """Keep every test away from the project's figures and from the caller's
    settings.
    """
    monkeypatch.setenv("KILNFLIGHT_FIGURES", str(tmp_path / "figures"))
    monkeypatch.setenv("KILNFLIGHT_DERIVED", str(tmp_path / "derived"))
    monkeypatch.delenv("KILNFLIGHT_EXTERNAL", raising=False)
    monkeypatch.setenv("KILNFLIGHT_ROOT", str(PROJECT))


def _authors_data() -> Path | None:
    """Return the folder that KILNFLIGHT_EXTERNAL names, or that of `make data`."""
    named = os.environ.get("KILNFLIGHT_EXTERNAL")
    folder = Path(named or PROJECT / "data" / "external")
    there = all((folder / name).is_file() for name in data.BELT_DEM.values())
    return folder if there else None


AUTHORS_DATA = _authors_data()


@pytest.fixture
def authors_data(monkeypatch) -> Path:
    """The folder with the authors' DEM tracks."""
    if AUTHORS_DATA is None:
        pytest.skip("the authors' DEM tracks are not here (make data fetches them)")
    monkeypatch.setenv("KILNFLIGHT_EXTERNAL", str(AUTHORS_DATA))
    return AUTHORS_DATA


@pytest.fixture
def axes():
    """Empty axes in the project's style."""
    figure, grid = style.canvas(1, 1)
    yield grid[0, 0]
    plt.close(figure)


@pytest.fixture(scope="session")
def smoke(tmp_path_factory):
    """Every notebook at quick scale, without the authors' data, and its pages.

    Processes of pytest-xdist share one: the first makes it, the others wait.
    """
    fetched = any((PROJECT / "data" / "external").glob("*.zip"))
    if (
        os.environ.get("KILNFLIGHT_SMOKE") and not fetched
    ):  # CI has just run `make quick`
        folder = tmp_path_factory.mktemp("smoke")
        for name, made in {
            "build": "build/quick",
            "figures": "build/quick/figures",
            "site": "site",
        }.items():
            (folder / name).symlink_to(PROJECT / made)
        return folder
    shared = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        shared = shared.parent
    folder = shared / "smoke"
    with locked(shared):
        if not (folder / "site").is_dir():  # the site comes last, and whole
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            _run_all(folder)
    return folder


# Numbers of the longest notebooks: two for each process, to begin with.
LONGEST = ("10", "20", "60", "50")
# Executes notebooks one after the other: to start papermill takes half a second.
EXECUTE = """
import sys
tools, build, *paths = sys.argv[1:]
sys.path.insert(0, tools)
from execute import main

sys.exit(max([main([path, "--build", build, "-p", "scale=quick"]) for path in paths]))
"""


def _run_all(folder: Path) -> None:
    """Execute every notebook at quick scale and render the site below a folder."""
    (folder / "external").mkdir()
    project = folder / "project"
    for part in ("notebooks", "identify", "data/reference", "figures"):  # of record
        shutil.copytree(PROJECT / part, project / part)
    shutil.copy(PROJECT / "CITATION.cff", project)
    environment = {
        **os.environ,
        "KILNFLIGHT_ROOT": str(project),
        "KILNFLIGHT_FIGURES": str(folder / "figures"),
        "KILNFLIGHT_DERIVED": str(folder / "derived"),
    }
    environment.pop("KILNFLIGHT_EXTERNAL", None)
    build, sources = str(folder / "build"), sorted((PROJECT / "notebooks").glob("*.py"))

    def run(*arguments):
        done = subprocess.run(
            [sys.executable, *arguments],
            env=environment,
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr

    def execute(paths):
        run("-c", EXECUTE, str(PROJECT / "tools"), build, *map(str, paths))

    early = [
        path for number in LONGEST for path in sources if path.stem.startswith(number)
    ]
    last = [path for path in sources if path.stem in ("00_claims", "01_choices")]
    others = [*early, *(path for path in sources if path not in (*early, *last))]
    with ThreadPoolExecutor(2) as pool:  # two processes
        list(pool.map(execute, [others[::2], others[1::2]]))
    execute(last)  # these collect what the others said
    run(str(PROJECT / "tools" / "gallery.py"), str(folder / "gallery"), "bead")
    run(str(PROJECT / "docs" / "generate.py"), build, str(folder / "site"))


@pytest.fixture
def seeds() -> Path:
    """The folder with the texts of the three works; KILNFLIGHT_WORKS names it."""
    folder = os.environ.get("KILNFLIGHT_WORKS")
    if not folder:
        pytest.skip("KILNFLIGHT_WORKS names no texts of the works (not ours to ship)")
    return Path(folder)


@pytest.fixture
def constant_acceleration() -> pd.DataFrame:
    """Three belt particles of constant acceleration, sampled at 100 Hz up to 900 mm."""
    time, tracks = np.arange(200) / 100.0, []
    for particle, start, (velocity, acceleration), (lateral, braking) in (
        (3, 0, (1000.0, 1500.0), (50.0, -100.0)),
        (5, 7, (1200.0, 800.0), (-20.0, -100.0)),
        (8, 2, (900.0, 0.0), (50.0, 0.0)),
    ):
        frame = start + np.arange(200)
        x = 400.0 + velocity * time + acceleration * time**2 / 2
        y = 90.0 + lateral * time + braking * time**2 / 2
        columns = {
            "frame": frame,
            "particle": particle,
            "time_s": frame / 100.0,
            "x": x,
            "y": y,
        }
        tracks.append(pd.DataFrame(columns)[BELT_TRACKS.names][x < 900.0])
    return pd.concat(tracks, ignore_index=True)


@pytest.fixture(scope="session")
def kept_scene():
    """A function that gives a scene by name; its flights are made once."""
    return cache(scenes.open_scene)


@dataclass
class SmallRecording:
    """A recording of 24 x 32 pixels in memory; ``asked`` lists the frames that were
    rendered.
    """

    length: int = 5
    attributes: Attributes = field(default_factory=lambda: SMALL)
    stops_at: int | None = None
    asked: list[int] = field(default_factory=list)

    def __len__(self) -> int:
        return self.length

    def content(self) -> str:
        return "in memory"

    def frame(self, t: int) -> Frame:
        if t == self.stops_at:
            raise KeyboardInterrupt
        self.asked.append(t)
        rng = np.random.default_rng(t)
        gray = rng.integers(0, 4096, (24, 32), dtype=np.uint16)
        flat = rng.choice(24 * 32, 10 * t, replace=False)  # frame 0 has no points
        pixels = np.column_stack(np.divmod(flat, 32)).astype(np.int32)
        xyz = rng.normal(5000, 1000, (len(flat), 3)).astype(np.float32)
        labels = rng.integers(0, 5, (24, 32), dtype=np.uint8) if t % 2 else None
        return Frame(t, t / 330.0, gray, pixels, xyz, labels)


SMALL = Attributes(
    "small",
    330.0,
    24,
    32,
    fraction="confetti",
    pressure_bar=4.5,
    lance_mm=(10.0, -20.0, 9000.0),
    roi=((0, 0), (24, 0), (24, 32)),
    flame_roi=(2, 8, 3, 9),
)


@pytest.fixture
def small() -> SmallRecording:
    return SmallRecording()


@pytest.fixture(scope="session")
def stored_flights(tmp_path_factory, kept_scene) -> Path:
    """Twenty frames of the small twin on disk, in which paper shreds fly."""
    folder = tmp_path_factory.mktemp("recordings") / "shreds.zarr"
    twin = kept_scene("paper-shred-4.5-bar@small")
    write_recording(twin, folder, range(562, 582))
    return folder


@pytest.fixture(scope="session")
def same_frame():
    """Raise unless two frames hold the same values of the same types."""

    def same(one: Frame, other: Frame) -> None:
        assert (one.index, one.time_s) == (other.index, other.time_s)
        for name in ("gray", "pixels", "xyz", "labels"):
            a, b = getattr(one, name), getattr(other, name)
            assert (a is None) == (b is None)
            if a is not None:
                assert a.dtype == b.dtype
                np.testing.assert_array_equal(a, b)

    return same


@pytest.fixture(scope="session")
def polynomials():
    """A function that gives a fitted trajectory of given coefficients."""

    def fit(coefficients, t0=0.0, first_s=0.02, last_s=0.4):
        outlet, orders = (0.0, 0.0, 6500.0), (2, 2, 2)
        return Fit(
            outlet, t0, 0, (t0, t0), orders, coefficients, first_s, last_s, points=80
        )

    return fit
