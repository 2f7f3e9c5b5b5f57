from dataclasses import replace

import pytest

from kilnflight.experiments import statements
from kilnflight.experiments import twin_calibration as calibration
from kilnflight.twin import truth
from kilnflight.twin.fitted import FlightInputs, flight_inputs


def test_the_frozen_inputs_cost_less_and_as_much_as_the_file_says():
    content, targets = calibration.read_fit(), statements.calibration_targets()
    before = calibration.cost(FlightInputs(), targets)
    after = calibration.cost(flight_inputs(), targets)
    assert after < before / 2
    assert before == pytest.approx(content["cost_inputs_only"], rel=0.02)
    assert after == pytest.approx(content["cost_calibrated"], rel=0.02)


def test_another_seed_agrees_that_they_cost_less():
    targets = statements.calibration_targets()
    values = [
        calibration.cost(inputs, targets, seed=3) for inputs in (flight_inputs(), FlightInputs())
    ]
    assert values[0] < values[1] / 2


def test_the_frozen_inputs_lie_within_the_limits():
    for name, (low, high) in calibration.LIMITS.items():
        assert low <= getattr(flight_inputs(), name) <= high


def test_the_cost_flies_and_reads_no_held_out_cell(monkeypatch):
    targets = statements.calibration_targets()
    assert set(targets["use"]) == {statements.CALIBRATED}
    flown, original = [], truth.released

    def noted(name, bar, *rest):
        flown.append((name, bar))
        return original(name, bar, *rest)

    monkeypatch.setattr(truth, "released", noted)
    monkeypatch.setattr(statements, "statements", lambda: pytest.fail("read what is held out"))
    calibration.cost(FlightInputs(), targets, count=5)
    assert tuple(flown) == statements.FIT_CAMPAIGNS


def test_held_out_numbers_do_not_change_the_targets(monkeypatch):
    before = calibration.target_rows(statements.calibration_targets())
    read = statements.claims.published

    def other(name, **how):
        table = read(name, **how)
        outside = (table["pressure_bar"] == "5") | table["fraction"].str.contains("PE|shred")
        table.loc[outside & (table["value_low"] != ""), "value_low"] = "0.123"
        return table

    monkeypatch.setattr(statements.claims, "published", other)
    assert calibration.target_rows(statements.calibration_targets()) == before


def test_the_search_is_deterministic_and_keeps_to_the_limits():
    def bowl(inputs):
        return (inputs.lance_length_m - 4) ** 2 + (inputs.extinction_1_s / 300 - 1) ** 2

    search = replace(calibration.SEARCH, seed=1, generations=5)
    first = search(bowl)
    assert first == search(bowl)
    assert bowl(first[0]) < bowl(FlightInputs())
