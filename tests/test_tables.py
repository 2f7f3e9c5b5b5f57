import numpy as np
import pandas as pd
import pytest

from kilnflight.checks import InputError
from kilnflight.tables import (
    BELT_ARRIVAL,
    BELT_LAST,
    BELT_PREDICTED,
    BELT_TRACKS,
    DETECTIONS,
    FLIGHTS,
    SLICES,
    TRAJECTORIES,
    VALVE_EVENTS,
    Column,
    Table,
    bound_of,
    impossible,
)

TABLES = [BELT_TRACKS, BELT_LAST, BELT_ARRIVAL, BELT_PREDICTED, VALVE_EVENTS]
TABLES += [DETECTIONS, TRAJECTORIES, FLIGHTS, SLICES]


@pytest.mark.parametrize("table", TABLES)
def test_an_empty_table_passes_its_own_check(table):
    assert list(table.check(table.empty()).columns) == table.names


def test_more_columns_are_dropped_and_the_order_is_ours(constant_acceleration):
    more = constant_acceleration.assign(note="x")[["note", *reversed(BELT_TRACKS.names)]]
    assert list(BELT_TRACKS.check(more).columns) == BELT_TRACKS.names


def test_a_value_that_is_not_finite_is_refused_with_column_and_row(constant_acceleration):
    constant_acceleration.loc[4, "y"] = np.nan
    with pytest.raises(InputError, match=r"my file: column y is not finite in row 4"):
        BELT_TRACKS.check(constant_acceleration, "my file")


def test_text_instead_of_numbers_is_refused(constant_acceleration):
    table = constant_acceleration.astype({"x": str})
    with pytest.raises(InputError, match=r"column x holds str.*expected float \(mm\)"):
        BELT_TRACKS.check(table)


def test_a_detection_may_lack_its_place_in_space_but_nothing_else():
    row = {
        name: 1 if DETECTIONS.columns[k].kind is int else 1.0
        for k, name in enumerate(DETECTIONS.names)
    }
    table = pd.DataFrame([{**row, "x": np.nan, "y": np.nan, "z": np.nan}])
    assert len(DETECTIONS.check(table)) == 1
    with pytest.raises(InputError, match="column z is not finite"):
        DETECTIONS.check(table.assign(z=np.inf))
    with pytest.raises(InputError, match="column gray is not finite"):
        DETECTIONS.check(table.assign(gray=np.nan))


def test_a_column_of_words_holds_words():
    words = Table("endings", Column("ending", str, "1", "how it ended"))
    assert len(words.check(pd.DataFrame({"ending": ["landed", "lost"]}))) == 2
    for no_words in ([1, 2], ["landed", None]):
        with pytest.raises(InputError, match=r"column ending holds .*expected str"):
            words.check(pd.DataFrame({"ending": no_words}))


def test_a_column_of_truth_values_holds_nothing_else():
    truths = Table("flights", Column("from_lance", bool, "1", "whether it starts there"))
    assert len(truths.check(pd.DataFrame({"from_lance": [True, False]}))) == 2
    with pytest.raises(InputError, match=r"column from_lance holds .*expected bool"):
        truths.check(pd.DataFrame({"from_lance": [0, 1]}))


@pytest.mark.parametrize(
    ("column", "possible", "absurd"),
    [
        ("measured_m_s", 13.5, 1_063_640.0),  # once saved in fig-5-21-velocity.csv
        ("velocity 3-4 m (m/s)", -2.0, 379.9),
        ("velocity_m_s", 31.9, -31.0),
        ("lateral_mm_s", -4000.0, 5001.0),
        ("dwell_s", 1.4, -0.001),
        ("dwell longest (s)", 5.9, 15.1),
        ("ignition_s", 0.0, -0.06),
        ("ignition median (s)", 0.3, 15.1),
        ("depth_true_mm", 0.0, -5419.0),
        ("expected_z", 4971.0, -1.0),
        ("radius_mm", 772.0, 2001.0),
        ("radius_mm", 700.0, -1.0),
        ("precision", 1.0, 1.01),
        ("recall_published", 0.0, -0.01),
        ("f1", 0.5, 2.0),
        ("jsc", 0.5, -0.1),
        ("jsc_theta", 0.5, 1.1),
        ("ignited (%)", 100.0, 100.1),
        ("touching_percent", 0.0, -1.0),
        ("tp", 0.0, -1.0),
        ("dwell_s_n", 400.0, -1.0),
        ("gray", 65_535.0, 65_536.0),
        ("velocity_m_s_bias", -40.0, 63.0),
        ("f1_gain", -1.0, 1.1),
        ("rmse_mm", 317.0, -1.0),
        ("velocity_m_s_spread", 7.0, -0.1),
        ("precision_low", 0.2, -0.1),
    ],
)
def test_a_column_has_its_physical_bound(column, possible, absurd):
    table = pd.DataFrame({column: [possible, np.nan, possible], "name": "a"})
    assert impossible(table) == []
    (sentence,) = impossible(pd.concat([table, table.assign(**{column: absurd})]))
    assert sentence.startswith(f"column {column}: 3 of 6 outside ")
    assert sentence.endswith(f"worst {absurd:g}")


def test_the_table_says_what_a_column_without_a_unit_is():
    medians = pd.DataFrame({"outcome": ["velocity 3-4 m (m/s)"], "estimate": [2091.0]})
    assert impossible(medians) == []
    assert len(impossible(medians, "velocity-medians")) == 1
    steps = pd.DataFrame({"dwell_s_low": [-0.1], "dwell_s_bias": [-0.08], "dwell_s_high": [0.0]})
    assert impossible(steps, "accuracy-steps") == []


def test_every_column_with_a_unit_has_a_bound_and_words_have_none():
    units = ["mm", "mm_s", "m_s", "s", "ms", "m", "px", "k", "deg", "hz", "mib", "percent"]
    assert [unit for unit in units if bound_of(f"quantity_{unit}") is None] == []
    assert bound_of("threshold") is None
    assert impossible(pd.DataFrame({"dwell_s": ["-1"], "covers": [True]})) == []
    assert impossible(pd.DataFrame()) == []
