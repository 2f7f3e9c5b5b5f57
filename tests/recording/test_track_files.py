"""Files as other programs write them, files that are none, and what is written is read back."""

import tempfile
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kilnflight.checks import InputError
from kilnflight.recording import track_files as files
from kilnflight.scores import score_tracks

CHALLENGE = """<?xml version="1.0" encoding="ISO-8859-1" standalone="no"?>
<root>
 <TrackContestISBI2012 SNR="7" density="low" scenario="VESICLE" generationDateTime="today">
  <particle>
   <detection t="1" x="10.5" y="20" z="0"/>
   <detection t="0" x="9.5" y="21" z="0"/>
  </particle>
  <particle></particle>
  <particle nSpots="1"><detection t="4" x="1" y="2" z="3"></detection></particle>
 </TrackContestISBI2012>
</root>
"""
TRACKMATE = """LABEL,ID,TRACK_ID,QUALITY,POSITION_X,POSITION_Y,POSITION_Z,POSITION_T,FRAME,RADIUS
Label,Spot ID,Track ID,Quality,X,Y,Z,T,Frame,Radius
Label,Spot ID,Track ID,Quality,X,Y,Z,T,Frame,R
,,,(quality),(micron),(micron),(micron),(sec),,(micron)
ID7,7,2,1.5,10.5,20,0,0.5,1,7.5
"a, b",8,,1.5,11.5,21,0,0.0,0,7.5
"""
MANUAL = "64\tNaN\tNaN\t\n65\t483.785714000000\t\t936.285714000000\n\n66   477.8  937.4\n"
NAMES = ["frame", "particle", "row", "col"]


def write(tmp_path, text, name="file"):
    path = tmp_path / name
    path.write_text(text, newline="")
    return path


def test_a_file_of_the_challenge(tmp_path):
    tracks = files.read_challenge(write(tmp_path, CHALLENGE))
    assert tracks.to_numpy().tolist() == [
        [0, 0, 21, 9.5, 0],
        [1, 0, 20, 10.5, 0],
        [4, 2, 2, 1, 3],
    ]
    assert tracks.columns.tolist() == [*NAMES, "plane"]


@pytest.mark.parametrize("header", [1, 4])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_a_table_of_trackmate_with_its_lines_of_names(tmp_path, header, end):
    lines = TRACKMATE.splitlines()
    text = end.join([*lines[:header], *lines[4:], ""])
    tracks = files.read_trackmate(write(tmp_path, text.replace('"a, b",8,,', '"a, b",8,None,')))
    assert tracks.to_numpy().tolist() == [[0, -1, 21, 11.5, 0], [1, 2, 20, 10.5, 0]]
    assert files.read_trackmate(write(tmp_path, text)).equals(tracks)


def test_a_table_of_trackpy_with_its_index(tmp_path):
    table = pd.DataFrame({"y": [2.5, 1.0], "x": [7.0, 3.0], "mass": 9.0, "frame": [3, 1]})
    table["particle"] = [0.0, 0.0]
    table.to_csv(tmp_path / "tracks.csv")
    expected = [[1, 0, 1.0, 3.0], [3, 0, 2.5, 7.0]]
    for tracks in (files.read_trackpy(tmp_path / "tracks.csv"), files.from_trackpy(table)):
        assert tracks.to_numpy().tolist() == expected
        assert tracks["frame"].dtype == tracks["particle"].dtype == np.int64
        assert tracks.columns.tolist() == NAMES


def test_tracks_of_trackpy_itself_are_read():
    trackpy = pytest.importorskip("trackpy")
    trackpy.quiet()
    detections = pd.DataFrame({"frame": [0, 1, 2] * 2, "y": [0.0, 1, 2, 50, 51, 52], "x": 5.0})
    with warnings.catch_warnings():  # its own calls of pandas
        warnings.simplefilter("ignore")
        linked = trackpy.link(detections, search_range=5)
    tracks = files.from_trackpy(linked)
    assert tracks.groupby("particle")["row"].apply(list).tolist() == [[0, 1, 2], [50, 51, 52]]


def test_a_layer_of_napari():
    assert files.from_napari([[7, 3, 1, 2, 9]]).to_numpy().tolist() == [[3, 7, 2, 9, 1]]
    assert files.from_napari(np.empty((0, 4))).columns.tolist() == NAMES
    flat = files.from_napari([[7, 3, 2, 9]])
    assert files.to_napari(flat).tolist() == [[7, 3, 2, 9]]


def test_a_trajectory_of_figure_5_11(tmp_path):
    write(tmp_path, "64 nan nan", "path_2.txt")
    write(tmp_path, MANUAL, "path_10.txt")
    write(tmp_path, "1 2 3", "path_1.txt")
    assert files.read_manual(tmp_path).to_numpy().tolist() == [
        [1, 0, 2, 3],
        [65, 2, 483.785714, 936.285714],
        [66, 2, 477.8, 937.4],
    ]


def test_a_written_trajectory_names_the_frames_without_it(tmp_path):
    tracks = files.from_napari([[0, 3, 1, 1], [0, 5, 2, 2], [4, 6, 7.5, 8]])
    files.write_manual(tracks, tmp_path / "out")
    assert (tmp_path / "out" / "trajectory_0004.txt").read_text() == (
        "3\tNaN\tNaN\n4\tNaN\tNaN\n5\tNaN\tNaN\n6\t7.5\t8.0\n"
    )
    with pytest.raises(InputError, match="exists already"):
        files.write_manual(tracks, tmp_path / "out")


def test_a_written_trajectory_has_one_row_per_frame(tmp_path):
    tracks = files.from_napari([[2, 3, 1, 1], [2, 3, 2, 2]])
    with pytest.raises(
        InputError, match="write_manual: tracks: particle 2 has two rows in frame 3"
    ):
        files.write_manual(tracks, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("read", "text", "message"),
    [
        (files.read_challenge, CHALLENGE[:-20], "no whole XML file .*line 10"),
        (files.read_challenge, "", "no whole XML file"),
        (files.read_challenge, "<a/>", "has no element TrackContestISBI2012"),
        (files.read_challenge, CHALLENGE.replace('y="20"', ""), "0, detection 0, column y: '' is"),
        (
            files.read_challenge,
            CHALLENGE.replace('"20"', '"NaN"'),
            "0, column y: 'NaN'",
        ),
        (
            files.read_challenge,
            CHALLENGE.replace('t="1"', 't="1.5"'),
            "0, column t: '1.5'",
        ),
        (
            files.read_challenge,
            CHALLENGE.replace("<root>", "<root><particle/>"),
            "a particle stands",
        ),
        (files.read_challenge, CHALLENGE.replace("<particle>", "<a>", 1), "no whole XML file"),
        (files.read_challenge, CHALLENGE.replace("<root>", "<root><detection/>"), "a detection st"),
        (files.read_challenge, "<!DOCTYPE a><a/>", "document type"),
        (
            files.read_challenge,
            '<!DOCTYPE a [<!ENTITY b "' + "b" * 9 + '"><!ENTITY c "&b;&b;">]><a>&c;</a>',
            "document type",
        ),
        (files.read_challenge, '<?xml version="1.0" encoding="no"?><a/>', "no whole XML"),
        (files.read_trackmate, "", "line 1: column.s. FRAME, .* it has none"),
        (files.read_trackmate, TRACKMATE.replace(",20,", ",,"), "line 5, column POSITION_Y: ''"),
        (files.read_trackmate, TRACKMATE.replace("7,2,1.5", "7,x,1.5"), "5, column TRACK_ID: 'x'"),
        (files.read_trackmate, TRACKMATE.replace("0.0,0,", "0.0,x,"), "line 6, column FRAME: 'x'"),
        (files.read_trackmate, TRACKMATE[:-6], "line 6: 9 fields, but line 1 names 10"),
        (files.read_trackpy, "y,x,frame\n1,2,3\n", "column.s. particle missing"),
        (files.read_trackpy, "y,x,frame,particle\n1,2,3,0\ninf,2,4,0\n", "line 3, column y: 'inf'"),
        (files.read_trackpy, "y,x,frame,particle\n1,2,3,0.5\n", "line 2, column particle: '0.5'"),
        (files.read_napari, "ID,T,Y,X\n1,2,3\n", "line 2: 3 fields"),
        (files.read_napari, "ID,T,Z,Y,X\n1,2,,3,4\n", "line 2, column Z: ''"),
        (files.read_napari, "ID,T,Y,X\n" + "1" * 200_000, "after line 1: field larger"),
    ],
)
def test_a_file_that_is_invalid_is_refused(tmp_path, read, text, message):
    with pytest.raises(InputError, match=message) as raised:
        read(write(tmp_path, text))
    assert str(tmp_path / "file") in str(raised.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 2", "line 1: 2 columns"),
        ("1 NaN 2", "line 1, column row: 'NaN'"),
        ("1 2 3\nx 2 3", "line 2, column frame: 'x'"),
        ("1.5 2 3", "line 1, column frame: '1.5' is no whole"),
    ],
)
def test_a_trajectory_that_is_invalid_is_refused(tmp_path, text, message):
    path = write(tmp_path, text, "1.txt")
    with pytest.raises(InputError, match=message) as raised:
        files.read_manual(tmp_path)
    assert str(path) in str(raised.value)


def test_a_missing_file_is_refused(tmp_path):
    for read in (files.read_challenge, files.read_trackmate, files.read_trackpy, files.read_napari):
        with pytest.raises(InputError, match="cannot be read"):
            read(tmp_path / "none")
    with pytest.raises(InputError, match=r"no folder with \.txt files"):
        files.read_manual(tmp_path / "none")
    (tmp_path / "binary").write_bytes(b"\xff\xfe\x80")
    with pytest.raises(InputError, match="cannot be read as text"):
        files.read_napari(tmp_path / "binary")


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: files.from_napari([[1, 2, 3]]), r"expected \(n, 4\) or \(n, 5\)"),
        (lambda: files.from_napari([[1, 0.5, 3, 4]]), "no whole number"),
        (lambda: files.from_napari([[-2, 1, 3, 4]]), "numbered from 0"),
        (lambda: files.from_napari([[1, np.nan, 3, 4]]), "not finite"),
        (lambda: files.from_trackpy(pd.DataFrame({"y": [1]})), "x missing"),
        (
            lambda: files.from_trackpy(
                pd.DataFrame({"y": [1], "x": [1], "frame": [np.nan], "particle": [0]})
            ),
            "column frame holds float64 with gaps",
        ),
    ],
)
def test_a_table_that_is_invalid_is_refused(call, message):
    with pytest.raises(InputError, match=message):
        call()


FORMATS = {
    "challenge": (files.read_challenge, files.write_challenge),
    "trackpy": (files.read_trackpy, files.write_trackpy),
    "trackmate": (files.read_trackmate, files.write_trackmate),
    "napari": (files.read_napari, files.write_napari),
    "manual": (files.read_manual, files.write_manual),
}
formats = pytest.mark.parametrize("name", FORMATS)
coordinate = st.floats(-1e9, 1e9) | st.floats(allow_nan=False, allow_infinity=False)
rows = st.lists(
    st.tuples(st.integers(0, 40), st.integers(-1, 12), coordinate, coordinate, coordinate),
    min_size=1,
    max_size=20,
    unique_by=lambda row: row[:2],
)


def table(rows, planes=True):
    names = ["frame", "particle", "row", "col", "plane"]
    ordered = pd.DataFrame(rows, columns=names).sort_values(
        ["particle", "frame"], ignore_index=True
    )
    return ordered if planes else ordered.drop(columns="plane")


def returned(name, tracks):
    read, write = FORMATS[name]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "tracks.txt"
        write(tracks, path)
        assert [file.name for file in Path(folder).iterdir()] == ["tracks.txt"]
        return read(path)


def expected(name, tracks):
    """What the format can hold of the tracks."""
    if name != "trackmate":
        tracks = tracks[tracks["particle"] >= 0].reset_index(drop=True)
    if name in ("challenge", "manual"):
        tracks = tracks.assign(particle=tracks["particle"].rank(method="dense").astype("int64") - 1)
    if name in ("challenge", "trackmate") and "plane" not in tracks:
        tracks = tracks.assign(plane=0.0)
    return tracks.drop(columns="plane") if name == "manual" and "plane" in tracks else tracks


@formats
@given(entries=rows, planes=st.booleans())
def test_every_digit_comes_back(name, entries, planes):
    tracks = table(entries, planes)
    if name == "manual" and (tracks["particle"] < 0).all():
        return
    pd.testing.assert_frame_equal(returned(name, tracks), expected(name, tracks), check_exact=True)


@formats
def test_no_tracks_are_a_file_without_tracks(name, tmp_path):
    empty = table([])[:0].astype({"frame": int, "particle": int, "row": float, "col": float})
    if name == "manual":
        with pytest.raises(InputError, match="holds no track"):
            files.write_manual(empty, tmp_path / "none")
        return
    tracks = returned(name, empty.astype({"plane": float}))
    assert tracks.empty
    assert tracks.columns.tolist() == ["frame", "particle", "row", "col", "plane"]
    assert tracks["frame"].dtype == tracks["particle"].dtype == np.int64


@given(rows)
def test_tables_in_memory_come_back(entries):
    tracks = table(entries)
    linked = tracks[tracks["particle"] >= 0].reset_index(drop=True)
    for form in (linked, linked.drop(columns="plane")):
        pd.testing.assert_frame_equal(files.from_trackpy(files.to_trackpy(form)), form)
        pd.testing.assert_frame_equal(files.from_napari(files.to_napari(form)), form)


@formats
def test_the_order_of_rows_and_other_columns_do_not_matter(name):
    tracks = table([(t, k, t + 0.1, k / 3, 0.0) for t in range(5) for k in range(3)])
    mixed = tracks.sample(frac=1, random_state=1).assign(gray=7.0)
    pd.testing.assert_frame_equal(returned(name, mixed), returned(name, tracks))
    assert score_tracks(tracks, returned(name, mixed), gate=1.0).alpha == 1.0


@formats
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"frame": 0.5}, "column frame: 0.5 in row 0 is no whole number"),
        ({"particle": "1"}, "column particle holds"),
        ({"particle": -2}, "numbered from 0"),
        ({"row": np.nan}, "not finite"),
        ({"col": "a"}, "not made of numbers"),
    ],
)
def test_what_cannot_be_written_is_refused_and_leaves_nothing(name, change, message, tmp_path):
    tracks = table([(0, 0, 1.0, 2.0, 0.0)])
    _, write = FORMATS[name]
    with pytest.raises(InputError, match=message):
        write(tracks.assign(**change), tmp_path / "out")
    with pytest.raises(InputError, match="missing"):
        write(tracks.drop(columns="row"), tmp_path / "out")
    with pytest.raises(InputError, match="folder does not exist"):
        write(tracks, tmp_path / "no" / "out")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", [name for name in FORMATS if name != "manual"])
def test_what_was_there_stays_until_the_new_is_whole(name, tmp_path, monkeypatch):
    read, write = FORMATS[name]
    path = tmp_path / "tracks"
    write(table([(0, 0, 1.0, 2.0, 0.0)]), path)

    def full(*_args, **_more):
        raise OSError("disk is full")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_text", full)
        with pytest.raises(OSError, match="full"):
            write(table([(0, 0, 5.0, 5.0, 0.0)]), path)
    assert read(path)["row"].tolist() == [1.0]
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_that_could_not_be_filled_is_gone(tmp_path, monkeypatch):
    written = Path.write_text
    calls = iter([written])

    def second_fails(self, *args, **more):
        return next(calls)(self, *args, **more)

    monkeypatch.setattr(Path, "write_text", second_fails)
    with pytest.raises(StopIteration):
        files.write_manual(table([(0, k, 1.0, 1.0, 0.0) for k in range(2)]), tmp_path / "out")
    assert not list(tmp_path.iterdir())
