"""Tables as other programs read and write them."""

from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest

from kilnflight.recording.track_files import FORMATS, read_table, write_table

NAMES = ["frame", "particle", "row", "col"]


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("count", [0, 9])
def test_other_programs_find_every_digit_of_rows_in_tracks(form, count, tmp_path):
    table = pd.DataFrame(
        np.random.default_rng(1).normal(size=(count, 2)) * 100, columns=NAMES[2:]
    )
    table = table.assign(
        frame=range(count), particle=np.arange(count) % 3 - 1, gray=1.0
    )
    write_table(table.sample(frac=1.0, random_state=1), tmp_path / "t", form)
    if form == "challenge":
        found = [
            [
                int(place.get("t")),
                particle,
                float(place.get("y")),
                float(place.get("x")),
            ]
            for particle, track in enumerate(
                ElementTree.parse(tmp_path / "t").iter("particle")
            )
            for place in track.iter("detection")
        ]
    else:
        skip = range(1, 4) if form == "trackmate" else None
        columns = [FORMATS[form][name] for name in NAMES]
        found = pd.read_csv(tmp_path / "t", skiprows=skip)[columns].to_numpy()
    expected = table[table["particle"] >= 0].sort_values(["particle", "frame"])[NAMES]
    np.testing.assert_array_equal(np.reshape(found, (-1, 4)), expected)


@pytest.mark.parametrize("name", ["t.csv", "t.parquet"])
def test_x_and_y_of_another_program_are_col_and_row(name, tmp_path):
    table = pd.DataFrame(
        {"mass": 9, "x": [7.0, 9.0, 11.0, 13.0], "y": 2.5, "frame": range(4)}
    )
    write_table(table, tmp_path / name)
    found = read_table(tmp_path / name)
    assert found.columns.tolist() == ["mass", "col", "row", "frame"]
    ours = table.assign(row=1.0, col=2.0)  # x, y in mm
    write_table(ours, tmp_path / name)
    pd.testing.assert_frame_equal(read_table(tmp_path / name), ours)
