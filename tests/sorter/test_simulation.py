"""The simulated sorter, its tracks on disk and its fitted values."""

import json
import sys

import numpy as np
import pandas as pd
import pytest

from kilnflight.checks import InputError
from kilnflight.project import cache
from kilnflight.sorter import simulation
from kilnflight.sorter.bodies import is_installed
from kilnflight.sorter.machine import BULKS, FEEDS, Conveyor
from kilnflight.sorter.simulation import FittedValues, Sorter, fitted_values
from kilnflight.tables import BELT_BODIES, BELT_TRACKS

pytest.importorskip("mujoco")


def test_the_same_seed_gives_the_same_bytes_in_one_process_or_two(monkeypatch, tmp_path):
    monkeypatch.setattr(simulation, "BATCH", 12)
    runs = []
    for jobs in (1, 2):
        monkeypatch.setenv("KILNFLIGHT_DERIVED", str(tmp_path / str(jobs)))
        runs.append(simulation.simulate_tracks("spheres", 24, seed=3, jobs=jobs))
    pd.testing.assert_frame_equal(runs[0], runs[1], check_exact=True)
    assert len(list(tmp_path.rglob("belt-*.parquet"))) == 4
    assert not runs[0]["x"].equals(simulation.simulate_tracks("spheres", 24, seed=4)["x"])


def test_kept_batches_are_not_made_again(monkeypatch):
    first = simulation.simulate_tracks("cuboids", 8)
    monkeypatch.setattr(Sorter, "__call__", None)
    pd.testing.assert_frame_equal(first, simulation.simulate_tracks("cuboids", 8))


@pytest.mark.parametrize("material", BULKS)
def test_nothing_is_lost_and_nothing_leaves_sideways(material):
    tracks = Sorter()(BULKS[material], 30, np.random.default_rng(5))
    BELT_BODIES.check(tracks)
    BELT_TRACKS.check(tracks)
    assert tracks["particle"].nunique() == 30
    assert (tracks.groupby("particle")["frame"].diff().dropna() == 1).all()
    assert (tracks.groupby("particle")["x"].max() > 788.0).all()
    assert tracks["y"].between(0.9, 179.1).all()
    assert tracks["z"].min() > 0.9 * min(BULKS[material].half_mm)


def test_batches_follow_each_other_and_none_is_empty(monkeypatch):
    monkeypatch.setattr(simulation, "BATCH", 5)
    tracks = simulation.simulate_tracks("spheres", 12)
    assert tracks["particle"].unique().tolist() == list(range(12))
    spans = tracks.groupby(tracks["particle"] // 5)["frame"].agg(["min", "max"])
    assert (spans["min"].to_numpy()[1:] > spans["max"].to_numpy()[:-1]).all()


@pytest.mark.parametrize("given", [False, True])
def test_each_material_comes_with_its_own_bursts_whoever_gives_the_sorter(monkeypatch, given):
    slides = []
    monkeypatch.setattr(simulation, "_batch", lambda used, *_: slides.append(used.slide))
    monkeypatch.setattr(simulation, "_joined", lambda parts, *_: list(parts))
    sorter = simulation.calibrated_sorter() if given else None
    for material in BULKS:
        simulation.simulate_tracks(material, 5, sorter=sorter)
    assert slides == [simulation.calibrated_sorter(material).slide for material in BULKS]
    assert [(s.feed_s, s.feed_mean_s, s.feed_std_s) for s in slides] == list(FEEDS.values())


def test_no_particle_is_an_empty_table():
    tracks = simulation.simulate_tracks("spheres", 0)
    assert tracks.empty
    assert tracks.columns.tolist() == BELT_BODIES.names


def test_unknown_material_and_a_negative_count_are_told():
    with pytest.raises(InputError, match="there are spheres, cuboids, cylinders"):
        simulation.simulate_tracks("peppercorns")
    with pytest.raises(InputError, match="count"):
        simulation.simulate_tracks("spheres", -1)


def test_without_mujoco_nothing_is_simulated(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    assert not is_installed()
    with pytest.raises(InputError, match="MuJoCo, which is not installed"):
        simulation.simulate_tracks("spheres", 5)


def test_a_step_too_long_for_the_contacts_is_told():
    with pytest.raises(InputError, match=r"step_s .* is too long"):
        Sorter(conveyor=Conveyor(step_s=0.0005))


def test_the_untouched_values_are_the_defaults():
    assert FittedValues().applied(Sorter()) == Sorter()
    other = FittedValues(belt_friction=0.2, drop_mm=50.0).applied(Sorter())
    assert (other.contacts.belt_friction, other.slide.drop_mm) == (0.2, 50.0)
    assert other.contacts.wall_friction == Sorter().contacts.wall_friction


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda record: record["inputs"].update(drop_mm=1.0), "damaged"),
        (lambda record: record.update(targets_sha256="0", sha256=None), "other targets"),
        (lambda record: record["inputs"].update(strange=1.0), "other inputs"),
    ],
)
def test_a_file_that_does_not_fit_is_refused(tmp_path, change, message):
    content = json.loads(simulation.FILE.read_text())
    known = content.pop("sha256")
    change(content)
    again = "damaged" not in message
    content.pop("sha256", None)
    content["sha256"] = cache.content_hash(content) if again else known
    path = tmp_path / "values.json"
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=message):
        fitted_values(path)
