"""The authors' DEM tracks and recordings."""

import gzip
import zipfile

import numpy as np
import pandas as pd
import pytest

from kilnflight.belt import PredictionPhase
from kilnflight.belt.recordings import (
    HISTORY,
    list_recordings,
    read_dem,
    read_recording,
)
from kilnflight.checks import InputError
from kilnflight.experiments.belt import paper_2020
from kilnflight.experiments.belt.paper_2020 import find_recordings
from kilnflight.publication import data, notebooks

GOOD = (
    "0.40,0.09,nan,nan,nan,nan\n"
    "0.41,0.09,0.39,0.05,nan,nan\n"
    "nan,nan,0.40,0.06,nan,nan\n"
)


def as_zip(folder, text):
    path = folder / "tracks.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a.csv", text)
    return path


def test_columns_become_one_row_per_particle_and_frame(tmp_path):
    tracks = read_dem(as_zip(tmp_path, GOOD))
    assert tracks["particle"].tolist() == [0, 0, 1, 1]
    assert tracks["frame"].tolist() == [0, 1, 1, 2]
    np.testing.assert_allclose(tracks["time_s"], [0.0, 0.01, 0.01, 0.02])
    np.testing.assert_allclose(tracks["x"], [400.0, 410.0, 390.0, 400.0])
    np.testing.assert_allclose(tracks["y"], [90.0, 90.0, 50.0, 60.0])
    assert tracks.attrs["particles"] == 3  # one was never seen
    (tmp_path / "a.csv").write_text(GOOD)
    assert read_dem(tmp_path / "a.csv").equals(tracks)


def test_the_authors_files_hold_the_papers_particles(authors_data):
    """They end at most 15 mm before the edge, so far arrivals are extrapolated."""
    tracks = read_dem(paper_2020.find_dem()["spheres"])
    assert tracks.attrs["particles"] == 3713
    assert tracks["x"].between(387.0, 789.0).all()
    assert tracks["y"].between(0.0, 180.0).all()
    end = tracks.groupby("particle")["x"].max()
    phase = PredictionPhase()
    assert end[end > 700.0].min() >= phase.target_mm - phase.extrapolated_mm


MIDPOINTS = (
    "FrameNr,NumberMidPoints,MidPoint_1_x,MidPoint_1_y,MidPoint_2_x,MidPoint_2_y\n"
)
TRACKS = "TrackID_1_X,TrackID_1_Y,TrackID_2_X,TrackID_2_Y\n"
ROWS = "0,2,5,10,50,30\n1,1,5.5,95,NaN,NaN\n2,0,NaN,NaN,NaN,NaN\n"


def write(path, text):
    with gzip.open(path, "wt") as file:
        file.write(text)


@pytest.fixture
def path(tmp_path, monkeypatch):
    """A recording of three frames and the authors' tracks beside it."""
    (tmp_path / "Kugeln").mkdir()
    path = tmp_path / "Kugeln" / "001.csv.gz"
    write(path, MIDPOINTS + ROWS)
    write(
        path.with_name(f"001{HISTORY}.csv.gz"),
        TRACKS + "5,10,NaN,NaN\n5.5,95,NaN,NaN\n",
    )
    monkeypatch.setenv("KILNFLIGHT_RECORDINGS", str(tmp_path))
    return path


def test_positions_and_the_tracks_of_the_authors(path):
    assert find_recordings() == list_recordings(path.parents[1]) == {"spheres": [path]}
    table = read_recording(path)
    assert table.columns.tolist() == ["frame", "x", "y", "author_track"]
    assert table.to_numpy().tolist() == [
        [0, 10, 5, 0],
        [0, 30, 50, -1],
        [1, 95, 5.5, 0],
    ]
    alone = path.with_name("002.csv.gz")
    write(alone, MIDPOINTS + ROWS)
    assert (read_recording(alone)["author_track"] == -1).all()
    alone.unlink()
    plain = path.with_suffix("")  # not packed
    plain.write_bytes(gzip.decompress(path.read_bytes()))
    assert find_recordings() == {"spheres": [plain]}
    pd.testing.assert_frame_equal(read_recording(plain), table)
    join_recordings = notebooks.borrow("44_real_belt").join_recordings
    both = join_recordings([table, table])
    assert both["author_track"].tolist() == [0, -1, 0, 1, -1, 1]
    assert both["frame"].iloc[3] - both["frame"].iloc[2] == 100
    with pytest.raises(InputError, match="recording"):
        join_recordings([])


def test_beside_the_other_data_only_the_published_files_are_used(path, monkeypatch):
    monkeypatch.delenv("KILNFLIGHT_RECORDINGS")
    monkeypatch.setattr("kilnflight.store.paths.external", lambda: path.parents[1])
    assert find_recordings() == {}
    (path.parents[1] / "belt_recordings" / "Kugeln").mkdir(parents=True)
    beside = path.parents[1] / "belt_recordings" / "Kugeln" / "001.csv"
    monkeypatch.setattr(data, "RECORDINGS", ("belt_recordings/Kugeln/001.csv",))
    beside.write_bytes(b"other")
    with pytest.raises(InputError, match=r"001\.csv"):
        find_recordings()
    monkeypatch.setenv("KILNFLIGHT_RECORDINGS", str(path.parent))
    with pytest.raises(InputError, match="KILNFLIGHT_RECORDINGS"):
        find_recordings()


@pytest.mark.parametrize("rows", ["", "0,0,NaN,NaN,NaN,NaN\n1,0,NaN,NaN,NaN,NaN\n"])
def test_a_recording_without_a_measurement_is_empty_and_joins(path, rows):
    whole = read_recording(path)
    write(path, MIDPOINTS + rows)
    empty = read_recording(path)
    assert len(empty) == 0
    pd.testing.assert_series_equal(empty.dtypes, whole.dtypes)
    chapter = notebooks.borrow("44_real_belt")
    both = chapter.join_recordings([empty, whole, empty, whole])
    apart = (
        both["frame"][len(whole) :].to_numpy() - both["frame"][: len(whole)].to_numpy()
    )
    assert (apart == whole["frame"].max() + 2 * 100).all()


BAD = ("0,1,2\n", "0.4,nan\n0.5,0.1\n", "0.4,0.1\n0.4,abc\n", "0.4,inf\n0.5,0.1\n", "")


@pytest.mark.parametrize("text", BAD)
def test_a_bad_table_and_a_torn_file_are_refused(tmp_path, text):
    path = as_zip(tmp_path, text)
    for content in (path.read_bytes(), path.read_bytes()[:60]):
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"tracks\.zip"):
            read_dem(path)


@pytest.mark.parametrize("numbers", [(0, 1, 1), (0, "NaN", 2), (0, 0.5, 1), (-1, 0, 1)])
def test_frames_that_do_not_ascend_and_damaged_files_are_refused(path, numbers):
    write(path, MIDPOINTS + "3,1,5,10,NaN,NaN\n4,1,5,95,NaN,NaN\n9,1,5,500,NaN,NaN\n")
    assert read_recording(path)["frame"].tolist() == [3, 4, 9]
    write(path, MIDPOINTS + "".join(f"{number},1,5,10,NaN,NaN\n" for number in numbers))
    with pytest.raises(InputError, match="FrameNr"):
        read_recording(path)
    write(path, MIDPOINTS.replace(",MidPoint_2_y", "") + "0,1,5,10,50\n")
    with pytest.raises(InputError, match=r"001\.csv"):
        read_recording(path)
    path.write_bytes(b"no gzip")
    with pytest.raises(InputError, match=r"001\.csv"):
        read_recording(path)
