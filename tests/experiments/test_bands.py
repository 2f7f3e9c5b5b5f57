"""Bands of headline numbers over scenarios, by hand-made numbers and on few flights."""

import numpy as np
import pandas as pd
import pytest

from kilnflight.checks import InputError
from kilnflight.experiments import bands, campaigns, detection, tracking
from kilnflight.twin.scenes import scene_name


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


def test_bands_keep_what_has_no_value_and_the_order_of_the_numbers():
    table = numbers(
        ("base", "dwell", "shred", 0.3), ("base", "dwell", "chip", np.nan),
        ("pose-00", "dwell", "shred", 0.2), ("pose-00", "dwell", "chip", np.nan),
    )  # fmt: skip
    found = bands.bands(table, ["pose-00"])
    assert found["case"].tolist() == ["shred", "chip"]
    assert np.isnan(found.loc[1, "low"])
    assert found.loc[1, "lowest"] == ""


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
