"""What films and stacks state of bits, time, scale and parts, and what they lack."""

import re
import struct
import uuid

import cv2
import numpy as np
import pytest
import tifffile

from kilnflight.checks import InputError
from kilnflight.film.report import summarise_recording
from kilnflight.recording.files import open_any
from kilnflight.recording.store import open_recording, write_recording

DEEP = np.random.default_rng(1).integers(0, 65_536, (6, 24, 32), dtype=np.uint16)
FLAT = (DEEP >> 8).astype(np.uint8)


def film(path, frames, stamps=None, rate=25.0):
    """Write a lossless grey film; ``stamps`` are the numbers at which frames stand."""
    given = [cv2.VIDEOWRITER_PROP_IS_COLOR, 0]
    if frames.dtype == np.uint16:
        given += [cv2.VIDEOWRITER_PROP_DEPTH, cv2.CV_16U]
    codec = cv2.VideoWriter_fourcc(*"FFV1")
    writer = cv2.VideoWriter(str(path), codec, rate, frames.shape[2:0:-1], given)
    for frame in frames:
        writer.write(frame)
    writer.release()
    if stamps is not None:
        content = path.read_bytes()
        for k, stamp in reversed([*enumerate(stamps)]):
            # blocks of track 1 have their time in ms, and flags
            old, new = (
                struct.pack(">h", int(1000 * n / rate + 0.5)) for n in (k, stamp)
            )
            block = rb"\xa3[\x80-\xff]\x81|\xa3[\x40-\x7f].\x81|\xa1.\x81|\xa1..\x81"
            place = re.search(
                rb"(%b)%b[\x80\x00]" % (block, re.escape(old)), content, re.S
            )
            start = place.end(1)
            content = content[:start] + new + content[start + 2 :]
        path.write_bytes(content)
    return path


def film_with_gaps(path):
    """Write an MP4 of 25 frames/s with frames 0, 1, 2, 5, 6, 8; its mean rate is 18."""
    codec = cv2.VideoWriter_fourcc(*"mp4v")
    writer = cv2.VideoWriter(str(path), codec, 25.0, (32, 24), isColor=False)
    for stamp in (0, 1, 2, 5, 6, 8):
        writer.write(np.full((24, 32), 20 * stamp, np.uint8))
    writer.release()
    content = bytearray(path.read_bytes().replace(b"edts", b"free"))

    def number(place):
        return struct.unpack_from(">I", content, place)[0]

    table = content.index(b"stts") + 8  # one entry of frames and ticks each
    tick = number(table + 8)
    runs = [(2, 1), (1, 3), (1, 1), (2, 2)]
    entries = b"".join(struct.pack(">II", n, ticks * tick) for n, ticks in runs)
    content[table : table + 12] = struct.pack(">I", len(runs)) + entries
    for box in (b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stts"):
        size = content.index(box) - 4
        struct.pack_into(">I", content, size, number(size) + len(entries) - 8)
    length = content.index(b"mdhd") + 20
    struct.pack_into(">I", content, length, 10 * tick)
    path.write_bytes(content)


@pytest.mark.parametrize("ending", ["mkv", "avi"])
def test_a_grey_film_of_16_bits_keeps_them_all(ending, tmp_path):
    recording = open_any(film(tmp_path / f"a.{ending}", DEEP))
    for t in (*range(6), 2, 0):  # back, too
        np.testing.assert_array_equal(recording.gray(t), DEEP[t])
    assert recording.attributes.notes == ()


TIMES = {  # rate of the film, frames it has, their numbers, its true rate
    "all": (25.0, range(6), range(6), 25.0),
    "two left out": (25.0, (0, 1, 3, 4, 5, 7), (0, 1, 3, 4, 5, 7), 25.0),
    "a long gap, in whole ms": (330.0, (0, 1, 2, 3, 60, 61), (0, 1, 2, 3, 60, 61), 330),
    "in 2 and 3 ms": (400.0, (0, 1, 2, 3, 4, 6), (0, 1, 2, 3, 4, 6), 400.0),
    "several in a ms": (3000.0, range(6), range(6), 3000.0),
    "a late start": (25.0, (3, 4, 5, 7, 8, 9), (0, 1, 2, 4, 5, 6), 25.0),
    "every second": (50.0, range(0, 12, 2), range(6), 25.0),
}


@pytest.mark.parametrize("kind", TIMES)
def test_frames_of_a_film_stand_where_their_time_says(kind, tmp_path):
    rate, stamps, numbers, true = TIMES[kind]
    recording = open_any(film(tmp_path / "a.mkv", FLAT, stamps, rate))
    frames = [recording.frame(t) for t in range(6)]
    first = frames[0].index
    assert [frame.index - first for frame in frames] == [*numbers]
    assert recording.attributes.frame_rate_hz == pytest.approx(true, rel=0.005)
    assert [frame.time_s for frame in frames] == pytest.approx(
        np.array(numbers) / recording.attributes.frame_rate_hz
    )
    missing = numbers[-1] - 5
    notes = recording.attributes.notes
    assert [note.split()[0] for note in notes] == [f"{missing}"] * (missing > 0)
    np.testing.assert_array_equal(frames[5].gray, FLAT[5])


def test_the_mean_rate_of_a_header_is_not_that_of_a_film_with_gaps(tmp_path):
    film_with_gaps(tmp_path / "a.mp4")
    stated = cv2.VideoCapture(str(tmp_path / "a.mp4")).get(cv2.CAP_PROP_FPS)
    assert stated < 20
    recording = open_any(tmp_path / "a.mp4")
    assert [recording.frame(t).index for t in range(6)] == [0, 1, 2, 5, 6, 8]
    assert recording.attributes.frame_rate_hz == pytest.approx(25.0)
    assert recording.gray(5).mean() == pytest.approx(160, abs=3)


def test_time_that_goes_backwards_and_a_rate_of_0_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"a\.mkv"):
        open_any(film(tmp_path / "a.mkv", FLAT, (0, 1, 2, 7, 6, 8)))
    with pytest.raises(InputError, match="frame_rate_hz"):
        open_any(FLAT, frame_rate_hz=0.0)
    with pytest.raises(InputError, match="um_per_px"):
        open_any(FLAT, um_per_px=0.0)


def imagej(path, axes="TYX", width=1 / 0.65, **told):
    resolution = (width, width)
    metadata = {"axes": axes} | told
    tifffile.imwrite(path, DEEP, imagej=True, resolution=resolution, metadata=metadata)


def ome(path, **told):
    tifffile.imwrite(path, DEEP, ome=True, metadata={"axes": "TYX"} | told)


STATED = {  # what writes the file; frames/s and um/px that follow, None: not known
    "micron": (lambda path: imagej(path, unit="micron", finterval=0.05), 20.0, 0.65),
    "escaped": (lambda path: imagej(path, unit="\\u00B5m"), None, 0.65),
    "mm": (lambda path: imagej(path, width=500.0, unit="mm"), None, 2.0),
    "inch": (lambda path: imagej(path, width=254.0, unit="inch"), None, 100.0),
    "cm": (lambda path: imagej(path, width=1e4, unit="cm"), None, 1.0),
    "pixel": (lambda path: imagej(path), None, None),
    "minutes": (lambda path: imagej(path, finterval=0.5, tunit="min"), 1 / 30, None),
    "ome": (
        lambda path: ome(path, PhysicalSizeX=0.5, TimeIncrement=0.1),
        10.0,
        0.5,
    ),
    "ome with units": (
        lambda path: ome(
            path,
            PhysicalSizeX=106.0,
            PhysicalSizeXUnit="nm",
            TimeIncrement=20.0,
            TimeIncrementUnit="ms",
        ),
        50.0,
        0.106,
    ),
    "ome with a sign": (
        lambda path: ome(path, PhysicalSizeX=0.5, PhysicalSizeXUnit="µm"),
        None,
        0.5,
    ),
    "plain": (lambda path: tifffile.imwrite(path, DEEP), None, None),
}


@pytest.mark.parametrize("kind", STATED)
def test_scale_and_frame_rate_are_read_where_a_stack_states_them(kind, tmp_path):
    make, rate, scale = STATED[kind]
    make(tmp_path / "a.tif")
    recording = open_any(tmp_path / "a.tif")
    known = recording.attributes
    assert known.timed == (rate is not None)
    assert known.frame_rate_hz == pytest.approx(rate or 1.0)
    assert (known.um_per_px or 0.0) == pytest.approx(scale or 0.0)
    assert str(known.notes).count("the file states") == sum(
        value is not None for value in (rate, scale)
    )
    given = open_any(tmp_path / "a.tif", frame_rate_hz=7.0, um_per_px=3.0).attributes
    assert (given.frame_rate_hz, given.um_per_px, given.timed) == (7.0, 3.0, True)


MALFORMED = {
    "PhysicalSizeX": ("0,65", "", "NaN um", "nan", "inf", "-0.65"),
    "TimeIncrement": ("fast", "-1"),
    "finterval": ("0,5", "-inf"),
}


@pytest.mark.parametrize("name", MALFORMED)
def test_a_number_that_is_none_is_told_with_file_and_field(name, tmp_path):
    path = tmp_path / "a.tif"
    for text in MALFORMED[name]:
        if name == "finterval":
            imagej(path, **{name: text})
        else:
            told = f'<OME><Pixels PhysicalSizeY="1" {name}="{text}" /></OME>'
            tifffile.imwrite(path, DEEP, description=told, metadata=None)
        known = open_any(path).attributes
        assert (known.um_per_px, known.timed) == (None, False)
        notes = [note for note in known.notes if "a.tif" in note]
        assert [name in note and text in note for note in notes] == [True] * bool(text)
        given = open_any(path, frame_rate_hz=7.0, um_per_px=3.0).attributes
        assert (given.frame_rate_hz, given.um_per_px) == (7.0, 3.0)


def test_a_unit_that_is_not_known_is_told_and_nothing_follows_from_it(tmp_path):
    imagej(tmp_path / "a.tif", unit="furlong", finterval=2.0, tunit="moon")
    step = {"TimeIncrement": 1.0, "TimeIncrementUnit": "day"}
    ome(tmp_path / "b.tif", PhysicalSizeX=1.0, PhysicalSizeXUnit="mil", **step)
    for name, units in {"a.tif": ("furlong", "moon"), "b.tif": ("mil", "day")}.items():
        known = open_any(tmp_path / name).attributes
        assert (known.um_per_px, known.timed) == (None, False)
        for unit, note in zip(units, known.notes, strict=True):
            assert name in note
            assert unit in note


@pytest.mark.parametrize(("height", "scale"), [(0.4, None), (0.2001, 0.2), (0.0, 0.2)])
def test_pixels_that_are_not_square_have_no_scale_and_it_is_said(
    height, scale, tmp_path
):
    ome(tmp_path / "a.tif", PhysicalSizeX=0.2, PhysicalSizeY=height)
    known = open_any(tmp_path / "a.tif").attributes
    assert known.um_per_px == scale
    assert [("square" in note) for note in known.notes] == [scale is None]


def test_times_of_single_frames_are_not_used_and_it_is_said(tmp_path):
    ome(tmp_path / "a.tif", Plane={"DeltaT": [0.0, 0.1, 0.2, 0.9, 1.0, 1.1]})
    recording = open_any(tmp_path / "a.tif")
    assert [recording.frame(t).index for t in range(6)] == [*range(6)]
    assert ["DeltaT" in note for note in recording.attributes.notes] == [True]


def test_a_file_of_several_pages_after_one_of_one_page_is_named(tmp_path):
    tifffile.imwrite(tmp_path / "a_0.tif", DEEP[0])
    tifffile.imwrite(tmp_path / "a_1.tif", DEEP[1:4], photometric="minisblack")
    recording = open_any(tmp_path)
    np.testing.assert_array_equal(recording.gray(0), DEEP[0])
    with pytest.raises(InputError, match=r"a_1\.tif.* 3 "):
        recording.gray(1)


def test_a_stored_recording_keeps_rate_and_scale(tmp_path):
    imagej(tmp_path / "a.tif", unit="um", finterval=0.05)
    first = write_recording(open_any(tmp_path / "a.tif"), tmp_path / "a.zarr")
    for name, scale in (("b", 2.0), ("c", 3.0)):
        other = open_any(tmp_path / "a.tif", um_per_px=scale)
        write_recording(other, tmp_path / f"{name}.zarr")
    stored = [open_recording(tmp_path / f"{name}.zarr") for name in "abc"]
    scales = [each.attributes.um_per_px for each in stored]
    assert scales == pytest.approx([0.65, 2.0, 3.0])
    assert len({each.content() for each in (first, *stored)}) == 3
    assert stored[0].attributes.frame_rate_hz == 20.0
    rows = dict(summarise_recording(stored[0]))
    assert rows["frame rate"] == "20 Hz"
    assert rows["scale"] == "0.65 um/px"
    unknown = write_recording(open_any(FLAT), tmp_path / "d.zarr")
    assert "frame rate" not in dict(summarise_recording(unknown))


def ome_set(folder, order=(0, 1, 2), pages=2):
    """Write one OME recording in three files, each of which describes all."""
    folder.mkdir()
    names = [f"run_{k}.ome.tif" for k in order]
    marks = [f"urn:uuid:{uuid.uuid4()}" for _ in order]
    data = "".join(
        f'<TiffData IFD="{k % pages}" FirstT="{k}" PlaneCount="1">'
        f'<UUID FileName="{names[k // pages]}">{marks[k // pages]}</UUID></TiffData>'
        for k in range(3 * pages)
    )
    for k, name in enumerate(names):
        text = (
            '<?xml version="1.0"?><OME xmlns="http://www.openmicroscopy.org/Schemas/OME'
            f'/2016-06" UUID="{marks[k]}"><Image ID="Image:0"><Pixels ID="Pixels:0" '
            'DimensionOrder="XYCZT" Type="uint16" SizeX="32" SizeY="24" SizeC="1" '
            f'SizeZ="1" SizeT="{3 * pages}" PhysicalSizeX="0.5">'
            '<Channel ID="Channel:0" SamplesPerPixel="1"/>'
            f"{data}</Pixels></Image></OME>"
        )
        part = DEEP[pages * k : pages * (k + 1)]
        tifffile.imwrite(folder / name, part, description=text, metadata=None)


@pytest.mark.parametrize("pages", [1, 2])
def test_an_ome_set_of_files_is_one_film_and_never_black(pages, tmp_path):
    ome_set(tmp_path / "set", pages=pages)
    for source in (tmp_path / "set", tmp_path / "set" / "run_0.ome.tif"):
        recording = open_any(source)
        gray = [recording.gray(t) for t in range(len(recording))]
        np.testing.assert_array_equal(gray, DEEP[: 3 * pages])
        assert recording.attributes.um_per_px == 0.5
    (tmp_path / "set" / "run_1.ome.tif").unlink()
    for source in (tmp_path / "set", tmp_path / "set" / "run_0.ome.tif"):
        with pytest.raises(InputError, match=r"run_1\.ome\.tif"):
            open_any(source)


def test_files_with_pages_are_read_one_after_the_other(tmp_path):
    folder = tmp_path / "film"
    folder.mkdir()
    parts = {"a_9": DEEP[:3], "a_10": DEEP[3:4], "a_11": DEEP[4:]}
    for name, part in parts.items():
        tifffile.imwrite(
            folder / f"{name}.tif", part, compression="zlib", photometric="minisblack"
        )
    for source in (folder, folder / "a_*.tif"):
        recording = open_any(source)
        for t in (*range(6), 4, 0):
            np.testing.assert_array_equal(recording.gray(t), DEEP[t])
        assert [recording.frame(t).index for t in range(6)] == [*range(6)]
        assert "3 files" in str(recording.attributes.notes)
    before = recording.content()
    assert open_any(folder).content() == before
    tifffile.imwrite(folder / "a_11.tif", DEEP[:2])
    assert open_any(folder / "a_*.tif").content() != before


@pytest.mark.parametrize("name", ["a_0", "a_1"])
def test_a_damaged_file_among_others_is_named(name, tmp_path):
    for each in ("a_0", "a_1"):
        tifffile.imwrite(tmp_path / f"{each}.tif", DEEP, photometric="minisblack")
    (tmp_path / f"{name}.tif").write_bytes(b"no picture")
    with pytest.raises(InputError, match=name):
        open_any(tmp_path)


def test_slices_of_one_channel_are_a_film_and_said(tmp_path):
    for write, name in ((imagej, "a.tif"), (ome, "b.ome.tif")):
        write(tmp_path / name, axes="ZYX")
        recording = open_any(tmp_path / name)
        np.testing.assert_array_equal(recording.gray(5), DEEP[5])
        assert "along z" in str(recording.attributes.notes)
    tifffile.imwrite(
        tmp_path / "c.tif",
        DEEP.reshape(2, 3, 24, 32),
        imagej=True,
        metadata={"axes": "TZYX"},
    )
    with pytest.raises(InputError, match="TZYX") as error:
        open_any(tmp_path / "c.tif")
    assert "<" not in str(error.value)  # as of an enumeration


def test_a_film_that_changes_size_or_bits_is_refused_with_the_frame(tmp_path):
    for k in range(4):
        cv2.imwrite(str(tmp_path / f"bits_{k}.png"), (FLAT, DEEP)[k > 1][k])
        size = FLAT[k, : 24 - 4 * (k > 1)]
        cv2.imwrite(str(tmp_path / f"size_{k}.png"), size)
    for kind in ("bits", "size"):
        recording = open_any(tmp_path / f"{kind}_*.png")
        recording.gray(1)
        with pytest.raises(InputError, match="frame 2"):
            recording.gray(2)
        with tifffile.TiffWriter(tmp_path / f"{kind}.tif") as writer:
            for k in range(4):
                page = cv2.imread(str(tmp_path / f"{kind}_{k}.png"), -1)
                writer.write(page, contiguous=False, photometric="minisblack")
        with pytest.raises(InputError, match="pages differ"):
            open_any(tmp_path / f"{kind}.tif")
    mixed = open_any([FLAT[0], DEEP[1]])
    with pytest.raises(InputError, match="frame 1"):
        mixed.gray(1)


def test_frames_that_come_again_are_counted(tmp_path):
    again = FLAT[[0, 1, 1, 2, 2, 3]]
    stored = write_recording(open_any(again, um_per_px=1.0), tmp_path / "a.zarr")
    assert stored.attributes.notes == ("2 of 6 frames are equal to the one before",)
    assert open_recording(tmp_path / "a.zarr").content() == stored.content()
    assert write_recording(open_any(FLAT), tmp_path / "b").attributes.notes == ()


def test_pixels_that_are_masked_are_not_seen_and_other_nan_is_named():
    values = DEEP.astype(float)
    values[:, :, :9] = np.nan
    recording = open_any(values)
    assert "0.281 of the picture" in str(recording.attributes.notes)
    for t in range(6):
        np.testing.assert_array_equal(recording.gray(t)[:, 9:], DEEP[t, :, 9:])
        assert len(np.unique(recording.gray(t)[:, :9])) == 1
    values[3, 5, 20] = np.nan
    with pytest.raises(InputError, match="nan"):
        open_any(values)
    mask = np.zeros((24, 32), np.uint8)
    mask[:, 9:] = 255
    other = open_any(DEEP, mask=mask)
    np.testing.assert_array_equal(other.gray(2), recording.gray(2))
    assert other.content() != open_any(DEEP).content()
    assert other.content() != open_any(DEEP, mask=mask[:, ::-1]).content()
    with pytest.raises(InputError, match="NaN"):
        open_any(np.full((3, 24, 32), np.nan))
    for wrong in (mask[1:], mask[0], 0 * mask, "no picture"):
        with pytest.raises(InputError, match="mask"):
            open_any(DEEP, mask=wrong)


def test_a_rate_of_one_is_another_recording_than_no_rate(tmp_path):
    np.save(tmp_path / "a.npy", FLAT)
    unknown, stated = (
        open_any(tmp_path / "a.npy", **given) for given in ({}, {"frame_rate_hz": 1.0})
    )
    assert unknown.content() != stated.content()
