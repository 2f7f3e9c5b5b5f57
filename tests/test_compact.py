"""The size of the code against the limits in pyproject.toml, counted in tokens.

A token is a name, number, string or sign of code. Docstrings, comments and blank lines
have none, so that joining lines makes nothing smaller and explaining costs nothing.
"""

import ast
import io
import tokenize
import tomllib
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LIMITS = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["compact"]
PACKAGE = sorted((ROOT / "analysis" / "kilnflight").rglob("*.py"))
NOTEBOOKS = sorted((ROOT / "notebooks").glob("[0-9]*.py"))
NO_CODE = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}
pytestmark = pytest.mark.published


def tokens_by_line(text: str) -> Counter[int]:
    """Count the tokens of code that start in each line."""
    documented = set()
    for node in ast.walk(ast.parse(text)):
        if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            continue
        if ast.get_docstring(node) is not None:
            documented |= set(range(node.body[0].lineno, node.body[0].end_lineno + 1))
    found = tokenize.generate_tokens(io.StringIO(text).readline)
    lines = (token.start[0] for token in found if token.type not in NO_CODE)
    return Counter(line for line in lines if line not in documented)


def tokens_by_function(text: str) -> dict[str, int]:
    """Count the tokens of each function by name and line."""
    count = tokens_by_line(text)
    return {
        f"{node.name}:{node.lineno}": sum(
            count[line] for line in range(node.lineno, node.end_lineno + 1)
        )
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.FunctionDef)
    }


def test_neither_docstrings_nor_comments_nor_line_breaks_count():
    plain = "def add(a, b):\n    return a + b\n"
    written = (
        'def add(\n    a,\n    b,\n):\n    """Add."""\n\n    return a + b  # sum\n'
    )
    assert sum(tokens_by_line(plain).values()) == 12
    assert sum(tokens_by_line(written).values()) == 13  # the comma behind b
    assert tokens_by_function(plain) == {"add:1": 12}


def test_the_package_and_its_parts_keep_to_their_limits():
    texts = {path: path.read_text("utf-8") for path in PACKAGE}
    files = {path.name: tokens_by_line(text).total() for path, text in texts.items()}
    package = sum(tokens_by_line(text).total() for text in texts.values())
    functions = {
        f"{path.name}:{name}": size
        for path, text in texts.items()
        for name, size in tokens_by_function(text).items()
    }
    assert package <= LIMITS["package"]
    assert {name: size for name, size in files.items() if size > LIMITS["file"]} == {}
    assert {
        name: size for name, size in functions.items() if size > LIMITS["function"]
    } == {}


def test_notebooks_are_few_and_short():
    sizes = {
        path.name: tokens_by_line(path.read_text("utf-8")).total() for path in NOTEBOOKS
    }
    assert len(sizes) <= LIMITS["notebooks"]
    assert {
        name: size for name, size in sizes.items() if size > LIMITS["notebook"]
    } == {}
