"""Manifests: each test changes one thing of a good set of four frames, 24 x 32. Then one file."""

import json
import re
import textwrap
from dataclasses import asdict

import h5py
import numpy as np
import pandas as pd
import plyfile
import pytest
import scipy.io
import tifffile
from PIL import Image

from kilnflight.checks import InputError
from kilnflight.recording import importing
from kilnflight.recording.importing import import_recording, read_array, read_manifest, read_points
from kilnflight.recording.store import open_recording

FRAMES = (8, 9, 10, 11)
THEIRS = {0: 0, 60: 1, 120: 2, 180: 3, 240: 4}


def toml(values):
    """Return TOML of a dictionary of values and, below them, tables."""
    plain = {k: v for k, v in values.items() if not isinstance(v, dict)}
    text = "".join(f"{key} = {json.dumps(value)}\n" for key, value in plain.items())
    for name, table in values.items():
        if isinstance(table, dict):
            text += f"[{name}]\n"
            for key, value in table.items():
                inline = (
                    ", ".join(f"{k} = {v}" for k, v in value.items()) if key == "classes" else ""
                )
                text += f"{key} = {{ {inline} }}\n" if inline else f"{key} = {json.dumps(value)}\n"
    return text


class Files:
    """A set of files and their manifest."""

    def __init__(self, folder):
        self.folder = folder
        self.target = folder / "out" / "small.zarr"
        self.entries = {
            "name": "small",
            "frame_rate_hz": 330.0,
            "fraction": "confetti",
            "pressure_bar": 4.5,
            "lance_mm": [1.0, 2.0, 9000.0],
            "roi": [[0, 0], [24, 0], [24, 32]],
            "flame_roi": [2, 8, 3, 9],
            "gray": {"pattern": "gray/{frame:04d}.tif"},
            "coordinates": {"pattern": "xyz/{frame}.mat", "key": "XYZ", "form": "grid"},
            "labels": {"pattern": "labels/{frame:04d}.png", "classes": THEIRS},
        }
        for name in ("gray", "xyz", "labels"):
            (folder / name).mkdir()
        for frame in FRAMES:
            self.write(frame, *self.content(frame))

    @staticmethod
    def content(frame):
        rng = np.random.default_rng(frame)
        grid = rng.normal(5000, 500, (24, 32, 3)).astype(np.float32)
        grid[rng.random((24, 32)) > 0.1] = np.nan
        labels = rng.choice(np.array(list(THEIRS), np.uint8), (24, 32))
        return rng.integers(0, 4096, (24, 32), dtype=np.uint16), grid, labels

    def write(self, frame, gray=None, grid=None, labels=None):
        if gray is not None:
            tifffile.imwrite(self.folder / f"gray/{frame:04d}.tif", gray)
        if grid is not None:
            scipy.io.savemat(self.folder / f"xyz/{frame}.mat", {"XYZ": grid, "other": 1})
        if labels is not None:
            Image.fromarray(labels).save(self.folder / f"labels/{frame:04d}.png")

    @property
    def manifest(self):
        path = self.folder / "small.toml"
        path.write_text(toml(self.entries))
        return path

    def run(self):
        return import_recording(self.manifest, self.target).set_index("what")["value"]

    def fails(self, message):
        with pytest.raises(InputError, match=message) as caught:
            self.run()
        assert "\n" not in str(caught.value)
        assert not self.target.parent.exists() or not list(self.target.parent.iterdir())


@pytest.fixture
def files(tmp_path):
    return Files(tmp_path)


def test_everything_comes_back(files):
    facts = files.run()
    stored = open_recording(files.target)
    assert asdict(stored.attributes) == {
        **{k: v for k, v in files.entries.items() if not isinstance(v, dict)},
        "rows": 24,
        "columns": 32,
        "lance_mm": (1.0, 2.0, 9000.0),
        "roi": ((0, 0), (24, 0), (24, 32)),
        "flame_roi": (2, 8, 3, 9),
    }
    for t, number in enumerate(FRAMES):
        gray, grid, labels = files.content(number)
        frame = stored.frame(t)
        assert (frame.index, frame.time_s) == (number, t / 330.0)
        np.testing.assert_array_equal(frame.gray, gray)
        back = np.full_like(grid, np.nan)
        back[frame.pixels[:, 0], frame.pixels[:, 1]] = frame.xyz
        np.testing.assert_array_equal(back, grid)
        np.testing.assert_array_equal(np.array(list(THEIRS))[frame.labels], labels)
    assert facts["frames"] == "4 of 24 x 32 pixels"
    assert facts["gray"].endswith(" (12 bits)")
    assert facts["labels"] == "4 frames"
    assert [path.name for path in files.target.parent.iterdir()] == ["small.zarr"]


@pytest.mark.parametrize("ending", ["csv", "npy"])
def test_points_with_other_names_units_and_origin(files, ending):
    points = np.array([[1, 1, 0.5, -0.25, 4.0], [24, 32, 0.0, 0.0, 9.0], [3, 3, 0.0, 0.0, -1.0]])
    for number in FRAMES:
        path = files.folder / f"xyz/{number}.{ending}"
        if ending == "csv":
            pd.DataFrame(points, columns=list("vuXYZ")).to_csv(path, index=False)
        else:
            np.save(path, points)
    files.entries["coordinates"] = {
        "pattern": "xyz/{frame}." + ending,
        "form": "points",
        "columns": list("vuXYZ"),
        "origin": 1,
        "unit": "m",
        "invalid": -1,
    }
    files.run()
    frame = open_recording(files.target).frame(2)
    assert frame.pixels.tolist() == [[0, 0], [23, 31]]
    assert frame.xyz.tolist() == [[500.0, -250.0, 4000.0], [0.0, 0.0, 9000.0]]


def test_a_grid_with_a_number_for_invalid(files):
    files.entries["coordinates"]["invalid"] = 0
    for number in FRAMES:
        grid = files.content(number)[1]
        files.write(number, grid=np.where(np.isnan(grid), 0, grid))
    fewest = min(np.isfinite(files.content(k)[1][..., 2]).sum() for k in FRAMES)
    assert files.run()["points"].startswith(f"{fewest} to ")


def test_labels_may_cover_some_frames_and_coordinates_may_lack(files):
    for number in FRAMES[:3]:
        (files.folder / f"labels/{number:04d}.png").unlink()
    del files.entries["coordinates"]
    facts = files.run()
    assert facts["labels"] == "1 frames"
    assert facts["warning"] == "4 of 4 frames without points, the first is 8"
    assert open_recording(files.target).frame(0).labels is None


def test_a_frame_number_may_stand_twice_in_a_pattern(files):
    for number in FRAMES:
        folder = files.folder / f"take_{number}"
        folder.mkdir()
        tifffile.imwrite(folder / f"{number:03d}.tif", files.content(number)[0])
    files.entries["gray"]["pattern"] = "take_{frame}/{frame:03d}.tif"
    assert files.run()["frames"].startswith("4 of ")


def test_the_documented_manifest_is_right(files):
    example = re.search(r"(?ms)^    name = .*?^    classes[^\n]*", importing.__doc__)
    text = textwrap.dedent(example.group()).replace("frame_{frame", "{frame")
    text = text.replace("xyz/{frame:04d}", "xyz/{frame}")
    text = re.sub("(?m)^(roi|flame_roi) .*$", "", text)  # of a larger image
    (files.folder / "example.toml").write_text(text)
    recording = read_manifest(files.folder / "example.toml")
    assert recording.attributes.name == "chips-4.5bar"
    assert len(recording.frame(3).xyz) > 0
    assert recording.frame(0).labels.max() == 4


def change(name, **values):
    return lambda files: files.entries[name].update(values)


def top(**values):
    return lambda files: files.entries.update(values)


def drop(*keys):
    return lambda files: [files.entries.pop(key) for key in keys]


def put(frame, part, edit):
    """Return a change of one file of one frame."""

    def apply(files):
        parts = dict(zip(("gray", "grid", "labels"), files.content(frame), strict=True))
        files.write(frame, **{part: edit(parts[part])})

    return apply


def cut(files):
    path = files.folder / "gray/0010.tif"
    path.write_bytes(path.read_bytes()[:-100])


def at(position, value):
    def edit(array):
        array[position] = value
        return array

    return edit


def remove(name):
    return lambda files: (files.folder / name).unlink()


def lists(row, col):
    """Return a change to point lists, where frame 10 has a point at this pixel."""

    def apply(files):
        for number in FRAMES:
            rows = [[5, 6, 1.0, 2.0, 4000.0], [row, col, 1.0, 2.0, 4000.0]][: 1 + (number == 10)]
            np.save(files.folder / f"xyz/{number}.npy", np.array(rows))
        files.entries["coordinates"] = {"pattern": "xyz/{frame}.npy", "form": "points"}

    return apply


GRAY_10 = r"recording small, frame 10: \S*gray/0010\.tif"
XYZ_10 = r"recording small, frame 10: \S*xyz/10\.mat"
BAD = [
    # frames
    (remove("gray/0010.tif"), r"\[gray\]: frame 10 is missing \(gray/0010\.tif\), 1 in all of 8"),
    (remove("xyz/10.mat"), r"\[coordinates\]: frame 10 is missing \(xyz/10\.mat\)"),
    (remove("gray/0011.tif"), r"\[coordinates\]: \S*xyz/11\.mat is of frame 11, which has no gray"),
    (cut, rf"{GRAY_10} cannot be read .* It is cut off"),
    (put(10, "gray", lambda g: g[:-1]), rf"{GRAY_10}: gray: shape \(23, 32\), expected \(24, 32\)"),
    (put(10, "gray", lambda g: g.astype(np.uint8)), rf"{GRAY_10}: gray is uint8, expected uint16"),
    (put(10, "gray", lambda g: g / 4096), rf"{GRAY_10}: gray is float64, expected uint16"),
    (
        put(8, "gray", lambda g: np.dstack([g] * 3)),
        r"frame 8: \S*0008\.tif has shape \(24, 32, 3\)",
    ),
    # coordinates
    (put(10, "grid", lambda x: x * np.nan), rf"{XYZ_10} holds no position, every one is NaN"),
    (
        put(10, "grid", at((3, 4), np.inf)),
        rf"{XYZ_10}: 1 of \d+ points are not finite.*row 3, col 4",
    ),
    (put(10, "grid", lambda x: x[1:]), r"10\.mat: shape \(23, 32, 3\), expected \(24, 32, 3\)"),
    (change("coordinates", invalid=-1), "frame 8: .*not finite.*A pixel without depth is left out"),
    (change("coordinates", key="xyz"), "frame 8: .*has no 'xyz'; it holds XYZ, other"),
    (lists(24, 3), r"frame 10: \S*10\.npy: 1 point\(s\) outside the image.*row 24, col 3"),
    (lists(-1e12, 3), r"frame 10: \S*10\.npy: 1 point\(s\) outside the image"),
    (lists(2.5, 3), r"frame 10: \S*10\.npy: row 2\.5, col 3 is no pixel"),
    (lists(np.nan, 3), r"frame 10: \S*10\.npy: row nan, col 3 is no pixel"),
    (lists(5, 6), r"frame 10: \S*10\.npy: 1 point\(s\) share a pixel"),
    # labels
    (put(10, "labels", at((3, 4), 7)), r"0010\.png has the unknown class 7 in 1 .*row 3, col 4"),
    (put(10, "labels", lambda a: a[1:]), r"frame 10: labels of \S*0010\.png: shape \(23, 32\)"),
    # the manifest
    (top(fraction="gravel"), r"small\.toml: recording small: unknown fraction 'gravel'; use one"),
    (top(frame_rate_hz=-330.0), "frame_rate_hz: must be above 0, got -330.0"),
    (top(name=5), r"small\.toml: name is 5, expected text"),
    (top(frame_rate_hz="fast"), r"frame_rate_hz: must be above 0, got .fast."),
    (top(roi=[1, 2, 3]), r"small\.toml: a value has the wrong type"),
    (top(lance_mm=[1.0, 2.0]), "expected x, y, z in mm"),
    (top(presure=5), "unknown: presure; it takes name, frame_rate_hz"),
    (drop("name", "frame_rate_hz"), "missing: name, frame_rate_hz"),
    (drop("gray"), r"there is no \[gray\]"),
    (top(gray="gray/*.tif"), r"\[gray\] is 'gray/\*\.tif', expected a table"),
    (change("gray", pattern="gray/{frame}.png"), "no file in .* fits the pattern"),
    (change("gray", pattern="gray/0008.tif"), r"pattern 'gray/0008\.tif' needs \{frame\}"),
    (change("gray", pattern="gray/{number}.tif"), r"needs \{frame\}"),
    (change("gray", pattern=3), r"\[gray\]: pattern is 3, expected str"),
    (change("gray", bits=12), r"\[gray\]: unknown: bits; its keys are pattern, key"),
    (top(coordinates={"pattern": "xyz/{frame}.mat"}), r"\[coordinates\]: missing: form"),
    (change("coordinates", form="cloud"), r"\[coordinates\]: form is 'cloud', expected one of"),
    (change("coordinates", unit="cm"), r"\[coordinates\]: unit is 'cm'"),
    (change("coordinates", invalid="none"), r"\[coordinates\]: invalid is 'none'"),
    (change("coordinates", columns=["a"]), r"\[coordinates\]: columns must be five names"),
    (change("labels", classes={0: 7}), r"\[labels\]: classes has 0 = 7, expected"),
    (change("labels", classes={"wall": 0}), r"\[labels\]: classes has wall = 0, expected"),
]


@pytest.mark.parametrize(("break_it", "message"), BAD)
def test_one_clear_error_and_nothing_left(files, break_it, message):
    break_it(files)
    files.fails(message)


def test_two_files_of_one_frame(files):
    tifffile.imwrite(files.folder / "gray/00008.tif", files.content(8)[0])
    files.fails(r"0008\.tif and .*0008\.tif are both frame 8")


@pytest.mark.parametrize(
    ("content", "message"), [(None, "cannot be read"), (b"name = ", "TOML"), (b"\xff", "TOML")]
)
def test_a_manifest_that_is_none(tmp_path, content, message):
    if content is not None:
        (tmp_path / "m.toml").write_bytes(content)
    with pytest.raises(InputError, match=rf"m\.toml: .*{message}"):
        read_manifest(tmp_path / "m.toml")


def test_an_existing_target_is_left_alone(files):
    files.target.mkdir(parents=True)
    with pytest.raises(InputError, match="exists already"):
        files.run()
    assert files.target.is_dir()


def test_an_import_that_was_killed_starts_again(files):
    left = files.target.parent / ".small.zarr.import" / "small.zarr.part"
    left.mkdir(parents=True)
    (left / "journal.txt").write_text("half")
    files.run()
    assert [path.name for path in files.target.parent.iterdir()] == ["small.zarr"]


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
        ("photo.jpg", b"jpg", "is none of .h5, .hdf5, .mat"),
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
