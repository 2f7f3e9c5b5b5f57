"""What looks right and is not: it is refused, or read as it is.

One test for each kind: corrected manifests, values that were never written, results of
others, flipped bits, names with brackets.
"""

import hashlib
import json
import os
import subprocess
import sys
import tracemalloc
from dataclasses import fields, replace

import cv2
import h5py
import numpy as np
import pandas as pd
import pytest
import scipy.io
import tifffile
import zarr

import kilnflight
from kilnflight.__main__ import main
from kilnflight.checks import InputError
from kilnflight.recording import files
from kilnflight.recording.files import WHITE, open_any
from kilnflight.recording.frames import Attributes
from kilnflight.recording.manifest import FileTable
from kilnflight.recording.store import open_recording, write_recording
from kilnflight.store.cache import CachedTable

NOISE = np.random.default_rng(3).integers(40, 60, (5, 24, 32)).astype(np.uint8)
MOVED = NOISE.copy()
for t in range(5):
    MOVED[t, 10:14, 4 + 3 * t : 8 + 3 * t] = 250
MANIFEST = """
name = "a"
frame_rate_hz = 330.0
[gray]
pattern = "gray/{frame}.png"
[labels]
pattern = "labels/{frame}-{class}.png"
form = "masks"
classes = { b = 2, c = 3 }
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def pictures(folder, film=MOVED):
    folder.mkdir()
    for t, picture in enumerate(film):
        cv2.imwrite(str(folder / f"a_{t}.png"), picture)
    return folder


def manifest(folder):
    for part in ("gray", "labels"):
        (folder / part).mkdir()
    for t in range(3):
        cv2.imwrite(str(folder / f"gray/{t}.png"), MOVED[t])
        for name in "bc":
            cv2.imwrite(str(folder / f"labels/{t}-{name}.png"), MOVED[t] // 200)
    path = folder / "film.toml"
    path.write_text(MANIFEST)
    return path


def another(value):
    """Return another value of a field than the one that it has."""
    if isinstance(value, dict):
        return value | {"d": 4}
    if isinstance(value, bool):
        return not value
    if isinstance(value, int | float):
        return value + 1
    return {None: 7.5, (): ("told",)}.get(value, f"{value}x")


@pytest.mark.parametrize("of", [FileTable("a"), Attributes("a", 1.0, 24, 32)])
def test_every_entry_changes_the_key_of_a_recording(folder, of):
    """A field that is added later, too."""
    recording = open_any(manifest(folder))
    known = {recording.content()}
    for field in fields(of):
        value = getattr(of, field.name)
        if isinstance(of, Attributes):
            changed = object.__new__(Attributes)
            vars(changed).update(vars(of), **{field.name: another(value)})
            other = replace(recording, attributes=changed)
        else:
            table = replace(of, **{field.name: another(value)})
            parts = [recording.parts[0]._replace(table=table), *recording.parts[1:]]
            other = replace(recording, parts=parts)
        known.add(other.content())
    assert len(known) == 1 + len(fields(of))


@pytest.mark.parametrize("name", ["gray/1.png", "labels/1-b.png", "labels/2-c.png"])
def test_contents_of_files_count_and_their_times_do_not(folder, name):
    path = manifest(folder)
    before = open_any(path).content()
    changed = folder / name
    os.utime(changed, (1, 1))
    assert open_any(path).content() == before
    about = changed.stat()
    content = bytearray(changed.read_bytes())
    content[-1] ^= 1
    changed.write_bytes(content)
    os.utime(changed, ns=(about.st_atime_ns, about.st_mtime_ns))
    assert open_any(path).content() != before


@pytest.mark.parametrize("chunks", [(1, 24, 32), (2, 12, 32), None])
def test_what_was_never_written_is_not_black(folder, chunks):
    for name, written in (("whole.h5", 5), ("half.h5", 3 if chunks else 0)):
        with h5py.File(name, "w") as file:
            film = file.create_dataset("film", NOISE.shape, NOISE.dtype, chunks=chunks)
            if written:
                film[:written] = NOISE[:written]
    np.testing.assert_array_equal(open_any("whole.h5").gray(4), NOISE[4])
    with pytest.raises(InputError, match=r"half\.h5"):
        open_any("half.h5")


def test_a_damaged_part_of_an_hdf5_film_is_named(folder):
    with h5py.File("a.h5", "w") as file:
        options = {"chunks": (1, 24, 32), "fletcher32": True}
        place = file.create_dataset("film", data=NOISE, **options).id.get_chunk_info(3)
    content = bytearray((folder / "a.h5").read_bytes())
    content[place.byte_offset] ^= 1
    (folder / "a.h5").write_bytes(content)
    film = open_any("a.h5")
    np.testing.assert_array_equal(film.gray(2), NOISE[2])
    with pytest.raises(InputError, match=r"a\.h5"):
        film.gray(3)


@pytest.mark.parametrize(
    "name", ["summary.csv", "tracks.parquet", "detections.png", "flights.parquet"]
)
def test_files_that_no_run_wrote_are_kept(folder, name):
    (folder / name).write_text("mine")
    with pytest.raises(InputError, match=name):
        kilnflight.run(MOVED, folder)
    assert (folder / name).read_text() == "mine"
    assert [path.name for path in folder.iterdir()] == [name]


def test_a_picture_of_a_run_is_not_run_into_its_folder(folder):
    kilnflight.run(MOVED, "self")
    before = (folder / "self/detections.png").read_bytes()
    with pytest.raises(InputError):
        kilnflight.run("self/detections.png", "self")
    assert (folder / "self/detections.png").read_bytes() == before


def test_a_folder_holds_the_run_of_one_film(folder):
    for name, film in (("a.zarr", MOVED), ("b.zarr", MOVED[::-1])):
        write_recording(open_any(film), name)
    kilnflight.run("a.zarr", "results")
    earlier = b"of an earlier run"
    (folder / "results/slices.parquet").write_bytes(earlier)
    with (folder / "results/parts/recording.txt").open("a") as known:
        known.write("\n" + hashlib.sha256(earlier).hexdigest())
    (folder / "results/mine.txt").write_text("mine")
    with pytest.raises(InputError, match="results"):
        kilnflight.run("b.zarr", "results")
    kilnflight.run("a.zarr", "results", background="none")
    assert not (folder / "results/slices.parquet").exists()
    assert (folder / "results/mine.txt").exists()


@pytest.mark.parametrize("name", ["summary.csv", "flights.parquet", "tracks.png"])
def test_a_file_of_ones_own_in_the_folder_of_a_run_is_kept(folder, name):
    kilnflight.run(MOVED, "results")
    (folder / "results" / name).write_bytes(b"mine")
    with pytest.raises(InputError, match=name):
        kilnflight.run(MOVED, "results")
    assert (folder / "results" / name).read_bytes() == b"mine"
    (folder / "results" / name).unlink()
    kilnflight.run(MOVED, "results")


def test_a_flipped_bit_of_a_table_is_noticed(tmp_path):
    rng = np.random.default_rng(0)
    made = pd.DataFrame({"row": rng.normal(size=50), "n": np.arange(50), "case": "x"})
    table = CachedTable("a", lambda: made, {}, tmp_path)
    table()
    whole = table.path.read_bytes()
    for bit in rng.integers(0, 8 * len(whole), 400):
        content = bytearray(whole)
        content[bit // 8] ^= 1 << bit % 8
        table.path.write_bytes(content)
        with pytest.raises(InputError, match=table.path.name):
            table()


def test_a_flipped_bit_of_the_values_of_a_result_is_noticed(tmp_path):
    rng = np.random.default_rng(0)
    tracks = pd.DataFrame({"frame": np.arange(900), "row": 1.0, "col": rng.random(900)})
    path = tmp_path / "tracks.parquet"
    kilnflight.write_table(tracks, path)
    whole = path.read_bytes()
    refused = 0
    for bit in rng.integers(0, 8 * len(whole) * 3 // 4, 40):  # names follow the values
        content = bytearray(whole)
        content[bit // 8] ^= 1 << bit % 8
        path.write_bytes(content)
        try:
            pd.testing.assert_frame_equal(kilnflight.read_table(path), tracks)
        except InputError:
            refused += 1
    assert refused > 30


EDITS = {
    "separator": lambda told: told["chunk_key_encoding"]["configuration"].update(
        separator="."
    ),
    "order of bytes": lambda told: told["codecs"][0]["configuration"].update(
        endian="big"
    ),
    "order of axes": lambda told: told["codecs"].insert(
        0, {"name": "transpose", "configuration": {"order": [0, 2, 1]}}
    ),
    "value of what is not there": lambda told: told.update(fill_value=7),
}


@pytest.mark.parametrize("edit", EDITS)
@pytest.mark.parametrize("name", ["gray", "xyz"])
def test_edited_metadata_are_refused_on_opening(folder, edit, name):
    write_recording(open_any(NOISE), "a.zarr")
    path = folder / "a.zarr" / name / "zarr.json"
    told = json.loads(path.read_text())
    EDITS[edit](told)
    path.write_text(json.dumps(told))
    with pytest.raises(InputError, match=name):
        open_recording("a.zarr")


@pytest.mark.parametrize("name", ["film [1]", "a?b", "c*", "{frame}", "d[!e]"])
def test_a_path_that_exists_is_no_pattern(folder, name):
    pictures(folder / name)
    pictures(folder / "film 1", NOISE)  # what some would fit as patterns
    np.save(folder / f"{name}.npy", MOVED)
    tables = manifest(folder / name)
    for path in (name, folder / name, f"{name}/a_*.png", f"{name}/a_{{frame}}.png"):
        np.testing.assert_array_equal(open_any(path).gray(2), MOVED[2])
    assert len(open_any(f"{name}.npy")) == 5
    assert len(open_any(tables).labelled) == 3
    stored = write_recording(open_any(name), f"{name}.zarr")
    assert len(stored) == 5


@pytest.mark.parametrize("value", [1e306, -1e160, np.inf])
def test_a_value_beside_which_all_others_vanish_is_named(value):
    film = NOISE / 7.0
    film[3, 4, 5] = value
    with pytest.raises(InputError, match=rf"frame 3.*{value:g}".replace("+", ".")):
        open_any(film)


@pytest.mark.parametrize("place", ["/dev/fd/1", "/proc/self/fd/1", "/dev/null"])
def test_nothing_is_written_below_dev(folder, place, capsys):
    pd.DataFrame({"frame": [0, 1], "row": 1.0, "col": 2.0}).to_csv("d.csv")
    with pytest.raises(SystemExit):
        main(["track", "d.csv", place])


def test_an_import_does_not_write_into_its_source(folder, monkeypatch, capsys):
    pictures(folder / "frames")
    monkeypatch.chdir("frames")
    before = sorted(folder.rglob("*"))
    with pytest.raises(SystemExit):
        main(["import", "."])
    assert sorted(folder.rglob("*")) == before


@pytest.mark.parametrize("letters", [200, 244, 250, 255])
def test_a_long_name_can_be_written(folder, letters):
    tracks = pd.DataFrame({"frame": [0, 1], "particle": 0, "row": 1.0, "col": 2.0})
    path = folder / f"{'n' * (letters - 4)}.csv"
    kilnflight.write_table(tracks, path)
    pd.testing.assert_frame_equal(kilnflight.read_table(path), tracks)
    assert [each.name for each in folder.iterdir()] == [path.name]
    name = "n" * letters
    assert len(write_recording(open_any(NOISE), name)) == 5
    kilnflight.run(MOVED, f"m{name[1:]}")


@pytest.mark.filterwarnings("ignore")  # three detections are few
def test_a_column_of_the_user_is_not_replaced():
    table = pd.DataFrame({"frame": [0, 10, 20], "row": 1.0, "col": 2.0})
    assert kilnflight.track(table)["number"].tolist() == [0, 10, 20]
    with pytest.raises(InputError, match="number"):
        kilnflight.track(table.assign(number=7))


@pytest.mark.parametrize("word", ["no", "False", 0.0, 2])
def test_a_word_or_number_is_no_yes(word):
    table = pd.DataFrame({"frame": [0, 1], "row": 1.0, "col": 2.0})
    with pytest.raises(InputError):
        kilnflight.track(table, post_processing=word)
    with pytest.raises(InputError):
        kilnflight.detect(MOVED, dark=word)
    with pytest.raises(InputError):
        kilnflight.detect(MOVED, progress=word)
    with pytest.raises(InputError):
        open_any(MOVED, timed=word)


def test_an_hdf5_film_is_read_frame_by_frame(folder):
    film = np.random.default_rng(0).integers(0, 255, (200, 64, 64), dtype=np.uint8)
    with h5py.File("long.h5", "w") as file:
        file.create_dataset("film", data=film, chunks=(1, 64, 64))
    tracemalloc.start()
    try:
        np.testing.assert_array_equal(open_any("long.h5").gray(150), film[150])
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < film.nbytes / 4


def test_no_memory_is_told_in_one_line(folder, monkeypatch, capsys):
    def none_left(*_, **__):
        raise MemoryError

    np.save("a.npy", MOVED)
    monkeypatch.setattr(files, "_recording", none_left)
    with pytest.raises(SystemExit):
        main(["run", "a.npy"])
    (line,) = capsys.readouterr().err.splitlines()
    assert "memory" in line


def test_an_edited_stack_is_read_anew(folder):
    """Also within one session, where arrays of files are kept."""
    tables = folder / "m.toml"
    tables.write_text(
        'name = "s"\nframe_rate_hz = 1.0\n[gray]\npattern = "a.mat"\nform = "stack"\n'
    )
    scipy.io.savemat("a.mat", {"g": np.moveaxis(MOVED, 0, -1)})
    before = open_any(tables)
    np.testing.assert_array_equal(before.gray(2), MOVED[2])
    known = before.content()
    scipy.io.savemat("a.mat", {"g": np.moveaxis(MOVED[:, ::-1], 0, -1)})
    assert before.content() != known
    for recording in (before, open_any(tables)):
        np.testing.assert_array_equal(recording.gray(2), MOVED[2, ::-1])


@pytest.mark.parametrize("pattern", ["m/{class}/{frame}.png", "{frame}-{class}.png"])
@pytest.mark.parametrize("names", [("1", "2"), ("p", "g")])
def test_a_class_is_found_where_its_name_stands_elsewhere(folder, pattern, names):
    for frame in range(1, 4):
        cv2.imwrite(str(folder / f"gray_{frame}.tif"), NOISE[frame])
        for k, name in enumerate(names):
            path = folder / pattern.format(**{"frame": frame, "class": name})
            path.parent.mkdir(parents=True, exist_ok=True)
            mask = np.zeros((24, 32), np.uint8)
            mask[frame, 10 * k : 10 * k + 5] = 1
            cv2.imwrite(str(path), mask)
    classes = ", ".join(f'"{name}" = {k + 2}' for k, name in enumerate(names))
    (folder / "m.toml").write_text(
        'name = "s"\nframe_rate_hz = 1.0\n[gray]\npattern = "gray_{frame}.tif"\n'
        f'[labels]\npattern = "{pattern}"\nform = "masks"\nclasses = {{ {classes} }}\n'
    )
    recording = open_any("m.toml")
    for t in range(3):
        labels = recording.frame(t).labels
        assert np.argwhere(labels).tolist() == [
            [t + 1, k] for k in (*range(5), *range(10, 15))
        ]
        assert set(labels[t + 1]) == {0, 2, 3}


def test_an_edited_recording_is_not_copied(folder):
    stored = write_recording(open_any(NOISE), "a.zarr")
    one, other = (stored.path / f"gray/c/{t}/0/0" for t in (1, 3))
    content = one.read_bytes()
    one.write_bytes(other.read_bytes())
    other.write_bytes(content)
    for opens in (open_any, open_recording):
        with pytest.raises(InputError, match="changed"):
            opens("a.zarr")


@pytest.mark.parametrize(
    ("name", "value"), [("frame_rate_hz", 20.0), ("um_per_px", 3.0), ("name", "b")]
)
def test_an_edited_attribute_of_a_zarr_is_refused(folder, name, value):
    write_recording(open_any(MOVED, frame_rate_hz=10.0), "a.zarr")
    zarr.open_group("a.zarr", mode="r+").attrs[name] = value
    with pytest.raises(InputError, match="changed"):
        open_any("a.zarr")


@pytest.mark.parametrize("value", [1e7, 1e30, -1e30, 1e99])
def test_a_value_that_makes_all_others_one_grey_value_is_refused(value):
    film = MOVED / 255.0
    film[3, 5, 6] = value
    with pytest.raises(InputError, match="frame 3"):
        open_any(film)
    assert open_any(np.minimum(film, 1.0).clip(0)).gray(3).max() == WHITE


@pytest.mark.parametrize("value", [1e7, -1e30, 65_000.0])
@pytest.mark.parametrize("frames", [slice(None), slice(0, 3), slice(4, 5)])
def test_bad_pixels_of_several_frames_are_refused(value, frames):
    film = MOVED / 255.0
    film[frames, 5, 6] = value
    film[frames, 20, 30] = value
    with pytest.raises(InputError, match="one grey value"):
        open_any(film)
    with pytest.raises(InputError, match="one grey value"):
        open_any(film[frames][:1])


def test_particles_that_are_seldom_there_are_no_bad_pixels():
    film = np.zeros((40, 24, 32))
    film[7, 10:12, 10:13] = 1e6
    film[30, 5, 5] = 1e6
    assert open_any(film).gray(7).max() == WHITE
    noise = np.random.default_rng(0).normal(size=film.shape)
    bright = noise.copy()
    bright[7, 10, 10] = 3000.0
    assert open_any(bright).gray(7).max() == WHITE


def test_tiles_that_were_never_written_are_refused(tmp_path):
    tiles = [[None, *np.ones((3, 16, 16), np.uint8)], np.ones((4, 16, 16), np.uint8)]
    for k, first in enumerate(tiles):
        path = tmp_path / f"{k}.tif"
        pages = (tile for tile in (*np.ones((4, 16, 16), np.uint8), *first))
        tifffile.imwrite(path, pages, shape=(2, 32, 32), dtype="u1", tile=(16, 16))
    assert len(open_any(tmp_path / "1.tif")) == 2
    with pytest.raises(InputError, match="written"):
        open_any(tmp_path / "0.tif")


@pytest.mark.parametrize("name", ["/dev/fd/1", "/dev/stdout", "/proc/self/fd/1"])
def test_a_file_by_the_name_of_a_device_is_kept(folder, name):
    """As with >> file: renaming would replace what it holds."""
    (folder / "link.csv").symlink_to(name)
    code = "from kilnflight.store.cache import *; write_whole(Path('link.csv'), b'x')"
    with open("held", "w") as held:
        held.write("mine")
        held.flush()
        done = subprocess.run([sys.executable, "-c", code], stdout=held, check=False)
    assert done.returncode != 0
    assert (folder / "held").read_text() == "mine"


def test_results_do_not_lie_among_the_frames(folder, monkeypatch, capsys):
    monkeypatch.chdir(pictures(folder / "f"))
    with pytest.raises(SystemExit):
        main(["run", "."])
    assert {path.suffix for path in (folder / "f").iterdir()} == {".png"}


def test_a_preview_is_a_picture(folder, capsys):
    np.save("a.npy", MOVED)
    (folder / "notes.txt").write_text("mine")
    with pytest.raises(SystemExit):
        main(["preview", "a.npy", "--to", "notes.txt"])
    assert (folder / "notes.txt").read_text() == "mine"


@pytest.mark.filterwarnings("ignore")
def test_a_link_in_a_circle_is_one_line(folder, capsys):
    (folder / "d.csv").write_text("frame,row,col\n0,1,1\n")
    (folder / "l.csv").symlink_to("l.csv")
    with pytest.raises(SystemExit):
        main(["track", "d.csv", "l.csv"])
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_a_pattern_of_frames_passes_over_other_names(folder):
    for t in range(3):
        cv2.imwrite(f"{t}.png", MOVED[t])
        cv2.imwrite(f"l{t}.png", MOVED[t])
    assert len(open_any("{frame}.png")) == 3


@pytest.mark.parametrize(
    ("entry", "key"),
    [
        ("origin = true", "origin"),
        ("key = 1", "key"),
        ("numbers = true", "numbers"),
        ("classes = { b = true, c = 3 }", "classes"),
        ("classes = { b = 2.0, c = 3 }", "classes"),
    ],
)
def test_entries_of_a_manifest_are_of_their_kind(folder, entry, key):
    path = manifest(folder)
    lines = [line for line in path.read_text().splitlines() if key not in line]
    path.write_text("\n".join([*lines, entry, ""]))
    with pytest.raises(InputError, match=key):
        open_any(path)


@pytest.mark.parametrize("kind", [object, np.float16])
def test_tracks_are_the_same_for_every_kind_of_number(kind):
    frame = np.repeat(np.arange(12), 3)
    table = pd.DataFrame({"frame": frame, "row": 50.0 * (np.arange(36) % 3)})
    table["col"] = 2.0 * frame
    found = kilnflight.track(table.astype(kind), post_processing=False)
    expected = kilnflight.track(table, post_processing=False)
    assert found["particle"].tolist() == expected["particle"].tolist()


def test_whole_numbers_that_floats_skip_are_refused():
    film = MOVED.astype(np.uint64) + 2**60
    with pytest.raises(InputError, match="frame 0"):
        open_any(film)
    assert len(open_any(film - 2**60)) == len(MOVED)


@pytest.mark.parametrize(
    "stated",
    [
        {"rows": -1},
        {"length": "3"},
        {"notes": 3},
        {"exit_point_mm": 1.0},
        {"fraction": np.nan},
        {"name": "a/b"},
    ],
)
def test_facts_that_cannot_be_stated_are_refused(stated):
    with pytest.raises(InputError, match=next(iter(stated))):
        open_any(MOVED, **stated)


@pytest.mark.parametrize("workers", ["3", 1.5, 0, True])
def test_workers_are_a_whole_number(folder, workers):
    with pytest.raises(InputError, match="jobs"):
        kilnflight.run(MOVED, "results", workers=workers)


def test_a_mask_of_a_second_class_that_is_missing_is_named(folder):
    recording = open_any(manifest(folder))
    lost = next((folder / "labels").glob("*-c.png"))
    lost.unlink()
    with pytest.raises(InputError, match=lost.name):
        recording.content()


@pytest.mark.parametrize("name", ["1-b.png", "2-c.png"])
def test_a_mask_that_is_missing_is_no_frame_without_labels(folder, name):
    path = manifest(folder)
    (folder / "labels" / name).unlink()
    with pytest.raises(InputError, match=f"frame {name[0]}"):
        open_any(path)


@pytest.mark.parametrize("span", ["[0.5, 2]", "[true, 3]", "['a', 'b']", "3", "[3, 1]"])
def test_subsets_span_whole_numbers(folder, span):
    path = manifest(folder)
    text = path.read_text()
    path.write_text(text.replace("[gray]", f"subsets = {{ V1 = {span} }}\n[gray]"))
    with pytest.raises(InputError, match=path.name):
        files.open_subsets(path)


@pytest.mark.parametrize("name", ["to", "to/parts"])
def test_a_file_in_place_of_a_folder_is_named(folder, name):
    path = folder / name
    path.parent.mkdir(exist_ok=True)
    path.write_text("mine")
    with pytest.raises(InputError, match="to"):
        kilnflight.run(MOVED, "to")
    assert path.read_text() == "mine"


def test_a_damaged_name_of_the_film_is_no_traceback(folder):
    kilnflight.run(MOVED, "to")
    (folder / "to/parts/recording.txt").write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match="to"):
        kilnflight.run(MOVED, "to")
