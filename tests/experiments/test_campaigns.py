"""The campaigns of the small twin, at the smallest scale."""

import pandas as pd
import pytest

from kilnflight import kiln
from kilnflight.checks import InputError
from kilnflight.detection.wall import Cylinder
from kilnflight.experiments import campaigns
from kilnflight.experiments.campaigns import Settings
from kilnflight.project.parallel import Workers
from kilnflight.tables import FLIGHTS, SLICES, TRAJECTORIES

LEARNED = Settings(300.0, Cylinder((0.0, 400.0, 7000.0), (0.0, 0.0, 1.0), 700.0), 740.0)


def test_the_scales_are_those_of_the_thesis_or_parts():
    for scale, number, frames in (("quick", 2, 48), ("standard", 8, 2000), ("full", 8, 24892)):
        some = campaigns.campaigns(scale, LEARNED)
        assert len(some) == number
        assert sum(len(one.frames) for one in some) == frames
        assert all(not one.run.detection.differences for one in some)
        x, y, z = some[0].run.exit_point_mm
        assert (x, y, z) == pytest.approx((-73.4, 238.6, 6500.0), abs=15)
    with pytest.raises(InputError, match="no scale 'huge'; there are quick"):
        campaigns.campaigns("huge", LEARNED)


def test_few_frames_give_all_tables_and_two_processes_the_same(monkeypatch, tmp_path):
    monkeypatch.setitem(campaigns.FRAMES, "quick", (100, 4))
    some = campaigns.campaigns("quick", LEARNED, scenario="small")
    found = campaigns.measure(some)
    for table, kind in zip(found[1:], (TRAJECTORIES, FLIGHTS, SLICES), strict=True):
        assert list(table.columns) == ["fraction", "pressure_bar", *kind.names]
        kind.check(table)
    files = {file.name: file.read_bytes() for file in (tmp_path / "derived").glob("*.parquet")}
    assert len(files) == 2 * 5
    monkeypatch.setenv("KILNFLIGHT_DERIVED", str(tmp_path / "two"))
    again = campaigns.measure(some, Workers(2))
    for one, other in zip(found, again, strict=True):
        pd.testing.assert_frame_equal(one, other)
    for name, content in files.items():
        assert (tmp_path / "two" / name).read_bytes() == content


def test_another_wall_or_exit_point_is_another_table():
    run = campaigns.campaigns("quick", LEARNED, scenario="small")[0].run
    lance = run.__class__(run.detection, (0.0, 0.0, 6500.0), run.wall, run.in_air)
    wall = run.__class__(run.detection, run.exit_point_mm, None, run.in_air)
    for name in kiln.KILN_STEPS:
        names = {one.table(name).path.name for one in (run, lance, wall)}
        assert len(names) == (2 if name == "tracks" else 3)
