"""Every verdict can say why: the calls that make verdicts name a cause."""

import ast
from pathlib import Path

PROJECT = Path(__file__).parents[1]


def calls_without_cause(text):
    """Return the calls of claims.judge and claims.undecidable without because= and truth=."""
    found = []
    for node in ast.walk(ast.parse(text)):
        made = isinstance(node, ast.Call) and ast.unparse(node.func)
        if made not in ("claims.judge", "claims.undecidable"):
            continue
        given = {
            word.arg for word in node.keywords if ast.unparse(word.value) not in ("''", "None")
        }
        if not given & {"because", "truth"}:
            found.append(ast.unparse(node))
    return found


def test_a_call_without_a_cause_is_found():
    assert calls_without_cause("claims.judge('a', 1)") == ["claims.judge('a', 1)"]
    assert calls_without_cause("claims.judge('a', 1, because='twin')") == []
    assert calls_without_cause("claims.undecidable('a', 'no')") == ["claims.undecidable('a', 'no')"]


def test_an_empty_cause_is_none():
    assert calls_without_cause("claims.judge('a', 1, because='')") != []


def test_every_verdict_of_the_project_names_its_cause():
    places = [
        *PROJECT.glob("notebooks/*.py"),
        *PROJECT.glob("analysis/kilnflight/experiments/*.py"),
    ]
    missing = {path.name: calls_without_cause(path.read_text()) for path in places}
    assert {name: calls for name, calls in missing.items() if calls} == {}
