import hashlib
import subprocess

import pytest

from kilnflight import __version__
from kilnflight.project import figures


@pytest.fixture
def project(tmp_path, monkeypatch):
    """A project of its own with one commit."""
    monkeypatch.setenv("KILNFLIGHT_ROOT", str(tmp_path))
    for name in ("data/reference/claims.csv", "analysis/a.py", "notebooks/n.py"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("x = 1\n")
    (tmp_path / "pyproject.toml").write_text("")
    (tmp_path / "requirements.lock").write_text("")

    def git(*arguments):
        identity = ["-c", "user.name=n", "-c", "user.email=e"]
        command = ["git", *identity, *arguments]
        return subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, text=True)

    git("init", "-q")
    git("add", "-A")
    git("commit", "-qm", "one")
    return tmp_path, git


def test_inputs_are_known_by_their_checksum(tmp_path):
    path = tmp_path / "in.csv"
    path.write_bytes(b"1,2\n")
    made = figures.trace("02_x", {"scale": "quick"}, seed=3, inputs=[path])
    assert made.inputs == {"in.csv": hashlib.sha256(b"1,2\n").hexdigest()}
    assert (made.notebook, made.seed, made.version) == ("02_x", 3, __version__)


def test_the_commit_is_the_last_one_that_touched_what_counts(project):
    folder, git = project
    first = git("rev-parse", "HEAD").stdout.strip()
    (folder / "README.md").write_text("figures and pages do not count")
    git("add", "-A")
    git("commit", "-qm", "two")
    assert figures.trace("n", {}).commit == first
    (folder / "analysis/a.py").write_text("x = 2\n")
    assert figures.trace("n", {}).commit == first + "+changes"
    git("commit", "-qam", "three")
    assert figures.trace("n", {}).commit == git("rev-parse", "HEAD").stdout.strip()


def test_without_a_repository_or_git_there_is_no_commit(project, monkeypatch, tmp_path_factory):
    empty = tmp_path_factory.mktemp("no-git")
    (empty / "data/reference").mkdir(parents=True)
    (empty / "data/reference/claims.csv").write_text("")
    monkeypatch.setenv("KILNFLIGHT_ROOT", str(empty))
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(empty.parent))
    assert figures.trace("n", {}).commit == ""
    monkeypatch.setenv("PATH", str(empty))
    assert figures.trace("n", {}).commit == ""
