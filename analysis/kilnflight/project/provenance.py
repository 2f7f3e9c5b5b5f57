"""Where a figure comes from: notebook, parameters, seed, inputs, version and commit."""

from __future__ import annotations

import hashlib
import subprocess
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from kilnflight import __version__
from kilnflight.project import paths as places

# What a result depends on: the commit that last touched any of these made the figure.
SOURCES = ("analysis", "notebooks", "data/reference", "pyproject.toml", "requirements.lock")


@dataclass(frozen=True)
class Provenance:
    """Where a figure comes from."""

    notebook: str
    parameters: Mapping[str, object] = field(default_factory=dict)
    seed: int | None = None
    inputs: Mapping[str, str] = field(default_factory=dict)  # name -> SHA-256
    version: str = __version__
    commit: str = ""


def trace(
    notebook: str,
    parameters: Mapping[str, object],
    *,
    seed: int | None = None,
    inputs: Iterable[Path] = (),
) -> Provenance:
    """Return the provenance of what a notebook makes.

    Parameters
    ----------
    notebook
        Stem of the notebook, for example ``"02_depth_calibration"``.
    parameters
        The values of its parameters cell.
    seed
        Seed of every random draw, if there is any.
    inputs
        Files that were read; their SHA-256 is kept.
    """
    checksums = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in inputs}
    return Provenance(notebook, dict(parameters), seed, checksums, __version__, _commit())


def _commit() -> str:
    """Return the commit that last touched `SOURCES`, "+changes" if they differ from it."""

    def git(*arguments: str) -> str:
        answer = subprocess.run(
            ["git", *arguments, "--", *SOURCES],
            cwd=places.root(),
            capture_output=True,
            text=True,
            check=False,
        )
        return answer.stdout.strip() if answer.returncode == 0 else ""

    try:
        commit = git("log", "-1", "--format=%H")
        return commit + ("+changes" if commit and git("status", "--porcelain") else "")
    except FileNotFoundError:  # no git on this machine: the version must do
        return ""
