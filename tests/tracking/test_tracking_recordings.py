"""The tracker on the belt of the authors, held against the links that they made.

Their own tracking result tells which detections belong together. It is no truth, but the
result of people who know their sorter; both are given the same positions.
"""

import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from kilnflight.tracking.filter import ConstantAcceleration, ConstantVelocity
from kilnflight.tracking.tracker import track

PROJECT = Path(__file__).resolve().parents[2]
RECORDINGS = Path(
    os.environ.get("KILNFLIGHT_RECORDINGS")
    or PROJECT.parent / "shared" / "data" / "belt_recordings"
)
# What is known of the belt beforehand: it runs along the rows with some 85 px per frame,
# and what lies on it moves with it. One setting for all materials.
KNOWN = {"velocity": (85.0, 0.0), "velocity_sd": 8.0, "measurement_sd": 1.0}
BELT = (ConstantVelocity(**KNOWN), ConstantAcceleration(**KNOWN))


def read(path):
    """Return the detections of a recording: frame, row, col, and the authors' particle."""
    wide = pd.read_csv(path).to_numpy(dtype=float)
    places = wide[:, 2:].reshape(len(wide), -1, 2)
    frame, _ = np.nonzero(np.isfinite(places[:, :, 0]))
    col, row = places[np.isfinite(places[:, :, 0])].T
    table = pd.DataFrame({"frame": frame, "row": row, "col": col})
    name = path.name.replace(".csv.gz", "_trackHistory_NothingDeleted.csv.gz")
    history = pd.read_csv(path.with_name(name)).to_numpy(dtype=float)
    tracks = history.reshape(len(history), -1, 2)
    _, particle = np.nonzero(np.isfinite(tracks[:, :, 0]))
    x, y = tracks[np.isfinite(tracks[:, :, 0])].T
    theirs = pd.DataFrame({"row": y, "col": x, "truth": particle})
    return table.merge(theirs, on=["row", "col"], how="left", validate="many_to_one")


def links(table, column):
    """Return the pairs of rows that follow each other in a track, as a set."""
    order = np.lexsort((table["frame"], table[column]))
    same = np.diff(table[column].to_numpy()[order]) == 0
    return set(zip(order[:-1][same], order[1:][same], strict=True))


@pytest.mark.parametrize("motion", BELT, ids=["velocity", "acceleration"])
@pytest.mark.parametrize("material", ["Kugeln", "Weizen", "Zylinder"])
def test_the_links_of_the_authors_are_found(material, motion):
    if not (RECORDINGS / material).is_dir():
        pytest.skip(f"the authors' recordings are not in {RECORDINGS} (not ours to ship)")
    first = sorted((RECORDINGS / material).glob("*[0-9].csv.gz"))[0]
    table = read(first)
    assert table["truth"].notna().all()
    theirs, ours = links(table, "truth"), links(track(table, motion=motion), "particle")
    assert len(theirs & ours) >= 0.99 * max(len(theirs), len(ours))
