"""make itself, on a copy of the project with three small notebooks and this
environment.

What runs when is asked of make with a stand-in for Python, which only writes down what
it was to do. One project goes the whole way with real notebooks, test after test.
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
# # Notebook {stem}

# %% tags=["parameters"]
scale = "standard"
seed = 1

# %%
import pandas as pd
from kilnflight.publication import claims, figures, verdicts

LAST
origin = figures.trace("{stem}", {{"scale": scale}})
table = verdicts.collect() if "{name}" == "claims" else pd.DataFrame({{"seed": [seed]}})
figures.save("{name}", table, caption="A table.", provenance=origin)
figures.conclude("Seed " + str(seed), [], origin)
"""
STAND_IN = """#!/bin/sh
echo "$KILNFLIGHT_FIGURES $*" >> asked
case "$*" in
*tools/schedule.py*) mkdir -p "build/$2" && touch "build/$2/ran" ;;
*generate.py\\ build*) mkdir -p site && touch site/index.html ;;
esac
"""
STEMS = ["00_claims", "02_one", "26_two"]

pytestmark = pytest.mark.skipif(
    shutil.which("make") is None, reason="no make on this machine"
)


def copied(folder, python):
    """Make a project in a folder, in which nothing has run; ``python`` stands for
    Python.
    """
    for part in ("analysis", "data/reference", "docs", "tools"):
        ignored = shutil.ignore_patterns("__pycache__", "*.egg-info")
        shutil.copytree(PROJECT / part, folder / part, ignore=ignored)
    for name in ("Makefile", "pyproject.toml", "requirements.lock", "CITATION.cff"):
        shutil.copy(PROJECT / name, folder / name)
    (folder / "docs" / "api.md").write_text(
        "# API\n"
    )  # the real one takes half a minute
    (folder / "notebooks").mkdir()
    for stem in STEMS:
        write(folder, stem)
    stands_for = folder / ".venv" / "bin" / "python"
    stands_for.parent.mkdir(parents=True)
    stands_for.write_text(python)
    stands_for.chmod(0o755)
    time.sleep(0.01)
    (folder / ".venv" / "installed").touch()
    return folder


@pytest.fixture
def project(tmp_path):
    """A project in which make only says what it would run."""
    return copied(tmp_path / "project", STAND_IN)


@pytest.fixture(scope="module")
def real(tmp_path_factory):
    """One project that executes notebooks."""
    python = f'#!/bin/sh\nexec "{sys.executable}" "$@"\n'
    return copied(tmp_path_factory.mktemp("real") / "project", python)


def write(folder, stem, last="pass"):
    name = "claims" if stem == "00_claims" else f"seed-{stem[:2]}"
    text = NOTEBOOK.format(stem=stem, name=name).replace("LAST", last)
    (folder / "notebooks" / f"{stem}.py").write_text(text)


def settings(folder):
    """How make is called: one job, and no network, so that no optional data are
    fetched.
    """
    kept = {
        k: v for k, v in os.environ.items() if not k.startswith(("KILNFLIGHT", "MAKE"))
    }
    kept |= {"PYTHONPATH": str(folder / "analysis"), "JOBS": "1"}
    kept |= dict.fromkeys(("https_proxy", "HTTPS_PROXY"), "http://127.0.0.1:9")
    return {"cwd": folder, "env": kept, "text": True}


def make(folder, *arguments):
    called = ["make", *arguments]
    return subprocess.run(called, **settings(folder), capture_output=True, check=False)


def ran(done):
    return [
        line.split(":")[0] for line in done.stdout.splitlines() if ": running" in line
    ]


def test_a_failing_cell_stops_make_and_is_not_taken_as_done(real):
    write(real, "26_two", 'raise ValueError("no such particle")')
    done = make(real)
    assert done.returncode != 0
    assert ran(done) == ["02_one", "26_two"]
    assert "own simulation" in done.stdout
    assert "26_two: cell 4 (import pandas" in done.stderr
    assert "Traceback" not in done.stderr
    assert (real / "build" / "standard" / "26_two.failed.ipynb").is_file()
    assert not (real / "build" / "standard" / "26_two.ipynb").exists()
    assert not (real / "site").exists()


def test_a_killed_run_leaves_nothing(real):
    sleeping = real / "sleeping"
    write(
        real,
        "26_two",
        f"import time; open({str(sleeping)!r}, 'w').close(); time.sleep(60)",
    )
    with subprocess.Popen(
        ["make"],
        **settings(real),
        start_new_session=True,
        # a test run in the background of a shell has been told to ignore Ctrl-C
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as running:
        while running.poll() is None and not sleeping.exists():
            time.sleep(0.1)
        os.killpg(running.pid, signal.SIGINT)
        try:
            _, errors = running.communicate(timeout=40)
        finally:
            running.kill()
    assert running.returncode != 0
    assert "Traceback" not in errors
    assert "26_two: interrupted" in errors
    left = {path.name for path in (real / "build" / "standard").iterdir()}
    assert not [
        name for name in left if name.startswith(".") or name == "26_two.ipynb"
    ], left


def test_make_goes_on_where_it_was_stopped(real):
    write(real, "26_two")
    done = make(real)
    assert done.returncode == 0, done.stderr
    assert ran(done) == ["26_two", "00_claims"]
    assert not (real / "build" / "standard" / "26_two.failed.ipynb").exists()
    assert "Seed 1" in (real / "site" / "02_one.html").read_text()
    page = real / "site" / "index.html"
    made = page.stat().st_mtime_ns
    again = make(real)
    assert ran(again) == []
    assert "up to date" in again.stdout
    assert page.stat().st_mtime_ns == made
    os.utime(real / "docs" / "limits.md")
    assert "rendering" in make(real).stdout
    assert "rendering" not in make(real).stdout


@pytest.mark.parametrize("scale", ["quick", "standard", "full"])
def test_full_alone_writes_what_is_cited(project, scale):
    done = make(project, scale, "PARAMETERS=seed=7 26.draws=9", "JOBS=2", "ONLY=26")
    assert done.returncode == 0, done.stderr
    reduced = "" if scale == "full" else f"{project}/build/{scale}/figures"
    assert (f"build/{scale}/figures" in done.stdout) == bool(reduced)
    lines = (project / "asked").read_text().splitlines()
    commands = [line.partition(" ")[::2] for line in lines]  # figures' folder, command
    (asked,) = [each for each in commands if "schedule.py" in each[1]]
    settings = "--jobs 2 --only 26 --parameters seed=7 26.draws=9"
    assert asked == (reduced, f"tools/schedule.py {scale} {settings}")
    (rendered,) = [each for each in commands if "generate.py build" in each[1]]
    assert rendered == (reduced, f"docs/generate.py build/{scale} site")
    written = [command for _, command in commands if "--readme" in command]
    assert written == ["docs/generate.py --readme"] * (scale == "full")


def test_a_wrong_parameter_of_a_late_notebook_stops_all(real):
    done = make(real, "PARAMETERS=26.seed=abc")
    assert done.returncode != 0
    assert "26_two: parameter seed" in done.stderr
    assert ran(done) == []


def test_help_lists_every_target_with_its_comment(project):
    text = make(project, "help").stdout
    for target in (
        "quick standard full",
        "setup",
        "data",
        "test",
        "check",
        "bench",
        "clean",
    ):
        assert f"make {target} " in text


def test_clean_keeps_figures(project):
    for name in ("figures", "build"):
        (project / name).mkdir()
        (project / name / "a.png").touch()
    assert make(project, "clean").returncode == 0
    assert not (project / "build").exists()
    assert (project / "figures" / "a.png").exists()
