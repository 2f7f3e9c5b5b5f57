"""The steps in Python: a recording of any kind or an array, detected, tracked and drawn."""

import subprocess
import sys

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest

import kilnflight
from kilnflight.__main__ import main
from kilnflight.checks import InputError
from kilnflight.tables import DETECTIONS


@pytest.fixture(scope="module")
def flying():
    """Twenty frames of noise in which one bright particle flies."""
    rng = np.random.default_rng(0)
    rows, cols = np.ogrid[:96, :128]
    images = rng.normal(1000, 20, (20, 96, 128))
    for t, image in enumerate(images):
        image += 8000 * np.exp(-((rows - 40) ** 2 + (cols - 10 - 5 * t) ** 2) / 18)
    return images.astype(np.uint16)


def test_an_array_is_detected_tracked_and_drawn(flying):
    recording = kilnflight.open(flying, frame_rate_hz=330.0)
    assert recording.attributes.frame_rate_hz == 330.0
    np.testing.assert_array_equal(recording.gray(3), flying[3])
    detections = DETECTIONS.check(kilnflight.detect(recording))
    tracks = kilnflight.track(detections)
    (track,) = (table for particle, table in tracks.groupby("particle") if particle >= 0)
    assert len(track) == 20
    np.testing.assert_allclose(track["col"], 10 + 5 * track["frame"], atol=1)
    assert track["z"].isna().all()
    figure = kilnflight.plot_tracks(recording, tracks)
    assert len(figure.axes[0].lines) == 1
    plt.close(figure)
    assert kilnflight.detect(recording, threshold=60_000.0).empty


def test_the_steps_are_those_of_the_commands(stored_flights, tmp_path, capsys):
    table, tracks = tmp_path / "d.csv", tmp_path / "t.csv"
    assert main(["detect", str(stored_flights), str(table), "--threshold", "200"]) == 0
    recording = kilnflight.open(stored_flights)
    detections = kilnflight.detect(recording, 200.0)
    pd.testing.assert_frame_equal(detections, pd.read_csv(table), check_exact=True)
    for extra in ([], ["--raw"]):
        assert main(["track", str(table), str(tracks), *extra]) == 0
        expected = pd.read_csv(tracks)
        pd.testing.assert_frame_equal(kilnflight.track(detections, raw=bool(extra)), expected)


def test_a_manifest_is_opened_where_its_files_lie(flying, tmp_path):
    for t in range(3):
        np.save(tmp_path / f"{t}.npy", flying[t])
    manifest = tmp_path / "mine.toml"
    manifest.write_text('name = "mine"\nframe_rate_hz = 330\n[gray]\npattern = "{frame}.npy"\n')
    recording = kilnflight.open(str(manifest))
    assert (len(recording), recording.attributes.name) == (3, "mine")
    np.testing.assert_array_equal(recording.gray(2), flying[2])


@pytest.mark.parametrize(
    ("source", "message"),
    [
        (np.zeros((3, 4), np.uint16), r"open: array .*shape \(3, 4\)"),
        (np.zeros((3, 4, 5), np.uint8), "recording array: gray is uint8, expected uint16. Give"),
        ("gone", "gone: there is no recording"),
        ("gone.toml", "cannot be read"),
    ],
)
def test_what_is_no_recording_is_refused(source, message):
    with pytest.raises(InputError, match=message):
        kilnflight.open(source)


def test_an_array_has_no_frame_beyond_its_end(flying):
    with pytest.raises(InputError, match="there is no frame 20; it has 20 frames"):
        kilnflight.open(flying).frame(20)


def test_the_package_itself_loads_nothing():
    code = "import kilnflight, sys; print('numpy' in sys.modules, callable(kilnflight.track))"
    process = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert process.stdout == "False True\n"
    with pytest.raises(AttributeError, match="no attribute 'fly'"):
        _ = kilnflight.fly
