"""Written pages (docs/) and the API, which is read from the code.

docs/*.md -> documents/*.md, rooms of the package -> api/*.md
"""

from __future__ import annotations

import pkgutil
import re
from pathlib import Path
from typing import Any

import pandas as pd
from sphinx.application import Sphinx

import kilnflight
from kilnflight.checks import InputError
from kilnflight.project import claims
from kilnflight.project.site.links import Links

FOLDER = Path(__file__).parents[4] / "docs"
METHODS = ("methods", "limits", "glossary")
USE = ("own_recording", "made")
PLACE = re.compile(r"@([a-z-]+)@")  # of a number that comes from figures/
NOT_LIBRARY = ("experiments", "project", "__main__")


def write(folder: Path, verdicts: pd.DataFrame, links: Links) -> None:
    """Write the pages of docs/ with the numbers that they name, references as links.

    Parameters
    ----------
    folder
        Of the sources of the site.
    verdicts
        Of all claims: ``verdict``.
    links
        To notebooks, figures and tables.

    Raises
    ------
    InputError
        If a page names a number that there is not.
    """
    counts = {name.replace(" ", "-"): number for name, number in claims.count(verdicts).items()}
    numbers = {"claims": len(verdicts), **counts}
    folder.mkdir(parents=True)
    for path in sorted(FOLDER.glob("*.md")):
        text = path.read_text()
        if unknown := set(PLACE.findall(text)) - set(numbers):
            known = ", ".join(numbers)
            raise InputError(f"{path.name}: no number {', '.join(unknown)}; there are {known}.")
        text = PLACE.sub(lambda found: str(numbers[found[1]]), text)
        (folder / path.name).write_text(links(text, "../"))


def setup(app: Sphinx) -> dict[str, bool]:
    """Let Sphinx read docstrings in which bars mean an absolute value, and shorten paths."""
    app.connect("autodoc-process-docstring", _bars)
    app.connect("autodoc-process-signature", _short_paths)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _short_paths(*given: Any) -> tuple[str, str] | None:
    """Return a signature whose default paths begin at the package, not on this machine."""
    arguments, returned = given[-2:]
    if not arguments:
        return None
    return re.sub(r"\w*Path\('[^']*/(kilnflight/[^']*)'\)", r"Path('\1')", arguments), returned


def _bars(*given: object) -> None:
    """Write the bars of the docstring's lines, the last argument, so that they stay bars."""
    lines = given[-1]
    assert isinstance(lines, list)
    lines[:] = [line.replace("|", r"\|") for line in lines]


def groups() -> dict[str, list[str]]:
    """Return the pages of the left bar by group; none, API neither, of a project without docs/."""
    if not FOLDER.is_dir():
        return {"API": ["rooms"]}
    return {
        "Methods": [f"documents/{name}" for name in METHODS],
        "Use it": [f"documents/{name}" for name in USE],
        "API": ["rooms", *(f"api/{room}" for room in rooms())],
    }


def rooms() -> list[str]:
    """Return the rooms of the package that a user imports."""
    modules = pkgutil.iter_modules(kilnflight.__path__)
    return [module.name for module in modules if module.name not in NOT_LIBRARY]


def write_api(folder: Path) -> None:
    """Write a page for each room with all that it offers."""
    folder.mkdir(parents=True)
    for room in rooms() if FOLDER.is_dir() else ():
        package = Path(kilnflight.__path__[0]) / room
        inside = sorted(each.name for each in pkgutil.iter_modules([str(package)]))
        names = [room, *(f"{room}.{name}" for name in inside)]
        parts = [f"# kilnflight.{room}"]
        for name in names:
            if name != room:
                parts.append(f"## kilnflight.{name}")
            options = "   :members:\n   :ignore-module-all:\n"
            directive = f".. automodule:: kilnflight.{name}\n{options}"
            parts.append(f"```{{eval-rst}}\n{directive}\n```")
        (folder / f"{room}.md").write_text("\n\n".join(parts) + "\n")
