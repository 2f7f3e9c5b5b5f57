from dataclasses import replace

import pandas as pd
import pytest

from kilnflight import sorter
from kilnflight.belt import PredictionPhase, deviation


@pytest.fixture
def small(monkeypatch):
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


def test_published_particles_are_left_out_with_the_known_reasons(authors_data):
    from kilnflight.belt.dem import find_dem

    tracks = sorter.load_tracks(find_dem(), seed=1)
    observed = {key: PredictionPhase().observe(one) for key, one in tracks.items()}
    counts = sorter.count_particles(tracks, observed).set_index(["source", "data_set"])
    never = counts.loc[sorter.AUTHORS, "never on the belt"]
    missed = counts.loc[sorter.AUTHORS, "target never reached"]
    assert never.to_dict() == {"spheres": 0, "cuboids": 150, "cylinders": 15}
    assert missed.to_dict() == {"spheres": 0, "cuboids": 2, "cylinders": 1}
