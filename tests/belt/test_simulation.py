import sys

import numpy as np
import pandas as pd
import pytest

from kilnflight.belt import simulation
from kilnflight.belt.bulk import BULKS, Bulk
from kilnflight.belt.conveyor import Conveyor
from kilnflight.belt.machine import Sorter
from kilnflight.belt.physics import Contacts, is_installed
from kilnflight.belt.slide import Slide
from kilnflight.checks import InputError
from kilnflight.tables import BELT_BODIES, BELT_TRACKS

pytest.importorskip("mujoco")


def test_the_same_seed_gives_the_same_bytes_in_one_process_or_two(monkeypatch, tmp_path):
    monkeypatch.setattr(simulation, "BATCH", 12)
    made = []
    for jobs in (1, 2):
        monkeypatch.setenv("KILNFLIGHT_DERIVED", str(tmp_path / str(jobs)))
        made.append(simulation.tracks("spheres", 24, seed=3, jobs=jobs))
    pd.testing.assert_frame_equal(made[0], made[1], check_exact=True)
    assert len(list(tmp_path.rglob("belt-*.parquet"))) == 4
    assert not made[0]["x"].equals(simulation.tracks("spheres", 24, seed=4)["x"])


def test_kept_batches_are_not_made_again(monkeypatch):
    first = simulation.tracks("cuboids", 8)
    monkeypatch.setattr(Sorter, "__call__", None)
    pd.testing.assert_frame_equal(first, simulation.tracks("cuboids", 8))


@pytest.mark.parametrize("material", BULKS)
def test_nothing_is_lost_and_nothing_leaves_sideways(material):
    tracks = Sorter()(BULKS[material], 30, np.random.default_rng(5))
    BELT_BODIES.check(tracks)
    BELT_TRACKS.check(tracks)
    assert tracks["particle"].nunique() == 30
    assert (tracks.groupby("particle")["frame"].diff().dropna() == 1).all()
    assert (tracks.groupby("particle")["x"].max() > 788.0).all()
    assert tracks["y"].between(0.9, 179.1).all()
    assert tracks["z"].min() > 0.95 * min(BULKS[material].half_mm)


def test_batches_follow_each_other_and_none_is_empty(monkeypatch):
    monkeypatch.setattr(simulation, "BATCH", 5)
    tracks = simulation.tracks("spheres", 12)
    assert simulation.batches(12) == [5, 5, 2]
    assert tracks["particle"].unique().tolist() == list(range(12))
    spans = tracks.groupby(tracks["particle"] // 5)["frame"].agg(["min", "max"])
    assert (spans["min"].to_numpy()[1:] > spans["max"].to_numpy()[:-1]).all()


def test_no_particle_is_an_empty_table():
    tracks = simulation.tracks("spheres", 0)
    assert tracks.empty
    assert tracks.columns.tolist() == BELT_BODIES.names


def test_unknown_material_and_a_negative_count_are_told():
    with pytest.raises(InputError, match="there are spheres, cuboids, cylinders"):
        simulation.tracks("peppercorns")
    with pytest.raises(InputError, match="count"):
        simulation.tracks("spheres", -1)


def test_without_mujoco_nothing_is_simulated(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    assert not is_installed()
    with pytest.raises(InputError, match="MuJoCo, which is not installed"):
        simulation.tracks("spheres", 5)


@pytest.mark.parametrize(
    ("kind", "wrong"),
    [
        (Contacts, {"belt_friction": 0.0}),
        (Contacts, {"rolling_friction": -0.1}),
        (Slide, {"drop_mm": -1.0}),
        (Slide, {"speed_spread": float("nan")}),
        (Slide, {"exit_deg": 90.0}),
        (Slide, {"rolling_share": 1.5}),
        (Conveyor, {"start_mm": 900.0}),
        (Conveyor, {"step_s": 0.0003}),
        (Conveyor, {"sampling_hz": 0.0}),
    ],
)
def test_what_is_no_sorter_is_told(kind, wrong):
    with pytest.raises(InputError, match=kind.__name__):
        kind(**wrong)


def test_a_step_too_long_for_the_contacts_is_told():
    with pytest.raises(InputError, match=r"step_s .* is too long"):
        Sorter(conveyor=Conveyor(step_s=0.0005))


def test_a_body_needs_the_lengths_of_its_shape():
    with pytest.raises(InputError, match="a sphere has one"):
        Bulk("sphere", (1.0, 2.0), 10)
    with pytest.raises(InputError, match="Bulk: half_mm"):
        Bulk("sphere", (-1.0,), 10)
