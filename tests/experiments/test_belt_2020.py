"""The 2020 paper from tracks to differences, on small worlds."""

import numpy as np
import pandas as pd
import pytest

from kilnflight.belt.evaluation import SUMMARY, Evaluation, arrival_deviations
from kilnflight.experiments import belt_2020
from kilnflight.experiments.belt_2020 import PHASE


@pytest.fixture(scope="module")
def tracks():
    """Few particles of the friction model, which stands in for the authors' tracks."""
    return belt_2020.load_tracks({}, seed=1, particles=150)


@pytest.fixture(scope="module")
def observed(tracks):
    return {name: PHASE.observe(table) for name, table in tracks.items()}


def test_fewer_particles_are_the_first_of_more(tracks):
    assert list(tracks) == ["spheres", "cuboids", "cylinders"]
    first = belt_2020.load_tracks({}, seed=1, particles=3)
    for name, table in tracks.items():
        assert table["particle"].nunique() == 150
        kept = table[table["particle"].isin(first[name]["particle"])].reset_index(drop=True)
        pd.testing.assert_frame_equal(first[name], kept)


def test_published_particles_are_left_out_with_the_known_reasons(authors_data):
    from kilnflight.belt.recordings import find_dem

    tracks = belt_2020.load_tracks(find_dem(), seed=1)
    seen = {name: table["particle"].nunique() for name, table in tracks.items()}
    assert seen == {"spheres": 3713, "cuboids": 4207, "cylinders": 4412}
    left_out = {name: PHASE.observe(table).left_out for name, table in tracks.items()}
    missed = {name: reasons["target never reached"] for name, reasons in left_out.items()}
    assert missed == {"spheres": 0, "cuboids": 2, "cylinders": 1}


def test_resampled_tracks_keep_a_cubic_and_every_observation():
    frame, time = np.arange(5, 25), np.arange(5, 25) / 100
    path = pd.DataFrame({"frame": frame, "particle": 7, "time_s": time})
    path = path.assign(x=900 * time + 300 * time**2 - 80 * time**3, y=20 * time)
    fast = belt_2020.resample(path, 1000.0)
    assert len(fast) == 191
    t = fast["time_s"].to_numpy()
    np.testing.assert_allclose(fast["x"], 900 * t + 300 * t**2 - 80 * t**3, atol=1e-9)
    pd.testing.assert_frame_equal(belt_2020.resample(fast, 100.0), path, check_dtype=False)


def accelerated(*velocities):
    """Particles with an acceleration of 1500 mm/s^2 at 100 Hz, one after the other."""
    time = np.arange(30) / 100.0
    parts = [
        pd.DataFrame(
            {
                "frame": np.arange(30),
                "particle": k,
                "time_s": time,
                "x": 400 + velocity * time + 750 * time**2,
                "y": 90 + 10 * k * time,
            }
        )
        for k, velocity in enumerate(velocities)
    ]
    return pd.concat(parts, ignore_index=True)


def test_velocity_stands_at_the_midpoint_and_not_across_a_gap():
    tracks = accelerated(1000.0, 1100.0)
    steps = belt_2020.step_velocities(tracks)
    assert len(steps) == 2 * 29
    assert steps["velocity_x_mm_s"][0] == pytest.approx(1000.0 + 1500.0 * 0.005)
    assert steps["x"][0] == pytest.approx(tracks["x"][:2].mean())
    assert len(belt_2020.step_velocities(tracks.drop(index=5))) == 2 * 29 - 2


def test_velocities_are_interpolated_where_a_particle_was_seen():
    steps = belt_2020.step_velocities(accelerated(1000.0, 1100.0))
    at = belt_2020.velocities_at(steps, "velocity_x_mm_s", np.array([350.0, 500.0]))
    assert np.isnan(at[:, 0]).all()
    # v^2 = v_0^2 + 2 a s; between two steps the velocity is linear in time, not in x
    np.testing.assert_allclose(at[:, 1], np.sqrt([1.3e6, 1.51e6]), rtol=1e-3)
    across = belt_2020.velocities_at(steps, "velocity_y_mm_s", np.array([500.0]))
    np.testing.assert_allclose(across, [[0.0], [10.0]], atol=1e-9)


def test_models_are_summed_up_by_the_median_of_the_draws(observed):
    evaluation = Evaluation(draws=3, share=0.05)
    table = belt_2020.compare_models(observed, PHASE, arrival_deviations, evaluation, 1)
    assert table.columns[:3].tolist() == ["data_set", "model", SUMMARY[0]]
    assert len(table) == 3 * 6
    draws = evaluation(observed["cuboids"], PHASE, arrival_deviations, 1)
    mae = draws.groupby("model")["mae"].median()
    part = table[table["data_set"] == "cuboids"].set_index("model")
    assert part["mae"].to_dict() == mae.to_dict()
    assert (part["mae_low"] <= part["mae"]).all()
    named = belt_2020.with_unit(table, "ms").columns
    assert {"median_ms", "whisker_low_ms", "iqr_high_ms", "n", "model"} <= set(named)


def shifted(part, phase, calibration):
    """Three models on any particles: the better one is 1 closer, the third the first again."""
    spread = np.linspace(-1.0, 1.0, np.count_nonzero(~calibration))
    yield from (("near", spread), ("far", 3.0 * spread), ("again", spread))


def test_differences_are_of_the_right_models_and_hold_beyond_chance(observed):
    orders = [("a", ("near",), ("far",)), ("b", ("far", "near"), ("again",))]
    orders += [("c", ("near",), ("again",))]
    by_name = {"spheres": orders, "cuboids": orders}
    few = {name: observed[name] for name in by_name}
    pairs = belt_2020.compare_pairs(few, PHASE, shifted, by_name, "quick", 1)
    assert len(pairs) == 2 * 3 * 2
    first = pairs.iloc[:2]
    assert first["measure"].tolist() == ["MAE", "IQR"]
    assert first["excess"].tolist() == pytest.approx([1.0, 2.0], rel=0.05)
    assert (first["excess_low"] < first["excess"]).all()
    assert pairs["higher"].tolist() == 2 * (2 * ["far"] + 4 * ["again"])
    assert belt_2020.holds(pairs, "a") == [True, True]
    assert belt_2020.holds(pairs, "b") == [False, False]
    assert belt_2020.holds(pairs, "c") == [None, None]  # no difference is none beyond chance


def test_an_order_is_open_where_the_measures_differ():
    columns = ["id", "data_set", "measure", "lower", "higher", "excess_low", "excess_high"]
    rows = [("a", "s", "MAE", "x", "y", 1, 2), ("a", "s", "IQR", "x", "y", -2, -1)]
    pairs = pd.DataFrame(rows, columns=columns)
    assert belt_2020.holds(pairs, "a") == [None]
    assert belt_2020.holds(pairs, "a", ["MAE"]) == [True]


def test_measures_leave_out_what_has_no_prediction():
    values = np.array([[-1.0, 2.0], [1.0, 4.0], [3.0, np.nan]])
    np.testing.assert_allclose(belt_2020.measures(values), [[5 / 3, 3.0], [2.0, 1.0]])


def test_boxes_have_a_panel_per_data_set_and_row():
    row = dict.fromkeys(SUMMARY, 1.0)
    rows = [row | {"data_set": s, "model": m, "kind": "k"} for s in "ab" for m in ("IV", "CA")]
    picture = belt_2020.draw_deviations(pd.DataFrame(rows), "kind", {"k": "late (ms)"}, 50, 0)
    assert [axes.get_title() for axes in picture.axes] == ["a", "b"]
    assert [axes.get_ylabel() for axes in picture.axes] == ["late (ms)", ""]
    assert [text.get_text() for text in picture.axes[1].get_xticklabels()] == ["IV", "CA"]
