from dataclasses import replace

import numpy as np
import pytest

from kilnflight.recording.summary import summarise


def test_the_numbers_are_those_of_the_frames(small):
    report = summarise(small)
    frames = [small.frame(t) for t in range(5)]
    depths = np.concatenate([frame.xyz[:, 2] for frame in frames])
    assert (report.frames, report.rows, report.columns, report.bit_depth) == (5, 24, 32, 12)
    assert report.gray_range == (
        min(f.gray.min() for f in frames),
        max(f.gray.max() for f in frames),
    )
    assert report.points == (0, 20.0, 40)
    assert report.depth_share == pytest.approx(100 / (5 * 24 * 32))
    assert report.depth_range_mm == (depths.min(), depths.max())
    assert report.labelled_frames == 2
    counted = sum((f.labels == 3).sum() for f in frames if f.labels is not None)
    assert report.label_pixels["non-burning in air"] == counted
    assert report.warnings == ("1 of 5 frames without points, the first is 0",)


def test_the_text_has_one_fact_a_line(small):
    lines = summarise(small).text().splitlines()
    assert lines[0] == "recording   small"
    assert lines[1] == "frames      5 of 24 x 32 pixels"
    assert lines[3] == "points      0 to 40 per frame, median 20; 2.60 % of the pixels"
    assert len(lines) == 12


def metres(f):
    return {"xyz": f.xyz / 1000}


@pytest.mark.parametrize(
    ("edit", "warning"),
    [
        (lambda f: {"gray": np.minimum(f.gray, 2047)}, "of the pixels are saturated at 2047"),
        (lambda f: {"gray": f.gray * np.uint16(0)}, "every pixel is black"),
        (lambda f: {"gray": f.gray // np.uint16(32)}, "no gray value above 127"),
        (metres, "is the unit right"),
    ],
)
def test_what_looks_wrong_is_warned_of(small, edit, warning):
    original = small.frame
    small.frame = lambda t: replace(original(t), **edit(original(t)))
    assert any(warning in text for text in summarise(small).warnings)


def test_a_recording_without_points_or_labels(small):
    report = summarise(replace(small, length=1))
    assert report.depth_range_mm is None
    assert "depth" not in report.text()
    assert "labels      0 frames" in report.text()
