from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from kilnflight.checks import InputError
from kilnflight.twin import scenes, truth
from kilnflight.twin.camera import Geometry
from kilnflight.twin.fitted import (
    SecondInputs,
    SecondLightInputs,
    flight_inputs,
    light_inputs,
    second_kiln,
    second_kiln_with,
    second_light,
)
from kilnflight.twin.flight import Flight
from kilnflight.twin.gas import Gas
from kilnflight.twin.life import Life
from kilnflight.twin.particles import Burst
from kilnflight.twin.poses import read_poses


def test_scenes_have_the_published_lengths_and_rates():
    run = scenes.campaign("PE granule", 5.0)
    assert (run.frames, run.frame_rate_hz, run.gas.pressure_bar) == (3113, 153.85, 5.0)
    assert scenes.campaign("wood chip", 4.5).frames == 3102
    assert len(scenes.open_scene("V3")) == 160
    total = sum(sum(lengths) for lengths in scenes.LENGTHS.values())
    assert total == 24_892


def test_a_scenario_changes_one_thing():
    base, double = scenes.open_scene("V1"), scenes.open_scene("V1@depth-error-double")
    assert double.scene.depth.scale == 2.0
    assert replace(double.scene, depth=base.scene.depth, name="V1") == base.scene
    assert double.attributes.name == "V1@depth-error-double"


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


def test_scenes_take_the_frozen_inputs_and_inputs_only_takes_none():
    scene = scenes.open_scene("confetti-4.5-bar").scene
    assert (scene.flight, scene.gas, scene.geometry) == second_kiln()
    untouched = scenes.open_scene("confetti-5.0-bar@inputs-only").scene
    before = second_kiln_with(SecondInputs(), read_poses().mode)
    assert (untouched.flight, untouched.geometry) == (before.flight, before.geometry)
    assert untouched.gas == replace(before.gas, pressure_bar=5.0)
    assert SecondLightInputs().applied(untouched) == untouched


def test_scenes_of_the_first_twin_take_its_own_inputs():
    scene = scenes.open_scene("confetti-4.5-bar@first").scene
    assert (scene.flight, scene.gas) == flight_inputs().applied(Flight(), Gas())
    assert scene.geometry == Geometry()
    untouched = scenes.open_scene("V2@first+inputs-only").scene
    assert (untouched.flight, untouched.gas) == (Flight(), Gas())
    assert scenes.open_scene("wood-chip-5.0-bar@inputs-only+first").scene.gas == Gas(
        pressure_bar=5.0
    )
    assert scenes.open_scene("V2").scene.optics.light is not None
    assert scenes.open_scene("V2@first").scene.optics.light is None


def test_scenes_have_the_fitted_light():
    first, scene = scenes.ground_truth("V2", first=True), scenes.ground_truth("V2")
    assert light_inputs().applied(first) == first
    assert second_light().applied(scene) == scene


def test_the_second_look_sees_less_of_the_bottom():
    first, scene = (scenes.open_scene(name).scene.surroundings for name in ("V1@first", "V1"))
    assert max(row for row, _ in scene.roi) == scenes.ROI_BOTTOM < max(row for row, _ in first.roi)


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
        scenes.cache_file(scenes.open_scene(name)) for name in (SCENE, "V4@small", "V3@axis-0")
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


def test_scenarios_are_joined_in_their_order():
    name = "V1@first+choked-lance+recirculation"
    both, base = (scenes.open_scene(each).scene for each in (name, "V1@first"))
    assert both.gas == replace(base.gas, choked=True, lance_stream_m_s=-0.6)
    assert both.name == name
    with pytest.raises(InputError, match="such as V1@no-jet"):
        scenes.open_scene("V1@small+nonsense")


def test_flames_hold_or_blow_off_in_both_twins():
    def flight(scenarios):
        return scenes.open_scene(f"confetti-4.5-bar@{scenarios}").scene.flight

    base = flight("base")
    assert flight("flames-blow-off").volatiles.chemical_time_s == pytest.approx(
        2 * base.volatiles.chemical_time_s
    )
    assert 0 < flight("flames-hold").volatiles.chemical_time_s < 1e-8
    first = flight("first").extinction_1_s
    assert flight("first+flames-blow-off").extinction_1_s == pytest.approx(first / 2)
    assert flight("first+flames-hold").extinction_1_s == np.inf


def test_dumped_handfuls_load_the_air():
    thrown, dumped = (
        scenes.open_scene(name).scene for name in ("wood-chip-4.5-bar", "wood-chip-4.5-bar@dumped")
    )
    assert dumped.gas.load > 0.1
    assert dumped.gas.jet_velocity_m_s < thrown.gas.jet_velocity_m_s
    assert sum(burst.count for burst in dumped.feed) == sum(burst.count for burst in thrown.feed)


def test_the_second_flight_changes_flight_gas_and_pose_alone_and_keeps_the_pressure():
    base = scenes.open_scene("confetti-5.0-bar@first").scene
    second = scenes.open_scene("confetti-5.0-bar@first+second-flight").scene
    kiln = second_kiln()
    assert (second.flight, second.geometry) == (kiln.flight, kiln.geometry)
    assert second.gas == replace(kiln.gas, pressure_bar=5.0)
    kept = {name: getattr(base, name) for name in ("flight", "gas", "geometry", "name")}
    assert replace(second, **kept) == base


def test_subsets_of_the_second_flight_have_the_chemical_time_of_table_5_2():
    flight = scenes.open_scene("V4").scene.flight
    volatiles = replace(second_kiln().flight.volatiles, chemical_time_s=1e-4)
    assert flight == replace(second_kiln().flight, volatiles=volatiles)


def test_scaled_down_before_or_after_the_second_flight_is_the_same():
    one, other = (
        scenes.open_scene(f"V4@first+{joined}").scene
        for joined in ("second-flight+small", "small+second-flight")
    )
    assert replace(one, name="V4") == replace(other, name="V4")


def test_run_effects_differ_between_recordings_and_repeat():
    names = ("wood-chip-4.5-bar", "wood-chip-5.0-bar")
    plain, varied, again = (
        [scenes.open_scene(name + more).scene for name in names]
        for more in ("", "@run-effects", "@run-effects")
    )
    assert varied == again
    drawn = [
        (
            after.gas.temperature_k - before.gas.temperature_k,
            after.flight.launch_elevation_deg - before.flight.launch_elevation_deg,
            sum(burst.count for burst in after.feed) / sum(burst.count for burst in before.feed),
        )
        for before, after in zip(plain, varied, strict=True)
    ]
    assert drawn[0] != drawn[1]
    for warmer, steeper, more in drawn:
        assert -100.0 <= warmer <= 100.0
        assert 0.0 < abs(steeper) < 4.0
        assert 0.3 < more < 3.0


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
