"""What contacts change: settings that differ in one value, and the mechanics of contacts."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

pytest.importorskip("mujoco")

from kilnflight.belt.recordings import find_dem, read_dem
from kilnflight.checks import InputError
from kilnflight.experiments import belt_sorter
from kilnflight.sorter import friction
from kilnflight.sorter.bodies import build_model
from kilnflight.sorter.machine import BULKS, FEEDS, Contacts, Conveyor, Slide
from kilnflight.sorter.simulation import Sorter


def test_each_setting_differs_in_one_value_only():
    settings = belt_sorter.contact_settings(Sorter())
    reference = settings[belt_sorter.REFERENCE]
    assert reference.sorter.contacts == Contacts()
    assert reference.sorter.conveyor.step_s == belt_sorter.FINE_S
    assert settings[belt_sorter.USUAL].sorter == Sorter()
    changed = [setting for name, setting in settings.items() if "as used" not in name]
    for setting in changed:
        usual, present = vars(Contacts()), vars(setting.sorter.contacts)
        different = [name for name in usual if usual[name] != present[name]]
        assert len(different) + (setting.impedance != belt_sorter.IMPEDANCE) == 1
        assert setting.sorter.conveyor == reference.sorter.conveyor
    assert len(changed) == 2 * (4 + 1 + len(belt_sorter.ASSUMED))


def test_the_impedance_is_that_of_the_physics():
    model = build_model(BULKS["spheres"], Contacts(), 2, Conveyor())
    np.testing.assert_array_equal(model.pair_solimp[:, :2], belt_sorter.IMPEDANCE)


def test_as_used_is_what_the_sorter_does():
    setting = belt_sorter.Setting(Sorter())
    ours = belt_sorter.simulate_setting(setting, "spheres", 3, seed=4)
    known = Sorter()(BULKS["spheres"], 3, np.random.default_rng([4, 0]))
    pd.testing.assert_frame_equal(ours, known)
    others = belt_sorter.simulate_setting(replace(setting, others=True), "spheres", 3, seed=4)
    assert not others.equals(known)


@pytest.mark.parametrize(("step_s", "low", "high"), [(0.0002, 0.5, 0.6), (0.00005, 0.53, 0.56)])
def test_restitution_is_that_of_wood_and_scatters_less_with_shorter_steps(step_s, low, high):
    setting = belt_sorter.Setting(Sorter(conveyor=Conveyor(step_s=step_s)))
    least, most = belt_sorter.restitution(setting)
    assert low < least < most < high


def test_more_damping_means_less_restitution():
    """A linear spring and damper: exp(-pi d / sqrt(1 - d^2)) at least, for it cannot pull."""
    shares = []
    for damping in (0.25, 0.5, 0.9):
        contacts = replace(Contacts(), body_damping=damping, body_time_s=0.0024)
        conveyor = Conveyor(step_s=0.00005)
        least, most = belt_sorter.restitution(
            belt_sorter.Setting(Sorter(contacts, conveyor=conveyor))
        )
        assert np.exp(-np.pi * damping / np.sqrt(1 - damping**2)) < least <= most < 1
        assert most - least < 0.02
        shares.append(most)
    assert shares == sorted(shares, reverse=True)


def test_the_table_has_a_row_per_setting_and_material():
    table = belt_sorter.vary_contacts(Sorter(), 4, seed=1, materials=("spheres",))
    assert table["setting"].tolist() == list(belt_sorter.contact_settings(Sorter()))
    assert np.isfinite(table.drop(columns=["setting", "data_set"]).to_numpy()).all()
    away = belt_sorter.changes(table).set_index("setting")
    assert belt_sorter.REFERENCE not in away.index
    # A wall that no particle touches changes nothing at all.
    assert (away.loc["wall_friction 0.2"].drop("data_set") == 0.0).all()


def profile(variant, data_set, **columns):
    """Return a profile of two places with an authors' spread of 40 mm/s along and across."""
    known = {"median_m_s": 1.2, "iqr_m_s": 0.01, "lateral_iqr_m_s": 0.01}
    known |= {"width_m_s": 0.04, "lateral_width_m_s": 0.04}
    table = pd.DataFrame({"x_mm": [425.0, 750.0]}).assign(variant=variant, data_set=data_set)
    return table.assign(**(known | columns))


def test_what_resembles_is_within_half_of_the_spread():
    parts = [profile("authors", "spheres"), profile("authors", "cylinders")]
    parts += [profile("ours", "spheres", median_m_s=1.219, width_m_s=0.079)]
    parts += [profile("ours", "cylinders", lateral_iqr_m_s=0.031)]
    table = belt_sorter.resemblance(pd.concat(parts, ignore_index=True), "authors")
    assert table["resembles"].tolist() == [True, False]
    np.testing.assert_allclose(table["median_share"], [0.019 / 0.04, 0.0], atol=1e-12)
    np.testing.assert_allclose(table["lateral_iqr_share"], [0.0, 0.021 / 0.04], atol=1e-12)


@pytest.mark.parametrize("width", belt_sorter.WIDTHS)
@pytest.mark.parametrize(("times", "alike"), [(0.45, False), (0.55, True), (1.9, True)])
def test_what_is_far_too_narrow_does_not_resemble(width, times, alike):
    known = profile("authors", "spheres")
    ours = known.assign(variant="ours", **{width: times * known[width]})
    table = belt_sorter.resemblance(pd.concat([known, ours], ignore_index=True), "authors")
    assert table["resembles"].tolist() == [alike]
    np.testing.assert_allclose(table[width.replace("_m_s", "_ratio")], times)


def test_without_the_authors_tracks_nobody_knows_what_resembles():
    own = friction.MATERIALS["spheres"]
    tracks = {("own-simulation", "spheres"): replace(own, particles=20)(np.random.default_rng(0))}
    assert belt_sorter.resembles(tracks) == {}
    twice = tracks | {("authors-dem", "spheres"): tracks["own-simulation", "spheres"]}
    assert belt_sorter.resembles(twice) == {"spheres": True}


def test_entry_times_are_taken_back_to_the_start_of_the_belt():
    time_s = np.tile(0.02 + 0.01 * np.arange(3), 2) + np.repeat([0.0, 0.1], 3)
    x = np.tile(390.0 + 10.0 * np.arange(3), 2)
    columns = {"frame": np.rint(100 * time_s).astype(int), "particle": np.repeat([4, 7], 3)}
    tracks = pd.DataFrame(columns | {"time_s": time_s, "x": x, "y": 90.0})
    np.testing.assert_allclose(belt_sorter.entry_times(tracks), [0.018, 0.118])


def test_the_feeds_are_read_off_the_authors_tracks(authors_data):
    for material, known in FEEDS.items():
        time_s = belt_sorter.entry_times(read_dem(find_dem()[material]))
        later = time_s[1:] - time_s[0]
        found = (later[-1], later.mean(), later.std())
        np.testing.assert_allclose(found, known, rtol=0.003)


def test_a_feed_that_swells_and_ebbs_has_more_than_poisson_s_dispersion():
    table = belt_sorter.burst_table({}, Slide(), seed=1)
    assert table["data_set"].nunique() == len(BULKS)
    spheres = table[table["data_set"] == "spheres"]
    rate = (spheres["own_dispersion"] - 1.0) / spheres["own_mean"]  # its variance over mean squared
    assert (rate.between(0.1, 0.6)).all()
    assert spheres["own_dispersion"].is_monotonic_increasing


def test_what_cannot_be_compared_is_told():
    with pytest.raises(InputError, match="vary_contacts: count"):
        belt_sorter.vary_contacts(Sorter(), 1, seed=0)
    with pytest.raises(InputError, match="no material 'sand'"):
        belt_sorter.simulate_setting(belt_sorter.Setting(Sorter()), "sand", 3, seed=0)
    with pytest.raises(InputError, match="impedance"):
        belt_sorter.Setting(Sorter(), impedance=1.0)
    stiff = replace(Contacts(), belt_time_s=0.0002)
    with pytest.raises(InputError, match="too long for contacts"):
        belt_sorter.Setting(Sorter(contacts=stiff, conveyor=Conveyor(step_s=0.0002)))


def test_what_does_not_resemble_is_named_in_a_sentence(monkeypatch):
    alike = {"spheres": True, "cuboids": False, "cylinders": False}
    monkeypatch.setattr(belt_sorter, "resembles", lambda tracks: alike)
    assert belt_sorter.describe_unlike({}).startswith(" Own cuboids and cylinders do not resemble")
    assert belt_sorter.describe_unlike({}).endswith(belt_sorter.SPIN_KNOWN)
    monkeypatch.setattr(belt_sorter, "resembles", lambda tracks: {})
    assert belt_sorter.describe_unlike({}) == ""
