"""Folders of the project; no other module spells their paths."""

import os
from pathlib import Path

from kilnflight.checks import InputError

# Names of environment variables.
SAVED_LIST = "KILNFLIGHT_SAVED"  # its file lists what was saved, for make
NOTEBOOK = "KILNFLIGHT_NOTEBOOK"  # stem of the notebook that runs


def root() -> Path:
    """Return the project's folder, which holds ``data/reference/claims.csv``.

    It is KILNFLIGHT_ROOT if set, else the nearest one at or above the working
    directory, else above this file. Raises an `InputError` if none of these holds that
    file.
    """
    here = Path.cwd()
    places = [here, *here.parents, *Path(__file__).resolve().parents]
    named = os.environ.get("KILNFLIGHT_ROOT")
    if named:
        places = [Path(named)]
    for folder in places:
        if (folder / "data" / "reference" / "claims.csv").is_file():
            return folder
    raise InputError(
        f"{places[0]}: no clone of kilnflight: work in one or set KILNFLIGHT_ROOT."
    )


def reference() -> Path:
    """Return data/reference, the folder of published numbers and claims."""
    return root() / "data" / "reference"


def figures() -> Path:
    """Return the folder of figures: KILNFLIGHT_FIGURES or figures/."""
    return Path(os.environ.get("KILNFLIGHT_FIGURES") or root() / "figures")


def external() -> Path:
    """Return the folder of the authors' data: KILNFLIGHT_EXTERNAL or data/external."""
    return Path(os.environ.get("KILNFLIGHT_EXTERNAL") or root() / "data" / "external")


def recordings() -> Path:
    """Return the folder of belt recordings: KILNFLIGHT_RECORDINGS or the authors'."""
    return Path(
        os.environ.get("KILNFLIGHT_RECORDINGS") or external() / "belt_recordings"
    )


def derived() -> Path:
    """Return the folder of cached tables: KILNFLIGHT_DERIVED or data/derived."""
    return Path(os.environ.get("KILNFLIGHT_DERIVED") or root() / "data" / "derived")
