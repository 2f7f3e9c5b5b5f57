"""The listed inputs are those of the code."""

import ast
from dataclasses import fields, is_dataclass

import pandas as pd
import pytest

from kilnflight.simulated.kiln import (
    background,
    feeding,
    fuel,
    laws,
    life,
    picture,
    scenes,
)
from kilnflight.store import paths

TABLE = pd.read_csv(paths.reference() / "twin_inputs.csv", keep_default_na=False)


def parts(whole):
    for value in (getattr(whole, field.name) for field in fields(whole)):
        if is_dataclass(value):
            yield from ((type(value).__name__, value), *parts(value))


def flat(value):
    """Return the numbers of nested tuples and dictionaries, without words."""
    value = tuple(value.values()) if isinstance(value, dict) else value
    if isinstance(value, tuple):
        return [number for each in value for number in flat(each)]
    return [] if isinstance(value, str) else [float(value)]


def test_the_listed_inputs_are_those_of_the_code():
    scene = scenes.ground_truth("V1")
    rooms = (background, feeding, laws, life, picture, scenes)
    known = dict(parts(scene)) | {
        room.__name__.rpartition(".")[2]: room for room in rooms
    }
    known |= {f"{name} at {bar} bar": law for (name, bar), law in laws.LAWS.items()}
    known |= fuel.FRACTIONS | {"Scene": scene}
    others = {
        f"{name}.depth_error_mm": error for name, error in scene.depth.particle_error_mm
    }
    for kind, rows in scenes.COUNTS.groupby("label"):
        counts = tuple(rows["everywhere"]), tuple(rows["within"])
        others |= {f"labelled {kind}.counts": counts}
        shares = tuple(feeding.MIXTURES.loc[kind, "share"])
        others |= {f"labelled {kind}.shares": shares}
    papers = scenes.RECORDED["confetti"]
    granules = scenes.RECORDED["PE granule"]
    others |= {
        "scenes.RATE_HZ": papers["rate_hz"],
        "scenes.PE_RATE_HZ": granules["rate_hz"],
        "scenes.PE_EXPOSURE_S": granules["exposure_s"],
    }
    for name, recorded in scenes.RECORDED.items():
        window = recorded["trajectories"], recorded["window"]
        frames = recorded["frames_4.5_bar"], recorded["frames_5.0_bar"]
        others |= {f"{name}.window": window, f"{name}.frames": frames}
    for name, text in zip(TABLE["name"], TABLE["value"], strict=True):
        of, _, key = name.rpartition(".")
        value = others[name] if name in others else getattr(known[of], key)
        assert flat(ast.literal_eval(text)) == pytest.approx(flat(value), rel=1e-5), (
            name
        )


def test_every_input_has_a_status_and_a_source():
    assert set(TABLE["status"]) == {
        "published",
        "handbook",
        "fitted",
        "identified",
        "assumption",
    }
    assert TABLE["name"].is_unique
    assert (TABLE["source"] != "").all()
