"""Every input of the twin with its source, as the code states it.

Values are those of a scene; what is said of them is the comment beside each field of a data class.
"""

from __future__ import annotations

import ast
import inspect
import io
import re
import tokenize
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import pandas as pd

from kilnflight.experiments import twin_flight, twin_light, twin_pose
from kilnflight.twin import particles
from kilnflight.twin.scene import Scene

COLUMNS = ["module", "of", "input", "value", "unit", "status", "low", "high", "source"]
UNITS = {
    "j_kg_k": "J/(kg K)", "w_m_k": "W/(m K)", "kg_m2_s": "kg/(m2 s)", "kg_m3": "kg/m3",
    "k_m": "K/m", "m_s": "m/s", "j_mol": "J/mol", "j_kg": "J/kg", "mm_px": "mm/px", "1_s": "1/s",
    "1_m": "1/m", "bar": "bar", "deg": "degrees", "mm": "mm", "px": "px", "hz": "Hz", "k": "K",
    "m": "m", "s": "s",
}  # fmt: skip
# Bounds of what was fitted, fixed before.
FITTED: dict[str, tuple[float | None, float | None]] = {**twin_flight.LIMITS, **twin_light.LIMITS}
FITTED |= {name: twin_pose.PRIOR[name].support() for name in ("axis_height_mm", "lance_depth_mm")}
FITTED |= {"launch_elevation_deg": twin_pose.PRIOR["elevation_deg"].interval(0.95)}
FITTED |= dict.fromkeys(("axis_far_mm", "inlet_depth_mm"), (None, None))  # by the pose's scale
# to Tables 5.2 and 5.18 and the number of points (`kilnflight.experiments.twin_depth`)
FITTED |= dict.fromkeys(("contrast", "wall_points", "particle_error_mm"), (None, None))
# What a comment says, in the order in which it is asked.
STATUS = {
    "assumption": r"assum|tried first|by hand",
    "scenario": r"scenario",
    "handbook": r"handbook|data sheet",
    "published": r"\bsec\.|Tables? \d|Figs?\. \d|Eqs?\. \d",
    "literature": r"(19|20)\d\d|others\)",
}
BOUNDS = re.compile(r"(-?\d+\.?\d*) to (-?\d+\.?\d*)(?= \(|[,;:)]|$)")  # not of another unit


def input_table(scene: Scene) -> pd.DataFrame:
    """Return every number that a scene and the four fractions are made of, a row of `COLUMNS`.

    ``of`` is the data class or the fraction. ``status`` is "fitted", or what the comment says:
    "published", "literature", "handbook", "scenario", "assumption"; "not said" of the rest.
    """
    rows = [row for part in _parts(scene) for row in _rows(part, type(part).__name__, {})]
    text = inspect.getsource(particles)
    for node in ast.parse(text).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.value).startswith("Fraction("):
            kind = getattr(particles, ast.unparse(node.targets[0]))
            given = {each.arg: each for each in node.value.keywords}  # type: ignore[attr-defined]
            above = _notes(text, {"": node.targets[0]})[""]
            notes = {name: note or above for name, note in _notes(text, given).items()}
            rows += _rows(kind, kind.name, notes)
    return pd.DataFrame(rows, columns=COLUMNS)


def _parts(whole: Any) -> Iterator[Any]:
    """Yield the data classes in the fields of one, each before its own."""
    for value in (getattr(whole, field.name) for field in fields(whole)):
        if is_dataclass(value):
            yield value
            yield from _parts(value)


def _rows(part: Any, name: str, notes: dict[str, str]) -> list[tuple[object, ...]]:
    """Return a row for each field that is a number; ``notes`` come before those of the class."""
    kinds = [kind for kind in reversed(type(part).__mro__) if is_dataclass(kind)]
    of_class: dict[str, str] = {}
    for source in map(inspect.getsource, kinds):  # what a class inherits is stated where it is
        stated = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.AnnAssign)]
        own = _notes(source, {ast.unparse(node.target): node for node in stated})
        of_class |= {key: note for key, note in own.items() if note or key not in of_class}
    notes = of_class | notes
    general = "handbook" if isinstance(part, particles.Fraction) else type(part).__doc__ or ""
    rows: list[tuple[object, ...]] = []
    for key in (field.name for field in fields(part)):
        value, note = getattr(part, key), notes.get(key, "")
        if (not isinstance(value, (float, tuple)) and type(value) is not int) or key == "body":
            continue
        said = (
            kind for text in (note, general) for kind in STATUS if re.search(STATUS[kind], text)
        )
        unit = next((UNITS[end] for end in UNITS if key.endswith(f"_{end}")), "")
        status = "fitted" if key in FITTED else next(said, "not said")
        found = BOUNDS.search(note) if isinstance(value, float) else None
        ends = FITTED.get(key) or (tuple(map(float, found.groups())) if found else (None, None))
        shown = re.sub(r"\d+\.\d+", lambda number: f"{float(number[0]):.6g}", str(value))
        module = type(part).__module__.rpartition(".")[2]
        rows.append((module, name, key, shown, unit, status, *ends, note))
    return rows


def _notes(source: str, nodes: Mapping[Any, Any]) -> dict[Any, str]:
    """Return the comments above and behind each node of a source."""
    texts, alone = {}, set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            texts[token.start[0]] = token.string.lstrip("# ").replace("`", "")
            alone |= set() if token.line[: token.start[1]].strip() else {token.start[0]}
    notes = {}
    for name, node in nodes.items():
        first = node.lineno
        while first - 1 in alone:
            first -= 1
        lines = range(first, node.end_lineno + 1)
        notes[name] = " ".join(texts[line] for line in lines if line in texts)
    return notes
