"""Columns are checked once, and then taken as they are."""

import numpy as np
import pandas as pd
import pytest

from kilnflight import belt
from kilnflight.belt.columns import checked_arrival, checked_last, only
from kilnflight.checks import InputError
from kilnflight.tables import BELT_ARRIVAL, BELT_LAST

FIRST = (1, 0.5, 623.0, 90.0, 1400.0, 20.0, 300.0, -50.0)
SECOND = (2, 0.6, 620.0, 80.0, 1450.0, -9.0, 0.0, 1.0)
LAST = pd.DataFrame([FIRST, SECOND], columns=BELT_LAST.names)
SEEN = pd.DataFrame([(1, 0.605, 92.0, 15.0), (2, 0.71, 79.0, -8.0)], columns=BELT_ARRIVAL.names)


def test_columns_are_those_of_the_tables_and_not_checked_again():
    last, seen = checked_last(LAST), checked_arrival(SEEN)
    assert list(last._fields) == BELT_LAST.names
    assert list(seen._fields) == BELT_ARRIVAL.names
    assert checked_last(last) is last
    assert checked_arrival(seen) is seen
    assert only(last, np.array([False, True])).particle.tolist() == [2]
    assert [len(column) for column in checked_last(BELT_LAST.empty())] == [0] * 8


def test_a_table_without_a_column_is_refused():
    with pytest.raises(InputError, match="velocity_x_mm_s"):
        checked_last(LAST.drop(columns="velocity_x_mm_s"))


@pytest.mark.parametrize("model", belt.ARRIVAL_MODELS, ids=lambda model: model.name)
def test_arrival_models_say_the_same_of_tables_and_columns(model):
    last, seen = checked_last(LAST), checked_arrival(SEEN)
    assert model.calibrated(last, seen, 773.0) == model.calibrated(LAST, SEEN, 773.0)
    fitted = model.calibrated(LAST, SEEN, 773.0)
    assert fitted(last, 773.0).tolist() == fitted(LAST, 773.0).tolist()


@pytest.mark.parametrize("model", belt.LATERAL_MODELS, ids=lambda model: model.name)
def test_lateral_models_say_the_same_of_tables_and_columns(model):
    last, seen, left = checked_last(LAST), checked_arrival(SEEN), np.array([0.1, 0.11])
    assert model.calibrated(last, seen) == model.calibrated(LAST, SEEN)
    fitted = model.calibrated(LAST, SEEN)
    assert fitted(last, left).tolist() == fitted(LAST, left).tolist()
