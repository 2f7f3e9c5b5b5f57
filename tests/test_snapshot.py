"""Twenty frames of the small twin through all steps: the tables are those of before.

To renew the stored tables after a change that is meant to move numbers, run this file
with KILNFLIGHT_RENEW=1 and say in the commit which numbers moved and why.
"""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from kilnflight import chain
from kilnflight.film.preparation import prepare
from kilnflight.film.settings import Options
from kilnflight.flight import Plausible, Rules
from kilnflight.recording.store import open_recording
from kilnflight.tracklets import Cutting

STORED = Path(__file__).with_name("snapshot.parquet")
TABLES = ("detections", *chain.CHAIN_STEPS)
# Positions come as float32. Fits look for t0: they are as exact as the search.
TOLERANCE = {"detections": 1e-6, "tracks": 1e-6}
FITTED = 1e-4
# Another processor rounds some grey values otherwise: an area of pixels gains one, and
# a track with it is another. So one row of a table, or of 100, may be further off.
OTHERS = 0.01
FURTHER = 0.1


@pytest.fixture(scope="module")
def made(stored_flights, tmp_path_factory):
    """Return the tables of a run by name."""
    folder = tmp_path_factory.mktemp("run")
    run, _ = prepare(open_recording(stored_flights), folder, Options(threshold=200.0))
    # the one flight of these frames counts: its first metre is fitted far too fast
    air = Plausible(150.0)
    run = replace(run, rules=Rules(plausible=air), cutting=Cutting(air.fastest_m_s))
    chain.make_tables([run])
    tables = {"detections": run.detection.detections()}
    tables |= {name: run.table(name)() for name in chain.CHAIN_STEPS}
    if os.environ.get("KILNFLIGHT_RENEW"):
        marked = [table.assign(table=name) for name, table in tables.items()]
        pd.concat(marked, ignore_index=True).to_parquet(STORED)
    return tables


@pytest.mark.parametrize("name", TABLES)
def test_a_table_is_that_of_before(made, name):
    table, stored = made[name], pd.read_parquet(STORED)
    stored = stored[stored["table"] == name]
    assert len(table) == len(stored) > 0
    for column in table:
        before = stored[column].astype(table[column].dtype).to_numpy()
        if table[column].dtype.kind not in "fiu":
            np.testing.assert_array_equal(table[column], before, column)
        else:
            tolerance = TOLERANCE.get(name, FITTED)
            close = np.isclose(table[column], before, tolerance, 1e-9, equal_nan=True)
            assert np.count_nonzero(~close) <= max(1, OTHERS * len(table)), column
            np.testing.assert_allclose(table[column], before, FURTHER, err_msg=column)
