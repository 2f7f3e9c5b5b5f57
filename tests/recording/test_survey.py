"""Archives of labelled frames in twelve layouts, and in layouts that are wrong."""

import re
import zipfile
from collections import defaultdict
from dataclasses import replace

import numpy as np
import pytest
import scipy.io
from tests.recording.layouts import FIVE, LAYOUTS, MASKS, grid, picture, text

from kilnflight.checks import InputError
from kilnflight.experiments.detection import labelled
from kilnflight.publication import notebooks
from kilnflight.recording import series, survey
from kilnflight.recording.files import open_any, open_subsets
from kilnflight.simulated.kiln import scenes

NUMBERS = (80, 85, 90)  # frames of each subset


class Part:
    """Some frames of a recording."""

    def __init__(self, recording):
        self.recording = recording
        self.attributes = recording.attributes

    def __len__(self):
        return len(NUMBERS)

    def frame(self, t):
        return self.recording.frame(NUMBERS[t])

    def gray(self, t):
        return self.recording.gray(NUMBERS[t])


class Square(Part):
    """The same frames cut to a square, whose rows and columns may be swapped."""

    def __init__(self, part):
        super().__init__(part.recording)

    def frame(self, t):
        frame = super().frame(t)
        side = min(frame.gray.shape)
        inside = frame.pixels[:, 1] < side
        return replace(
            frame,
            gray=frame.gray[:, :side],
            labels=frame.labels[:, :side],
            pixels=frame.pixels[inside],
            xyz=frame.xyz[inside],
        )


@pytest.fixture(scope="module")
def subsets():
    return {name: Part(scenes.open_scene(f"{name}@small", 0)) for name in ("V1", "V4")}


def answered(folder, subsets):
    """Draft the manifest of a folder, answer its questions, and return its path."""
    _, draft = survey.draft(folder)
    known = next(iter(subsets.values())).attributes
    focal = scenes.open_scene("V1@small", 0).scene.geometry.focal_length_px
    draft = draft.replace("focal_length_px = 7727.3", f"focal_length_px = {focal}")
    draft = draft.replace("origin = 1  # ?", "origin = 0  #")
    if "mask_" in draft:  # the draft asks whether it is a picture for each class
        assert 'form = "masks"' in draft
        classes = ", ".join(f"{word} = {kind}" for word, kind in MASKS.items())
        draft = re.sub(r"mask_\w+", "mask_{class}", draft)
        top, labels = draft.split("[labels]")
        labels = labels.replace('form = "grid"', 'form = "masks"')
        labels = labels.replace("classes = {  }", f"classes = {{ {classes} }}")
        draft = f"{top}[labels]{labels}"
    roi = [[float(row), float(col)] for row, col in known.roi]
    path = folder / "labelled.toml"
    path.write_text(f"roi = {roi}\nflame_roi = {[*known.flame_roi]}\n{draft}")
    return path


def table_5_11(of_subsets):
    """Return the counts of the eleven methods, by method."""
    chapter = notebooks.borrow("24_all_methods", scale="quick", seed=0)
    clusters = defaultdict(labelled.SharedClusters)
    attempts = chapter.detect(of_subsets, labelled.OURS, clusters)
    return attempts.groupby("method")[labelled.COUNTS].sum()


@pytest.fixture(scope="module")
def expected(subsets):
    own = [
        labelled.Subset.of_labels(name, part, range(len(part)))
        for name, part in subsets.items()
    ]
    return table_5_11(own)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_gives_the_same_table(tmp_path, subsets, expected, layout):
    if layout == "subsets_by_word":
        subsets = dict(zip(("1_paper", "2_wood"), subsets.values(), strict=True))
    LAYOUTS[layout](tmp_path, subsets)
    found = labelled.open_labelled(answered(tmp_path, subsets))
    assert [subset.name for subset in found] == [*subsets]
    for subset, own in zip(found, subsets.values(), strict=True):
        for t in range(len(NUMBERS)):
            ours = subset.recording.frame(t)
            true = own.frame(t)
            np.testing.assert_array_equal(ours.gray, true.gray)
            np.testing.assert_array_equal(ours.labels, true.labels)
            order = np.lexsort(ours.pixels.T)
            other = np.lexsort(true.pixels.T)
            np.testing.assert_array_equal(ours.pixels[order], true.pixels[other])
            np.testing.assert_allclose(ours.xyz[order], true.xyz[other], rtol=1e-6)
    assert table_5_11(found).equals(expected)


def test_a_zip_is_unpacked_once_and_drafted(tmp_path, subsets):
    folder = tmp_path / "made"
    folder.mkdir()
    LAYOUTS["folders_with_mat"](folder, subsets)
    with zipfile.ZipFile(tmp_path / "set.zip", "w") as file:
        for path in folder.rglob("*.*"):
            file.write(path, path.relative_to(folder))
    assert series.is_archive(tmp_path / "set.zip")
    assert series.is_archive(folder)
    assert not series.is_archive(folder / "V1" / "gray_01.png")
    unpacked = series.unpack(tmp_path / "set.zip")
    assert series.unpack(tmp_path / "set.zip") == unpacked
    assert (
        survey.draft(unpacked)[1].splitlines()[1:]
        == (survey.draft(folder)[1].splitlines()[1:])
    )


def test_another_folder_of_that_name_is_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "set.zip", "w") as file:
        file.writestr("a.txt", "1 2 3\n")
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "mine.txt").write_text("4 5 6\n")
    with pytest.raises(InputError, match=r"set\.zip"):
        series.unpack(tmp_path / "set.zip")


def test_an_archive_that_is_cut_or_none_is_named(tmp_path, subsets):
    whole = tmp_path / "whole.zip"
    with zipfile.ZipFile(whole, "w") as file:
        file.writestr("a.txt", "1 2 3\n" * 100)
    cut = tmp_path / "cut.zip"
    cut.write_bytes(whole.read_bytes()[:200])
    with pytest.raises(InputError, match=r"cut\.zip"):
        series.unpack(cut)
    assert not (tmp_path / "cut").exists()
    with pytest.raises(InputError, match="no pictures"):
        survey.draft(tmp_path / "nothing")


def test_an_archive_with_a_password_is_named(tmp_path):
    path = tmp_path / "closed.zip"
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("a.txt", "1 2 3\n")
    content = bytearray(path.read_bytes())
    content[6] |= 1  # local header: encrypted
    content[content.index(b"PK\x01\x02") + 8] |= 1  # the same in the directory
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"closed\.zip: has a password"):
        series.unpack(path)
    assert not (tmp_path / "closed").exists()


def one_subset(folder, subset, **changes):
    """Write a set of one subset whose parts are changed by functions."""
    for k in range(len(NUMBERS)):
        frame = subset.frame(k)
        parts = {"gray": frame.gray, "labels": frame.labels, "xyz": grid(frame)}
        for name, change in changes.items():
            parts[name] = change(parts[name])
        picture(folder / f"gray_{k}.png", parts["gray"])
        picture(folder / f"labels_{k}.png", parts["labels"])
        scipy.io.savemat(folder / f"xyz_{k}.mat", {"XYZ": parts["xyz"]})


CHANGES = {
    "z back": ({"xyz": lambda xyz: xyz * [1, 1, -1]}, 'z = "back"'),
    "columns lead": ({"xyz": lambda xyz: np.swapaxes(xyz, 0, 1)}, 'order = "col row"'),
    "y down": ({"xyz": lambda xyz: xyz * [1, -1, 1]}, 'y = "down"'),
    "metres": ({"xyz": lambda xyz: xyz / 1000}, 'unit = "m"'),
    "0 for nothing": ({"xyz": np.nan_to_num}, "invalid = 0"),
    "classes": ({"labels": lambda labels: np.uint8(FIVE)[labels]}, "240 = 4"),
}


@pytest.mark.parametrize(("changes", "line"), CHANGES.values(), ids=CHANGES)
def test_what_the_files_decide_stands_in_the_draft(tmp_path, subsets, changes, line):
    one_subset(tmp_path, subsets["V1"], **changes)
    draft = survey.draft(tmp_path)[1]
    assert line in draft
    path = tmp_path / "labelled.toml"
    path.write_text(draft)
    frame = open_any(path).frame(0)
    true = subsets["V1"].frame(0)
    np.testing.assert_array_equal(frame.labels, true.labels)
    np.testing.assert_allclose(
        frame.xyz, true.xyz[np.lexsort(true.pixels.T[::-1])], 1e-6
    )


WRONG = {
    "order of points": ({"xyz": lambda xyz: np.swapaxes(xyz, 0, 1)}, "set order"),
    "y": ({"xyz": lambda xyz: xyz * [1, -1, 1]}, "set y"),
    "unit": ({"xyz": lambda xyz: xyz / 1000}, "unit"),
    "invalid": ({"xyz": np.nan_to_num}, "invalid"),
    "order of labels": ({"labels": lambda labels: labels.T}, "order in [labels]"),
    "millimetres for metres": ({"xyz": lambda xyz: xyz * 1000}, "unit"),
    "classes 2 and 3": (
        {"labels": lambda labels: np.uint8([0, 1, 3, 2, 4])[labels]},
        "set classes",
    ),
    "classes 0 and 4": (
        {"labels": lambda labels: np.uint8([4, 1, 2, 3, 0])[labels]},
        "set classes",
    ),
    "no points": ({"xyz": lambda xyz: np.full_like(xyz, np.nan)}, "[coordinates]"),
}


@pytest.mark.parametrize(("changes", "told"), WRONG.values(), ids=WRONG)
def test_what_contradicts_the_manifest_is_named_with_its_line(
    tmp_path, subsets, changes, told
):
    square = Square(subsets["V1"])
    (tmp_path / "right").mkdir()
    one_subset(tmp_path / "right", square)
    draft = survey.draft(tmp_path / "right")[1]
    one_subset(tmp_path, square, **changes)
    path = tmp_path / "labelled.toml"
    path.write_text(draft)
    with pytest.raises(InputError, match=re.escape(told)):
        labelled.open_labelled(path)


def test_labels_of_another_size_are_named_with_their_file(tmp_path, subsets):
    one_subset(tmp_path, subsets["V1"], labels=lambda labels: labels[::2, ::2])
    path = tmp_path / "labelled.toml"
    path.write_text(survey.draft(tmp_path)[1])
    with pytest.raises(InputError, match=r"labels_0\.png.*\[labels\]"):
        open_any(path).frame(0)


def test_two_subsets_in_one_series_are_refused(tmp_path, subsets):
    LAYOUTS["one_folder_with_hdf5"](tmp_path, subsets)
    path = tmp_path / "labelled.toml"
    mixed = survey.draft(tmp_path)[1].replace("{subset}", "*")
    path.write_text(mixed)
    with pytest.raises(InputError, match=r"labelled\.toml"):
        open_any(path)
    path.write_text(survey.draft(tmp_path)[1])
    with pytest.raises(InputError, match="V1, V4"):
        open_any(path)
    assert [*open_subsets(path)] == ["V1", "V4"]


def test_a_kind_that_all_subsets_would_share_is_refused(tmp_path, subsets):
    LAYOUTS["folders_with_mat"](tmp_path, subsets)
    path = tmp_path / "labelled.toml"
    draft = survey.draft(tmp_path)[1]
    path.write_text(draft.replace("{subset}/truth", "V1/truth"))
    with pytest.raises(InputError, match=r"\[labels\].*\{subset\}"):
        open_subsets(path)


def test_frames_that_are_numbered_through_are_told_apart_by_their_span(
    tmp_path, subsets
):
    both = [part.frame(t) for part in subsets.values() for t in range(len(part))]
    for k, frame in enumerate(both, start=1):
        picture(tmp_path / f"gray_{k}.png", frame.gray)
        picture(tmp_path / f"labels_{k}.png", frame.labels)
    draft = survey.draft(tmp_path)[1]
    path = tmp_path / "labelled.toml"
    asked = "# subsets = { V1 = [1, 10], V2 = [11, 20] }"
    assert asked in draft
    path.write_text(draft.replace(asked, "subsets = { V1 = [1, 3], V4 = [4, 6] }"))
    found = open_subsets(path)
    assert [*found] == [*subsets]
    for name, part in subsets.items():
        assert found[name].labelled == [0, 1, 2]
        for t in range(3):
            frame = found[name].frame(t)
            np.testing.assert_array_equal(frame.labels, part.frame(t).labels)
            np.testing.assert_array_equal(frame.gray, part.frame(t).gray)
    path.write_text(draft.replace(asked, "subsets = { V1 = [3, 1] }"))
    with pytest.raises(InputError, match="V1"):
        open_subsets(path)


def test_columns_in_another_order_are_named_by_the_manifest(tmp_path, subsets):
    frame = subsets["V1"].frame(0)
    picture(tmp_path / "gray_0.png", frame.gray)
    shown = frame.gray[tuple(frame.pixels.T)]
    table = np.column_stack([frame.xyz.astype(np.float64), frame.pixels, shown])
    text(tmp_path / "points_0.txt", table)
    path = tmp_path / "labelled.toml"
    more = '[coordinates]\npattern = "points_{frame}.txt"\nform = "points"\n'
    path.write_text(survey.draft(tmp_path)[1] + more)
    with pytest.raises(InputError, match=r"points_0\.txt"):
        open_any(path).frame(0)
    path.write_text(path.read_text() + 'columns = "x y z row col -"\n')
    ours = open_any(path).frame(0)
    np.testing.assert_array_equal(ours.pixels, frame.pixels)
    np.testing.assert_allclose(ours.xyz, frame.xyz, rtol=1e-6)
    path.write_text(path.read_text().replace("x y z row col -", "x y z row"))
    with pytest.raises(InputError, match="columns"):
        open_any(path)


def test_a_key_that_would_do_nothing_is_refused(tmp_path, subsets):
    one_subset(tmp_path, subsets["V1"])
    path = tmp_path / "labelled.toml"
    draft = survey.draft(tmp_path)[1]
    for kind, line in {"gray": 'order = "col row"', "labels": 'unit = "m"'}.items():
        path.write_text(draft.replace(f"[{kind}]", f"[{kind}]\n{line}"))
        with pytest.raises(InputError, match=line.split()[0]):
            open_any(path)


def test_points_that_no_pixel_fits_get_a_question(tmp_path, subsets):
    rng = np.random.default_rng(0)
    one_subset(tmp_path, subsets["V1"], xyz=rng.permutation)
    assert 'order = "row col"  # ?' in survey.draft(tmp_path)[1]


@pytest.mark.parametrize(
    ("names", "pattern"),
    [
        ("V{s}/gray_{f:02d}.png", "{subset}/gray_{frame}.png"),
        ("gray/V{s}_{f}.png", "gray/{subset}_{frame}.png"),
        ("{f:03d}_V{s}_16bit.png", "{frame}_{subset}_16bit.png"),
        ("V{s}/V{s}_{f}.png", "{subset}/{subset}_{frame}.png"),
        ("V{s}_Frame{f:04d}.png", "{subset}_Frame{frame}.png"),
        ("Label_{s}{f}_V{s}_F{f:03d}.png", "Label_*_{subset}_F{frame}.png"),
        ("V{s}_202{s}/gray_{f}.png", "{subset}_*/gray_{frame}.png"),
        ("V{s}_202{s}/V{s}_{f}.png", "{subset}_*/{subset}_{frame}.png"),
        ("{s}/{f}_t{s}{f}31.png", "{subset}/{frame}_*.png"),
        ("set2/{s}/gray/{f}.png", "set2/{subset}/gray/{frame}.png"),
    ],
)
def test_frames_and_subsets_are_told_by_their_names(tmp_path, names, pattern):
    """There are more subsets than frames."""
    shown = np.arange(2000, dtype=np.uint16).reshape(40, 50)
    for s in range(1, 6):
        for f in range(2):
            picture(tmp_path / names.format(s=s, f=f), shown)
    assert f'pattern = "{pattern}"' in survey.draft(tmp_path)[1]


def test_text_that_is_no_table_is_listed_with_the_reason(tmp_path):
    picture(tmp_path / "gray_1.png", np.arange(2000, dtype=np.uint16).reshape(40, 50))
    text(tmp_path / "cloud_1.csv", np.ones((3, 2)), ",", "a,b")
    told, draft = survey.draft(tmp_path)
    assert "\n[coordinates]" not in draft
    assert "# [coordinates]  # ?" in draft
    assert any("cloud_1.csv" in line and "a, b" in line for line in told)


def test_classes_are_those_of_all_files(tmp_path):
    shown = np.arange(2000, dtype=np.uint16).reshape(40, 50)
    for k, values in enumerate([(0, 120, 240), (0, 60, 180)]):
        picture(tmp_path / f"image_{k}.png", shown)
        labels = np.zeros((40, 50), np.uint8)
        labels[:3, :3] = np.reshape(values * 3, (3, 3))
        picture(tmp_path / f"labels_{k}.png", labels)
    assert "{ 0 = 0, 60 = 1, 120 = 2, 180 = 3, 240 = 4 }" in survey.draft(tmp_path)[1]


def test_another_series_of_one_kind_is_a_question(tmp_path):
    shown = np.arange(2000, dtype=np.uint16).reshape(40, 50)
    for k in range(2):
        picture(tmp_path / f"depth_{k}.png", shown)
        picture(tmp_path / f"image_{k}.png", shown[::-1])
        picture(tmp_path / f"overlay_{k}.png", np.dstack([shown // 8] * 3))
    draft = survey.draft(tmp_path)[1]
    assert draft.count("# ? or pattern") == 2
    assert '\npattern = "overlay' not in draft
