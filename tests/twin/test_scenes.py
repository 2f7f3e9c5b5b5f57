from dataclasses import replace

import pandas as pd
import pytest

from kilnflight.checks import InputError
from kilnflight.twin import scenes, truth
from kilnflight.twin.fitted import second_kiln
from kilnflight.twin.life import Life
from kilnflight.twin.particles import Burst


def test_scenes_have_the_published_lengths_and_rates():
    run = scenes.campaign("PE granule", 5.0)
    assert (run.frames, run.frame_rate_hz, run.gas.pressure_bar) == (3113, 153.85, 5.0)
    assert scenes.campaign("wood chip", 4.5).frames == 3102
    assert len(scenes.open_scene("V3")) == 160
    total = sum(sum(lengths) for lengths in scenes.LENGTHS.values())
    assert total == 24_892


def test_a_scenario_changes_one_thing():
    base, colder = scenes.open_scene("V1"), scenes.open_scene("V1@wall-profile")
    assert colder.scene.gas.wall_fall_k_m == 24.0
    assert replace(colder.scene, gas=base.scene.gas, name="V1") == base.scene
    assert colder.attributes.name == "V1@wall-profile"


def test_scenarios_are_joined():
    both, base = (scenes.open_scene(name).scene for name in ("V1@no-jet+small", "V1"))
    assert both.gas.jet_persistence == 0.0
    assert both.geometry.rows == base.geometry.rows // 4
    with pytest.raises(InputError, match="such as V1@no-jet"):
        scenes.open_scene("V1@small+nonsense")


@pytest.mark.parametrize("name", ["V9", "coal-4.5-bar", "V1@nonsense", ""])
def test_unknown_scenes_are_told(name):
    with pytest.raises(InputError, match="no scene"):
        scenes.open_scene(name)


def test_unknown_campaigns_are_told():
    with pytest.raises(InputError, match="no subset 'V9'"):
        scenes.ground_truth("V9")
    for wrong in (("coal", 4.5), ("confetti", 4.0)):
        with pytest.raises(InputError, match="no campaign"):
            scenes.campaign(*wrong)


@pytest.mark.parametrize("name", scenes.WINDOWS)
def test_as_many_start_and_last_in_a_tracking_window_as_published(name, campaign_twin):
    twin = campaign_twin(name)
    window = scenes.tracking_window(twin)
    trajectories, length = scenes.WINDOWS[name]
    table, rate = twin.life.table, twin.scene.frame_rate_hz
    marked = [
        window.start <= released * rate
        and min((released + lasts) * rate, window.stop) - released * rate >= 15
        for released, lasts in zip(table["release_s"], table["end_s"], strict=True)
    ]
    assert len(window) == length
    assert abs(sum(marked) - trajectories) <= 1  # no window of the paper shreds holds 32


def test_a_mixed_recording_has_no_tracking_window():
    with pytest.raises(InputError, match=r"Table 5\.15 has no 'mixed'"):
        scenes.tracking_window(scenes.open_scene("V1"))


def test_a_handful_has_as_many_particles_as_asked_for():
    for kind in scenes.HANDFULS:
        bursts = scenes.handful(kind, 101)
        assert sum(burst.count for burst in bursts) == 101
        assert sum(scenes.HANDFULS[kind][0].values()) == pytest.approx(1.0)


SCENE = "wood-chip-4.5-bar@small"


def test_a_kept_scene_is_the_same_to_the_bit(same_frame, monkeypatch):
    first = scenes.cached_scene(SCENE)
    monkeypatch.setattr("kilnflight.twin.scene.live", lambda *_: pytest.fail("worked out again"))
    kept = scenes.cached_scene(SCENE)
    assert isinstance(kept.life, Life)
    monkeypatch.undo()
    afresh = scenes.open_scene(SCENE)
    for t in (200, 205):
        same_frame(kept.frame(t), afresh.frame(t))
        same_frame(kept.frame(t), first.frame(t))
    pd.testing.assert_frame_equal(truth.marked(kept, [201]), truth.marked(first, [201]))


def test_another_scene_seed_or_code_is_another_file(monkeypatch):
    places = {
        scenes.cache_file(scenes.open_scene(name)) for name in (SCENE, "V4@small", "V3@no-jet")
    }
    places |= {scenes.cache_file(scenes.open_scene(SCENE, 1))}
    monkeypatch.setattr(scenes, "code_hash", lambda *_: "changed")
    places |= {scenes.cache_file(scenes.open_scene(SCENE))}
    assert len(places) == 5


def test_a_damaged_file_is_told():
    scenes.cached_scene(SCENE)
    for content in (b"", b"\x80\x05", bytes(24)):
        scenes.cache_file(scenes.open_scene(SCENE)).write_bytes(content)
        with pytest.raises(InputError, match=r"cannot be read .* Delete it"):
            scenes.cached_scene(SCENE)


@pytest.mark.parametrize(
    ("name", "seed", "message"),
    [("V9", 0, "no scene 'V9'"), ("V3@nothing", 0, "no scene"), ("V5", -1, "V5: seed is -1")],
)
def test_a_scene_that_is_not_there_is_told_as_ever(name, seed, message):
    for call in (scenes.open_scene, scenes.cached_scene):
        with pytest.raises(InputError, match=message):
            call(name, seed)


def test_dumped_handfuls_load_the_air():
    thrown, dumped = (
        scenes.open_scene(name).scene for name in ("wood-chip-4.5-bar", "wood-chip-4.5-bar@dumped")
    )
    assert dumped.gas.load > 0.1
    assert dumped.gas.jet_velocity_m_s < thrown.gas.jet_velocity_m_s
    assert sum(burst.count for burst in dumped.feed) == sum(burst.count for burst in thrown.feed)


def test_scenes_have_the_fitted_inputs_and_their_own_pressure():
    scene, kiln = scenes.open_scene("confetti-5.0-bar").scene, second_kiln()
    assert (scene.flight, scene.geometry) == (kiln.flight, kiln.geometry)
    assert scene.gas == replace(kiln.gas, pressure_bar=5.0)
    assert scene.optics.wall_level == 20_700.0


def test_subsets_have_the_chemical_time_of_table_5_2():
    flight = scenes.open_scene("V4").scene.flight
    volatiles = replace(second_kiln().flight.volatiles, chemical_time_s=1e-4)
    assert flight == replace(second_kiln().flight, volatiles=volatiles)


def test_a_wide_lance_has_six_times_the_momentum_and_a_wider_tube():
    plain, wide = (scenes.open_scene(f"V1{more}").scene for more in ("", "@wide-lance"))
    momentum = [s.gas.air_kg_s * s.gas.jet_velocity_m_s for s in (plain, wide)]
    assert momentum[1] == pytest.approx(6.25 * momentum[0])
    bodies = [s.surroundings.burner for s in (plain, wide)]
    assert 2 * bodies[1].lance_bore_mm == pytest.approx(1000 * wide.gas.lance_diameter_m)
    steel = [body.lance_mm - body.lance_bore_mm for body in bodies]
    assert steel[1] == pytest.approx(steel[0])


def test_a_scene_without_a_particle_in_view_says_so():
    late = replace(scenes.ground_truth("V3"), feed=(Burst("PE granule", 3, 10.0),))
    with pytest.raises(InputError, match="none of its 3 particles is in the picture in 160 frames"):
        _ = scenes.Twin(scenes.downscaled(late)).life
