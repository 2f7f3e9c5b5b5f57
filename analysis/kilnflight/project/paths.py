"""Where the project's folders are; nothing else spells a path."""

from __future__ import annotations

import os
from pathlib import Path

from kilnflight.checks import InputError

SAVED_LIST = "KILNFLIGHT_SAVED"  # environment: a file that lists what was saved, for make
PROGRESS = "KILNFLIGHT_PROGRESS"  # a file in which long work says how far it is


def root() -> Path:
    """Return the project's folder: the one that holds ``data/reference/claims.csv``.

    Looked for in the environment variable ``KILNFLIGHT_ROOT``, then upwards from
    the working directory, then upwards from this file (an editable install).
    """
    named = os.environ.get("KILNFLIGHT_ROOT")
    here = Path.cwd()
    candidates = (
        [Path(named)] if named else [here, *here.parents, *Path(__file__).resolve().parents]
    )
    for folder in candidates:
        if (folder / "data" / "reference" / "claims.csv").is_file():
            return folder
    raise InputError(
        f"no kilnflight project found from {named or here} upwards (a folder with "
        "data/reference/claims.csv). Work inside a clone of the repository, or name it in "
        "KILNFLIGHT_ROOT."
    )


def reference() -> Path:
    """Return data/reference: the published numbers and the claims."""
    return root() / "data" / "reference"


def figures() -> Path:
    """Return the folder that `kilnflight.project.figures.save` writes to.

    ``KILNFLIGHT_FIGURES`` names another one (the tests do).
    """
    return Path(os.environ.get("KILNFLIGHT_FIGURES") or root() / "figures")


def external() -> Path:
    """Return the folder of the authors' data.

    It is ``KILNFLIGHT_EXTERNAL`` or data/external.
    """
    return Path(os.environ.get("KILNFLIGHT_EXTERNAL") or root() / "data" / "external")


def derived() -> Path:
    """Return the folder of what stages keep: ``KILNFLIGHT_DERIVED`` or data/derived."""
    return Path(os.environ.get("KILNFLIGHT_DERIVED") or root() / "data" / "derived")
