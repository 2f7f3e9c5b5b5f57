"""Functions of one notebook for another, and for tests."""

import ast
from collections.abc import Mapping
from types import ModuleType

from kilnflight.store.paths import root

DEFINING = (ast.Import, ast.ImportFrom, ast.FunctionDef, ast.ClassDef)


def borrow(stem: str, **given: object) -> ModuleType:
    """Return the functions of another notebook as a module, without running it.

    Parameters
    ----------
    stem
        Name of the notebook, such as ``"22_clouds"``.
    given
        Variables that its functions use, such as ``seed``. They take the place of its
        own constants; more may be set in the module afterwards.

    Notes
    -----
    Its imports, functions, classes and literal constants are executed, nothing else.
    """
    path = root() / "notebooks" / f"{stem}.py"
    module = ModuleType(stem)
    module.__dict__.update(given)
    lines = [
        line
        for line in ast.parse(path.read_text("utf-8")).body
        if isinstance(line, DEFINING) or _is_constant(line, given)
    ]
    code = compile(ast.Module(lines, type_ignores=[]), str(path), "exec")
    exec(code, module.__dict__)
    return module


def _is_constant(line: ast.stmt, given: Mapping[str, object]) -> bool:
    """Return whether a line gives a literal value to a name that is not given."""
    if not (isinstance(line, ast.Assign) and isinstance(line.targets[0], ast.Name)):
        return False
    if line.targets[0].id in given:
        return False
    try:
        ast.literal_eval(line.value)
    except ValueError:
        return False
    return True
