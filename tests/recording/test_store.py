import os
import pickle
import signal
import subprocess
import sys
import tempfile
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import zarr
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from kilnflight.checks import InputError
from kilnflight.recording import store
from kilnflight.recording.frames import Attributes, Frame
from kilnflight.recording.store import open_recording, write_recording


@pytest.fixture
def target(tmp_path):
    return tmp_path / "small.zarr"


def test_what_is_written_comes_back(small, target, same_frame):
    stored = write_recording(small, target)
    assert stored.attributes == small.attributes
    assert len(stored) == 5
    for t in range(5):
        same_frame(stored.frame(t), small.frame(t))
    same_frame(pickle.loads(pickle.dumps(stored)).frame(3), small.frame(3))
    assert [path.name for path in target.parent.iterdir()] == ["small.zarr"]


@given(data=st.data())
@settings(max_examples=25, deadline=None)
def test_any_gray_and_points_come_back(data, same_frame):
    rows, columns = data.draw(st.integers(1, 6)), data.draw(st.integers(1, 6))
    gray = data.draw(hnp.arrays(np.uint16, (rows, columns)))
    cells = st.tuples(st.integers(0, rows - 1), st.integers(0, columns - 1))
    pixels = data.draw(st.lists(cells, unique=True))
    numbers = st.floats(allow_nan=False, allow_infinity=False, width=32)
    xyz = data.draw(hnp.arrays(np.float32, (len(pixels), 3), elements=numbers))
    frame = Frame(7, 0.5, gray, np.array(pixels, np.int32).reshape(-1, 2), xyz)

    class Single:
        attributes = Attributes("single", 330.0, rows, columns)

        def __len__(self):
            return 1

        def frame(self, t):
            return frame

    with tempfile.TemporaryDirectory() as folder:
        same_frame(write_recording(Single(), Path(folder) / "single.zarr").frame(0), frame)


def test_a_part_keeps_index_and_time(small, target, same_frame):
    stored = write_recording(small, target, frames=range(2, 4))
    assert len(stored) == 2
    same_frame(stored.frame(0), small.frame(2))


def test_points_in_several_chunks(small, target, same_frame, monkeypatch):
    monkeypatch.setattr(store, "POINTS_PER_CHUNK", 7)
    stored = write_recording(small, target)
    for t in range(5):
        same_frame(stored.frame(t), small.frame(t))


def test_a_frame_is_read_from_its_chunks_alone(small, target):
    stored = write_recording(small, target)
    for file in target.glob("*/c/[0124]/*/0"):
        file.unlink()
    stored.frame(3)


def test_truth_is_stored_beside(small, target):
    table = pd.DataFrame({"particle": [3, 5], "time_s": [0.1, np.nan], "end": ["wall", None]})
    write_recording(small, target, truth={"particles": table})
    pd.testing.assert_frame_equal(open_recording(target).truth()["particles"], table)
    assert write_recording(small, target.with_name("b")).truth() == {}


def test_a_cut_off_recording_cannot_be_opened_and_goes_on(small, target, same_frame):
    with pytest.raises(KeyboardInterrupt):
        write_recording(replace(small, stops_at=3), target)
    for path in (target, target.with_name("small.zarr.part")):
        with pytest.raises(InputError, match=r"small\.zarr\.part: .* after 3 of 5 frames\. Run"):
            open_recording(path)
    small.asked.clear()
    stored = write_recording(small, target)
    assert small.asked == [2, 3, 4]  # 2 is compared with what stands there
    for t in range(5):
        same_frame(stored.frame(t), small.frame(t))


def test_a_killed_process_leaves_nothing_that_opens(small, target, same_frame):
    script = f"""
import os, signal, sys
sys.path.insert(0, {str(Path(__file__).parents[1])!r})
from conftest import SmallRecording
from kilnflight.recording.store import write_recording
class Killed(SmallRecording):
    def frame(self, t):
        if t == 2:
            os.kill(os.getpid(), signal.SIGKILL)
        return super().frame(t)
write_recording(Killed(), {str(target)!r})
"""
    process = subprocess.run([sys.executable, "-c", script], env=os.environ, check=False)
    assert process.returncode == -signal.SIGKILL
    with pytest.raises(InputError, match="cut off after 2 of 5 frames"):
        open_recording(target)
    # what a kill inside a write may leave: half a chunk and half a line
    part = target.with_name("small.zarr.part")
    (part / "xyz/c/2/0").mkdir(parents=True)
    (part / "xyz/c/2/0/0").write_bytes(b"half")
    with (part / store.JOURNAL).open("a") as journal:
        journal.write("[2, 0.0")
    stored = write_recording(small, target)
    for t in range(5):
        same_frame(stored.frame(t), small.frame(t))


def test_a_kill_before_the_first_line_starts_again(small, target):
    part = target.with_name("small.zarr.part")
    part.mkdir()
    (part / store.JOURNAL).write_text('{"frames"')
    with pytest.raises(InputError, match="cut off after 0 of some frames"):
        open_recording(target)
    assert len(write_recording(small, target)) == 5


@pytest.mark.parametrize("other", ["attributes", "frames", "content"])
def test_another_recording_is_not_mixed_into_one_begun(small, target, other):
    with pytest.raises(KeyboardInterrupt):
        write_recording(replace(small, stops_at=3), target)
    frames = None
    if other == "attributes":
        small = replace(small, attributes=replace(small.attributes, pressure_bar=5.0))
    elif other == "frames":
        frames = range(1, 5)
    else:
        original = small.frame
        small.frame = lambda t: replace(original(t), gray=original(t).gray + np.uint16(1))
    with pytest.raises(InputError, match=r"begun with another recording .* Delete it"):
        write_recording(small, target, frames)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"time_s": 0.0}, "frame 3 at 0.0 s follows frame 2"),
        ({"index": 2}, "frame 2 at .* follows frame 2"),
        ({"xyz": np.full((30, 3), np.nan, np.float32)}, "frame 3: all 30 points"),
        ({"gray": np.zeros((24, 31), np.uint16)}, "frame 3: gray: shape"),
    ],
)
def test_a_wrong_frame_never_becomes_a_recording(small, target, change, message):
    original = small.frame
    small.frame = lambda t: replace(original(t), **change) if t == 3 else original(t)
    with pytest.raises(InputError, match=message):
        write_recording(small, target)
    assert not target.exists()


def test_an_existing_target_is_left_alone(small, target):
    target.mkdir()
    with pytest.raises(InputError, match=r"small\.zarr: exists already"):
        write_recording(small, target)
    assert list(target.iterdir()) == []


@pytest.mark.parametrize("frames", [range(5, 6), range(-1, 2), range(3, 3)])
def test_frames_that_are_not_there(small, target, frames):
    with pytest.raises(InputError, match=r"small: (there is no frame|no frames to write)"):
        write_recording(small, target, frames)
    assert not list(target.parent.iterdir())


@pytest.mark.parametrize("t", [-1, 5])
def test_a_frame_that_is_not_there(small, target, t):
    with pytest.raises(InputError, match=f"small: there is no frame {t}; it has 5 frames"):
        write_recording(small, target).frame(t)


@pytest.mark.parametrize("name", store.KINDS)
@pytest.mark.parametrize("fault", ["missing", "damaged"])
def test_a_damaged_frame_is_refused(small, target, name, fault):
    stored = write_recording(small, target)
    chunk = target / name / "c/3/0/0"
    content = chunk.read_bytes()
    chunk.unlink()
    if fault == "damaged":
        chunk.write_bytes(content[:-9] + bytes(9))
    with pytest.raises(InputError, match=rf"small\.zarr, frame 3: its {name} is {fault}"):
        stored.frame(3)
    stored.frame(1)


def test_a_folder_without_a_recording_is_refused(small, target):
    with pytest.raises(InputError, match="there is no recording"):
        open_recording(target)
    zarr.open_group(target, mode="w")
    with pytest.raises(InputError, match="a Zarr group, but not a kilnflight recording"):
        open_recording(target)


@pytest.mark.parametrize("fault", ["missing", "unknown"])
def test_a_recording_with_other_attributes_is_refused(small, target, fault):
    write_recording(small, target)
    attributes = {**asdict(small.attributes), "presure": 5} if fault == "unknown" else {}
    group = zarr.open_group(target, mode="r+")
    group.attrs.put({"format": store.FORMAT, "name": "small", **attributes})
    argument = "presure" if fault == "unknown" else "frame_rate_hz"
    message = rf"small\.zarr: damaged recording .*argument.*{argument}.* again"
    with pytest.raises(InputError, match=message):
        open_recording(target)


def test_a_recording_without_an_array_is_refused(small, target):
    write_recording(small, target)
    (target / "index" / "zarr.json").unlink()
    with pytest.raises(InputError, match="damaged recording"):
        open_recording(target)
