"""make itself, on a copy of the project with three small notebooks and this environment.

The tests of what make keeps share one copy and go on where the one before ended: what every
test needs anew is made once.
"""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[1]
NOTEBOOK = """# %% [markdown]
# # {title}

# %% tags=["parameters"]
scale = "standard"
seed = 1

# %%
import pandas as pd
from kilnflight.project import figures

LAST
origin = figures.trace("{stem}", {{"scale": scale}})
table = pd.DataFrame({{"seed": [seed]}})
figures.save("seed-{stem}".replace("_", "-"), table, caption="A seed.", provenance=origin)
figures.conclude("Seed " + str(seed), [], origin)
"""
CLAIMS = """# %% [markdown]
# # Claims

# %% tags=["parameters"]
scale = "standard"
seed = 1

# %%
from kilnflight.project import claims, figures

origin = figures.trace("00_claims", {"scale": scale})
figures.save("claims", claims.collect(), caption="All.", provenance=origin)
figures.conclude("Collected.", [], origin)
"""

pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="no make on this machine")


def copied(folder):
    """Make a project in a folder, in which nothing has run."""
    for part in ("analysis", "data/reference", "docs"):
        ignored = shutil.ignore_patterns("__pycache__", "*.egg-info")
        shutil.copytree(PROJECT / part, folder / part, ignore=ignored)
    for name in ("Makefile", "pyproject.toml", "requirements.lock", "CITATION.cff"):
        shutil.copy(PROJECT / name, folder / name)
    (folder / "docs" / "api.md").write_text("# API\n")  # the real one takes half a minute
    (folder / "notebooks").mkdir()
    (folder / "notebooks" / "00_claims.py").write_text(CLAIMS)
    for stem in ("02_one", "24_two"):
        write(folder, stem)
    # the environment of this test run instead of a new one
    (folder / ".venv" / "bin").mkdir(parents=True)
    python = folder / ".venv" / "bin" / "python"
    python.write_text(f'#!/bin/sh\nexec "{sys.executable}" "$@"\n')
    python.chmod(0o755)
    time.sleep(0.01)
    (folder / ".venv" / "installed").touch()
    return folder


@pytest.fixture
def project(tmp_path):
    return copied(tmp_path / "project")


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    """One project for the tests that execute notebooks."""
    return copied(tmp_path_factory.mktemp("shared") / "project")


def write(folder, stem, last="pass"):
    text = NOTEBOOK.format(title=f"Notebook {stem}", stem=stem).replace("LAST", last)
    (folder / "notebooks" / f"{stem}.py").write_text(text)


def environment(folder, external=""):
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("KILNFLIGHT", "MAKE"))}
    kept["PYTHONPATH"] = str(folder / "analysis")
    if external:
        kept["KILNFLIGHT_EXTERNAL"] = str(external)
    kept["JOBS"] = "1"  # what runs when is asserted below
    # no address outside this machine: the optional data cannot be fetched
    return kept | {"https_proxy": "http://127.0.0.1:9", "HTTPS_PROXY": "http://127.0.0.1:9"}


def make(folder, *arguments, external=""):
    return subprocess.run(
        ["make", *arguments],
        cwd=folder,
        env=environment(folder, external),
        capture_output=True,
        text=True,
        check=False,
    )


def ran(done):
    return [line.split(":")[0] for line in done.stdout.splitlines() if ": running" in line]


def test_a_failing_cell_stops_make_and_is_not_taken_as_done(shared):
    write(shared, "24_two", 'raise ValueError("no such particle")')
    for expected in (["02_one", "24_two"], ["24_two"]):
        done = make(shared)
        assert done.returncode != 0
        assert ran(done) == expected
        assert ("own simulation" in done.stdout) == (expected[0] == "02_one")
        assert "24_two: cell 4 (import pandas" in done.stderr
        assert "failed: ValueError: no such particle" in done.stderr
        assert "Traceback" not in done.stderr
    assert (shared / "build" / "standard" / "24_two.failed.ipynb").is_file()
    assert not (shared / "build" / "standard" / "24_two.ipynb").exists()
    assert not (shared / "site").exists()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_killed_run_leaves_nothing(shared, number):
    sleeping = shared / "sleeping"
    write(shared, "24_two", f"import time; open({str(sleeping)!r}, 'w').close(); time.sleep(60)")
    with subprocess.Popen(
        ["make"],
        cwd=shared,
        env=environment(shared),
        start_new_session=True,
        # a test run in the background of a shell has been told to ignore Ctrl-C
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as running:
        while running.poll() is None and not sleeping.exists():
            time.sleep(0.1)
        os.killpg(running.pid, number)
        try:
            _, errors = running.communicate(timeout=40)
        finally:
            running.kill()
    sleeping.unlink()
    assert running.returncode != 0
    assert "Traceback" not in errors
    assert "24_two: interrupted" in errors
    left = {path.name for path in (shared / "build" / "standard").iterdir()}
    assert not [name for name in left if name.startswith(".")], left
    assert "24_two.ipynb" not in left


def test_make_goes_on_where_it_was_stopped(shared):
    assert make(shared, "build/standard/02_one.ipynb").returncode == 0
    write(shared, "24_two")
    done = make(shared)
    assert done.returncode == 0, done.stderr
    assert ran(done) == ["24_two", "00_claims"]
    assert not (shared / "build" / "standard" / "24_two.failed.ipynb").exists()
    assert (shared / "site" / "index.html").is_file()


def test_make_is_incremental(shared):
    assert make(shared).returncode == 0
    again = make(shared)
    assert ran(again) == []
    assert "up to date" in again.stdout

    (shared / "notebooks" / "24_two.py").touch()
    assert ran(make(shared, "build/standard/00_claims.ipynb")) == ["24_two", "00_claims"]

    (shared / "build" / "standard" / "figures" / "seed-02-one.csv").unlink()
    assert ran(make(shared, "build/standard/02_one.ipynb")) == ["02_one"]
    assert (shared / "build" / "standard" / "figures" / "seed-02-one.csv").exists()

    changed = make(shared, "PARAMETERS=02.seed=5")
    assert ran(changed) == ["02_one", "00_claims"]
    assert "Seed 5" in (shared / "site" / "02_one.html").read_text()

    # targets that run no notebook leave the settings alone
    assert make(shared, "help").returncode == 0
    assert ran(make(shared, "PARAMETERS=02.seed=5")) == []


def test_a_reduced_run_leaves_what_is_cited_alone(shared):
    reduced = make(shared, "all", "PARAMETERS=02.seed=5", "JOBS=2")  # the test before made most
    done = make(shared, "quick", "PARAMETERS=seed=7", "JOBS=2")
    assert (reduced.returncode, done.returncode) == (0, 0), reduced.stderr + done.stderr
    assert sorted(ran(done)) == ["00_claims", "02_one", "24_two"]
    assert ran(done)[-1] == "00_claims"
    assert not (shared / "figures").exists()
    for run, scale in ((reduced, "standard"), (done, "quick")):
        assert (shared / "build" / scale / "figures" / "claims.csv").is_file()
        assert f"build/{scale}/figures" in run.stdout


def test_make_full_alone_writes_what_is_cited(shared):
    shutil.copy(PROJECT / "README.md", shared)
    before = (shared / "build" / "standard" / "figures" / "claims.csv").stat().st_mtime
    done = make(shared, "full", "PARAMETERS=seed=8", "JOBS=2")
    assert done.returncode == 0, done.stderr
    assert (shared / "figures" / "claims.csv").is_file()
    assert not (shared / "build" / "full" / "figures").exists()
    assert (shared / "build" / "standard" / "figures" / "claims.csv").stat().st_mtime == before
    assert "Seed 8" in (shared / "README.md").read_text()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("nothing=3", "unknown parameter 'nothing'"),
        ("24.seed=abc", "24_two: parameter seed is 'abc', expected int"),  # of a late notebook
    ],
)
def test_a_wrong_parameter_stops_all(project, given, message):
    done = make(project, f"PARAMETERS={given}")
    assert done.returncode != 0
    assert message in done.stderr
    assert ran(done) == []


def test_a_named_folder_without_the_data_stops_make(project, tmp_path):
    done = make(project, external=tmp_path / "empty")
    assert done.returncode != 0
    assert "which has no DEM_spheres_115.zip" in done.stderr
    assert not list((project / "build").rglob("*.ipynb"))


def test_help_lists_every_target_with_its_comment(project):
    text = make(project, "help").stdout
    for target in (
        "quick standard full",
        *["setup", "data", "test", "check", "bench", "clean", "help"],
    ):
        assert f"make {target} " in text


def test_clean_keeps_figures(project):
    (project / "figures").mkdir()
    (project / "figures" / "a.png").touch()
    (project / "build").mkdir()
    assert make(project, "clean").returncode == 0
    assert not (project / "build").exists()
    assert (project / "figures" / "a.png").exists()
