"""The authors' DEM tracks and recordings."""

import gzip
import hashlib
import os
import zipfile
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from kilnflight.belt.recordings import (
    TRACKED,
    find_dem,
    find_recordings,
    read_dem,
    read_recording,
)
from kilnflight.belt.tracker import Followed
from kilnflight.checks import InputError
from kilnflight.experiments.belt_real import compare_links, join_recordings, links
from kilnflight.project import data

GOOD = "0.40,0.09,nan,nan\n0.41,0.09,0.39,0.05\nnan,nan,0.40,0.06\n"


def as_zip(folder, text, names=("a.csv",)):
    path = folder / "tracks.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for name in names:
            archive.writestr(name, text)
    return path


def test_columns_become_one_row_per_particle_and_frame(tmp_path):
    tracks = read_dem(as_zip(tmp_path, GOOD))
    assert tracks["particle"].tolist() == [0, 0, 1, 1]
    assert tracks["frame"].tolist() == [0, 1, 1, 2]
    np.testing.assert_allclose(tracks["time_s"], [0.0, 0.01, 0.01, 0.02])
    np.testing.assert_allclose(tracks["x"], [400.0, 410.0, 390.0, 400.0])
    np.testing.assert_allclose(tracks["y"], [90.0, 90.0, 50.0, 60.0])


def test_a_csv_is_read_like_its_zip(tmp_path):
    (tmp_path / "a.csv").write_text(GOOD)
    assert read_dem(tmp_path / "a.csv").equals(read_dem(as_zip(tmp_path, GOOD)))


def test_a_particle_that_was_never_seen_is_counted(tmp_path):
    tracks = read_dem(as_zip(tmp_path, "0.4,0.1,nan,nan\n0.5,0.1,nan,nan\n"))
    assert tracks["particle"].unique().tolist() == [0]
    assert tracks.attrs["particles"] == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0.4,0.1,0.2\n0.4,0.1,0.2\n", "3 columns.* one is missing"),
        ("0.4,nan\n0.5,0.1\n", "row 1, columns 1 and 2: only one of x and y"),
        ("0.4,0.1\n0.4,abc\n", "no table of numbers"),
        ("0.4,0.1\n0.4\n", "row 2, columns 1 and 2: only one of x and y"),
        ("", "no table of numbers"),
        ("0.4,inf\n0.5,0.1\n", "infinite"),
    ],
)
def test_a_bad_table_is_told(tmp_path, text, message):
    with pytest.raises(InputError, match=rf"tracks\.zip: .*{message}"):
        read_dem(as_zip(tmp_path, text))


def test_a_torn_zip_is_told(tmp_path):
    path = as_zip(tmp_path, GOOD)
    path.write_bytes(path.read_bytes()[:60])
    with pytest.raises(InputError, match=r"no table of numbers .*zip"):
        read_dem(path)


def test_a_damaged_member_is_told(tmp_path):
    path = as_zip(tmp_path, GOOD)
    content = bytearray(path.read_bytes())
    content[40] ^= 0xFF
    path.write_bytes(bytes(content))
    with pytest.raises(InputError, match=r"tracks\.zip"):
        read_dem(path)


def test_a_zip_with_more_than_one_file_is_told(tmp_path):
    with pytest.raises(InputError, match=r"no table of numbers .*Multiple files"):
        read_dem(as_zip(tmp_path, GOOD, ("a.csv", "b.csv")))


def test_a_missing_file_is_told(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_dem(tmp_path / "gone.zip")


def test_without_any_file_there_is_nothing_to_find(monkeypatch, tmp_path):
    monkeypatch.setattr("kilnflight.project.paths.external", lambda: tmp_path)
    assert find_dem() == {}


def test_some_but_not_all_files_are_an_error(monkeypatch, tmp_path):
    monkeypatch.setattr(
        "kilnflight.project.data.find", lambda name: tmp_path if "spheres" in name else None
    )
    with pytest.raises(InputError, match="cuboids, cylinders are missing"):
        find_dem()


def test_the_authors_files_hold_the_papers_particles(authors_data):
    counts = {"spheres": 3713, "cuboids": 4357, "cylinders": 4427}
    for name, path in find_dem().items():
        tracks = read_dem(path)
        assert tracks.attrs["particles"] == counts[name]
        assert tracks["x"].between(387.0, 789.0).all()
        assert tracks["y"].between(0.0, 180.0).all()


MIDPOINTS = "FrameNr,NumberMidPoints,MidPoint_1_x,MidPoint_1_y,MidPoint_2_x,MidPoint_2_y\n"
HISTORY = f"{TRACKED}.csv.gz"
TRACKS = "TrackID_1_X,TrackID_1_Y,TrackID_2_X,TrackID_2_Y\n"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "Kugeln").mkdir()
    path = tmp_path / "Kugeln" / "001.csv.gz"
    rows = "0,2,5,10,50,30\n1,1,5.5,95,NaN,NaN\n2,0,NaN,NaN,NaN,NaN\n"
    write(path, MIDPOINTS + rows)
    write(path.with_name("001" + HISTORY), TRACKS + "5,10,NaN,NaN\n5.5,95,NaN,NaN\n")
    monkeypatch.setenv("KILNFLIGHT_RECORDINGS", str(tmp_path))
    return tmp_path


def write(path, text):
    with gzip.open(path, "wt") as file:
        file.write(text)


def test_positions_and_the_tracks_of_the_authors(folder):
    files = find_recordings()
    assert {name: [path.name for path in paths] for name, paths in files.items()} == {
        "spheres": ["001.csv.gz"]
    }
    table = read_recording(files["spheres"][0])
    assert table.columns.tolist() == ["frame", "x", "y", "author_track"]
    assert table.to_numpy().tolist() == [[0, 10, 5, 0], [0, 30, 50, -1], [1, 95, 5.5, 0]]


def test_files_that_are_not_packed_will_do_and_count_once(folder):
    packed = folder / "Kugeln" / "001.csv.gz"
    known = read_recording(packed)
    for path in (packed, packed.with_name("001" + HISTORY)):
        path.with_suffix("").write_bytes(gzip.decompress(path.read_bytes()))
    plain = packed.with_suffix("")
    assert find_recordings() == {"spheres": [plain]}
    packed.with_name("001" + HISTORY).unlink()
    pd.testing.assert_frame_equal(read_recording(plain), known)


@pytest.mark.parametrize("ending", [".csv", ".csv.gz"])
def test_beside_the_other_data_only_the_published_files_are_used(folder, monkeypatch, ending):
    monkeypatch.delenv("KILNFLIGHT_RECORDINGS")
    monkeypatch.setattr("kilnflight.project.paths.external", lambda: folder)
    (folder / "belt_recordings" / "Kugeln").mkdir(parents=True)
    path = folder / "belt_recordings" / "Kugeln" / f"001{ending}"
    path.write_bytes(b"other")
    with pytest.raises(InputError, match=r"001\.csv.*SHA-256"):
        find_recordings()
    name = "belt_recordings/Kugeln/001.csv"
    monkeypatch.setattr(data, "RECORDINGS", (name,))
    monkeypatch.setitem(data.SHA256, name, hashlib.sha256(b"").hexdigest())
    path.write_bytes(gzip.compress(b"") if ending.endswith("gz") else b"")
    assert find_recordings() == {"spheres": [path]}


def test_links_leave_out_what_is_in_no_track(folder):
    table = read_recording(find_recordings()["spheres"][0])
    assert links(table, "author_track").tolist() == [(0, 2)]


def test_links_of_a_tracker_are_compared_with_those_of_the_authors():
    """The authors link 0-1-2 and 3-4; the tracker 0-1, 2-3 and 4 alone, with a missed frame."""
    measured = pd.DataFrame({"frame": range(5), "author_track": [0, 0, 0, 1, 1]})
    states = pd.DataFrame({"row": [0, 1, -1, 2, 3], "particle": [7, 7, 7, 8, 8]})
    ends = pd.DataFrame({"particle": [7, 8], "reason": ["lost", "lost"]})
    assert compare_links(measured, Followed(states, ends)) == {
        "links_authors": 3,
        "links_tracker": 2,
        "recall_percent": pytest.approx(100 / 3),
        "agreed_percent": 50.0,
    }


def test_joined_recordings_share_neither_frames_nor_tracks(folder):
    recording = read_recording(find_recordings()["spheres"][0])
    both = join_recordings([recording, recording])
    assert both["author_track"].tolist() == [0, -1, 0, 1, -1, 1]
    assert both["frame"].iloc[3] - both["frame"].iloc[2] == 100
    assert len(links(both, "author_track")) == 2
    with pytest.raises(InputError, match="at least one"):
        join_recordings([])


def test_where_nothing_is_there(tmp_path, monkeypatch):
    monkeypatch.delenv("KILNFLIGHT_RECORDINGS", raising=False)
    monkeypatch.setenv("KILNFLIGHT_EXTERNAL", str(tmp_path))
    assert find_recordings() == {}
    monkeypatch.setenv("KILNFLIGHT_RECORDINGS", str(tmp_path))
    with pytest.raises(InputError, match="has no recording"):
        find_recordings()


def test_damaged_files_are_told(folder):
    path = folder / "Kugeln" / "001.csv.gz"
    write(path, MIDPOINTS.replace(",MidPoint_2_y", "") + "0,1,5,10,50\n")
    with pytest.raises(InputError, match="one is missing"):
        read_recording(path)
    path.write_bytes(b"no gzip")
    with pytest.raises(InputError, match="no table of numbers"):
        read_recording(path)


def test_missing_frames_stay_missing(folder):
    path = folder / "Kugeln" / "001.csv.gz"
    write(path, MIDPOINTS + "3,1,5,10,NaN,NaN\n4,1,5,95,NaN,NaN\n9,1,5,500,NaN,NaN\n")
    assert read_recording(path)["frame"].tolist() == [3, 4, 9]


@pytest.mark.parametrize("numbers", [(0, 2, 1), (0, 1, 1), (0, "NaN", 2), (0, 0.5, 1), (-1, 0, 1)])
def test_frames_that_do_not_ascend_are_told(folder, numbers):
    path = folder / "Kugeln" / "001.csv.gz"
    write(path, MIDPOINTS + "".join(f"{number},1,5,10,NaN,NaN\n" for number in numbers))
    with pytest.raises(InputError, match=r"001.csv.gz: FrameNr is .* must ascend"):
        read_recording(path)


@pytest.mark.parametrize("rows", ["", "0,0,NaN,NaN,NaN,NaN\n1,0,NaN,NaN,NaN,NaN\n"])
@pytest.mark.parametrize("tracked", [True, False])
def test_a_recording_without_a_measurement_is_empty_and_joins(folder, rows, tracked):
    path = folder / "Kugeln" / "001.csv.gz"
    whole = read_recording(path)
    write(path, MIDPOINTS + rows)
    if not tracked:
        path.with_name(path.name.replace(".csv.gz", HISTORY)).unlink(missing_ok=True)
    empty = read_recording(path)
    assert len(empty) == 0
    assert empty.columns.tolist() == whole.columns.tolist()
    pd.testing.assert_series_equal(empty.dtypes, whole.dtypes)
    both = join_recordings([empty, whole, empty, whole])
    assert both["frame"].min() == 100
    first, second = both[: len(whole)], both[len(whole) :]
    apart = second["frame"].to_numpy() - first["frame"].to_numpy()
    assert (apart == whole["frame"].max() + 2 * 100).all()
    assert not set(first["author_track"]) & set(second["author_track"]) - {-1}
    pd.testing.assert_frame_equal(join_recordings([empty, empty]), empty)


def real():
    project = Path(__file__).resolve().parents[2]
    named = os.environ.get("KILNFLIGHT_RECORDINGS")
    return Path(named) if named else project.parent / "shared" / "data" / "belt_recordings"


REAL = real()


@pytest.mark.parametrize("material", ["Kugeln", "Weizen", "Zylinder"])
def test_the_belt_tracker_finds_the_links_of_the_authors(material):
    from kilnflight.belt.camera import Area
    from kilnflight.belt.tracker import Appearance, BeltTracker
    from kilnflight.tracking.filter import ConstantVelocity

    if not (REAL / material).is_dir():
        pytest.skip(f"the authors' recordings are not in {REAL} (not ours to ship)")
    table = read_recording(sorted((REAL / material).glob("*[0-9].csv.gz"))[0])
    area = Appearance(Area(0, 1700, 2250), arrivals=0.5, entry_mm=85.0, entry_blur_mm=10.0)
    tracker = BeltTracker(ConstantVelocity((85.0, 0.0), 8.0, 1.0, 1.0), area, frame_s=1.0)
    comparison = compare_links(table, tracker(table))
    assert comparison["recall_percent"] >= 99
    assert comparison["agreed_percent"] >= 99
