"""Tables between steps, and limits of the numbers in saved tables."""

import pytest

from kilnflight import tables
from kilnflight.tables import BELT_TRACKS, Table

TABLES = [table for table in vars(tables).values() if isinstance(table, Table)]


@pytest.mark.parametrize("table", TABLES, ids=lambda table: table.name)
def test_an_empty_table_passes_its_own_check(table):
    assert list(table.check(table.empty()).columns) == table.names


def test_other_columns_are_left_out_and_the_order_is_that_of_the_table(
    constant_acceleration,
):
    more = constant_acceleration.assign(note="x")[
        ["note", *reversed(BELT_TRACKS.names)]
    ]
    assert list(BELT_TRACKS.check(more).columns) == BELT_TRACKS.names
