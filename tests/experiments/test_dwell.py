"""Dwell times of complete, lost and refused flights, made by hand."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from kilnflight.experiments import accuracy, campaigns, dwell, flight_pictures
from kilnflight.experiments.accuracy import FlightTables, compare
from kilnflight.experiments.campaigns import REASONS, Measurement
from kilnflight.scores.flights import FlightValues
from kilnflight.twin import truth
from kilnflight.twin.flight import Flight, Flights

CHIP, GRANULE = ("wood chip", 4.5), ("PE granule", 5.0)
TRUE = pd.DataFrame(
    {
        "particle": [10, 11, 12],
        "ending": ["burnt out", "landed", "landed"],
        "dwell_s": [0.3, 0.4, 0.5],
        "velocity_m_s": [5.0, 6.0, 7.0],
        "ignition_s": [0.1, np.nan, np.nan],
        "whole": True,
        "measurable": True,
    }
)
FLIGHTS = pd.DataFrame(
    {
        "particle": [1, 2, 3, 4, 5, 6],
        "from_lance": [True, True, True, False, True, True],
        "ending": ["landed", "lost", "burnt out", "lost", "landed", "lost"],
        "dwell_s": [0.32, 0.35, 0.7, 0.1, 40.0, 9.0],
        "ignition_s": [0.15, np.nan, 0.3, np.nan, np.nan, np.nan],
        "t0_s": 1.0,
        "first_s": 1.0,
        "last_s": [1.3, 1.2, 1.5, 1.1, 1.4, 1.4],
        "refused": ["", "", "", "", REASONS[0], REASONS[2]],
        "fraction": CHIP[0],
        "pressure_bar": CHIP[1],
    }
)
SLICES = pd.DataFrame({"particle": [1, 3], "slice_m": [1.0, 1.0], "velocity_m_s": [5.5, 9.0]})
OWNERS = pd.Series({1: 10, 2: 10, 3: -1, 4: 11, 5: 12, 6: 11})
TABLES = Measurement(None, None, FLIGHTS, None)
NONE = FlightValues(np.empty(0), np.empty((0, 5)), np.empty(0), np.empty(0))


def particles(flights=FLIGHTS):
    both = compare(FlightTables(flights, SLICES, OWNERS), TRUE)
    both = both.assign(fraction=CHIP[0], pressure_bar=CHIP[1])
    return dwell.flights_and_particles(Measurement(None, None, flights, None), both)


def test_a_lost_flight_has_the_time_it_was_seen_and_no_dwell_time():
    data = particles().set_index("track")
    assert data.loc[[1, 3], "measured_s"].tolist() == [0.32, 0.7]
    assert np.isnan(data.loc[2, "measured_s"])
    assert data.loc[2, "seen_s"] == pytest.approx(0.2)
    assert data.loc[[1, 3], "seen_s"].isna().all()
    assert {5, 6}.isdisjoint(data.index)  # refused
    assert data["true_s"].notna().sum() == 3


def test_endings_stand_by_the_true_ones_and_nothing_is_left_out():
    endings = dwell.ending_table(particles()).set_index("true")
    assert endings.index.tolist() == ["burnt out", "landed unlit", accuracy.NOT_WHOLE]
    assert endings.loc["burnt out", "landed burning"] == 1
    assert endings.loc["landed unlit", "not measured"] == 2
    # a shorter track, and a false flight
    assert endings.loc[accuracy.NOT_WHOLE, ["lost", "burnt out"]].tolist() == [1, 1]


def test_complete_lost_and_refused_flights_sum_up_and_reasons_have_their_column():
    table = dwell.count_flights(TABLES, {CHIP: NONE, GRANULE: NONE})
    assert table[["fraction", "pressure_bar"]].to_numpy().tolist() == [list(CHIP), list(GRANULE)]
    row = table.iloc[0]
    assert row["from_lance"] == 5 == row.iloc[3:].sum()
    assert row[["landed burning", "burnt out", "lost"]].tolist() == [1, 1, 1]
    assert row[[f"refused: {why}" for why in REASONS]].tolist() == [1, 0, 1]
    assert table.iloc[1, 2:].tolist() == [0] * 8
    assert dwell.describe(table) == (
        "Of 5 flights from the lance 2 are complete, 1 lost and 2 refused."
    )


def values(complete, lost=()):
    times = (np.array(each, dtype=float) for each in (complete, lost))
    complete, lost = times
    return NONE._replace(dwell_s=complete, censored_s=lost)


def test_medians_are_of_complete_flights_and_lost_ones_move_the_censored_one_only():
    times = np.linspace(0.2, 0.4, 11)
    ours = {CHIP: values(times), GRANULE: values(times, [0.31] * 10)}
    draw = np.random.default_rng(0)
    table = dwell.medians(ours, ours, ours, draw)
    assert table["measured_s"].tolist() == [pytest.approx(0.3)] * 2
    assert table[["complete", "lost"]].to_numpy().tolist() == [[11, 0], [11, 10]]
    assert table["with_lost_s"].tolist() == [pytest.approx(0.3), pytest.approx(0.34)]
    assert table["covers"].tolist() == [True, True]
    assert table["covers_with_lost"].tolist() == [True, True]
    late = dwell.medians(ours, ours, {key: values(times + 0.5) for key in ours}, draw)
    assert late[["covers", "covers_with_lost"]].to_numpy().tolist() == [[False, False]] * 2


@pytest.mark.parametrize("ours", [NONE, values([], [0.2, 0.3]), values([0.3])])
def test_few_or_no_complete_flights_are_counted_and_have_no_interval(ours):
    made = {CHIP: ours}
    (row,) = dwell.medians(made, made, made, np.random.default_rng(0)).to_dict("records")
    assert (row["complete"], row["lost"]) == (len(ours.dwell_s), len(ours.censored_s))
    assert np.isnan([row["low"], row["high"], row["with_lost_low"]]).all()
    assert np.isnan(row["measured_s"]) == (len(ours.dwell_s) == 0)
    assert pd.isna(row["covers"])
    assert pd.isna(row["covers_with_lost"])
    curves = dwell.curves({"true": made, "measured": made})
    assert curves["source"].nunique() in (0, 2)
    picture = flight_pictures.draw_still_flying(curves, [CHIP])
    assert [axes.get_title() for axes in picture.axes] == ["wood chip, 4.5 bar"]
    said = ["no complete flight" in text.get_text() for text in picture.axes[0].texts]
    assert said == ([] if len(curves) else [True])


def test_without_flights_every_table_is_there_and_empty():
    data = particles(FLIGHTS.head(0))
    assert data["measured_s"].isna().all()
    assert dwell.ending_table(data)["not measured"].sum() == 3
    table = dwell.count_flights(Measurement(None, None, FLIGHTS.head(0), None), {CHIP: NONE})
    assert dwell.describe(table).startswith("Of 0 flights from the lance 0 are complete")


def test_curves_have_a_source_and_boxes_a_panel_for_each_pressure():
    ours = {CHIP: values([0.2, 0.3], [0.25]), GRANULE: values([0.4])}
    sources = {"true": ours, "measured": ours}
    curves = dwell.curves(sources)
    part = curves[(curves["source"] == "measured") & (curves["fraction"] == CHIP[0])]
    np.testing.assert_allclose(part["time_s"], [0, 0.2, 0.25, 0.3])
    np.testing.assert_allclose(part["flying"], [1, 2 / 3, 2 / 3, 0])
    both = {(name, bar): values([0.3]) for name in ("wood chip", "confetti") for bar in (4.5, 5.0)}
    for keys in (list(both), list(both)[::2]):
        picture = flight_pictures.draw_dwell_boxes({"true": both}, keys)
        assert len(picture.axes) == len({bar for _, bar in keys})
        assert all(axes.has_data() for axes in picture.axes)


def test_complete_flights_alone_are_the_other_reading_of_velocities():
    left = dwell.complete_only(TABLES).flights
    assert left["particle"].tolist() == [1, 3, 5]


def test_the_truth_is_complete_only_as_far_as_a_person_sees_it(monkeypatch):
    """Five: seen to the end, lost early, out of the kiln, never visible, cut by the recording."""
    end, release = np.array([0.30, 0.50, 0.40, 0.20, 0.60]), 1.0
    ends = np.array([0, 0, truth.NO_DWELL[0], 0, 0], dtype=np.int8)
    flown = Flights.blank(5, Flight())._replace(end=ends, end_s=end)
    life = SimpleNamespace(
        table=pd.DataFrame({"particle": [7, 8, 9, 10, 11]}),
        release_s=np.full(5, release),
        flights=flown,
    )
    twin = SimpleNamespace(life=life, scene=SimpleNamespace(frame_rate_hz=100.0))
    seen = pd.DataFrame({"particle": [7, 7, 8, 9, 11], "frame": [110, 128, 120, 139, 150]})
    whole = np.array([True, True, True, True, False])
    monkeypatch.setattr(campaigns, "twin_of", lambda _: twin)
    monkeypatch.setattr(campaigns, "whole_flights", lambda _: whole.copy())
    monkeypatch.setattr(campaigns, "true_positions", lambda _: seen)
    values = campaigns.followed_values(None)
    assert values.dwell_s.tolist() == [0.30]
    np.testing.assert_allclose(values.censored_s, [0.20, 0.39])
    assert len(values.ignition_s) == 3
    assert campaigns.followed_values(None, beyond_s=0.31).dwell_s.tolist() == [0.30, 0.50]


def test_a_sentence_says_where_refusing_selects_most():
    table = pd.DataFrame(
        {
            "fraction": ["wood chip", "wood chip", "paper shred", "paper shred"],
            "refused": [False, True, False, True],
            "true_dwell_s": [0.3, 0.29, 0.4, 0.5],
        }
    )
    assert dwell.describe_refused(table) == (
        "Refusing shifts paper shred flights most: the refused ones truly last 0.50 s, "
        "the others 0.40 s (medians)."
    )
    assert "not known" in dwell.describe_refused(table[:0])
