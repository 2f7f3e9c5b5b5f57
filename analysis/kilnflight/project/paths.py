"""Where the project's folders are; nothing else spells a path."""

from __future__ import annotations

import os
from pathlib import Path

from kilnflight.checks import InputError

SAVED_LIST = "KILNFLIGHT_SAVED"  # environment: a file that lists what was saved, for make
NOTEBOOK = "KILNFLIGHT_NOTEBOOK"  # the notebook that runs


def root() -> Path:
    """Return the project's folder: the one that holds ``data/reference/claims.csv``.

    It is KILNFLIGHT_ROOT, else the nearest one above the working directory or this file.
    """
    named, here = os.environ.get("KILNFLIGHT_ROOT"), Path.cwd()
    found = [Path(named)] if named else [here, *here.parents, *Path(__file__).resolve().parents]
    for folder in found:
        if (folder / "data" / "reference" / "claims.csv").is_file():
            return folder
    raise InputError(
        f"no kilnflight project at {named or here} (a folder with data/reference/claims.csv). "
        "Work inside a clone of the repository, or name it in KILNFLIGHT_ROOT."
    )


def reference() -> Path:
    """Return data/reference: the published numbers and the claims."""
    return root() / "data" / "reference"


def figures() -> Path:
    """Return the folder of figures: KILNFLIGHT_FIGURES or figures/."""
    return Path(os.environ.get("KILNFLIGHT_FIGURES") or root() / "figures")


def external() -> Path:
    """Return the folder of the authors' data: KILNFLIGHT_EXTERNAL or data/external."""
    return Path(os.environ.get("KILNFLIGHT_EXTERNAL") or root() / "data" / "external")


def recordings() -> Path:
    """Return the folder of belt recordings: KILNFLIGHT_RECORDINGS or that of the authors' data."""
    return Path(os.environ.get("KILNFLIGHT_RECORDINGS") or external() / "belt_recordings")


def derived() -> Path:
    """Return the folder of kept tables: KILNFLIGHT_DERIVED or data/derived."""
    return Path(os.environ.get("KILNFLIGHT_DERIVED") or root() / "data" / "derived")
