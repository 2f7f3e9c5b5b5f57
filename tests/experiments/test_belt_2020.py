"""The 2020 paper from tracks to answers, on small worlds."""

import sys
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from kilnflight.belt import PredictionPhase
from kilnflight.belt.evaluation import SUMMARY, Evaluation, arrival_deviations
from kilnflight.belt.tracker import Followed
from kilnflight.belt.velocity import BeltVelocity
from kilnflight.experiments import belt_2020, belt_claims, belt_real, belt_sorter
from kilnflight.experiments.belt_2020 import over_draws
from kilnflight.experiments.belt_claims import arrival_answers, lateral_answers, speed_answers
from kilnflight.project import claims
from kilnflight.sorter.rendering import at_rate


@pytest.fixture
def small(monkeypatch):
    """The friction model, as without MuJoCo."""
    monkeypatch.setitem(sys.modules, "mujoco", None)
    few = {name: replace(belt, particles=200) for name, belt in belt_2020.MATERIALS.items()}
    monkeypatch.setattr(belt_2020, "MATERIALS", few)
    return belt_2020.tracks_by_source({}, seed=1)


def test_without_files_there_is_our_simulation_only(small):
    assert list(small) == [(belt_2020.OWN, name) for name in belt_2020.DATA_SETS]
    again = belt_2020.tracks_by_source({}, seed=1)
    for key, tracks in small.items():
        pd.testing.assert_frame_equal(tracks, again[key])


def test_every_particle_is_evaluated_or_has_a_reason(small):
    observed = {key: PredictionPhase().observe(bodies) for key, bodies in small.items()}
    counts = belt_2020.count_particles(small, observed)
    assert (counts["particles"] == counts.iloc[:, 3:].sum(axis=1)).all()


def test_comparison_has_a_row_per_data_set_draw_and_model(small):
    phase = PredictionPhase()
    observed = {key: phase.observe(bodies) for key, bodies in small.items()}
    evaluation = Evaluation(draws=2, share=0.05)
    table = belt_2020.compare_models(observed, phase, evaluation, arrival_deviations, 1)
    assert len(table) == 3 * 2 * 6
    assert table.columns[:4].tolist() == ["source", "data_set", "draw", "model"]


def test_a_study_compares_its_models_to_the_target(small):
    observed = {key: belt_2020.PHASE.observe(bodies) for key, bodies in small.items()}
    table = belt_2020.ARRIVAL.compare(observed, 2, 1)
    by_draw = belt_2020.compare_models(
        observed, belt_2020.PHASE, Evaluation(draws=2), arrival_deviations, 1
    )
    expected = by_draw.groupby(["data_set", "model"], sort=False)["mae"].median()
    assert table["mae"].to_numpy() == pytest.approx(expected.to_numpy(), abs=1e-6)


def test_the_same_few_particles_are_drawn_from_each_data_set(small):
    steps = belt_2020.sample_steps(small, belt_2020.OWN, 3, seed=0)
    assert steps["data_set"].unique().tolist() == list(belt_2020.DATA_SETS)
    assert (steps.groupby("data_set")["particle"].nunique() == 3).all()
    assert steps.equals(belt_2020.sample_steps(small, belt_2020.OWN, 3, seed=0))
    every = belt_2020.step_velocities(small[belt_2020.OWN, "spheres"])
    part = steps[steps["data_set"] == "spheres"]
    chosen = every[every["particle"].isin(part["particle"])]
    assert part["velocity_x_mm_s"].tolist() == chosen["velocity_x_mm_s"].tolist()


def on_a_belt(across):
    """Return places and tracks of 60 particles at 80 px per frame; number 59 has a gap.

    ``across`` has the velocities across the belt, one after the other.
    """
    frame, particles = np.arange(28), 60
    speed = np.repeat(np.resize(across, particles), len(frame))
    number, step = np.repeat(np.arange(particles), len(frame)), np.tile(frame, particles)
    places = {"frame": step + 40 * number, "x": 5.0 + 80.0 * step}
    table = pd.DataFrame(places | {"y": 500.0 + speed * step + 10 * number, "particle": number})
    known = {"velocity_x_mm_s": 80.0, "velocity_y_mm_s": speed, "valid": 1, "score": 1.0}
    known |= {"acceleration_x_mm_s2": 0.0, "acceleration_y_mm_s2": 0.0}
    states = table.assign(row=np.arange(len(table)), **known).drop(index=59 * len(frame) + 17)
    return {"spheres": table}, {("spheres", "CV filter"): Followed(states, pd.DataFrame())}


def test_on_recordings_constant_velocity_is_exact_and_short_tracks_are_left_out():
    measured, followed = on_a_belt([1.0])
    phase, evaluation = PredictionPhase(1150.0, 1550.0), Evaluation(share=0.1, draws=2)
    models, omitted = belt_real.compare_on_recordings(followed, measured, phase, evaluation, 1)
    assert omitted.iloc[0][["data_set", "filter", "predicted"]].tolist() == [
        "spheres", "CV filter", 59
    ]  # fmt: skip
    assert (models["left_out"] == 1).all()
    assert not models["model"].isin(["CALV", "LV-DSC"]).any()
    exact = models.set_index(["quantity", "model"])["mae"]
    assert exact["arrival_frames", "CV"] == pytest.approx(0.0, abs=1e-9)
    assert exact["lateral_px", "Straight"] == pytest.approx((1550 - 1125) / 80)
    empty, _ = belt_real.compare_on_recordings({}, {}, phase, evaluation, 1)
    assert empty.columns.tolist() == models.columns.tolist()


@pytest.mark.parametrize(
    ("across", "verdict"),
    [
        ([1.0, -1.0, 2.0], claims.REPRODUCED),
        ([1.0], claims.NOT_DECIDABLE),  # one bias for all is no spread
    ],
)
def test_straight_is_judged_by_both_measures_on_recordings(across, verdict):
    measured, followed = on_a_belt(across)
    phase, evaluation = PredictionPhase(1150.0, 1550.0), Evaluation(share=0.1, draws=2)
    models, _ = belt_real.compare_on_recordings(followed, measured, phase, evaluation, 1)
    judged = belt_real.judge_straight(models, followed, measured, phase, "quick", 1)
    assert (judged.id, judged.verdict) == ("belt20-22", verdict)
    assert judged.measured.startswith("spheres: CV-CV")


def test_other_targets_keep_the_length_of_the_phase(small):
    evaluation = Evaluation(draws=1, share=0.05)
    table = belt_2020.vary_target(small, [763.0, 773.0], evaluation, arrival_deviations, 1)
    assert table["target_mm"].unique().tolist() == [763.0, 773.0]
    assert len(table) == 2 * 3 * 6
    phase = PredictionPhase()
    observed = {key: phase.observe(bodies) for key, bodies in small.items()}
    same = belt_2020.compare_models(observed, phase, evaluation, arrival_deviations, 1)
    at_773 = table.loc[table["target_mm"] == 773.0, "mae"].to_numpy()
    assert at_773 == pytest.approx(same["mae"].to_numpy())


def test_published_particles_are_left_out_with_the_known_reasons(authors_data, monkeypatch):
    from kilnflight.belt.recordings import find_dem

    monkeypatch.setitem(sys.modules, "mujoco", None)
    tracks = belt_2020.tracks_by_source(find_dem(), seed=1)
    observed = {key: PredictionPhase().observe(bodies) for key, bodies in tracks.items()}
    counts = belt_2020.count_particles(tracks, observed).set_index(["source", "data_set"])
    never = counts.loc[belt_2020.AUTHORS, "never on the belt"]
    missed = counts.loc[belt_2020.AUTHORS, "target never reached"]
    assert never.to_dict() == {"spheres": 0, "cuboids": 150, "cylinders": 15}
    assert missed.to_dict() == {"spheres": 0, "cuboids": 2, "cylinders": 1}


def test_with_mujoco_our_simulation_has_contacts_and_1000_hz():
    pytest.importorskip("mujoco")
    tracks = belt_2020.tracks_by_source({}, seed=1, count=4)
    assert [bodies["particle"].nunique() for bodies in tracks.values()] == [4, 4, 4]
    step = tracks[belt_2020.OWN, "spheres"].groupby("particle")["time_s"].diff().dropna()
    assert step.to_numpy() == pytest.approx(0.001)
    assert "MuJoCo" in belt_2020.describe_own()


def test_without_mujoco_it_says_so_and_has_one_variant(small):
    assert "friction model" in belt_2020.describe_own()
    assert {key[0] for key in belt_sorter.variants(5, 1)} == {"friction model"}


def test_variants_are_at_100_hz_and_before_the_fit_there_are_spheres_only():
    pytest.importorskip("mujoco")
    tracks = belt_sorter.variants(2, 1)
    assert ("inputs only", "spheres") in tracks
    assert ("inputs only", "cuboids") not in tracks
    for bodies in tracks.values():
        assert bodies.groupby("particle")["time_s"].diff().dropna().to_numpy() == pytest.approx(
            0.01
        )


def test_thinning_changes_the_rate_and_nothing_else(small):
    evaluation = Evaluation(draws=1, share=0.05)
    table = belt_2020.vary_rate(small, (1, 2), evaluation, arrival_deviations, 1)
    assert table["sampling_hz"].unique().tolist() == [100.0, 50.0]
    observed = {key: belt_2020.AT_EDGE.observe(bodies) for key, bodies in small.items()}
    same = belt_2020.compare_models(observed, belt_2020.AT_EDGE, evaluation, arrival_deviations, 1)
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
    table = pd.concat(parts, ignore_index=True).assign(time_s=lambda rows: rows["frame"] / 1000)
    tracks = {(belt_2020.OWN, "spheres"): table}
    evaluation = Evaluation(draws=1, share=0.05)
    by_rate = belt_2020.vary_rate(tracks, (1, 20), evaluation, arrival_deviations, 1)
    slow = belt_2020.AT_EDGE.observe(at_rate(table, 50.0)).last["particle"]
    assert len(belt_2020.AT_EDGE.observe(table).last) == 120
    assert len(slow) == 120 * 12 / 20
    assert set(by_rate["n"] + by_rate["unpredicted"]) == {len(slow) - int(0.05 * len(slow))}


def test_misfits_are_root_mean_squares_over_the_belt():
    rows = [("a", 0.0, 1.0), ("a", 1.0, 2.0), ("b", 0.0, 4.0), ("b", 1.0, 6.0)]
    table = pd.DataFrame(rows, columns=["variant", "x_mm", "mean_m_s"]).assign(data_set="spheres")
    off = belt_sorter.velocity_misfits(table, "a")
    assert off[["variant", "data_set"]].to_numpy().tolist() == [["b", "spheres"]]
    assert off["mean_m_s"][0] == pytest.approx(12.5**0.5)
    assert belt_sorter.velocity_misfits(table, "c").empty


def test_draws_are_summed_up_per_model_and_data_set():
    draws = pd.DataFrame(
        [
            {"data_set": name, "draw": draw, "model": "A", **dict.fromkeys(SUMMARY, value)}
            for name, values in (("s", [1.0, 2.0, 9.0]), ("c", [5.0, 5.0, 5.0]))
            for draw, value in enumerate(values)
        ]
    )
    table = over_draws(draws)
    assert table[["data_set", "mae"]].to_numpy().tolist() == [["s", 2.0], ["c", 5.0]]
    assert table["iqr_low"].tolist() == pytest.approx([np.quantile([1, 2, 9], 0.025), 5.0])
    assert table["mae_high"].tolist() == pytest.approx([np.quantile([1, 2, 9], 0.975), 5.0])


SETS = ("spheres", "cuboids", "cylinders")


def table(values, columns=("median", "iqr", "mae")):
    rows = [
        {"data_set": name, "model": model} | dict.fromkeys(columns, value)
        for name in SETS
        for model, value in values.items()
    ]
    return pd.DataFrame(rows)


def verdicts(answers):
    return {claim: belt_claims.judge(claim, answer).verdict for claim, answer in answers.items()}


def test_a_world_as_published_reproduces_every_claim_about_the_arrival():
    published = table({"IV": 3.0, "CV": 4.0, "CVBC": 1.0, "CA": 1.5, "CALV": 1.4, "IA": 0.5})
    published.loc[
        (published["data_set"] == "cuboids") & (published["model"] == "CA"), ["iqr", "mae"]
    ] = 0.9
    published.loc[
        (published["data_set"] == "cuboids") & (published["model"] == "CALV"), ["iqr", "mae"]
    ] = 0.85
    published.loc[published["model"] != "CV", "median"] = 0.1  # only CV has a large bias
    assert set(verdicts(arrival_answers(published)).values()) == {claims.REPRODUCED}


def test_the_opposite_reproduces_none():
    published = table({"IV": 1.0, "CV": 1.0, "CVBC": 2.0, "CA": 1.9, "CALV": 0.9, "IA": 5.0})
    assert set(verdicts(arrival_answers(published)).values()) == {claims.NOT_REPRODUCED}


@pytest.mark.parametrize(("last", "holds"), [(1.4, True), (1.05, False), (1.51, False)])
def test_speed_must_rise_and_stay_below_the_belt(last, holds):
    means = [1.0, 1.1, last]
    published = pd.DataFrame({"data_set": "spheres", "x_mm": [1.0, 2.0, 3.0], "mean_m_s": means})
    answer = speed_answers(published)["belt20-6"]
    assert list(answer.values()) == [holds]


def test_a_world_as_published_reproduces_every_claim_about_the_position():
    models = {"Straight": 3.0, "CV-CV": 1.0, "CA-CA": 0.9, "LV-DSC": 0.92, "IA-CV": 1.0}
    published = table(models | {"IA-CA": 0.95, "IA-Ratio": 0.5})
    published.loc[
        (published["data_set"] == "cylinders") & (published["model"] == "IA-Ratio"), ["iqr", "mae"]
    ] = 2.0
    published.loc[  # CA is better than CV in two of the three data sets, as printed
        (published["data_set"] == "cylinders") & published["model"].isin(["CA-CA", "IA-CA"]),
        ["iqr", "mae"],
    ] = 1.1
    published.loc[
        (published["data_set"] == "cylinders") & (published["model"] == "LV-DSC"), ["iqr", "mae"]
    ] = 1.2
    assert set(verdicts(lateral_answers(published)).values()) == {claims.REPRODUCED}
    published[["iqr", "mae"]] = 6.0 - published[["iqr", "mae"]]
    opposite = verdicts(lateral_answers(published))
    assert opposite["belt20-7"] == opposite["belt20-8"] == claims.NOT_REPRODUCED


def test_what_the_rate_changes_is_described_and_by_source_our_rates_stay_apart():
    """At 1000 Hz the spheres' IV is no longer the widest; nothing else differs."""
    models = {"IV": 3.0, "CV": 4.0, "CVBC": 1.0, "CA": 1.5, "CALV": 1.4, "IA": 0.5}
    slow = table(models).assign(sampling_hz=100.0, source=belt_2020.OWN)
    fast = slow.assign(sampling_hz=1000.0)
    spheres = (fast["data_set"] == "spheres") & (fast["model"] == "IV")
    fast.loc[spheres, "iqr"] = 1.2
    by_rate = pd.concat([slow, fast], ignore_index=True)
    text = belt_2020.describe_changes(by_rate, arrival_answers)
    assert text.startswith("From 100 to 1000 Hz belt20-1 changes its verdict")
    assert text.endswith("Single data sets change: belt20-1 for spheres")
    assert "One rate only" in belt_2020.describe_changes(slow, arrival_answers)
    lowest = belt_2020.describe_lowest(by_rate)
    assert lowest.startswith("At 1000 Hz the lowest mean absolute error has: spheres IA, cuboids")
    others = table(models).assign(source=belt_2020.AUTHORS)
    own = others.assign(source=belt_2020.OWN)
    motion = {(belt_2020.OWN, 1000.0): {"belt20-13": pd.Series({"spheres": 115.0})}}
    every = pd.concat([others, own])
    by_source = belt_2020.verdicts_by_source(every, by_rate, arrival_answers, motion)
    assert by_source.groupby(["source", "sampling_hz"]).size().to_dict() == {
        (belt_2020.AUTHORS, 100.0): 7,
        (belt_2020.OWN, 100.0): 7,
        (belt_2020.OWN, 1000.0): 8,
    }


def test_without_a_simulation_of_contacts_shapes_decide_nothing(small):
    """The friction model assumes how each shape moves: claims that depend on it stay open."""
    study = belt_2020.LATERAL
    evaluation = Evaluation(draws=1, share=0.05)
    by_target, by_rate = study.vary(small, evaluation, 1)
    assert by_target["target_mm"].unique().tolist() == [733.0, 743.0, 753.0, 763.0, 773.0, 788.0]
    assert by_rate["sampling_hz"].unique().tolist() == [100.0]
    decisive = by_target[by_target["target_mm"] == 773.0]
    verdicts = {
        verdict.id: verdict for verdict in study.judge(study.answers(decisive), by_target, 100.0)
    }
    judged = [*range(7, 11), 15, *range(17, 20)]  # 16 needs the models of the arrival
    assert sorted(verdicts, key=lambda id: int(id[7:])) == [f"belt20-{k}" for k in judged]
    for name in study.shapes:
        assert verdicts[name].verdict == claims.NOT_DECIDABLE
    assert "decided by our own simulation at 100 Hz" in verdicts["belt20-7"].reason


def test_tables_and_captions_carry_the_unit_of_the_study():
    for study, unit in ((belt_2020.ARRIVAL, "ms"), (belt_2020.LATERAL, "mm")):
        draws = table({"A": 1.0}, SUMMARY).assign(source="s", draw=0)
        columns = study.table(over_draws(draws)).columns.tolist()
        values = [f"{name}_{unit}" for name in ("median", "q25", "q75", "mae")]
        assert columns == ["source", "data_set", "model", "n", *values]
        deciding = pd.DataFrame(columns=["lower", "excess", "excess_low", "iqr", "mae_high"])
        units = [f"{name}_{unit}" for name in deciding.columns[1:]]
        assert study.labelled(deciding).columns.tolist() == ["lower", *units]
        assert all(study.quantity in caption for caption in study.captions.values())


def test_the_velocity_stands_beside_that_of_the_authors_links():
    """Two tracks: 60, 60 and 62 px; a missing frame in between is no step."""
    places = pd.DataFrame(
        {
            "frame": [0, 1, 2, 0, 1, 3],
            "x": [0.0, 60.0, 120.0, 5.0, 67.0, 200.0],
            "y": 0.0,
            "author_track": [0, 0, 0, 1, 1, 1],
        }
    )
    known, key = BeltVelocity(61.0, 1.0, 3, 75.0), ("spheres", "013")
    table = belt_real.tabulate_velocities({key: places}, {key: known})
    assert table.iloc[0].to_dict() == {
        "material": "spheres", "recording": "013", **known._asdict(), "linked_px_per_frame": 60.0
    }  # fmt: skip
    untracked = belt_real.tabulate_velocities({key: places.assign(author_track=-1)}, {key: known})
    assert untracked["linked_px_per_frame"].isna().all()


def test_sentences_on_real_recordings_take_each_model_with_its_filter():
    models = {"IV": 3.0, "CV": 4.0, "CVBC": 1.0, "CA": 0.1, "IA": 0.5}
    places = {"Straight": 3.0, "CV-CV": 1.0, "CA-CA": 9.0, "IA-Ratio": 0.5}
    parts = []
    for kind, factor in (("CV filter", 1.0), ("CA filter", 2.0)):
        for quantity, values in (("arrival_frames", models), ("lateral_px", places)):
            part = table({name: factor * value for name, value in values.items()})
            parts.append(part.assign(filter=kind, quantity=quantity))
    recorded = pd.concat(parts)
    sentences = belt_real.hold_on_recordings(recorded)
    assert sentences.columns.tolist() == list(SETS)
    assert len(sentences) == 7
    yes = {name.split()[0] for name in sentences.index[(sentences == "yes").all(axis=1)]}
    # CA with its own filter is the best of all along the belt, and the worst across it.
    assert yes == {"belt20-1", "belt20-2", "belt20-10", "belt20-22"}
    recorded.loc[recorded["model"] == "Straight", "iqr"] = 0.9  # by one measure only
    recorded.loc[recorded["model"] == "CV", "iqr"] = 0.1  # a spread sees no bias
    sentences = belt_real.hold_on_recordings(recorded)
    assert (sentences.loc["belt20-22 CV is better than Straight"] == "open").all()
    assert (sentences.loc["belt20-2 CV is worst"] == "yes").all()


def test_the_friction_model_stands_in_for_the_authors_tracks():
    tracks = belt_2020.load_tracks({}, seed=1, particles=6)
    assert list(tracks) == ["spheres", "cuboids", "cylinders"]
    again = belt_2020.load_tracks({}, seed=1, particles=3)
    for name, table in tracks.items():
        assert table["particle"].nunique() == 6
        first = again[name]["particle"].unique()
        kept = table[table["particle"].isin(first)].reset_index(drop=True)
        pd.testing.assert_frame_equal(again[name], kept)


def test_resampled_tracks_keep_a_cubic_and_every_observation():
    time = np.arange(5, 25) / 100
    path = pd.DataFrame({"frame": np.arange(5, 25), "particle": 7, "time_s": time})
    path = path.assign(x=900 * time + 300 * time**2 - 80 * time**3, y=20 * time)
    fast = belt_2020.resample(path, 1000.0)
    assert len(fast) == 191
    t = fast["time_s"].to_numpy()
    np.testing.assert_allclose(fast["x"], 900 * t + 300 * t**2 - 80 * t**3, atol=1e-9)
    pd.testing.assert_frame_equal(belt_2020.resample(fast, 100.0), path, check_dtype=False)
