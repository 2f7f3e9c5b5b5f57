import json
from dataclasses import replace

import pytest

from kilnflight.checks import InputError
from kilnflight.project import cache
from kilnflight.twin.fitted import (
    FLIGHT_FILE,
    FlightInputs,
    LightInputs,
    flight_inputs,
)
from kilnflight.twin.flight import Flight
from kilnflight.twin.gas import Gas
from kilnflight.twin.scenes import ground_truth


def test_the_untouched_inputs_are_the_defaults():
    assert FlightInputs().applied(Flight(), Gas()) == (Flight(), Gas())
    flight, gas = FlightInputs(3.0, 0.005, 0.5, 1.0, 2.0, 300.0).applied(Flight(), Gas())
    assert (flight.lance_length_m, flight.extinction_1_s, gas.jet_persistence) == (3.0, 300.0, 0.5)


def test_untouched_inputs_change_nothing():
    scene = ground_truth("V1")
    plain = replace(scene, optics=type(scene.optics)(), on_the_wall=type(scene.on_the_wall)())
    plain = replace(plain, surroundings=type(scene.surroundings)())
    same = LightInputs().applied(plain)
    assert same.optics.flame_level == pytest.approx(plain.optics.flame_level)
    assert replace(same, optics=plain.optics) == plain


def write(path, content):
    path.write_text(json.dumps(content))
    return path


def test_a_file_of_other_targets_is_refused(tmp_path):
    content = json.loads(FLIGHT_FILE.read_text())
    content.pop("sha256")
    content["targets_sha256"] = "0" * 64
    content["sha256"] = cache.content_hash(content)
    with pytest.raises(InputError, match="other targets"):
        flight_inputs(write(tmp_path / "old.json", content))


def test_a_file_with_other_inputs_is_refused(tmp_path):
    content = json.loads(FLIGHT_FILE.read_text())
    content.pop("sha256")
    content["inputs"]["wind"] = content["inputs"].pop("jet_persistence")
    content["sha256"] = cache.content_hash(content)
    with pytest.raises(InputError, match="other inputs"):
        flight_inputs(write(tmp_path / "strange.json", content))


@pytest.mark.parametrize("change", ["value", "cut", "gone", "list"])
def test_a_damaged_file_is_refused(tmp_path, change):
    path, text = tmp_path / f"{change}.json", FLIGHT_FILE.read_text()
    if change == "value":
        content = json.loads(text)
        content["inputs"]["jet_persistence"] += 0.1
        write(path, content)
    elif change == "cut":
        path.write_text(text[: len(text) // 2])
    elif change == "list":
        write(path, [1, 2])
    with pytest.raises(InputError, match=path.name):
        flight_inputs(path)
