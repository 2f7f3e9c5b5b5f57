"""Tables between steps, and limits of the numbers in saved tables."""

import numpy as np
import pandas as pd
import pytest
from tests.definitions.bounds import impossible

from kilnflight import tables
from kilnflight.checks import InputError
from kilnflight.tables import BELT_TRACKS, DETECTIONS, Column, Table

TABLES = [table for table in vars(tables).values() if isinstance(table, Table)]


@pytest.mark.parametrize("table", TABLES, ids=lambda table: table.name)
def test_an_empty_table_passes_its_own_check(table):
    assert list(table.check(table.empty()).columns) == table.names


def test_other_columns_are_left_out_and_the_order_is_that_of_the_table(constant_acceleration):
    more = constant_acceleration.assign(note="x")[["note", *reversed(BELT_TRACKS.names)]]
    assert list(BELT_TRACKS.check(more).columns) == BELT_TRACKS.names


def test_a_detection_may_lack_its_position_in_space_only():
    row = {column.name: column.kind(1) for column in DETECTIONS.columns}
    table = pd.DataFrame([row | dict.fromkeys("xyz", np.nan)])
    assert len(DETECTIONS.check(table)) == 1
    for name, wrong in (("z", np.inf), ("gray", np.nan), ("gray", "bright"), ("frame", 0.5)):
        with pytest.raises(InputError, match=f"mine.*{name}"):
            DETECTIONS.check(table.assign(**{name: wrong}), "mine")


@pytest.mark.parametrize(
    ("kind", "right", "wrong"),
    [(str, ["landed", "lost"], ["landed", None]), (bool, [True, False], [0, 1])],
)
def test_words_and_truth_values(kind, right, wrong):
    table = Table("ends", Column("ending", kind, "1", "how it ended"))
    assert len(table.check(pd.DataFrame({"ending": right}))) == 2
    with pytest.raises(InputError, match="ending"):
        table.check(pd.DataFrame({"ending": wrong}))


@pytest.mark.parametrize(
    ("column", "possible", "wrong"),
    [
        ("measured_m_s", 13.5, 1_063_640.0),
        ("radius_mm", 700.0, -1.0),
        ("precision_low", 0.2, -0.1),
        ("tp", 0.0, -1.0),
        ("velocity_m_s_bias", -40.0, 63.0),
        ("rmse_mm", 317.0, -1.0),
    ],
)
def test_a_column_has_its_physical_bound(column, possible, wrong):
    assert impossible(pd.DataFrame({column: [possible, np.nan], "name": "a"})) == []
    (sentence,) = impossible(pd.DataFrame({column: [possible, wrong]}))
    assert sentence.startswith(f"column {column}: 1 of 2 outside")
