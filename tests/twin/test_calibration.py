import json

import pytest

from kilnflight.checks import InputError
from kilnflight.project import cache
from kilnflight.twin import calibration, outcomes, scenes, statements
from kilnflight.twin.calibration import INPUTS_ONLY, FreeInputs, calibrated, record
from kilnflight.twin.flight import Flight
from kilnflight.twin.gas import Gas


def test_the_untouched_inputs_are_the_defaults():
    assert INPUTS_ONLY.applied(Flight(), Gas()) == (Flight(), Gas())
    flight, gas = FreeInputs(3.0, 0.005, 0.5, 1.0, 2.0, 300.0).applied(Flight(), Gas())
    assert (flight.lance_length_m, flight.extinction_1_s, gas.jet_persistence) == (3.0, 300.0, 0.5)


def test_the_frozen_inputs_cost_less_and_as_much_as_the_file_says():
    content, said = record(), statements.targets()
    before = calibration.cost(INPUTS_ONLY, said)
    after = calibration.cost(calibrated(), said)
    assert after < before / 2
    assert before == pytest.approx(content["cost_inputs_only"], rel=0.02)
    assert after == pytest.approx(content["cost_calibrated"], rel=0.02)


def test_another_seed_agrees_that_they_cost_less():
    said = statements.targets()
    values = [calibration.cost(one, said, seed=3) for one in (calibrated(), INPUTS_ONLY)]
    assert values[0] < values[1] / 2


def test_the_frozen_inputs_lie_within_the_limits():
    for name, (low, high) in calibration.LIMITS.items():
        assert low <= getattr(calibrated(), name) <= high


def test_the_cost_flies_and_reads_no_held_out_cell(monkeypatch):
    said = statements.targets()
    assert set(said["use"]) == {statements.CALIBRATED}
    flown, original = [], outcomes.released

    def noted(name, bar, *rest):
        flown.append((name, bar))
        return original(name, bar, *rest)

    monkeypatch.setattr(outcomes, "released", noted)
    monkeypatch.setattr(statements, "statements", lambda: pytest.fail("read what is held out"))
    calibration.cost(FreeInputs(), said, count=5)
    assert tuple(flown) == statements.CELLS


def test_held_out_numbers_do_not_change_the_targets(monkeypatch):
    before = calibration.target_rows(statements.targets())
    read = statements.claims.published

    def other(name, **how):
        table = read(name, **how)
        outside = (table["pressure_bar"] == "5") | table["fraction"].str.contains("PE|shred")
        table.loc[outside & (table["value_low"] != ""), "value_low"] = "0.123"
        return table

    monkeypatch.setattr(statements.claims, "published", other)
    assert calibration.target_rows(statements.targets()) == before


def test_the_search_is_deterministic_and_keeps_to_the_limits():
    def bowl(one):
        return (one.lance_length_m - 4) ** 2 + (one.extinction_1_s / 300 - 1) ** 2

    first = calibration.fit(bowl, seed=1, generations=5)
    assert first == calibration.fit(bowl, seed=1, generations=5)
    assert bowl(first[0]) < bowl(INPUTS_ONLY)


def write(path, content):
    path.write_text(json.dumps(content))
    return path


def test_a_file_of_other_targets_is_refused(tmp_path):
    content = json.loads(calibration.FILE.read_text())
    content.pop("sha256")
    content["targets_sha256"] = "0" * 64
    content["sha256"] = cache.content_hash(content)
    with pytest.raises(InputError, match="other targets"):
        calibrated(write(tmp_path / "old.json", content))


def test_a_file_with_other_inputs_is_refused(tmp_path):
    content = json.loads(calibration.FILE.read_text())
    content.pop("sha256")
    content["inputs"]["wind"] = content["inputs"].pop("jet_persistence")
    content["sha256"] = cache.content_hash(content)
    with pytest.raises(InputError, match="other inputs"):
        calibrated(write(tmp_path / "strange.json", content))


@pytest.mark.parametrize("change", ["value", "cut", "gone", "list"])
def test_a_damaged_file_is_refused(tmp_path, change):
    path, text = tmp_path / f"{change}.json", calibration.FILE.read_text()
    if change == "value":
        content = json.loads(text)
        content["inputs"]["jet_persistence"] += 0.1
        write(path, content)
    elif change == "cut":
        path.write_text(text[: len(text) // 2])
    elif change == "list":
        write(path, [1, 2])
    with pytest.raises(InputError, match=path.name):
        calibrated(path)


def test_scenes_take_the_frozen_inputs_and_inputs_only_takes_none():
    scene = scenes.open_scene("confetti-4.5-bar").scene
    assert (scene.flight, scene.gas) == calibrated().applied(Flight(), Gas())
    untouched = scenes.open_scene("V2@inputs-only").scene
    assert (untouched.flight, untouched.gas) == (Flight(), Gas())
    assert scenes.open_scene("wood-chip-5.0-bar@inputs-only").scene.gas == Gas(pressure_bar=5.0)
