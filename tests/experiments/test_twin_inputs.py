"""Inputs of the twin with what the code says of them."""

from dataclasses import replace

import pytest

from kilnflight.experiments import twin_inputs
from kilnflight.twin.scenes import open_scene


@pytest.fixture(scope="module")
def scene():
    return open_scene("confetti-4.5-bar").scene


def test_every_input_has_its_value_unit_status_and_source(scene):
    table = twin_inputs.input_table(scene)
    assert list(table) == twin_inputs.COLUMNS
    assert not table.duplicated(["of", "input"]).any()
    rows = table.set_index(["of", "input"])
    row = rows.loc[("Gas", "lance_diameter_m")]
    assert row[["value", "unit", "status"]].tolist() == ["0.04", "m", "assumption"]
    assert row[["low", "high"]].tolist() == [0.04, 0.10]
    speed = rows.loc[("Gas", "velocity_at_5_bar_m_s")]
    assert speed[["value", "unit", "status"]].tolist() == ["16", "m/s", "published"]
    inherited = rows.loc[("LensCamera", "static_bias")]  # stated where the first look has it
    assert inherited["status"] == "scenario"
    assert "of the combustion chamber (sec. 2.1.1)" in row["source"]
    row = rows.loc[("Geometry", "lance_depth_mm")]
    assert row["status"] == "fitted"
    assert row["low"] <= float(row["value"]) <= row["high"]
    assert rows.loc[("Flight", "char_left"), "status"] == "assumption"
    assert rows.loc[("Flight", "restitution"), ["low", "high"]].tolist() == [0.5, 0.7]
    assert {"Burner", "Light", "Plates", "VolatileIgnition"} <= set(table["of"])


def test_fractions_say_where_their_values_come_from(scene):
    rows = twin_inputs.input_table(scene).set_index(["of", "input"])
    assert rows.loc[("wood chip", "length_m"), "source"].startswith("Spruce and pine")
    assert rows.loc[("wood chip", "pyrolysis_1_s"), "source"].startswith("pine (Wagenaar")
    assert rows.loc[("confetti", "char_time_s"), "status"] == "handbook"


def test_fitted_values_lie_within_their_bounds(scene):
    table = twin_inputs.input_table(scene)
    fitted = table[(table["status"] == "fitted") & table["low"].notna()]
    value = fitted["value"].astype(float)
    assert ((fitted["low"] <= value) & (value <= fitted["high"])).all()
    assert len(fitted) > 10


def test_what_a_scenario_changes_is_seen(scene):
    other = replace(scene, gas=replace(scene.gas, temperature_k=1300.0))
    rows = twin_inputs.input_table(other).set_index(["of", "input"])
    assert rows.loc[("Gas", "temperature_k"), "value"] == "1300"
