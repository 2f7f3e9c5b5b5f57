"""README.md and docs: the example uses names that exist, links lead somewhere, it stays short."""

import ast
import re
from functools import reduce
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[1]
TEXTS = ("README.md", "CONTRIBUTING.md", "data/README.md")


def test_the_example_imports_and_calls_what_is_there():
    text = (PROJECT / "docs" / "own_recording.md").read_text()
    example = re.findall(r"```python\n(.*?)```", text, re.DOTALL)[-1]
    tree = ast.parse(example)
    imports = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
    names = {}
    exec(compile(ast.Module(imports, []), "own_recording.md", "exec"), names)
    for node in ast.walk(tree):
        path = ast.unparse(node).split(".") if isinstance(node, ast.Attribute) else []
        if path and path[0] in names and all(part.isidentifier() for part in path):
            assert reduce(getattr, path[1:], names[path[0]]) is not None


@pytest.mark.parametrize("name", TEXTS)
def test_links_lead_somewhere(name):
    path = PROJECT / name
    for target in re.findall(r"\]\((?!http)([^)#]+)", path.read_text()):
        assert (path.parent / target).exists(), target


def test_the_readme_is_short():
    assert len((PROJECT / "README.md").read_bytes()) < 6500
