"""The code that a cached table depends on.

It is found from the imports, never from a list.

function or instance -> where it is defined -> all that it imports -> one hash
"""

from __future__ import annotations

import ast
import hashlib
import importlib.util
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from functools import cache, partial
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT.name
STEP = (f"{PACKAGE}.project.cache", "CachedTable")  # imported by modules that hold steps

Definition = tuple[str, str]  # module and name in it; without a name, the whole module


def code_hash(*objects: object) -> str:
    """Return a hash of the code that functions, classes and instances depend on.

    Notes
    -----
    From each definition the imports are followed through this package. A module counts whole,
    with everything that it imports and the JSON files beside it. Only a module that imports
    `CachedTable`, and so holds steps, is followed name by name: a change of one step leaves the
    tables of the others alone. Annotations import nothing. Other packages do not count, nor do
    objects that are defined elsewhere, as in a notebook.
    """
    return _closure_hash(frozenset(each for value in objects for each in _definitions(value)))


def _definitions(value: object) -> Iterator[Definition]:
    """Yield where an object is defined, and what the fields of a dataclass hold."""
    if isinstance(value, partial):
        value = value.func
    definition = value if hasattr(value, "__qualname__") else type(value)
    if definition.__module__.partition(".")[0] == PACKAGE:
        yield definition.__module__, definition.__qualname__.partition(".")[0]
    if is_dataclass(value) and not isinstance(value, type):
        value = [getattr(value, field.name) for field in fields(value)]
    for part in value if isinstance(value, list | tuple) else ():
        yield from _definitions(part)


@cache
def _closure_hash(start: frozenset[Definition]) -> str:
    pending, texts = set(start), {}
    while pending:
        module, name = pending.pop()
        parsed = _module(module)
        name = name if parsed.holds_steps else ""
        if (module, name) not in texts:
            texts[module, name] = parsed.text(name)
            pending |= parsed.uses(name)
    return hashlib.sha256(repr(sorted(texts.items())).encode()).hexdigest()


class _Module:
    """The file of a module: its imports, and its statements by the names they define."""

    def __init__(self, name: str) -> None:
        file = _file(name)
        if file is None:
            raise ImportError(f"{name}: no such module in {ROOT}.")
        self.name, self.source = name, file.read_text(encoding="utf-8")
        self.data = [path.read_text("utf-8") for path in sorted(file.parent.glob("*.json"))]
        self.imports: dict[str, Definition] = {}
        self.statements: dict[str, list[ast.stmt]] = {}
        tree = ast.parse(self.source)
        package = name if file.name == "__init__.py" else name.rpartition(".")[0]
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                for alias in node.names:
                    self._imported(alias.asname or alias.name, alias.name, "")
            elif isinstance(node, ast.ImportFrom):
                base = importlib.util.resolve_name("." * node.level + (node.module or ""), package)
                for alias in node.names:
                    self._imported(alias.asname or alias.name, base, alias.name)
        for statement in tree.body:
            for defined in _defined(statement):
                self.statements.setdefault(defined, []).append(statement)
        self.holds_steps = STEP in self.imports.values()

    def _imported(self, here: str, module: str, name: str) -> None:
        if _file(f"{module}.{name}"):
            module, name = f"{module}.{name}", ""
        if _file(module):
            self.imports[here] = (module, name)

    def _of(self, name: str) -> list[ast.stmt]:
        return self.statements.get("", []) + self.statements.get(name, [])

    def text(self, name: str) -> str:
        """Return the code behind a name, or all of it, and the JSON files beside it."""
        code = map(ast.unparse, self._of(name)) if name else [self.source]
        return "\n".join([*code, *self.data])

    def uses(self, name: str) -> set[Definition]:
        """Return what the code behind a name depends on, directly."""
        if not name:
            return set(self.imports.values())
        used = {name, *(read for statement in self._of(name) for read in _read(statement))}
        here = {(self.name, each) for each in used if each in self.statements}
        return here | {
            definition
            for alias, definition in self.imports.items()
            if alias.partition(".")[0] in used
        }


def _defined(statement: ast.stmt) -> list[str]:
    """Return the names that a statement defines.

    It is one empty name if the statement acts in another way.
    """
    match statement:
        case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
            return [name]
        case ast.Assign(targets=targets):
            return [node.id for node in targets if isinstance(node, ast.Name)] or [""]
        case ast.AnnAssign(target=ast.Name(id=name)):
            return [name]
        case ast.Import() | ast.ImportFrom() | ast.Expr(value=ast.Constant()):
            return []
    return [""]


def _read(node: ast.AST) -> Iterator[str]:
    """Yield the names in a statement, except in annotations."""
    for field, value in ast.iter_fields(node):
        if field not in ("annotation", "returns"):
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.Name):
                    yield child.id
                elif isinstance(child, ast.AST):
                    yield from _read(child)


_module = cache(_Module)


def _file(name: str) -> Path | None:
    """Return the file of a module of this package; None for any other name."""
    package, *parts = name.split(".")
    base = ROOT.joinpath(*parts)
    files = (base.with_suffix(".py"), base / "__init__.py") if parts else (base / "__init__.py",)
    return next((file for file in files if package == PACKAGE and file.is_file()), None)
