"""Bands of headline numbers over scenarios, by hand-made numbers and on few flights."""

import numpy as np
import pandas as pd
import pytest

from kilnflight.checks import InputError
from kilnflight.experiments import bands, campaigns, detection, tracking
from kilnflight.twin.scenes import SCENARIOS, scene_name


def numbers(*rows):
    return pd.DataFrame(rows, columns=bands.COLUMNS)


def test_bands_of_draws_leave_other_scenarios_out():
    table = numbers(
        ("base", "F1", "SIFT", 0.8),
        ("pose-00", "F1", "SIFT", 0.7),
        ("pose-01", "F1", "SIFT", 0.9),
        ("pose-02", "F1", "SIFT", 0.85),
        ("no-jet", "F1", "SIFT", 0.5),
    )
    row = bands.bands(table, ["pose-00", "pose-01", "pose-02"]).iloc[0]
    assert row["base"] == 0.8
    assert (row["draws_low"], row["draws_median"], row["draws_high"]) == (0.7, 0.85, 0.9)
    assert (row["low"], row["lowest"], row["high"], row["highest"]) == (
        0.5,
        "no-jet",
        0.9,
        "pose-01",
    )
    assert (row["draws"], row["scenarios"]) == (3, 5)
    every = bands.by_scenario(table)
    assert list(every) == ["base", "pose-00", "pose-01", "pose-02", "no-jet"]
    assert every.loc[("F1", "SIFT")].tolist() == [0.8, 0.7, 0.9, 0.85, 0.5]


def test_bands_keep_what_has_no_value_and_the_order_of_the_numbers():
    table = numbers(
        ("base", "dwell", "shred", 0.3), ("base", "dwell", "chip", np.nan),
        ("pose-00", "dwell", "shred", 0.2), ("pose-00", "dwell", "chip", np.nan),
    )  # fmt: skip
    found = bands.bands(table, ["pose-00"])
    assert found["case"].tolist() == ["shred", "chip"]
    assert np.isnan(found.loc[1, "low"])
    assert found.loc[1, "lowest"] == ""


def test_what_is_printed_stands_beside_each_quantity():
    table = bands.printed().set_index(["quantity", "case"])
    assert table.index.is_unique
    dwell = table.loc[("dwell median (s)", "confetti")]
    assert dwell.tolist() == [0.3, 0.5]
    assert table.loc[("F1", "Combi SIFT+DBSCAN"), "published_low"] == 0.9017
    # of few frames alpha is another number than that of Table 5.17
    assert "alpha of GNN" not in table.index.get_level_values("quantity")
    assert not table.loc[list(bands.OUTCOMES)].empty


def test_bands_are_drawn_and_told_as_far_as_they_are_known():
    table = bands.bands(
        numbers(
            ("base", "dwell median (s)", "confetti", 0.4),
            ("pose-00", "dwell median (s)", "confetti", 0.35),
            ("dumped", "dwell median (s)", "confetti", 0.6),
            ("base", "F1", "2D-SIFT", 0.8),
        ),
        ["pose-00"],
    )
    told = "Median dwell time of confetti (s) 0.35 to 0.35"
    assert bands.describe(table) == f"{told} [0.35 to 0.60] (1 draw)."
    assert bands.describe(table.assign(scenarios=2)) == f"{told} (1 draw)."  # base and the draw
    picture = bands.draw_bands(table)
    labels = [axes.get_xlabel() for axes in picture.axes]
    assert labels == ["median of the dwell time (s)", "F1"]
    assert table["published_high"].tolist() == [0.5, 0.8749]


def test_numbers_of_all_scenarios_stand_below_each_other():
    def one(scenario, value):
        return numbers((scenario, "F1", "SIFT", value))

    table = bands.of_all(one, ["base", "dumped"], 0.5)
    assert table["scenario"].tolist() == ["base", "dumped"]
    assert list(bands.of_all(one, [], 0.5)) == bands.COLUMNS


def test_scenarios_of_the_bands_exist():
    assert len(bands.DRAWS) == 16
    assert SCENARIOS.keys() >= {bands.BASE, *bands.DRAWS, *bands.OTHERS}


def test_flight_numbers_change_with_the_scenario_and_not_with_the_run():
    base, again, other = (bands.flight_numbers(name, 12, 3) for name in ("base", "base", "no-jet"))
    pd.testing.assert_frame_equal(base, again)
    assert len(base) == 4 * len(bands.OUTCOMES)
    speed = base["quantity"] == "velocity 0-1 m (m/s)"
    assert (base.loc[speed, "value"].to_numpy() != other.loc[speed, "value"].to_numpy()).all()
    share = base.loc[base["quantity"].str.endswith("(%)"), "value"]
    assert share.between(0, 100).all()


def test_a_scenario_changes_the_scenes_that_are_opened(monkeypatch):
    opened = []

    def refuse(name, seed):
        opened.append(name)
        raise InputError("enough")

    monkeypatch.setattr(detection.scenes, "cached_scene", refuse)
    with pytest.raises(InputError, match="enough"):
        detection.labelled_subsets("quick", scenario="small")
    assert opened == ["V4@small"]
    assert scene_name("V1") == "V1"
    assert campaigns.scene_name("V1", "small") == tracking.scene_name("V1", "small") == "V1@small"
