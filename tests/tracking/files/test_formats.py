"""Files as other programs write them, and files that are none."""

import warnings

import numpy as np
import pandas as pd
import pytest

from kilnflight.checks import InputError
from kilnflight.tracking import files

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
    found = files.read_challenge(write(tmp_path, CHALLENGE))
    assert found.to_numpy().tolist() == [
        [0, 0, 21, 9.5, 0],
        [1, 0, 20, 10.5, 0],
        [4, 2, 2, 1, 3],
    ]
    assert found.columns.tolist() == [*NAMES, "plane"]


def test_what_the_challenge_is_told_of_the_data_is_written(tmp_path):
    files.write_challenge(
        pd.DataFrame([[3, 5, 2.5, 1.5]], columns=NAMES).astype({"frame": int, "particle": int}),
        tmp_path / "out.xml",
        snr="4",
        scenario='a "kiln" & more',
    )
    text = (tmp_path / "out.xml").read_text()
    assert """snr="4" density="" scenario='a "kiln" &amp; more'""" in text
    assert '<detection t="3" x="1.5" y="2.5" z="0.0"/>' in text


@pytest.mark.parametrize("header", [1, 4])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_a_table_of_trackmate_with_its_lines_of_names(tmp_path, header, end):
    lines = TRACKMATE.splitlines()
    text = end.join([*lines[:header], *lines[4:], ""])
    found = files.read_trackmate(write(tmp_path, text.replace('"a, b",8,,', '"a, b",8,None,')))
    assert found.to_numpy().tolist() == [[0, -1, 21, 11.5, 0], [1, 2, 20, 10.5, 0]]
    assert files.read_trackmate(write(tmp_path, text)).equals(found)


def test_a_table_of_trackpy_with_its_index(tmp_path):
    table = pd.DataFrame({"y": [2.5, 1.0], "x": [7.0, 3.0], "mass": 9.0, "frame": [3, 1]})
    table["particle"] = [0.0, 0.0]
    table.to_csv(tmp_path / "tracks.csv")
    expected = [[1, 0, 1.0, 3.0], [3, 0, 2.5, 7.0]]
    for found in (files.read_trackpy(tmp_path / "tracks.csv"), files.from_trackpy(table)):
        assert found.to_numpy().tolist() == expected
        assert found["frame"].dtype == found["particle"].dtype == np.int64
        assert found.columns.tolist() == NAMES


def test_trackpy_links_what_it_is_given_and_we_read_it():
    trackpy = pytest.importorskip("trackpy")
    trackpy.quiet()
    seen = pd.DataFrame({"frame": [0, 1, 2] * 2, "y": [0.0, 1, 2, 50, 51, 52], "x": 5.0})
    with warnings.catch_warnings():  # its own calls of pandas
        warnings.simplefilter("ignore")
        linked = trackpy.link(seen, search_range=5)
    found = files.from_trackpy(linked)
    assert found.groupby("particle")["row"].apply(list).tolist() == [[0, 1, 2], [50, 51, 52]]


def test_a_layer_of_napari():
    assert files.from_napari([[7, 3, 1, 2, 9]]).to_numpy().tolist() == [[3, 7, 2, 9, 1]]
    assert files.from_napari(np.empty((0, 4))).columns.tolist() == NAMES
    one = files.from_napari([[7, 3, 2, 9]])
    assert files.to_napari(one).tolist() == [[7, 3, 2, 9]]


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


@pytest.mark.parametrize(
    ("read", "text", "message"),
    [
        (files.read_challenge, CHALLENGE[:-20], "no whole XML file .*line 10"),
        (files.read_challenge, "", "no whole XML file"),
        (files.read_challenge, "<a/>", "has no element TrackContestISBI2012"),
        (files.read_challenge, CHALLENGE.replace('y="20"', ""), "line 5: detection without y"),
        (files.read_challenge, CHALLENGE.replace('"20"', '"NaN"'), "line 5, y: 'NaN'"),
        (files.read_challenge, CHALLENGE.replace('t="1"', 't="1.5"'), "line 5, t: '1.5'"),
        (files.read_challenge, "<root><particle/></root>", "line 1: particle inside of root"),
        (files.read_challenge, "<!DOCTYPE a><a/>", "document type"),
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
def test_a_file_that_is_none_is_told(tmp_path, read, text, message):
    with pytest.raises(InputError, match=message) as raised:
        read(write(tmp_path, text))
    assert str(tmp_path / "file") in str(raised.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 2", "line 1: 2 columns"),
        ("1 NaN 2", "line 1, column 2: 'NaN'"),
        ("1 2 3\nx 2 3", "line 2, column 1: 'x'"),
        ("1.5 2 3", "line 1, column 1: '1.5' is no whole"),
    ],
)
def test_a_trajectory_that_is_none_is_told(tmp_path, text, message):
    path = write(tmp_path, text, "1.txt")
    with pytest.raises(InputError, match=message) as raised:
        files.read_manual(tmp_path)
    assert str(path) in str(raised.value)


def test_what_is_not_there_is_told(tmp_path):
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
        (lambda: files.from_napari([[1, 0.5, 3, 4]]), "whole numbers"),
        (lambda: files.from_napari([[-2, 1, 3, 4]]), "not below 0"),
        (lambda: files.from_napari([[1, np.nan, 3, 4]]), "not finite"),
        (lambda: files.from_trackpy(pd.DataFrame({"y": [1]})), "x missing"),
        (
            lambda: files.from_trackpy(
                pd.DataFrame({"y": [1], "x": [1], "frame": [np.nan], "particle": [0]})
            ),
            "column frame is not made of whole",
        ),
    ],
)
def test_a_table_that_is_none_is_told(call, message):
    with pytest.raises(InputError, match=message):
        call()
