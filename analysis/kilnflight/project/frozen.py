"""Small files that a calibration wrote once: read only what is whole and still fits."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from kilnflight.checks import InputError

Inputs = TypeVar("Inputs")


def digest(content: object) -> str:
    """Return the SHA-256 of something made of numbers and text, in one spelling."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def write(path: Path, content: dict[str, object]) -> dict[str, object]:
    """Write a calibration with its hash, and return what was written."""
    content = json.loads(json.dumps(content))
    whole = {**content, "sha256": digest(content)}
    path.write_text(json.dumps(whole, indent=1) + "\n", encoding="utf-8")
    return whole


def read(path: Path, targets: object, module: str) -> dict[str, object]:
    """Return the content of a calibration file without its hash.

    Parameters
    ----------
    path
        Of the file.
    targets
        What the calibration was fitted to, as it would be hashed today.
    module
        That makes the file, for the message.

    Raises
    ------
    InputError
        If it is missing or damaged, or was made for other targets.
    """
    again = f"Run `python -m {module}`, or take the file from the repository."
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        known = content.pop("sha256")
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"calibration {path}: cannot be read ({error}). {again}") from error
    if digest(content) != known:
        raise InputError(f"calibration {path}: damaged, its SHA-256 does not fit. {again}")
    if content.get("targets_sha256") != digest(targets):
        raise InputError(f"calibration {path}: made for other targets than published. {again}")
    return dict(content)


def inputs(kind: Callable[..., Inputs], path: Path, content: dict[str, Any]) -> Inputs:
    """Return the fitted inputs of a calibration, content of `read`, as the class they fill."""
    try:
        return kind(**content["inputs"])
    except (KeyError, TypeError) as error:
        raise InputError(f"calibration {path}: other inputs than here ({error}).") from error


def summary(content: dict[str, Any]) -> str:
    """Return what came out of a calibration, line by line."""
    names = ("inputs", "cost_inputs_only", "cost_calibrated", "evaluations", "sha256")
    return "\n".join(f"{name}: {content[name]}" for name in names)
