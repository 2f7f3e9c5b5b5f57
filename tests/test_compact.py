"""Size and density of the code against the limits in pyproject.toml.

A token is a name, number, string or sign of code. Docstrings, comments and blank lines
have none, so that joining lines makes nothing smaller and explaining costs nothing. An
idiom joins in one statement what would be clearer in two.
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


def is_literal_text_or_list(node: ast.expr) -> bool:
    """Return whether a factor is a text or a list."""
    if isinstance(node, ast.Constant):
        return isinstance(node.value, str)
    return isinstance(node, ast.JoinedStr | ast.List)


def idiom_of(node: ast.AST) -> str | None:
    """Return the name of the idiom that a node is, if it is one."""
    if isinstance(node, ast.Assign) and isinstance(node.value, ast.Tuple):
        if isinstance(node.targets[0], ast.Tuple):
            return "parallel_assignment"
    elif isinstance(node, ast.IfExp):
        return "conditional_expression"
    elif isinstance(node, ast.NamedExpr):
        return "assignment_in_expression"
    elif isinstance(node, ast.For) and ast.unparse(node.iter).endswith("[:1]"):
        return "loop_over_slice_of_one"
    elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult):
        sides = (node.left, node.right)
        conditions = [isinstance(side, ast.Compare | ast.BoolOp) for side in sides]
        if any(conditions) and any(map(is_literal_text_or_list, sides)):
            return "arithmetic_with_condition"
    return None


def idioms(text: str) -> Counter[str]:
    """Count the idioms of a file by name."""
    found = (idiom_of(node) for node in ast.walk(ast.parse(text)))
    return Counter(name for name in found if name)


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("a, b = x, y", "parallel_assignment"),
        ("a = b if c else d", "conditional_expression"),
        ("if (a := b()) > 1: pass", "assignment_in_expression"),
        ("for a in b[c][:1]: pass", "loop_over_slice_of_one"),
        ("a = '_' * (b == c)", "arithmetic_with_condition"),
    ],
)
def test_an_idiom_is_known(text, name):
    assert idioms(text) == {name: 1}
    assert idioms("a, b = f(x)\nc = 2 * [0]\nfor d in e: pass\n") == {}


def test_a_line_holds_one_thought():
    texts = [path.read_text("utf-8") for path in PACKAGE]
    counts = [tokens_by_line(text) for text in texts]
    lines = sum(map(len, counts))
    assert sum(count.total() for count in counts) / lines <= LIMITS["tokens_a_line"]
    found = sum((idioms(text) for text in texts), Counter())
    limits = LIMITS["idioms"]
    share = {name: 1000 * count / lines for name, count in found.items()}
    assert {name: n for name, n in share.items() if n > limits[name]} == {}


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
