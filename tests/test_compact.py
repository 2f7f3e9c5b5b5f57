"""The sizes of rooms, files and notebooks against the limits in pyproject.toml."""

import ast
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "analysis" / "kilnflight"
LIMITS = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["compact"]
pytestmark = pytest.mark.published


def code_lines(path: Path) -> int:
    """Return how many lines of a file hold code: no docstring, comment or blank line."""
    text = path.read_text("utf-8")
    stripped = (line.strip(" \t") for line in text.splitlines())
    lines = {k for k, line in enumerate(stripped, 1) if line and not line.startswith("#")}
    for node in ast.walk(ast.parse(text)):
        documented = isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
        if documented and ast.get_docstring(node):
            lines -= set(range(node.body[0].lineno, node.body[0].end_lineno + 1))
    return len(lines)


def test_rooms_and_their_files_keep_to_their_limits():
    files = {path: code_lines(path) for path in PACKAGE.rglob("*.py")}
    rooms = dict.fromkeys(LIMITS["rooms"], 0)
    for path, lines in files.items():
        rooms[path.relative_to(PACKAGE).parts[0].removesuffix(".py")] += lines
    assert {room: n for room, n in rooms.items() if n > LIMITS["rooms"][room]} == {}
    assert {path.name: n for path, n in files.items() if n > LIMITS["file"]} == {}


def test_notebooks_are_few_and_short():
    notebooks = {path.name: code_lines(path) for path in (ROOT / "notebooks").glob("*.py")}
    assert len(notebooks) <= LIMITS["notebooks"]
    assert {name: n for name, n in notebooks.items() if n > LIMITS["notebook"]} == {}
