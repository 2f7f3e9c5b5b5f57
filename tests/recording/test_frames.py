import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from kilnflight.checks import InputError
from kilnflight.recording.frames import Attributes, check_frame


def test_attributes_survive_json(small):
    text = json.dumps(asdict(small.attributes))
    assert Attributes.from_json(json.loads(text)) == small.attributes


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"name": " "}, "its name is empty"),
        ({"frame_rate_hz": 0.0}, "small, frame_rate_hz: must be"),
        ({"frame_rate_hz": float("nan")}, "frame_rate_hz: must be"),
        ({"rows": -1}, "rows: must be"),
        ({"pressure_bar": -4.5}, "pressure_bar: must be"),
        ({"fraction": "gravel"}, "unknown fraction 'gravel'; use one of wood chip, confetti"),
        ({"lance_mm": (1.0, float("inf"), 2.0)}, "expected x, y, z in mm"),
        ({"lance_mm": (1.0, 2.0)}, "expected x, y, z in mm"),
        ({"roi": ((0, 0), (1, 1))}, "three or more vertices"),
        ({"roi": ((0, 0), (24, 0), (10, 33))}, "inside the image of 24 x 32"),
        ({"flame_roi": (8, 2, 3, 9)}, "row0 < row1"),
        ({"flame_roi": (2, 8, 3, 33)}, "inside the image of 24 x 32"),
    ],
)
def test_wrong_attributes_are_refused(small, change, message):
    with pytest.raises(InputError, match=message):
        replace(small.attributes, **change)


def changed(array, position, value):
    array = array.copy()
    array[position] = value
    return array


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda f: {"gray": f.gray[:-1]}, r"gray: shape \(23, 32\), expected \(24, 32\)"),
        (lambda f: {"gray": f.gray.astype(np.uint8)}, "gray is uint8, expected uint16"),
        (lambda f: {"gray": f.gray.astype(float)}, "gray is float64, expected uint16"),
        (lambda f: {"pixels": f.pixels[1:]}, "29 pixels but 30 positions"),
        (lambda f: {"pixels": f.pixels.astype(np.int64)}, "pixels are int64"),
        (lambda f: {"pixels": changed(f.pixels, (3, 1), 32)}, r"col 32 \(point 3\)"),
        (lambda f: {"pixels": changed(f.pixels, (3, 0), -1)}, "outside the image of 24 x 32"),
        (lambda f: {"pixels": changed(f.pixels, 3, f.pixels[4])}, r"1 point\(s\) share a pixel"),
        (lambda f: {"xyz": changed(f.xyz, (2, 2), np.nan)}, "1 of 30 points are not finite"),
        (lambda f: {"xyz": f.xyz * np.nan}, "all 30 points are not finite"),
        (lambda f: {"xyz": f.xyz[:, :2]}, r"xyz: shape \(30, 2\)"),
        (lambda f: {"labels": f.labels.astype(int)}, "labels are int64"),
        (lambda f: {"labels": f.labels[:, 1:]}, r"labels: shape \(24, 31\)"),
        (lambda f: {"labels": changed(f.labels, (0, 0), 5)}, "label 5 is no class"),
        (lambda f: {"time_s": float("nan")}, "finite time"),
    ],
)
def test_a_wrong_frame_is_refused_with_recording_and_number(small, change, message):
    frame = small.frame(3)
    with pytest.raises(InputError, match=f"small, frame 3: .*{message}"):
        check_frame(replace(frame, **change(frame)), small.attributes)


def test_a_frame_without_points_or_labels_is_good(small):
    frame = small.frame(0)
    assert len(frame.xyz) == 0
    assert check_frame(frame, small.attributes) is frame
