"""Twenty frames of the small twin through all steps: the tables are those of before.

To renew the stored tables after a change that is meant to move numbers, run this file
with KILNFLIGHT_RENEW=1 and say in the commit which numbers moved and why.
"""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from kilnflight import chain
from kilnflight.film.preparation import prepare
from kilnflight.film.settings import Options
from kilnflight.flight import Plausible, Rules
from kilnflight.recording.store import open_recording, write_recording
from kilnflight.simulated.kiln import scenes
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
TOLERANCE |= {"coefficient": 1e-4, "rmse": 1e-6, "mape": 1e-6, "r2": 1e-6}


def make(folder):
    """Simulate the frames, run all steps, and write a table for each into a folder."""
    twin = scenes.open_scene("paper-shred-4.5-bar@small", 0)
    write_recording(twin, folder / "shreds.zarr", range(562, 582))
    stored = open_recording(folder / "shreds.zarr")
    run, _ = prepare(stored, folder / "run", Options(threshold=200.0))
    # the one flight of these frames counts: its first metre is fitted far too fast
    air = Plausible(150.0)
    run = replace(run, rules=Rules(plausible=air), cutting=Cutting(air.fastest_m_s))
    chain.make_tables([run])
    run.detection.detections().to_parquet(folder / "detections.parquet")
    for name in chain.CHAIN_STEPS:
        run.table(name)().to_parquet(folder / f"{name}.parquet")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Return the tables of a run by name."""
    folder = tmp_path_factory.mktemp("snapshot")
    # With AVX-512 numpy's exp, log and powers have other last digits (docs/made.md).
    plain = {"NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SPR"}
    command = [sys.executable, __file__, str(folder)]
    done = subprocess.run(
        command, env=os.environ | plain, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    tables = {name: pd.read_parquet(folder / f"{name}.parquet") for name in TABLES}
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


if __name__ == "__main__":
    make(Path(sys.argv[1]))
