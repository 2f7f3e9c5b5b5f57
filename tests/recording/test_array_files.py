"""Files of each format, whole, cut and damaged."""

import h5py
import numpy as np
import pandas as pd
import plyfile
import pytest
import scipy.io
import tifffile
from PIL import Image

from kilnflight.checks import InputError
from kilnflight.recording.array_files import read_array, read_points

GRAY = np.random.default_rng(1).integers(0, 4096, (24, 32), dtype=np.uint16)
NAMES = ("row", "col", "x", "y", "z")
POINTS = np.array([[0, 1, 2.5, 3.5, 4000.0], [23, 31, -1.0, 0.25, 9000.0]])


def write_hdf5(path, name, data):
    with h5py.File(path, "w") as file:
        file.create_dataset(name, data=data, compression="gzip")


def write_structured(path):
    kinds = [(name, "i4" if name in ("row", "col") else "f4") for name in NAMES]
    table = np.array([tuple(point) for point in POINTS], dtype=kinds)
    if path.suffix == ".npy":
        np.save(path, table)
    else:
        plyfile.PlyData([plyfile.PlyElement.describe(table, "vertex")]).write(path)


IMAGES = {
    "plain.tif": lambda path: tifffile.imwrite(path, GRAY),
    "zip.tif": lambda path: tifffile.imwrite(path, GRAY, compression="zlib"),
    "motorola.tiff": lambda path: tifffile.imwrite(path, GRAY, byteorder=">"),
    "lzw.tif": lambda path: Image.fromarray(GRAY).save(path, compression="tiff_lzw"),
    "packbits.tif": lambda path: Image.fromarray(GRAY).save(path, compression="packbits"),
    "image.png": lambda path: Image.fromarray(GRAY).save(path),
    "array.npy": lambda path: np.save(path, GRAY),
    "array.npz": lambda path: np.savez_compressed(path, gray=GRAY),
    "v5.mat": lambda path: scipy.io.savemat(path, {"gray": GRAY}, do_compression=True),
    "v73.mat": lambda path: write_hdf5(path, "gray", GRAY.T),  # MATLAB's order of axes
    "data.h5": lambda path: write_hdf5(path, "a/gray", GRAY),
}
POINT_FILES = {
    "points.csv": lambda path: pd.DataFrame(POINTS, columns=NAMES).to_csv(path, index=False),
    "points.ply": write_structured,
    "named.npy": write_structured,
    "plain.npy": lambda path: np.save(path, POINTS),
    "points.mat": lambda path: scipy.io.savemat(path, {"points": POINTS}),
}


@pytest.mark.parametrize("name", IMAGES)
def test_every_format_gives_the_same_image(tmp_path, name):
    IMAGES[name](tmp_path / name)
    image = read_array(tmp_path / name, None, "here")
    assert image.dtype == np.uint16
    np.testing.assert_array_equal(image, GRAY)


@pytest.mark.parametrize("name", POINT_FILES)
def test_every_format_gives_the_same_points(tmp_path, name):
    POINT_FILES[name](tmp_path / name)
    np.testing.assert_array_equal(read_points(tmp_path / name, None, NAMES, "here"), POINTS)


@pytest.mark.parametrize("name", IMAGES)
def test_no_cut_image_is_taken_for_a_whole_one(tmp_path, name, capfd):
    path = tmp_path / name
    IMAGES[name](path)
    content = path.read_bytes()
    # the last bytes of a PNG hold no pixels, a TIFF ends in metadata of no consequence
    for length in np.linspace(0, 0.97 * len(content), 25).astype(int):
        path.write_bytes(content[:length])
        with pytest.raises(InputError, match=f"frame 7: .*{name}"):
            read_array(path, None, "frame 7")
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", [n for n in POINT_FILES if not n.endswith(".csv")])
def test_no_cut_point_file_is_taken_for_a_whole_one(tmp_path, name):
    path = tmp_path / name
    POINT_FILES[name](path)
    content = path.read_bytes()
    for length in range(0, len(content) - 1, 11):
        path.write_bytes(content[:length])
        with pytest.raises(InputError, match=f"frame 7: .*{name}"):
            read_points(path, None, NAMES, "frame 7")


def test_the_key_chooses_and_is_asked_for(tmp_path):
    scipy.io.savemat(tmp_path / "two.mat", {"gray": GRAY, "xyz": POINTS})
    np.testing.assert_array_equal(read_array(tmp_path / "two.mat", "gray", "here"), GRAY)
    with pytest.raises(InputError, match=r"here: .*two\.mat .*needs a key; it holds gray, xyz"):
        read_array(tmp_path / "two.mat", None, "here")
    with pytest.raises(InputError, match=r"has no 'grey'; it holds gray, xyz"):
        read_array(tmp_path / "two.mat", "grey", "here")
    write_hdf5(tmp_path / "one.h5", "a/gray", GRAY)
    np.testing.assert_array_equal(read_array(tmp_path / "one.h5", "/a/gray", "here"), GRAY)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("gone.tif", None, "FileNotFoundError"),
        ("photo.jpg", b"jpg", "is not one of .h5, .hdf5, .mat"),
        ("words.npy", np.array(["a", "b"]), "holds <U1, expected numbers"),
        ("objects.npy", np.array([None]), "cannot be read"),
        ("empty.npy", np.empty(0), "holds no data"),
    ],
)
def test_files_that_are_no_arrays(tmp_path, name, content, message):
    if isinstance(content, bytes):
        (tmp_path / name).write_bytes(content)
    elif content is not None:
        np.save(tmp_path / name, content)
    with pytest.raises(InputError, match=f"frame 7: .*{name} .*{message}"):
        read_array(tmp_path / name, None, "frame 7")


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.csv", "row,col,x,y\n1,2,3,4\n", "no column z; it has row, col, x, y"),
        ("a.csv", "row,col,x,y,z\n1,2,3,4,far\n", "could not convert"),
        ("a.csv", "row,col,x,y,z\n1,2,3,4,5\n1,2,3", "last line has fewer columns"),
        ("a.csv", "", "EmptyDataError"),
        ("a.ply", "ply\nformat ascii 1.0\nelement face 0\nend_header\n", "KeyError"),
    ],
)
def test_point_files_that_lack_something(tmp_path, name, text, message):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=f"frame 7: .*{name} .*{message}"):
        read_points(tmp_path / name, None, NAMES, "frame 7")


def test_points_need_five_columns(tmp_path):
    np.save(tmp_path / "a.npy", POINTS[:, :4])
    with pytest.raises(InputError, match=r"shape \(2, 4\), expected \(n, 5\) for row, col"):
        read_points(tmp_path / "a.npy", None, NAMES, "here")


def test_a_list_without_points_is_empty(tmp_path):
    (tmp_path / "a.csv").write_text("row,col,x,y,z\n")
    np.save(tmp_path / "a.npy", np.empty((0, 5)))
    for name in ("a.csv", "a.npy"):
        assert read_points(tmp_path / name, None, NAMES, "here").shape == (0, 5)
