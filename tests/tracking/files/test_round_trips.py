"""What is written is read back to the last digit, in every format."""

import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kilnflight.checks import InputError
from kilnflight.scores import score_tracks
from kilnflight.tracking import files

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


def table(found, planes=True):
    names = ["frame", "particle", "row", "col", "plane"]
    made = pd.DataFrame(found, columns=names).sort_values(["particle", "frame"], ignore_index=True)
    return made if planes else made.drop(columns="plane")


def returned(name, tracks):
    read, write = FORMATS[name]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "tracks.txt"
        write(tracks, path)
        assert [one.name for one in Path(folder).iterdir()] == ["tracks.txt"]
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
@given(found=rows, planes=st.booleans())
def test_every_digit_comes_back(name, found, planes):
    tracks = table(found, planes)
    if name == "manual" and (tracks["particle"] < 0).all():
        return
    pd.testing.assert_frame_equal(returned(name, tracks), expected(name, tracks), check_exact=True)


@formats
def test_no_tracks_are_a_file_without_tracks(name, tmp_path):
    none = table([])[:0].astype({"frame": int, "particle": int, "row": float, "col": float})
    if name == "manual":
        with pytest.raises(InputError, match="holds no track"):
            files.write_manual(none, tmp_path / "none")
        return
    again = returned(name, none.astype({"plane": float}))
    assert again.empty
    assert again.columns.tolist() == ["frame", "particle", "row", "col", "plane"]
    assert again["frame"].dtype == again["particle"].dtype == np.int64


@given(rows)
def test_tables_in_memory_come_back(found):
    tracks = table(found)
    kept = tracks[tracks["particle"] >= 0].reset_index(drop=True)
    for one in (kept, kept.drop(columns="plane")):
        pd.testing.assert_frame_equal(files.from_trackpy(files.to_trackpy(one)), one)
        pd.testing.assert_frame_equal(files.from_napari(files.to_napari(one)), one)


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
def test_what_cannot_be_written_is_told_and_leaves_nothing(name, change, message, tmp_path):
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
