import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from kilnflight.checks import InputError
from kilnflight.experiments import statements
from kilnflight.experiments import twin_flight as calibration
from kilnflight.project import paths
from kilnflight.twin.fitted import SecondInputs, second_kiln, second_kiln_with
from kilnflight.twin.poses import Pose, read_poses


def bowl(inputs):
    return (inputs.lance_length_m - 4) ** 2 + (inputs.chemical_time_s / 1e-3 - 2) ** 2


def test_the_frozen_inputs_cost_less_than_the_untouched_and_as_much_as_the_file_says():
    content, targets = calibration.read_fit(), statements.calibration_targets()
    after = calibration.cost(SecondInputs(**content["inputs"]), Pose(**content["pose"]), targets)
    assert after == pytest.approx(content["cost_calibrated"], rel=0.02)
    assert after < content["cost_inputs_only"] / 2


def test_the_frozen_inputs_are_the_better_of_two_ends_and_lie_within_the_limits():
    content = calibration.read_fit()
    ends = content["starts"]
    assert len(ends) == 2
    assert content["cost_calibrated"] == min(end["cost"] for end in ends)
    for end in ends:
        assert end["cost"] < end["cost_start"]
    for name, (low, high) in calibration.LIMITS.items():
        assert low <= content["inputs"][name] <= high
        assert content["limits"][name] == [low, high]
    assert set(content["sources"]) == set(calibration.LIMITS)


def test_the_kiln_has_the_frozen_inputs_the_pose_and_the_second_physics():
    content, kiln = calibration.read_fit(), second_kiln()
    assert kiln == second_kiln_with(SecondInputs(**content["inputs"]), Pose(**content["pose"]))
    assert kiln.flight.launch_elevation_deg == content["pose"]["elevation_deg"]
    assert kiln.geometry.lance_depth_mm == content["pose"]["lance_depth_mm"]
    assert content["pose"] == asdict(read_poses().mode)
    assert kiln.gas.choked
    assert kiln.flight.bouncing
    assert kiln.flight.plates
    assert kiln.flight.volatiles


def test_the_cost_flies_and_reads_no_held_out_cell(monkeypatch):
    targets, flown = statements.calibration_targets(), []
    original = calibration.kiln_cost.__globals__["truth"].released

    def noted(name, bar, *rest):
        flown.append((name, bar))
        return original(name, bar, *rest)

    monkeypatch.setattr("kilnflight.twin.truth.released", noted)
    monkeypatch.setattr(statements, "statements", lambda: pytest.fail("read what is held out"))
    calibration.cost(SecondInputs(), Pose(), targets, count=5)
    assert tuple(flown) == statements.FIT_CAMPAIGNS


def test_both_descents_find_the_bottom_keep_to_the_limits_and_are_deterministic():
    search = replace(calibration.SEARCH, evaluations=200)
    seen = []

    def noted(inputs):
        seen.append(asdict(inputs))
        return bowl(inputs)

    found = search(noted)
    assert found == search(bowl)
    assert found[0].lance_length_m == pytest.approx(4.0, abs=0.05)
    assert found[0].chemical_time_s == pytest.approx(2e-3, rel=0.02)
    for name, (low, high) in calibration.LIMITS.items():
        values = np.array([each[name] for each in seen])
        assert low <= values.min() < values.max() <= high


def test_a_stopped_search_goes_on_where_it_was(monkeypatch, tmp_path):
    monkeypatch.setattr(paths, "derived", lambda: tmp_path)
    monkeypatch.setattr(calibration, "cost", lambda inputs, *_: bowl(inputs))
    of = calibration.Remembered(Pose(), statements.calibration_targets())
    first = of(SecondInputs())
    monkeypatch.setattr(calibration, "cost", lambda *_: pytest.fail("evaluated again"))
    assert of(SecondInputs()) == first
    with pytest.raises(pytest.fail.Exception):
        of(SecondInputs(lance_length_m=3.0))
    elsewhere = replace(of, pose=Pose(elevation_deg=1.0))
    with pytest.raises(pytest.fail.Exception):
        elsewhere(SecondInputs())


def test_an_edited_file_is_refused(tmp_path):
    content = json.loads(calibration.SECOND_FLIGHT_FILE.read_text())
    content["inputs"]["lance_length_m"] += 0.1
    path = tmp_path / "flight.json"
    path.write_text(json.dumps(content))
    for read in (calibration.read_fit, second_kiln):
        with pytest.raises(InputError, match="damaged"):
            read(path)
