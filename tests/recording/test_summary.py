from dataclasses import replace

import numpy as np
import pytest

from kilnflight.recording.summary import aligned, summarise


def test_the_numbers_are_those_of_the_frames(small):
    facts = summarise(small)
    value = facts.set_index("what")["value"]
    frames = [small.frame(t) for t in range(5)]
    gray = np.stack([frame.gray for frame in frames])
    depths = np.concatenate([frame.xyz[:, 2] for frame in frames])
    labels = np.stack([frame.labels for frame in frames if frame.labels is not None])
    assert value["frames"] == "5 of 24 x 32 pixels"
    assert value["gray"] == f"{gray.min()} to {gray.max()} (12 bits)"
    share = 100 * len(depths) / gray.size
    assert value["points"] == f"0 to 40 per frame, median 20; {share:.2f} % of the pixels"
    assert value["depth"] == f"{depths.min():.0f} to {depths.max():.0f} mm, as captured"
    assert value["labels"] == f"{len(labels)} frames" == "2 frames"
    assert f"{(labels == 3).sum()} px non-burning in air" in facts["value"].tolist()
    assert value["warning"] == "1 of 5 frames without points, the first is 0"


def test_the_text_has_a_fact_a_line(small):
    lines = aligned(summarise(small)).splitlines()
    assert lines[0] == "recording   small"
    assert lines[1] == "frames      5 of 24 x 32 pixels"
    assert lines[3] == "points      0 to 40 per frame, median 20; 2.60 % of the pixels"
    assert lines[5].strip() == "taken as true: no depth_calibration is stated"
    assert len(lines) == 13


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
    facts = summarise(small)
    assert any(warning in text for text in facts.loc[facts["what"] == "warning", "value"])


def test_a_recording_without_points_or_labels(small):
    value = summarise(replace(small, length=1)).set_index("what")["value"]
    assert "depth" not in value
    assert value["labels"] == "0 frames"
    assert value["warning"] == "1 of 1 frames without points, the first is 0"
