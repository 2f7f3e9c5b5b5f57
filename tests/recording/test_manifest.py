"""Manifests: each test changes one thing of a good set of four frames, 24 x 32."""

import json
import re
import textwrap

import cv2
import numpy as np
import pandas as pd
import pytest
import scipy.io
import tifffile

from kilnflight.checks import InputError
from kilnflight.film.report import summarise_recording
from kilnflight.recording import files as module
from kilnflight.recording.files import open_any
from kilnflight.recording.frames import calibrated_cloud
from kilnflight.recording.store import write_recording

FRAMES = (8, 9, 10, 11)
CLASSES = {0: 0, 60: 1, 120: 2, 180: 3, 240: 4}
ENTRIES = {
    **{
        "name": "small",
        "frame_rate_hz": 330.0,
        "fraction": "gravel",
        "pressure_bar": 4.5,
    },
    **{"lance_mm": [1.0, 2.0, 9000.0], "roi": [[0, 0], [24, 0], [24, 32]]},
    "gray": {"pattern": "gray/{frame:04d}.tif"},
    "coordinates": {"pattern": "xyz/{frame}.mat", "key": "XYZ", "form": "grid"},
    "labels": {"pattern": "labels/{frame:04d}.png", "classes": CLASSES},
}


def content(frame):
    rng = np.random.default_rng(frame)
    grid = rng.normal(5000, 500, (24, 32, 3)).astype(np.float32)
    grid[rng.random((24, 32)) > 0.1] = np.nan
    labels = rng.choice(np.array(list(CLASSES), np.uint8), (24, 32))
    return rng.integers(0, 4096, (24, 32), dtype=np.uint16), grid, labels


def toml(value):
    if isinstance(value, dict):
        return (
            "{"
            + ", ".join(f"{key} = {toml(item)}" for key, item in value.items())
            + "}"
        )
    return repr(value) if isinstance(value, float) else json.dumps(value)


class Files:
    """A set of files and their manifest."""

    def __init__(self, folder):
        self.folder, self.target = folder, folder / "out" / "small.zarr"
        self.entries = {
            k: dict(v) if isinstance(v, dict) else v for k, v in ENTRIES.items()
        }
        for name in ("gray", "xyz", "labels"):
            (folder / name).mkdir()
        for frame in FRAMES:
            self.write(frame, *content(frame))

    def write(self, frame, gray=None, grid=None, labels=None):
        if gray is not None:
            tifffile.imwrite(self.folder / f"gray/{frame:04d}.tif", gray)
        if grid is not None:
            scipy.io.savemat(
                self.folder / f"xyz/{frame}.mat", {"XYZ": grid, "other": 1}
            )
        if labels is not None:
            cv2.imwrite(str(self.folder / f"labels/{frame:04d}.png"), labels)

    @property
    def manifest(self):
        path = self.folder / "small.toml"
        path.write_text(
            "".join(f"{key} = {toml(v)}\n" for key, v in self.entries.items())
        )
        return path

    def run(self):
        stored = write_recording(open_any(self.manifest), self.target)
        return dict(summarise_recording(stored)), stored


@pytest.fixture
def files(tmp_path):
    return Files(tmp_path)


def test_everything_comes_back(files):
    facts, stored = files.run()
    assert stored.attributes.fraction == "gravel"
    assert stored.attributes.lance_mm == (1.0, 2.0, 9000.0)
    assert stored.attributes.roi == ((0, 0), (24, 0), (24, 32))
    for t, number in enumerate(FRAMES):
        gray, grid, labels = content(number)
        frame = stored.frame(t)
        assert (frame.index, frame.time_s) == (number, t / 330.0)
        np.testing.assert_array_equal(frame.gray, gray)
        stored_grid = np.full_like(grid, np.nan)
        stored_grid[frame.pixels[:, 0], frame.pixels[:, 1]] = frame.xyz
        np.testing.assert_array_equal(stored_grid, grid)
        np.testing.assert_array_equal(np.array(list(CLASSES))[frame.labels], labels)
    assert facts["frames"] == "4 of 24 x 32 pixels"
    assert [path.name for path in files.target.parent.iterdir()] == ["small.zarr"]


CALIBRATIONS = {
    "none": ("none", 5000.0),
    "Eq. 2.4": ("zhang-2023", 4938.0),
    "table": ([[6000, 5000], [4000, 3800]], 4400.0),
    "fit": ({"breakpoints_mm": [], "coefficients": [[0.5, 100.0]]}, 2600.0),
}


@pytest.mark.parametrize(("stated", "true_mm"), CALIBRATIONS.values(), ids=CALIBRATIONS)
def test_depths_are_calibrated_as_the_manifest_states(files, stated, true_mm):
    for frame in FRAMES:
        files.write(frame, grid=np.full((24, 32, 3), (0.0, 500.0, 5000.0), np.float32))
    files.entries["depth_calibration"] = stated
    facts, stored = files.run()
    expected = np.tile([0.0, true_mm / 10, true_mm], (24 * 32, 1))
    np.testing.assert_allclose(calibrated_cloud(stored, 0), expected, rtol=1e-6)
    assert facts["depth"].endswith("as captured") == (stated != "none")


@pytest.mark.parametrize("kind", ["csv", "npy"])
def test_points_with_other_units_and_origin(files, kind):
    points = np.array(
        [[1, 1, 0.5, -0.25, 4.0], [24, 32, 0.0, 0.0, 9.0], [3, 3, 0.0, 0.0, -1.0]]
    )
    for number in FRAMES:
        np.save(files.folder / f"xyz/{number}.npy", points)
        table = pd.DataFrame(points, columns=["row", "col", "x", "y", "z"])
        table[["z", "y", "x", "col", "row"]].to_csv(
            files.folder / f"xyz/{number}.csv", index=False
        )
    pattern = {"pattern": f"xyz/{{frame}}.{kind}", "form": "points"}
    files.entries["coordinates"] = {**pattern, "origin": 1, "unit": "m", "invalid": -1}
    frame = files.run()[1].frame(2)
    assert frame.pixels.tolist() == [[0, 0], [23, 31]]
    assert frame.xyz.tolist() == [[500.0, -250.0, 4000.0], [0.0, 0.0, 9000.0]]


@pytest.mark.parametrize("invalid", [0, np.inf, np.nan])
def test_some_frames_without_labels_or_depth_and_a_number_for_invalid(files, invalid):
    files.entries["coordinates"]["invalid"] = invalid
    for number in FRAMES[1:]:
        grid = content(number)[1]
        files.write(number, grid=np.where(np.isnan(grid), invalid, grid))
        (files.folder / f"labels/{number:04d}.png").unlink()
    (files.folder / "xyz/8.mat").unlink()
    _, stored = files.run()
    assert [len(stored.frame(t).xyz) for t in range(4)] == [
        0 if number == 8 else np.isfinite(content(number)[1][..., 2]).sum()
        for number in FRAMES
    ]
    assert [stored.frame(t).labels is None for t in range(4)] == [
        False,
        True,
        True,
        True,
    ]


def test_the_documented_manifest_is_right(files):
    text = re.search(r"(?ms)^    name = .*?^    classes[^\n]*", module.__doc__).group()
    text = textwrap.dedent(text).replace("frame_{frame", "{frame")
    text = text.replace("xyz/{frame:04d}", "xyz/{frame}")
    text = re.sub("(?m)^(roi|flame_roi) .*$", "", text)  # of a larger image
    (files.folder / "example.toml").write_text(text)
    recording = open_any(files.folder / "example.toml")
    assert recording.attributes.name == "chips-4.5bar"
    assert len(recording.frame(3).xyz) > 0
    assert recording.frame(0).labels.max() == 4


def change(table, **values):
    return lambda files: (files.entries[table] if table else files.entries).update(
        values
    )


def put(part, at, value):
    """Return a change of one value of frame 10."""

    def apply(files):
        parts = dict(zip(("gray", "grid", "labels"), content(10), strict=True))
        parts[part][at] = value
        files.write(10, **{part: parts[part]})

    return apply


def lists(*rows):
    """Return a change to lists of points, in which frame 10 has these."""

    def apply(files):
        for number in FRAMES:
            points = rows if number == 10 else [[5, 6, 1.0, 2.0, 4000.0]]
            np.save(files.folder / f"xyz/{number}.npy", np.array(points, float))
        files.entries["coordinates"] = {"pattern": "xyz/{frame}.npy", "form": "points"}

    return apply


def cut(files):
    path = files.folder / "gray/0010.tif"
    path.write_bytes(path.read_bytes()[:-100])


BAD = [
    (cut, "0010.tif"),
    (lambda files: files.write(10, np.zeros((23, 32), np.uint16)), "frame 10"),
    (lambda files: (files.folder / "gray/0011.tif").unlink(), "11.mat"),
    (put("grid", ..., np.nan), "10.mat"),
    (put("grid", (3, 4), np.inf), "frame 10"),
    (put("labels", (3, 4), 7), "0010.png"),
    (lambda files: files.write(10, grid=np.ones((23, 32, 3))), "10.mat"),
    (lambda files: files.write(10, labels=np.zeros((23, 32), np.uint8)), "0010.png"),
    *((lists([row, 3, 1.0, 2.0, 4000.0]), "10") for row in (24, -1e12, 2.5)),
    (lists([5, 6, 1.0, 2.0, 4000.0], [5, 6, 1.0, 2.0, 4000.0]), "frame 10"),
    (change(None, coordinates={"pattern": "near.npy"}), "near.npy"),
    *((change(None, **{key: value}), key) for key, value in {
        **{"frame_rate_hz": -330.0, "name": 5, "roi": [1, 2, 3], "fraction": 5},
        **{"lance_mm": [1.0, 2.0], "depth_calibration": "mine", "presure": 5},
        "rows": 5,
    }.items()),
    *((change(None, flame_roi=region), "flame_roi")
      for region in ([8, 9], [8, 2, 3, 9], [2.5, 8, 3, 9])),
    (change(None, name="a/b"), "name"),
    (change(None, lance_mm=["a", 2.0, 3.0]), "lance_mm"),
    (change(None, lance_mm=[]), "lance_mm"),
    (change(None, roi=[]), "roi"),
    (change(None, roi=[[0], [24, 0], [24, 32]]), "roi"),
    (lambda files: files.entries.pop("frame_rate_hz"), "frame_rate_hz is missing"),
    (lambda files: files.entries.pop("gray"), "gray"),
    (lambda files: files.entries.pop("name"), "name"),
    (change(None, gray="gray/*.tif"), "small.toml"),
    (change("gray", bits=12), "bits"),
    (change("gray", pattern="gray/{frame}.png"), "gray/{frame}.png"),
    (change("gray", pattern=3), "small.toml: [gray] pattern"),
    *((change("coordinates", invalid=value), "[coordinates] invalid")
      for value in ([1], True)),
    *((change("labels", classes={120: value}), "small.toml: [labels] classes")
      for value in (2.5, 300, "b", [1])),
    *((change("coordinates", **{key: value}), key) for key, value in {
        **{"form": "heap", "unit": "ft", "invalid": "none", "origin": 2},
        **{"key": "xyz"},
    }.items()),
    (change("labels", classes={0: 7}), "labels"),
    (change("labels", classes={"wall": 0}), "wall"),
    (lambda files: files.target.mkdir(parents=True), "small.zarr"),
]  # fmt: skip


@pytest.mark.parametrize(("break_it", "named"), BAD)
def test_one_clear_error_and_nothing_left(files, break_it, named):
    break_it(files)
    with pytest.raises(InputError, match=re.escape(named)) as caught:
        files.run()
    assert "\n" not in str(caught.value)
    left = files.target.parent.glob("*") if files.target.parent.exists() else []
    assert [path.name for path in left] in ([], ["small.zarr"])
