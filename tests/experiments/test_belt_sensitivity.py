"""What the 2016 paper does not print, varied: on small worlds and hand-made tables."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from kilnflight.experiments import belt_2016, belt_camera, belt_sensitivity
from kilnflight.experiments.belt_sensitivity import (
    FOUND,
    PLACES,
    calibration_answers,
    settle,
    shown,
    vary_corners,
    vary_filter,
)
from kilnflight.project import claims
from kilnflight.sorter.friction import FrictionBelt
from kilnflight.sorter.machine import BULKS
from kilnflight.sorter.rendering import Pictures

SMOOTH = FrictionBelt(
    particles=12,
    friction=0.0,
    rolling_friction=0.0,
    kicks_per_s=0.0,
    velocity_mm_s=1200.0,
    velocity_spread_mm_s=20.0,
    lateral_spread_mm_s=15.0,
    feed_s=0.4,
    sampling_hz=1000.0,
    steps_per_sample=1,
)


@pytest.fixture(scope="module")
def world():
    """Pictures and bodies of constant velocity."""
    bodies = SMOOTH(np.random.default_rng(5))
    pictured = belt_camera.track_pictures(Pictures(bodies, BULKS["spheres"], 0), 40)
    return pictured, bodies, belt_2016.noise_free(bodies)


def test_corners_off_by_a_pixel_shift_what_is_predicted_and_found_ones_do_not(world):
    table = vary_corners(*world, draws=4, seed=1).set_index("corners")
    assert table.index.tolist()[0::5] == [FOUND, PLACES]
    bias = table["images_lateral_bias_mm"]
    off = bias.drop([FOUND, PLACES])
    assert abs(bias[PLACES]) < 0.02  # constant velocity, exact places
    assert abs(bias[FOUND]) < 0.1 < off.abs().max() < 2.0  # a pixel has 0.44 mm
    assert len(table["tracking_bias_ms"].unique()) == 1  # no picture is involved


def test_a_found_corner_is_a_draw_without_error(world, monkeypatch):
    monkeypatch.setattr(belt_sensitivity, "CORNER_PX", 0.0)
    table = vary_corners(*world, draws=1, seed=1)
    for name in ("images_bias_ms", "images_lateral_bias_mm", "images_over_straight"):
        assert table[name][1] == pytest.approx(table[name][0], rel=1e-3, abs=1e-4)


def test_nine_filters_and_the_usual_one_among_them(world):
    table = vary_filter(*world)
    keys = table[["velocity_noise", "measurement_spread"]]
    assert len(keys.drop_duplicates()) == 9
    assert not {"belt16-1", "belt16-2", "belt16-4"} & set(table)  # no picture takes part
    usual = table[(keys == 1.0).all(axis="columns")].iloc[0]
    pictured, bodies, _ = world
    images = belt_2016.from_images(pictured, bodies).query("approach == 'Tracking'")
    assert usual["images_bias_ms"] == pytest.approx(images["temporal_ms"].median())
    assert np.ptp(table["images_bias_ms"]) > 0


def test_frictions_change_the_bodies(monkeypatch, tmp_path):
    """Without MuJoCo the friction model is varied: less friction, more acceleration left."""
    monkeypatch.setattr(belt_2016, "is_installed", lambda: False)
    few, spread = (
        belt_2016.simulate_bodies("spheres", 6, 0, friction=value, lateral=times)
        for value, times in ((0.1, 1.0), (0.1, 2.0))
    )
    usual = belt_2016.simulate_bodies("spheres", 6, 0)
    assert not few["x"].equals(usual["x"])
    first, wide = (part.groupby("particle")["y"].agg(np.ptp) for part in (few, spread))
    assert wide.sum() > 1.3 * first.sum()


CORNERS = pd.DataFrame(
    {
        "corners": [FOUND, "off 1", "off 2", PLACES],
        "tracking_bias_ms": 0.5,
        "images_bias_ms": [0.7, 0.9, 0.5, 0.6],
        "images_lateral_bias_mm": [0.01, 0.3, -0.4, 0.0],
        "belt16-5": ["yes", "yes", "no", "yes"],
        "belt16-6": "open",
    }
)


def test_what_the_calibration_and_the_filter_add_by_hand():
    """Root mean square of 0.3 and 0.4; of 0.2 and 0.2 over 0.5; 0.1 over 0.5."""
    answers = calibration_answers(CORNERS)
    assert answers["belt16-8"].item() == pytest.approx(0.01 / 0.125**0.5)
    assert answers["belt16-9"].to_dict() == pytest.approx({"calibration": 0.4, "adaptation": 0.2})


def test_draws_share_a_row_and_claims_are_listed_by_number():
    table = CORNERS.assign(corners=[FOUND, "off by 1 px, draw 1", "off by 1 px, draw 2", PLACES])
    rows = shown(table).set_index("corners")
    assert rows.index.tolist() == [FOUND, "off by 1 px, 2 draws", PLACES]
    assert rows["bias, images (ms)"].tolist() == ["0.700", "0.700 (0.500 to 0.900)", "0.600"]
    assert rows["fails"].tolist() == ["", "5 (in 1)", ""]
    assert rows["open"].tolist() == ["6", "6 (in 2)", "6"]


def test_what_does_not_vary_is_left_out():
    table = shown(CORNERS.assign(friction=["a", "b", "c", "d"]).drop(columns="corners"))
    assert "across, images (mm)" in table.columns
    assert "across, images (mm)" not in shown(CORNERS.assign(images_lateral_bias_mm=0.1)).columns


def test_the_lateral_spread_is_told_where_it_decides():
    table = pd.DataFrame({"friction": ["fitted", "fitted", "0.10"], "lateral_spread": [1, 2, 1]})
    table = table.assign(**{"within_0.2_mm": [0.87, 0.55, 0.96], "belt16-1": ["open"] * 3})
    verdict = settle(claims.judge("belt16-1", 0.854), {"friction": table})
    assert verdict.reason.endswith("fewer spheres than above): 1 times 0.87, 2 times 0.55")


@pytest.mark.parametrize(("name", "because"), [("friction", "twin"), ("filter", "method")])
def test_a_claim_that_a_setting_turns_is_not_decidable(name, because):
    given = claims.judge("belt16-5", {"bias": True}, note="why")
    verdict = settle(given, {name: CORNERS})
    assert (verdict.verdict, verdict.because) == ("not decidable", because)
    assert verdict.reason == f"why; {name}, 4 settings: yes 3, no 1, open 0"
    same = settle(given, {name: CORNERS.assign(**{"belt16-5": "yes"})})
    assert same == replace(given, reason=f"why; {name}, 4 settings: yes 4, no 0, open 0")
    assert settle(given, {name: CORNERS.drop(columns="belt16-5")}) == given
