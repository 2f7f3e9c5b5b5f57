import sys
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from kilnflight.belt import PredictionPhase, deviation
from kilnflight.belt.sampling import thinned
from kilnflight.experiments import sorter


@pytest.fixture
def small(monkeypatch):
    """The friction model, as without MuJoCo."""
    monkeypatch.setitem(sys.modules, "mujoco", None)
    few = {name: replace(one, particles=200) for name, one in sorter.MATERIALS.items()}
    monkeypatch.setattr(sorter, "MATERIALS", few)
    return sorter.load_tracks({}, seed=1)


def test_without_files_there_is_our_simulation_only(small):
    assert list(small) == [(sorter.OWN, name) for name in sorter.DATA_SETS]
    again = sorter.load_tracks({}, seed=1)
    for key, tracks in small.items():
        pd.testing.assert_frame_equal(tracks, again[key])


def test_every_particle_is_evaluated_or_has_a_reason(small):
    observed = {key: PredictionPhase().observe(one) for key, one in small.items()}
    counts = sorter.count_particles(small, observed)
    assert (counts["particles"] == counts.iloc[:, 3:].sum(axis=1)).all()


def test_comparison_has_a_row_per_data_set_draw_and_model(small):
    phase = PredictionPhase()
    observed = {key: phase.observe(one) for key, one in small.items()}
    evaluation = deviation.Evaluation(draws=2, share=0.05)
    table = sorter.compare(observed, phase, evaluation, deviation.arrival_deviations, 1)
    assert len(table) == 3 * 2 * 6
    assert table.columns[:4].tolist() == ["source", "data_set", "draw", "model"]


def test_other_targets_keep_the_length_of_the_phase(small):
    evaluation = deviation.Evaluation(draws=1, share=0.05)
    table = sorter.vary_target(small, [763.0, 773.0], evaluation, deviation.arrival_deviations, 1)
    assert table["target_mm"].unique().tolist() == [763.0, 773.0]
    assert len(table) == 2 * 3 * 6
    phase = PredictionPhase()
    observed = {key: phase.observe(one) for key, one in small.items()}
    same = sorter.compare(observed, phase, evaluation, deviation.arrival_deviations, 1)
    at_773 = table.loc[table["target_mm"] == 773.0, "mae"].to_numpy()
    assert at_773 == pytest.approx(same["mae"].to_numpy())


def test_published_particles_are_left_out_with_the_known_reasons(authors_data, monkeypatch):
    from kilnflight.belt.dem import find_dem

    monkeypatch.setitem(sys.modules, "mujoco", None)
    tracks = sorter.load_tracks(find_dem(), seed=1)
    observed = {key: PredictionPhase().observe(one) for key, one in tracks.items()}
    counts = sorter.count_particles(tracks, observed).set_index(["source", "data_set"])
    never = counts.loc[sorter.AUTHORS, "never on the belt"]
    missed = counts.loc[sorter.AUTHORS, "target never reached"]
    assert never.to_dict() == {"spheres": 0, "cuboids": 150, "cylinders": 15}
    assert missed.to_dict() == {"spheres": 0, "cuboids": 2, "cylinders": 1}


def test_with_mujoco_our_simulation_has_contacts_and_1000_hz():
    pytest.importorskip("mujoco")
    tracks = sorter.load_tracks({}, seed=1, count=4)
    assert [one["particle"].nunique() for one in tracks.values()] == [4, 4, 4]
    step = tracks[sorter.OWN, "spheres"].groupby("particle")["time_s"].diff().dropna()
    assert step.to_numpy() == pytest.approx(0.001)
    assert "MuJoCo" in sorter.describe_own()


def test_without_mujoco_it_says_so_and_has_one_variant(small):
    assert not sorter.is_simulated()
    assert "friction model" in sorter.describe_own()
    assert {key[0] for key in sorter.variants(5, 1)} == {"friction model"}


def test_variants_are_at_100_hz_and_before_the_fit_there_are_spheres_only():
    pytest.importorskip("mujoco")
    tracks = sorter.variants(2, 1)
    assert ("inputs only", "spheres") in tracks
    assert ("inputs only", "cuboids") not in tracks
    for one in tracks.values():
        assert one.groupby("particle")["time_s"].diff().dropna().to_numpy() == pytest.approx(0.01)


def test_thinning_changes_the_rate_and_nothing_else(small):
    evaluation = deviation.Evaluation(draws=1, share=0.05)
    table = sorter.vary_rate(small, (1, 2), evaluation, deviation.arrival_deviations, 1)
    assert table["sampling_hz"].unique().tolist() == [100.0, 50.0]
    observed = {key: sorter.AT_EDGE.observe(one) for key, one in small.items()}
    same = sorter.compare(observed, sorter.AT_EDGE, evaluation, deviation.arrival_deviations, 1)
    assert table.loc[table["sampling_hz"] == 100.0, "mae"].to_numpy() == pytest.approx(
        same["mae"].to_numpy()
    )


def test_the_same_particles_count_at_every_rate():
    """1 mm per frame to 799 mm: of every 20th frame the last one may lie before the edge."""
    frame = np.arange(409)
    parts = [
        pd.DataFrame({"frame": frame + k, "particle": k, "x": 391.0 + frame, "y": 90.0})
        for k in range(120)
    ]
    table = pd.concat(parts, ignore_index=True).assign(time_s=lambda one: one["frame"] / 1000)
    tracks = {(sorter.OWN, "spheres"): table}
    evaluation = deviation.Evaluation(draws=1, share=0.05)
    rated = sorter.vary_rate(tracks, (1, 20), evaluation, deviation.arrival_deviations, 1)
    slow = sorter.AT_EDGE.observe(thinned(table, 20)).last["particle"]
    assert len(sorter.AT_EDGE.observe(table).last) == 120
    assert len(slow) == 120 * 12 / 20
    assert set(rated["n"] + rated["unpredicted"]) == {len(slow) - int(0.05 * len(slow))}


def test_misfits_are_root_mean_squares_over_the_belt():
    rows = [("a", 0.0, 1.0), ("a", 1.0, 2.0), ("b", 0.0, 4.0), ("b", 1.0, 6.0)]
    table = pd.DataFrame(rows, columns=["variant", "x_mm", "mean_m_s"]).assign(data_set="spheres")
    off = sorter.misfits(table, "a")
    assert off[["variant", "data_set"]].to_numpy().tolist() == [["b", "spheres"]]
    assert off["mean_m_s"][0] == pytest.approx(12.5**0.5)
    assert sorter.misfits(table, "c").empty
