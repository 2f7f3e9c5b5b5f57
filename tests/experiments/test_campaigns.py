"""The campaigns of the small twin, at the smallest scale; values of flights made by hand."""

from functools import partial
from itertools import product
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from kilnflight import kiln
from kilnflight.checks import InputError
from kilnflight.detection.wall import Cylinder
from kilnflight.experiments import campaigns
from kilnflight.experiments.campaigns import Campaign, Measurement, Results, Settings
from kilnflight.project.parallel import Workers
from kilnflight.regression import AXIS_MEASURES, Regression, regress, regress_all
from kilnflight.tables import FLIGHTS, SLICES, TRAJECTORIES

EXIT = (0.0, 0.0, 6500.0)
CELL = ("confetti", 4.5)

LEARNED = Settings(300.0, Cylinder((0.0, 400.0, 7000.0), (0.0, 0.0, 1.0), 700.0), 740.0)


def test_the_scales_are_those_of_the_thesis_or_parts():
    for scale, number, frames in (("quick", 2, 48), ("standard", 4, 800), ("full", 8, 24892)):
        some = campaigns.campaigns(scale, LEARNED)
        assert len(some) == number
        assert sum(len(one.frames) for one in some) == frames
        assert all(not one.run.detection.differences for one in some)
        x, y, z = some[0].run.exit_point_mm
        assert (x, y, z) == pytest.approx((-66.1, 214.9, 5856.0), abs=15)  # pose.json
    with pytest.raises(InputError, match="no scale 'huge'; there are quick"):
        campaigns.campaigns("huge", LEARNED)


def test_few_frames_give_all_tables_and_two_processes_the_same(monkeypatch, tmp_path):
    monkeypatch.setitem(campaigns.FRAMES, "quick", (100, 4))
    some = campaigns.campaigns("quick", LEARNED, scenario="small")
    tables = campaigns.measure_campaigns(some)
    for table, kind in zip(tables[1:], (TRAJECTORIES, FLIGHTS, SLICES), strict=True):
        assert list(table.columns) == ["fraction", "pressure_bar", *kind.names]
        kind.check(table)
    files = {file.name: file.read_bytes() for file in (tmp_path / "derived").glob("*.parquet")}
    assert len(files) == 2 * 5
    monkeypatch.setenv("KILNFLIGHT_DERIVED", str(tmp_path / "two"))
    again = campaigns.measure_campaigns(some, Workers(2))
    for one, other in zip(tables, again, strict=True):
        pd.testing.assert_frame_equal(one, other)
    for name, content in files.items():
        assert (tmp_path / "two" / name).read_bytes() == content


def test_results_that_are_kept_send_nothing_to_workers(monkeypatch):
    monkeypatch.setitem(campaigns.FRAMES, "quick", (100, 4))
    monkeypatch.setattr(campaigns, "settings_from_labels", lambda scale, seed: LEARNED)
    small = partial(campaigns.campaigns, scenario="small")
    monkeypatch.setattr(campaigns, "campaigns", small)
    work, sent = Workers.__call__, []

    def noted(self, function, pieces, *rest):
        sent.extend(pieces)
        work(self, function, pieces, *rest)

    monkeypatch.setattr(Workers, "__call__", noted)
    made = campaigns.results("quick")
    assert len(sent) == 2 * 5 + 2  # five tables and the truth of each campaign
    sent.clear()
    kept = campaigns.results("quick")
    assert sent == []
    for one, other in zip(made.tables, kept.tables, strict=True):
        pd.testing.assert_frame_equal(one, other)


def test_another_wall_or_exit_point_is_another_table():
    run = campaigns.campaigns("quick", LEARNED, scenario="small")[0].run
    lance = run.__class__(run.detection, (0.0, 0.0, 6500.0), run.wall, run.in_air)
    wall = run.__class__(run.detection, run.exit_point_mm, None, run.in_air)
    for name in kiln.KILN_STEPS:
        names = {one.table(name).path.name for one in (run, lance, wall)}
        assert len(names) == (2 if name == "tracks" else 3)


def track(particle, speed, start=0, count=40):
    frame = np.arange(start + 2, start + 2 + count)
    t = (frame - start) / 100.0
    places = {"x": 300.0 * t, "y": 4900.0 * t**2, "z": 6500.0 - 1000.0 * speed * t}
    return pd.DataFrame({"particle": particle, "frame": frame, **places})


def flight(particle, dwell, from_lance=True, ignition=np.nan):
    row = dict.fromkeys(FLIGHTS.names, 0.0) | {"particle": particle, "dwell_s": dwell}
    row |= {"end_s": 0.3, "ending": "landed", "ignition": "none", "ignition_s": ignition}
    return row | {"from_lance": from_lance, "refused": ""}


def with_cell(table, cell=CELL):
    return table.assign(fraction=cell[0], pressure_bar=cell[1])


FITTED = regress_all(
    pd.concat([track(1, 5.0), track(2, 8.0), track(3, 5.0)]), EXIT, 100.0, Regression(highest=2)
)
FLOWN = pd.DataFrame([flight(1, 0.3), flight(2, 0.4, ignition=0.1), flight(3, 9.0, False)])
SLICED = pd.DataFrame(
    {"particle": [1, 2, 2, 2], "slice_m": [1.0, -1.0, 1.0, 2.0], "velocity_m_s": [5.0, -3.0, 8, 7]}
)


def test_only_flights_from_the_lance_count_and_slices_behind_it_do_not():
    values = campaigns.flight_values(FITTED, FLOWN, SLICED)
    assert values.dwell_s.tolist() == [0.3, 0.4]
    np.testing.assert_equal(values.velocity_m_s[:, :3], [[5, np.nan, np.nan], [8, 7, np.nan]])
    np.testing.assert_equal(values.ignition_s, [np.nan, 0.1])
    np.testing.assert_allclose(values.reached_m, [1.5, 2.4], rtol=1e-3)


def test_only_complete_flights_have_a_dwell_time_and_refused_ones_do_not_count():
    one = FLOWN.assign(ending=["lost", "burnt out", "landed"], last_s=[0.25, 0.4, 9.0])
    values = campaigns.flight_values(FITTED, one, SLICED)
    assert values.dwell_s.tolist() == [0.4]
    assert values.censored_s.tolist() == [0.25]  # last detected 0.25 s after it left, at t0 = 0
    assert len(values.ignition_s) == len(values.reached_m) == 2
    refused = one.assign(refused=["", "turns back behind the lance", ""])
    values = campaigns.flight_values(FITTED, refused, SLICED)
    assert (len(values.dwell_s), len(values.censored_s), len(values.velocity_m_s)) == (0, 1, 1)


@pytest.mark.parametrize(
    "flown",
    [FLOWN.assign(from_lance=False), FLOWN.assign(refused="leaves the kiln"), FLOWN.head(0)],
)
def test_without_a_flight_that_counts_there_are_no_values(flown):
    tables = Measurement(*map(with_cell, (track(1, 5.0), FITTED, flown, SLICED)))
    values = campaigns.values_by_campaign(tables, [CELL, ("PE granule", 5.0)])
    assert [len(each.reached_m) for each in values.values()] == [0, 0]
    assert campaigns.outcome_table(values).iloc[:, 3:].isna().all(axis=None)
    assert campaigns.from_lance(tables, "tracks").empty
    assert campaigns.fits_from_lance(tables, CELL, 5)[0] == {}


def measured(cells):
    parts = [FITTED, FLOWN, SLICED]
    tables = [pd.concat([with_cell(one, cell) for cell in cells]) for one in parts]
    return Measurement(with_cell(track(1, 5.0)), *tables)


def test_cells_and_their_table_have_one_row_each():
    values = campaigns.values_by_campaign(measured([CELL]), [CELL])
    row = campaigns.outcome_table(values).iloc[0]
    assert (row["particles"], row["dwell median (s)"]) == (2, pytest.approx(0.35))


def results_of_orders(exit_point=EXIT):
    """Two scattered flights, one too short for order 7, and one that is not from the lance."""
    tracks = pd.concat([track(1, 5.0), track(2, 8.0), track(3, 5.0, count=8), track(4, 5.0)])
    tracks[list("xyz")] += np.random.default_rng(0).normal(0, [7, 7, 150], (len(tracks), 3))
    flown = pd.DataFrame([flight(k, 0.3, from_lance=k != 4) for k in (1, 2, 3, 4)])
    parts = [tracks, regress_all(tracks, EXIT, 100.0), flown, SLICED]
    run = SimpleNamespace(frame_rate_hz=100.0, exit_point_mm=exit_point)
    tables = Measurement(*map(with_cell, parts))
    return tracks, Results([Campaign(*CELL, run)], tables, {}, {})


def test_each_order_is_measured_on_the_same_tracks_those_too_short_left_out():
    tracks, results = results_of_orders()
    fits, _ = campaigns.fits_from_lance(results.tables, CELL, 40)
    assert sorted(fits) == [1, 2, 3]
    table = campaigns.measures_by_order(results).set_index(["order", "axis"])
    assert list(table.index) == list(product(range(2, 8), "xyz"))
    for order in (2, 3, 7):
        method = Regression(lowest=order, highest=order)
        long = [regress(tracks[tracks["particle"] == k], EXIT, 100.0, method) for k in (1, 2)]
        for axis, name in product(range(3), AXIS_MEASURES):
            expected = np.median([getattr(fit, name)[axis] for fit in long])
            assert table.loc[(order, "xyz"[axis]), name] == pytest.approx(expected, rel=1e-12)
    assert table.loc[(7, "z"), "rmse_mm"] == pytest.approx(150, rel=0.3)
    first = campaigns.measures_by_order(results, most=1).set_index(["order", "axis"])
    one = regress(tracks[tracks["particle"] == 1], EXIT, 100.0, Regression(lowest=3, highest=3))
    assert first.loc[(3, "y"), "rmse_mm"] == one.rmse_mm[1]
