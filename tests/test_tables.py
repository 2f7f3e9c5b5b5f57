import numpy as np
import pandas as pd
import pytest

from kilnflight.checks import InputError
from kilnflight.tables import (
    BELT_ARRIVAL,
    BELT_LAST,
    BELT_TRACKS,
    DETECTIONS,
    FLIGHTS,
    SLICES,
    TRAJECTORIES,
    Column,
    Table,
)

TABLES = [BELT_TRACKS, BELT_LAST, BELT_ARRIVAL, DETECTIONS, TRAJECTORIES, FLIGHTS, SLICES]


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
