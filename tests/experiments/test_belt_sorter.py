"""What contacts change: settings that differ in one value, and the mechanics of contacts."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

pytest.importorskip("mujoco")

from kilnflight.belt.bodies import build_model
from kilnflight.belt.machine import BULKS, Contacts, Conveyor
from kilnflight.belt.sorter import Sorter
from kilnflight.checks import InputError
from kilnflight.experiments import belt_sorter


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
