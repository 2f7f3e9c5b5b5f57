import zipfile

import numpy as np
import pytest

from kilnflight.belt.dem import find_dem, read_dem
from kilnflight.checks import InputError

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
        ("0.4,0.1,0.2\n0.4,0.1,0.2\n", "3 columns.*A column is missing"),
        ("0.4,nan\n0.5,0.1\n", "row 1, columns 1 and 2: only one of x and y"),
        ("0.4,0.1\n0.4,abc\n", "not a table of numbers"),
        ("0.4,0.1\n0.4\n", "not a table of numbers"),
        ("", "no row"),
        ("0.4,inf\n0.5,0.1\n", "infinite"),
    ],
)
def test_a_bad_table_is_told(tmp_path, text, message):
    with pytest.raises(InputError, match=rf"tracks\.zip: .*{message}"):
        read_dem(as_zip(tmp_path, text))


def test_a_torn_zip_is_told(tmp_path):
    path = as_zip(tmp_path, GOOD)
    path.write_bytes(path.read_bytes()[:60])
    with pytest.raises(InputError, match="no whole zip file"):
        read_dem(path)


def test_a_damaged_member_is_told(tmp_path):
    path = as_zip(tmp_path, GOOD)
    content = bytearray(path.read_bytes())
    content[40] ^= 0xFF
    path.write_bytes(bytes(content))
    with pytest.raises(InputError, match=r"tracks\.zip"):
        read_dem(path)


def test_a_zip_with_more_than_one_file_is_told(tmp_path):
    with pytest.raises(InputError, match="holds 2 files"):
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
