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
# The start t0 is found to 1e-8 s only. The times and velocities made of it are as
# exact; the polynomials are of the time since t0, and errors grow with the power.
TOLERANCE = {
    "t0": 1e-7,
    "end_": 1e-7,
    "dwell": 1e-6,
    "velocity": 1e-6,
    "ignition_s": 1e-6,
}
TOLERANCE |= {"coefficient": 1e-4, "rmse": 1e-6, "mape": 1e-6, "r2": 1e-6, "wall": 1e-6}


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
        if table[column].dtype.kind != "f":
            np.testing.assert_array_equal(table[column], before, column)
        else:
            rtol = next(
                (r for part, r in TOLERANCE.items() if column.startswith(part)), 1e-9
            )
            np.testing.assert_allclose(
                table[column], before, rtol, 1e-12, err_msg=column
            )
