import ast
from dataclasses import fields, is_dataclass

import pandas as pd
import pytest

from kilnflight.project import paths
from kilnflight.twin import scenes
from kilnflight.twin.particles import FRACTIONS

TABLE = pd.read_csv(paths.reference() / "twin_inputs.csv", keep_default_na=False)


def parts(whole):
    for value in (getattr(whole, field.name) for field in fields(whole)):
        if is_dataclass(value):
            yield from ((type(value).__name__, value), *parts(value))


def test_the_listed_inputs_are_those_of_the_code():
    known = {**dict(parts(scenes.open_scene("confetti-4.5-bar").scene)), **FRACTIONS}
    for name, text in zip(TABLE["name"], TABLE["value"], strict=True):
        of, _, key = name.rpartition(".")
        value = getattr(known.get(of, scenes), key, None) or scenes.SIZES.get(key, 0.0)
        value = tuple(value.values()) if isinstance(value, dict) else value
        listed, ours = (pd.Series(flat(each)) for each in (ast.literal_eval(text), value))
        assert listed.tolist() == pytest.approx(ours.tolist(), rel=1e-5), name


def flat(value):
    """Return the numbers of nested tuples, without words."""
    if isinstance(value, tuple):
        return [number for each in value for number in flat(each)]
    return [] if isinstance(value, str) else [float(value)]


def test_every_input_has_a_status_and_a_source():
    assert set(TABLE["status"]) == {"published", "handbook", "fitted", "assumption"}
    assert TABLE["name"].is_unique
    assert (TABLE["source"] != "").all()
