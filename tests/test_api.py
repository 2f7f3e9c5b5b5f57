"""The steps in Python: a recording or an array, detected, tracked and drawn."""

import subprocess
import sys

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest

import kilnflight
from kilnflight.__main__ import main
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


@pytest.mark.parametrize("dark", [False, True])
def test_an_array_is_detected_tracked_and_drawn(flying, dark):
    recording = kilnflight.open(10_000 - flying if dark else flying)
    detections = DETECTIONS.check(kilnflight.detect(recording, dark=dark))
    tracks = kilnflight.track(detections)
    (track,) = (table for particle, table in tracks.groupby("particle") if particle >= 0)
    assert len(track) == 20
    np.testing.assert_allclose(track["col"], 10 + 5 * track["frame"], atol=1)
    assert track["z"].isna().all()
    alone = kilnflight.track(kilnflight.detect(kilnflight.open(flying[:1])))
    assert list(alone.columns) == list(tracks.columns)
    figure = kilnflight.plot_tracks(recording, tracks)
    assert len(figure.axes[0].lines) == 1
    plt.close(figure)


def test_an_array_in_a_file_runs_all_the_way(flying, tmp_path, capsys):
    np.save(tmp_path / "film.npy", flying)
    for _ in range(2):  # the copy of the first run serves the second
        assert main(["run", str(tmp_path / "film.npy"), "--threshold", "300"]) == 0
    assert "no depth" in capsys.readouterr().out
    tracks = pd.read_parquet(tmp_path / "film-run" / "tracks.parquet")
    assert set(tracks["particle"]) - {-1} == {0}
    assert len(list(tmp_path.glob("film-run/parts/recording-*.zarr"))) == 1


def test_the_steps_are_those_of_the_commands(stored_flights, tmp_path):
    table, tracks = tmp_path / "d.csv", tmp_path / "t.csv"
    assert main(["detect", str(stored_flights), str(table), "--threshold", "200"]) == 0
    detections = kilnflight.detect(kilnflight.open(stored_flights), 200.0)
    pd.testing.assert_frame_equal(detections, pd.read_csv(table), check_exact=True)
    for extra in ([], ["--raw"]):
        assert main(["track", str(table), str(tracks), *extra]) == 0
        expected = pd.read_csv(tracks)
        pd.testing.assert_frame_equal(kilnflight.track(detections, raw=bool(extra)), expected)


def test_the_package_itself_loads_nothing():
    code = "import kilnflight, sys; print('numpy' in sys.modules)"
    command = [sys.executable, "-c", code]
    process = subprocess.run(command, capture_output=True, text=True, check=True)
    assert process.stdout == "False\n"
    with pytest.raises(AttributeError, match="fly"):
        _ = kilnflight.fly
