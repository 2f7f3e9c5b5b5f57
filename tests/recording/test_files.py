"""Small files of every kind that is opened, whole, cut and damaged."""

import re

import cv2
import h5py
import numpy as np
import pytest
import scipy.io
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from kilnflight.checks import InputError
from kilnflight.film.report import summarise_recording
from kilnflight.recording.files import open_any
from kilnflight.recording.store import write_recording

FILM = np.random.default_rng(1).integers(0, 200, (5, 24, 32), dtype=np.uint8)
WIDE = FILM.astype(np.uint16) * 300


def film(path, frames=FILM, codec="FFV1", rate=25.0):
    size, colour = frames.shape[2:0:-1], frames.ndim == 4
    writer = cv2.VideoWriter(
        str(path), cv2.VideoWriter_fourcc(*codec), rate, size, colour
    )
    for frame in frames:
        writer.write(frame)
    writer.release()


def pictures(folder, ending, frames, end=""):
    folder.mkdir()
    for number, frame in enumerate(frames, start=8):
        cv2.imwrite(str(folder / f"2_{number:04d}{end}.{ending}"), frame)


def stack(path, frames=WIDE, **more):
    tifffile.imwrite(path, frames, **more)


def hdf5(path, **arrays):
    with h5py.File(path, "w") as file:
        for name, array in arrays.items():
            file.create_dataset(name, data=array, compression="gzip")


def separate_pages(path):
    with tifffile.TiffWriter(path) as writer:
        for frame in WIDE:
            writer.write(frame, contiguous=False)


LZW = [cv2.IMWRITE_TIFF_COMPRESSION, 5]
TWO = np.stack([WIDE, WIDE], axis=1)
COLOURED = np.stack(
    [FILM // 4, FILM // 2, FILM], axis=-1
)  # as OpenCV has it: blue, green, red
KINDS = {
    "film.avi": (film, FILM),
    "film.mp4": (
        lambda path: film(path, np.tile(FILM[:, :1, :1], (24, 32)), "mp4v"),
        None,
    ),
    "stack.tif": (stack, WIDE),
    "motorola.tif": (lambda path: stack(path, byteorder=">"), WIDE),
    "zip.tif": (lambda path: stack(path, compression="zlib"), WIDE),
    "pages.tif": (lambda path: stack(path, metadata=None), WIDE),
    "separate.tif": (separate_pages, WIDE),
    "lzw.tif": (lambda path: cv2.imwritemulti(str(path), list(WIDE), LZW), WIDE),
    "lzw-rgb.tif": (
        lambda path: cv2.imwritemulti(str(path), list(COLOURED), LZW),
        FILM,
    ),
    "imagej.tif": (
        lambda path: stack(path, imagej=True, metadata={"axes": "TYX"}),
        WIDE,
    ),
    "s.ome.tif": (lambda path: stack(path, metadata={"axes": "TYX"}), WIDE),
    "rgb.tif": (lambda path: stack(path, COLOURED[..., ::-1], photometric="rgb"), FILM),
    "one.tif": (lambda path: stack(path, WIDE[0]), WIDE[:1]),
    "one.png": (lambda path: cv2.imwrite(str(path), WIDE[0]), WIDE[:1]),
    "folder8": (lambda path: pictures(path, "png", FILM), FILM),
    "folder16": (lambda path: pictures(path, "tiff", WIDE), WIDE),
    "colours": (lambda path: pictures(path, "png", COLOURED), FILM),
    "jpeg": (lambda path: pictures(path, "jpg", FILM // 200 + 90), FILM // 200 + 90),
    "a.npy": (lambda path: np.save(path, WIDE), WIDE),
    "fortran.npy": (lambda path: np.save(path, np.asfortranarray(WIDE)), WIDE),
    "float.npy": (lambda path: np.save(path, WIDE.astype(np.float32)), WIDE),
    "colour.npy": (lambda path: np.save(path, COLOURED[..., ::-1]), FILM),
    "a.mat": (lambda path: scipy.io.savemat(path, {"film": WIDE}), WIDE),
    "b.mat": (
        lambda path: hdf5(path, film=WIDE.T),
        WIDE,
    ),  # v7.3: MATLAB's order of axes
    "a.h5": (lambda path: hdf5(path, film=WIDE), WIDE),
}


@pytest.mark.parametrize("name", KINDS)
def test_every_kind_is_opened(name, tmp_path):
    make, expected = KINDS[name]
    make(tmp_path / name)
    recording = open_any(tmp_path / name)
    expected = np.tile(FILM[:, :1, :1], (24, 32)) if expected is None else expected
    assert len(recording) == len(expected)
    assert recording.attributes.size == (24, 32)
    assert recording.attributes.frame_rate_hz == (
        25.0 if name.startswith("film") else 1.0
    )
    for t in (*range(len(expected)), 0):  # back to the start, too
        frame = recording.frame(t)
        assert frame.gray.dtype == np.uint16
        assert frame.gray.flags.c_contiguous
        tolerance = 3 if name == "film.mp4" else 0
        np.testing.assert_allclose(frame.gray, expected[t], atol=tolerance)
    assert recording.content() == open_any(str(tmp_path / name)).content()
    coloured = name in ("rgb.tif", "lzw-rgb.tif", "colours", "colour.npy")
    assert ("channel red" in str(recording.attributes.notes)) == coloured


def test_times_in_names_do_not_change_the_order_and_one_picture_is_no_film(tmp_path):
    for k, name in enumerate(("9-58", "9-59", "10-00")):
        (folder := tmp_path / "chips-4.5").mkdir(exist_ok=True)
        cv2.imwrite(str(folder / f"a_{name}.png"), FILM[k])
    with pytest.raises(InputError, match="10-00"):
        open_any(folder)
    (folder / "a_10-00.png").unlink()
    assert open_any(folder).attributes.name == "chips-4.5"
    with pytest.raises(InputError, match="array"):
        open_any(COLOURED[0])


class Lazy:
    def __len__(self):
        return len(FILM)

    def __getitem__(self, t):
        return FILM[t].tolist()


@pytest.mark.parametrize("film", [FILM, list(FILM), np.asfortranarray(FILM), Lazy()])
def test_arrays_and_anything_indexed_are_opened(film):
    recording = open_any(film, frame_rate_hz=50.0)
    assert recording.attributes.frame_rate_hz == 50.0
    np.testing.assert_array_equal([recording.gray(t) for t in range(5)], FILM)
    assert recording.content() == open_any(FILM, frame_rate_hz=50.0).content()
    assert recording.frame(2).time_s == 0.04


def test_a_named_channel(tmp_path):
    pictures(
        tmp_path / "p", "png", np.concatenate([COLOURED, COLOURED[..., :1]], axis=-1)
    )  # alpha
    for source, channel, expected in [
        (tmp_path / "p", "green", FILM // 2),
        (tmp_path / "p", "blue", FILM // 4),
        (COLOURED[..., ::-1], "blue", FILM // 4),
    ]:
        recording = open_any(source, channel=channel)
        np.testing.assert_array_equal(recording.gray(3), expected[3])
        assert recording.attributes.notes == ()
        with pytest.raises(InputError, match="channel"):
            open_any(source, channel="violet")
    with pytest.raises(InputError, match="channel"):
        open_any(FILM, channel="red")  # it is grey


@given(
    hnp.arrays(
        st.sampled_from([np.float32, np.float64, np.int32, np.int64, np.int16]),
        (3, 4, 5),
        # Within 4,096 of the least step: beyond, a few bad pixels are refused.
        elements=st.integers(-2000, 2000),
    ),
    st.sampled_from([1.0, 0.25, 64.0]),
)
@settings(max_examples=15)
def test_whole_gray_values_stay_and_others_are_scaled(values, unit):
    values = values * unit if values.dtype.kind == "f" else values
    recording = open_any(values)
    gray = np.stack([recording.gray(t) for t in range(3)]).astype(float)
    low, high = values.min(), values.max()
    if low >= 0 and high <= 65535 and high != 1 and (values == np.rint(values)).all():
        np.testing.assert_array_equal(gray, values)
        assert recording.attributes.notes == ()
    else:
        scale = 65535 / ((float(high) - low) or 1)
        np.testing.assert_allclose(
            gray, (values.astype(float) - low) * scale, atol=0.51
        )
        assert f"{low:g} to {high:g}" in recording.attributes.notes[0]


@pytest.mark.parametrize(
    "pattern", ["a_*.png", "a_{frame}*.png", "?_{frame:04d}_8bit.png"]
)
@pytest.mark.parametrize(
    ("numbers", "index", "missing"),
    [
        ((3, 4, 5, 9), (3, 4, 5, 9), 3),
        (
            (3, 4, 9, 20_000_000_000_000),
            (3, 4, 9, 20_000_000_000_000),
            19_999_999_999_994,
        ),
        ((10, 20, 30, 50), (0, 1, 2, 4), 1),  # every tenth frame
        ((1700, 1733, 1767, 1867), (0, 1, 2, 5), 2),  # ms of a clock, 30 frames/s
    ],
)
def test_gaps_in_numbers_are_frames_that_are_not_there(
    pattern, numbers, index, missing, tmp_path
):
    for number, frame in zip(numbers, FILM, strict=False):
        name = f"a_{number:04d}" + ("_8bit" if "{" in pattern else "")
        cv2.imwrite(str(tmp_path / f"{name}.png"), frame)
    recording = open_any(tmp_path / pattern, frame_rate_hz=10.0)
    assert tuple(recording.frame(t).index for t in range(4)) == index
    assert recording.frame(2).time_s == (index[2] - index[0]) / 10
    np.testing.assert_array_equal(recording.gray(2), FILM[2])
    assert len(recording.attributes.notes) == 1 + (index[0] == 0)
    assert recording.attributes.notes[-1].startswith(f"{missing} of ")
    stored = write_recording(recording, tmp_path / "o.zarr")
    assert ("note", recording.attributes.notes[-1]) in summarise_recording(stored)
    assert stored.frame(3).index == index[3]
    assert stored.attributes.notes == recording.attributes.notes


BAD = {
    "empty": lambda path: path.mkdir(),
    "none/*.png": lambda path: None,
    "gone.tif": lambda path: None,
    "text.png": lambda path: path.write_bytes(b""),
    "text.tif": lambda path: path.write_text("no picture"),
    "text.avi": lambda path: path.write_text("no film"),
    "text.xyz": lambda path: path.write_text("nothing"),
    "z.tif": lambda path: stack(path, TWO, imagej=True, metadata={"axes": "TZYX"}),
    "channels.ome.tif": lambda path: stack(path, TWO, metadata={"axes": "TCYX"}),
    "no_number": lambda path: (path.mkdir(), cv2.imwrite(str(path / "a.png"), FILM[0])),
    "both_8bit": lambda path: pictures(path, "png", FILM, "_8bit"),
    "two.h5": lambda path: hdf5(path, a=FILM, b=FILM),
    "objects.npy": lambda path: np.save(path, np.array([{}, 1], object)),
    "flat.npy": lambda path: np.save(path, FILM[0]),
    "nothing.npy": lambda path: np.save(path, FILM[:0]),
    "text.npy": lambda path: np.save(path, np.full((3, 4, 5), "a")),
    "number.npy": lambda path: np.save(path, 3.0),
}
WHOLE = (
    "text.xyz",
    "z.tif",
    "channels.ome.tif",
    "two.h5",
)  # neither cut off nor damaged


@pytest.mark.parametrize("name", BAD)
def test_what_cannot_be_opened_is_one_error_with_its_path(name, tmp_path):
    BAD[name](tmp_path / name)
    with pytest.raises(
        InputError, match=re.escape(name.split(".", maxsplit=1)[0])
    ) as error:
        open_any(tmp_path / name)
    assert "\n" not in str(error.value)
    assert name not in WHOLE or "damaged" not in str(error.value)
    assert name != "two.h5" or "a, b" in str(error.value)


@pytest.mark.parametrize(
    "stated", [{"channel": "red"}, {"frame_rate_hz": 5.0}, {"um_per_px": 0.5}]
)
def test_a_stored_recording_keeps_what_it_states(stated, tmp_path):
    write_recording(open_any(FILM), tmp_path / "a.zarr")
    with pytest.raises(InputError, match=next(iter(stated))):
        open_any(tmp_path / "a.zarr", **stated)


def test_a_frame_of_another_size_or_kind_or_a_mask_is_named(tmp_path):
    mixed = open_any([FILM[0], FILM[1] + 0.5])
    with pytest.raises(InputError, match="frame 1"):
        mixed.gray(1)
    pictures(tmp_path / "p", "png", FILM)
    (tmp_path / "p" / "notes.txt").write_text("no picture")
    assert len(open_any(tmp_path / "p")) == 5
    recording = open_any(
        [FILM[0], FILM[1, 1:], np.ma.masked_array(FILM[2], FILM[2] > 9)]
    )
    for t in (1, 2, 3):
        with pytest.raises(InputError, match=f"frame {t}"):
            recording.gray(t)
