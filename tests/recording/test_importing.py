"""Manifests: each test changes one thing of a good set of four frames, 24 x 32."""

import json
import re
import textwrap
from dataclasses import asdict

import numpy as np
import pandas as pd
import pytest
import scipy.io
import tifffile
from PIL import Image

from kilnflight.checks import InputError
from kilnflight.recording import importing
from kilnflight.recording.frames import calibrated_cloud
from kilnflight.recording.importing import import_recording, read_manifest
from kilnflight.recording.store import open_recording

FRAMES = (8, 9, 10, 11)
THEIRS = {0: 0, 60: 1, 120: 2, 180: 3, 240: 4}


def toml(values):
    """Return TOML of a dictionary of values and, below them, tables."""
    plain = {key: value for key, value in values.items() if not isinstance(value, dict)}
    text = "".join(f"{key} = {json.dumps(value)}\n" for key, value in plain.items())
    for name, table in values.items():
        if isinstance(table, dict):
            text += f"[{name}]\n"
            for key, value in table.items():
                inline = (
                    ", ".join(f"{theirs} = {ours}" for theirs, ours in value.items())
                    if key == "classes"
                    else ""
                )
                entry = repr(value) if isinstance(value, float) else json.dumps(value)  # inf, nan
                text += f"{key} = {{ {inline} }}\n" if inline else f"{key} = {entry}\n"
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
        **{key: entry for key, entry in files.entries.items() if not isinstance(entry, dict)},
        "rows": 24,
        "columns": 32,
        "lance_mm": (1.0, 2.0, 9000.0),
        "roi": ((0, 0), (24, 0), (24, 32)),
        "flame_roi": (2, 8, 3, 9),
        "depth_calibration": None,
    }
    for t, number in enumerate(FRAMES):
        gray, grid, labels = files.content(number)
        frame = stored.frame(t)
        assert (frame.index, frame.time_s) == (number, t / 330.0)
        np.testing.assert_array_equal(frame.gray, gray)
        stored_grid = np.full_like(grid, np.nan)
        stored_grid[frame.pixels[:, 0], frame.pixels[:, 1]] = frame.xyz
        np.testing.assert_array_equal(stored_grid, grid)
        np.testing.assert_array_equal(np.array(list(THEIRS))[frame.labels], labels)
    assert facts["frames"] == "4 of 24 x 32 pixels"
    assert facts["gray"].endswith(" (12 bits)")
    assert facts["labels"] == "4 frames"
    assert [path.name for path in files.target.parent.iterdir()] == ["small.zarr"]


CALIBRATIONS = {
    "none": ("none", 5000.0),
    "Eq. 2.4": ("zhang-2023", 4938.0),
    "table": ([[6000, 5000], [4000, 3800]], 4400.0),
    "fit": ({"breakpoints_mm": [], "coefficients": [[0.5, 100.0]]}, 2600.0),
}


@pytest.mark.parametrize(("stated", "true_mm"), CALIBRATIONS.values(), ids=CALIBRATIONS)
def test_depths_are_calibrated_as_the_manifest_states(files, stated, true_mm):
    for frame in FRAMES:  # no text of the default set changes but this one key
        files.write(frame, grid=np.full((24, 32, 3), (0.0, 500.0, 5000.0), np.float32))
    if isinstance(stated, dict):
        files.entries["depth_calibration"] = stated
    else:
        files.entries = {"depth_calibration": stated, **files.entries}
    facts, stored = files.run(), open_recording(files.target)
    expected = np.tile([0.0, true_mm / 10, true_mm], (24 * 32, 1))
    np.testing.assert_allclose(calibrated_cloud(stored, 0), expected, rtol=1e-6)
    lance = stored.attributes.exit_point_mm
    factor = lance[2] / 9000.0
    assert lance == pytest.approx((factor, 2 * factor, lance[2]))
    told = facts.iloc[facts.index.get_loc("depth") + 1]
    assert told.startswith("taken as true" if true_mm == 5000.0 else f"{true_mm:.0f} and")


def test_a_depth_that_the_calibration_puts_behind_the_camera_is_refused(files):
    near = np.full((24, 32, 3), (0.0, 0.0, 500.0), np.float32)
    files.write(9, grid=near)
    files.entries = {"depth_calibration": "zhang-2023", **files.entries}
    files.fails("recording small, frame 9: .* makes -5419 mm of 500 mm.*state the one of this")


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


@pytest.mark.parametrize("invalid", [0, np.inf, np.nan])
def test_a_grid_with_a_number_for_invalid(files, invalid):
    files.entries["coordinates"]["invalid"] = invalid
    for number in FRAMES:
        grid = files.content(number)[1]
        files.write(number, grid=np.where(np.isnan(grid), invalid, grid))
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
    (top(frame_rate_hz=-330.0), "frame_rate_hz: must be"),
    (top(name=5), r"small\.toml: name is 5, expected text"),
    (top(frame_rate_hz="fast"), r"frame_rate_hz: must be"),
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
def test_a_file_that_is_no_manifest_is_refused(tmp_path, content, message):
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
