"""Small faults put into the package by chance: do the tests of their room notice them?

    .venv/bin/python tests/faults/by_chance.py --seed 1 --count 24

Each fault changes one number, sign, comparison or truth value in a copy of the package.
The tests of the room, the contracts and the snapshot of the whole chain run on it. What
they do not notice is printed: a missing test, or a change that changes nothing.
"""

import argparse
import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

PROJECT = Path(__file__).resolve().parents[2]
PACKAGE = PROJECT / "analysis" / "kilnflight"
EVERYWHERE = ("tests/test_contracts.py", "tests/test_snapshot.py")
SWAPPED = {
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
    ast.Lt: ("<", "<="),
    ast.LtE: ("<=", "<"),
    ast.Gt: (">", ">="),
    ast.GtE: (">=", ">"),
    ast.Eq: ("==", "!="),
    ast.And: ("and", "or"),
    ast.Or: ("or", "and"),
}
MOST_S = 1800  # for the tests of one fault


class Fault(NamedTuple):
    """A place in a file, and what stands there instead."""

    file: Path
    line: int
    start: int  # of the old text in the file's text
    old: str
    new: str


def changed_number(value: object) -> str | None:
    """Return another number or truth value as code."""
    if isinstance(value, bool):
        return str(not value)
    if isinstance(value, int):
        return str(value + 1)
    if isinstance(value, float):
        return repr(value * 1.1 if value else 0.1)
    return None


def between(text: str, starts: list[int], node: ast.AST) -> Fault | None:
    """Return the fault of an operator, which stands between its operands."""
    if isinstance(node, ast.BinOp):
        left, operator, right = node.left, node.op, node.right
    elif isinstance(node, ast.Compare):
        left, operator, right = node.left, node.ops[0], node.comparators[0]
    else:
        left, operator, right = node.values[0], node.op, node.values[1]
    if type(operator) not in SWAPPED:
        return None
    old, new = SWAPPED[type(operator)]
    first = starts[left.end_lineno - 1] + left.end_col_offset
    last = starts[right.lineno - 1] + right.col_offset
    at = text.find(old, first, last)
    return None if at < 0 else Fault(Path(), left.end_lineno, at, old, new)


def left_alone(tree: ast.AST) -> set[int]:
    """Return the ids of nodes in types, decorators, texts and errors."""
    roots = []
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr | ast.Raise):
            roots.append(node)
        for name in ("annotation", "returns"):
            roots.append(getattr(node, name, None))
        roots += getattr(node, "decorator_list", [])
    return {id(inner) for root in roots if root for inner in ast.walk(root)}


def faults_of(file: Path) -> list[Fault]:
    """Return all faults that a file can be given."""
    content = file.read_bytes()
    text = content.decode("latin-1")  # offsets of the parser are bytes
    starts = [0]
    for line in text.split("\n"):
        starts.append(starts[-1] + len(line) + 1)
    tree = ast.parse(content)
    skipped = left_alone(tree)
    found = []
    for node in ast.walk(tree):
        if id(node) in skipped:
            continue
        fault = None
        if isinstance(node, ast.Constant):
            new = changed_number(node.value)
            start = starts[node.lineno - 1] + node.col_offset
            end = starts[node.end_lineno - 1] + node.end_col_offset
            if new is not None:
                fault = Fault(file, node.lineno, start, text[start:end], new)
        elif isinstance(node, ast.BinOp | ast.Compare | ast.BoolOp):
            fault = between(text, starts, node)
        if fault is not None:
            found.append(fault._replace(file=file))
    return found


def tests_of(file: Path) -> list[str]:
    """Return the tests of the room that a file belongs to."""
    room = file.relative_to(PACKAGE).parent
    tests = [f"tests/{room}"]
    if room == Path():
        tests = [f"tests/test_{file.stem}.py"]
        if file.stem == "association":
            tests.append("tests/test_joint_probabilities.py")
        if file.stem == "regression":
            tests = ["tests/regression"]
        if file.stem == "__main__":
            tests = ["tests/test_main.py"]
    tests.append(str(file.relative_to(PROJECT)))
    return [each for each in (*tests, *EVERYWHERE) if (PROJECT / each).exists()]


def is_noticed(fault: Fault) -> bool:
    """Return whether a test fails on a copy of the project with a fault."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name, "project")
        for part in ("analysis", "tests", "data/reference", "notebooks", "docs"):
            shutil.copytree(PROJECT / part, folder / part)
        for part in ("pyproject.toml", "README.md"):
            shutil.copy(PROJECT / part, folder / part)
        file = folder / fault.file.relative_to(PROJECT)
        text = file.read_bytes().decode("latin-1")
        end = fault.start + len(fault.old)
        broken = text[: fault.start] + fault.new + text[end:]
        file.write_bytes(broken.encode("latin-1"))
        try:
            done = subprocess.run(
                [sys.executable, "-m", "pytest", "-q", "-x", *tests_of(fault.file)],
                cwd=folder,
                env=os.environ | {"PYTHONPATH": str(folder / "analysis")},
                capture_output=True,
                timeout=MOST_S,
                check=False,
            )
        except subprocess.TimeoutExpired:  # the tests no longer end
            return True
        return done.returncode != 0


def main() -> None:
    """Draw faults, try each, and print what is not noticed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=24)
    options = parser.parse_args()
    known = [
        fault for file in sorted(PACKAGE.rglob("*.py")) for fault in faults_of(file)
    ]
    drawn = random.Random(options.seed).sample(known, options.count)
    noticed = 0
    for fault in drawn:
        seen = is_noticed(fault)
        noticed += seen
        where = f"{fault.file.relative_to(PACKAGE)}:{fault.line}"
        told = "noticed" if seen else "NOT NOTICED"
        print(f"{told}: {where}: {fault.old} -> {fault.new}", flush=True)
    print(f"{noticed} of {len(drawn)} of {len(known)} possible faults noticed")


if __name__ == "__main__":
    main()
