"""Tables as other programs read and write them."""

import warnings
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest

import kilnflight
from kilnflight.checks import InputError
from kilnflight.recording.track_files import FORMATS, read_table, write_table
from kilnflight.scores import score_tracks

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


@pytest.fixture
def tracks():
    """Three tracks of four frames, one with a gap, and a row in no track."""
    frame, particle = np.divmod(np.arange(12), 3)
    rng = np.random.default_rng(2)
    table = pd.DataFrame({"frame": frame, "particle": particle})
    table[["row", "col"]] = 50 * particle[:, None] + rng.normal(size=(12, 2))
    return pd.concat([table[table.index != 4], table[:1].assign(particle=-1, row=9.0)])


def ending(form):
    return {"challenge": "xml", "csv": "csv"}.get(form, "csv")


@pytest.mark.parametrize("form", ["csv", *FORMATS])
def test_every_export_comes_back(form, tracks, tmp_path):
    path = tmp_path / f"t.{ending(form)}"
    write_table(tracks, path, form)
    found = read_table(path)
    kept = tracks if form == "csv" else tracks[tracks["particle"] >= 0]
    order = ["particle", "frame"]
    np.testing.assert_array_equal(
        found.sort_values(order)[NAMES], kept.sort_values(order)[NAMES]
    )
    score = score_tracks(tracks, found, gate=1e-9)
    assert (score.tp, score.fn, score.fp) == (11, 1, 0)  # of the gap
    assert score.tp_tracks == 3


@pytest.mark.parametrize("form", FORMATS)
def test_a_table_in_memory_has_the_names_of_its_program(form, tracks):
    theirs = tracks[tracks["particle"] >= 0].rename(columns=FORMATS[form])
    assert score_tracks(tracks, theirs, gate=1e-9).tp == 11


def test_a_depth_of_another_program_is_a_plane(tracks, tmp_path):
    for form in FORMATS:
        path = tmp_path / f"t.{ending(form)}"
        write_table(tracks.assign(plane=tracks["row"] / 7), path, form)
        found = read_table(path)
        np.testing.assert_allclose(found["plane"], found["row"] / 7, rtol=1e-14)


SPOTS = """LABEL,ID,TRACK_ID,QUALITY,POSITION_X,POSITION_Y,POSITION_Z,POSITION_T,FRAME
Label,Spot ID,Track ID,Quality,X,Y,Z,T,Frame
Label,Spot ID,Track ID,Quality,X,Y,Z,T,Frame
,,,(quality),(micron),(micron),(micron),(sec),
ID1752,1752,0,36.5,5.25,7.5,0.0,0.0,0
ID1760,1760,0,35.5,5.75,8.5,0.0,0.4,2
ID1770,1770,,9.5,50.0,60.0,0.0,0.4,2
"""
SIMPLE = """<?xml version="1.0" encoding="UTF-8"?>
<Tracks nTracks="2" spaceUnits="micron" frameInterval="0.4" generationDateTime="today">
  <particle nSpots="2">
    <detection t="0" x="5.25" y="7.5" z="0.0" />
    <detection t="2" x="5.75" y="8.5" z="0.0" />
  </particle>
  <particle nSpots="1">
    <detection t="2" x="50.0" y="60.0" z="0.0" />
  </particle>
</Tracks>
"""
BTRACK = "ID,t,x,y,parent,root\n1,0,5.25,7.5,1,1\n1,2,5.75,8.5,1,1\n7,2,50,60,7,7\n"
BOXES = (
    "1,3,3.25,5.5,4,4,1,-1,-1,-1\n3,3,3.75,6.5,4,4,1,-1,-1,-1\n3,9,48,58,4,4,1,1,1,1\n"
)


@pytest.mark.filterwarnings("ignore:.*in micron")
@pytest.mark.parametrize("text", [SPOTS, SIMPLE, BTRACK, BOXES])
def test_tables_that_other_programs_wrote_are_read(text, tmp_path):
    (tmp_path / "a.txt").write_text(text)
    found = read_table(tmp_path / "a.txt")
    places = [[0, 7.5, 5.25], [2, 8.5, 5.75], [2, 60.0, 50.0]]
    assert found[["frame", "row", "col"]].to_numpy().tolist() == places
    first, second, third = found["particle"].tolist()
    assert first == second != third


@pytest.mark.parametrize("text", [SPOTS, SIMPLE])
@pytest.mark.parametrize(
    "unit", ["micron", "\u00b5m", "nm", "mm", "pixel", "pixels", ""]
)
def test_positions_that_are_no_pixels_are_said_once(text, unit, tmp_path):
    path = tmp_path / "a.txt"
    path.write_text(text.replace("micron", unit))
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        assert read_table(path)["col"].tolist() == [5.25, 5.75, 50.0]
    named = [unit in str(each.message) for each in said]
    assert named == [True] * (unit in ("micron", "\u00b5m", "nm", "mm"))


PLAIN = "frame,row,col,z\n0,1.5,2.5,\n1,2.5,3.5,7\n"


def test_a_last_line_without_an_end_is_read_and_said_a_cut_one_refused(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(PLAIN)
    whole = read_table(path)
    path.write_text(PLAIN[:-1])
    with pytest.warns(UserWarning, match=r"a\.csv"):
        pd.testing.assert_frame_equal(read_table(path), whole)
    for cut in (PLAIN[:-3], PLAIN[:-7]):
        path.write_text(cut)
        said = pytest.warns(UserWarning, match=r"a\.csv")
        with said, pytest.raises(InputError, match=r"a\.csv"):
            read_table(path)


@pytest.mark.parametrize(
    ("text", "culprit"),
    [
        (PLAIN + "2,3.5\n", "line 4"),
        (PLAIN.replace("2.5,\n", "2.5,,9\n"), "line 2"),
        (PLAIN.replace("col", "row"), "row"),
        (BOXES.replace("1,3", "0,3", 1), "from 1"),
    ],
)
def test_the_line_or_the_name_that_is_wrong_is_told(text, culprit, tmp_path):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(InputError, match=rf"a\.csv.*{culprit}"):
        read_table(tmp_path / "a.csv")


@pytest.mark.parametrize("separator", [";", "\t"])
@pytest.mark.parametrize("decimal", [".", ","])
def test_cells_between_semicolons_or_tabs_are_read(separator, decimal, tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(PLAIN)
    whole = read_table(path)
    path.write_text(PLAIN.replace(",", separator).replace(".", decimal))
    pd.testing.assert_frame_equal(read_table(path), whole)


def test_boxes_without_a_number_are_in_no_track_and_can_be_linked(tmp_path):
    lines = BOXES.replace(",3,", ",-1,").replace(",9,", ",-1,")
    (tmp_path / "det.txt").write_text(lines)
    assert read_table(tmp_path / "det.txt")["particle"].isna().all()
    cut = SIMPLE.replace("micron", "")[:-20]
    for wrong in ("1,2,3,4,5\n2,2,3,4,5\n", BOXES + "1,2\n", cut, "\n"):
        (tmp_path / "det.txt").write_text(wrong)
        with pytest.raises(InputError, match=r"det\.txt"):
            read_table(tmp_path / "det.txt")


MODEL = """<?xml version="1.0" encoding="UTF-8"?>
<TrackMate version="7.11.1"><Model spatialunits="pixel" timeunits="frame">
<AllSpots nspots="2"><SpotsInFrame frame="0">
<Spot ID="11" FRAME="0" POSITION_X="5.25" POSITION_Y="7.5" POSITION_Z="0.0" />
</SpotsInFrame><SpotsInFrame frame="1">
<Spot ID="12" FRAME="1" POSITION_X="5.75" POSITION_Y="8.5" POSITION_Z="0.0" />
</SpotsInFrame></AllSpots><AllTracks><Track TRACK_ID="0">
<Edge SPOT_SOURCE_ID="11" SPOT_TARGET_ID="12" /></Track></AllTracks></Model></TrackMate>
"""


@pytest.mark.parametrize("text", [MODEL, "<svg></svg>", "<!DOCTYPE html><html/>"])
def test_xml_of_another_kind_is_no_empty_table(text, tmp_path):
    (tmp_path / "a.xml").write_text(text)
    with pytest.raises(InputError, match=r"a\.xml.*(TrackMate|svg|html)"):
        read_table(tmp_path / "a.xml")


def test_spots_without_tracks_are_linked_and_not_scored(tmp_path):
    lines = [line.split(",") for line in SPOTS.splitlines()]
    text = "\n".join(",".join(line[:2] + line[3:]) for line in lines)
    (tmp_path / "a.csv").write_text(f"{text}\n".replace("micron", "pixel"))
    found = read_table(tmp_path / "a.csv")
    assert found[["frame", "row"]].to_numpy().tolist() == [[0, 7.5], [2, 8.5], [2, 60]]
    with pytest.raises(InputError, match="particle"):
        score_tracks(found, found, gate=5.0)
    steps = pytest.warns(UserWarning, match="steps of 2")
    with steps, pytest.warns(UserWarning, match="3 particles"):
        tracks = kilnflight.track(found, max_step=5.0)
    first, second, third = tracks["particle"]
    assert first == second != third


@pytest.mark.parametrize(
    ("name", "form"),
    [
        ("t.xml", "trackmate"),
        ("t.parquet", "napari"),
        ("t.csv", "challenge"),
        ("t.xml", "csv"),
    ],
)
def test_a_name_that_another_format_has_is_refused(name, form, tracks, tmp_path):
    with pytest.raises(InputError, match=name):
        write_table(tracks, tmp_path / name, form)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("read", [read_table, kilnflight.open])
@pytest.mark.parametrize("separator", [",", ";"])
def test_a_table_of_100_000_columns_is_refused(read, separator, tmp_path):
    names = ["frame", "row", "col", *(f"c{k}" for k in range(100_000))]
    path = tmp_path / "wide.csv"
    lines = [separator.join(names), separator.join(["1"] * len(names))]
    path.write_text("\n".join([*lines, ""]))
    with pytest.raises(InputError, match=r"wide\.csv"):
        read(path)


def test_text_between_the_tags_of_xml_is_a_lost_detection(tmp_path):
    tracks = pd.DataFrame({"frame": [0, 1], "particle": 0, "row": 1.0, "col": 2.0})
    path = tmp_path / "t.xml"
    write_table(tracks, path, "challenge")
    text = path.read_text()
    at = text.rindex("<detection")
    path.write_text(f"{text[:at]}}}{text[at + 1 :]}")
    with pytest.raises(InputError, match="text"):
        read_table(path)
