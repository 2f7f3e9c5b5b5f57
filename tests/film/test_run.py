"""`kilnflight run` on recordings of the kiln: tables, settings, warnings, what is
refused.
"""

import re
import shutil
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import kilnflight
from kilnflight import chain
from kilnflight.__main__ import main
from kilnflight.film import preparation
from kilnflight.film.doubts import doubts
from kilnflight.film.noise import block_noise, noise_threshold
from kilnflight.film.prepared import Prepared
from kilnflight.film.report import summary
from kilnflight.film.settings import Options
from kilnflight.flight.empty import background_gray
from kilnflight.recording.store import open_recording, write_recording
from kilnflight.regression import Fit
from kilnflight.tables import DETECTIONS, FLIGHTS, TRAJECTORIES

OPTIONS = Options(threshold=200.0)
LEVEL = ((0.0, 0.0), (0.0, 0.0), (-8000.0, 0.0))


class Changed:
    """A recording with other attributes, or with frames changed by a function."""

    def __init__(self, recording, change=lambda frame: frame, **attributes):
        self.recording, self.change = recording, change
        self.attributes = replace(recording.attributes, **attributes)

    def __len__(self):
        return len(self.recording)

    def frame(self, t):
        return self.change(self.recording.frame(t))


@pytest.fixture
def stored(stored_flights):
    return open_recording(stored_flights)


@pytest.fixture
def prepare(stored, tmp_path):
    """A function that prepares a changed recording: run and settings, several under a
    name.
    """

    def prepared(change=lambda frame: frame, **attributes):
        folder = tmp_path / "changed.zarr"
        shutil.rmtree(folder, ignore_errors=True)
        kept = write_recording(Changed(stored, change, **attributes), folder, range(6))
        ready, rows = preparation.prepare(kept, tmp_path, OPTIONS)
        return ready, {
            name: [value for key, value in rows if key == name] for name, _ in rows
        }

    return prepared


def test_the_whole_way(stored_flights, tmp_path, capsys):
    main(["run", str(stored_flights), "--to", str(tmp_path), "--threshold", "200"])
    output = capsys.readouterr().out
    tracks = pd.read_parquet(tmp_path / "tracks.parquet")
    tracked = tracks[tracks["particle"] >= 0]
    assert (count := tracked["particle"].nunique()) >= 3
    assert re.search(rf"tracks +{count} with {len(tracked)} detections", output)
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "tracks.csv"), tracks)
    found = kilnflight.detect(stored_flights, threshold=200.0)
    pd.testing.assert_frame_equal(
        found, pd.read_parquet(tmp_path / "detections.parquet")
    )
    for name, table in (("detections", DETECTIONS), ("trajectories", TRAJECTORIES)):
        assert list(pd.read_parquet(tmp_path / f"{name}.parquet")) == table.names
    value = pd.read_csv(tmp_path / "summary.csv").set_index("what")["value"]
    assert value["threshold"].startswith("200 grey values")
    assert all(f"{what}" in output for what in value.index)
    pictures = (
        "detections",
        "lengths-and-speeds",
        "mean-square-displacement",
        "tracks",
    )
    assert [path.stem for path in sorted(tmp_path.glob("*.png"))] == list(pictures)


@pytest.mark.parametrize("inside", [".", "a/../b/c"])
def test_a_run_leaves_the_recording_alone(inside, stored_flights, capsys):
    before = sorted(stored_flights.rglob("*"))
    with pytest.raises(SystemExit, match="2"):
        main(["run", str(stored_flights), "--to", str(stored_flights / inside)])
    assert str(stored_flights / inside) in capsys.readouterr().err
    assert sorted(stored_flights.rglob("*")) == before


@pytest.mark.parametrize("missing", ["lance", "wall"])
def test_without_a_lance_or_a_wall_there_are_tracks_but_no_flights(prepare, missing):
    def sparse(frame):
        return replace(frame, pixels=frame.pixels[:3], xyz=frame.xyz[:3])

    ready, settings = prepare(lance_mm=None) if missing == "lance" else prepare(sparse)
    assert (
        "no flights"
        in f"{settings['note'] if missing == 'wall' else settings['lance']}"
    )
    assert ready.post_processing == (missing == "wall")
    assert ready.flights().empty


def test_a_threshold_from_the_noise(stored):
    looks = preparation.Looks(Prepared(stored)).foregrounds("median")
    assert 5 < noise_threshold(looks) < 1000
    noisy = np.abs(np.random.default_rng(0).normal(0, 100, (256, 256))).astype(
        np.float32
    )
    noise = block_noise(noisy, 1)
    assert block_noise(3 * noisy, 1) == pytest.approx(3 * noise, rel=1e-4)
    assert 2 < noise < 40  # of the difference of Gaussians, not of the pixels
    noisy[100:110, 100:110] += 20_000
    assert block_noise(noisy, 1) == pytest.approx(noise, rel=0.1)


def test_another_content_is_another_source(stored, prepare, tmp_path):
    def brighter(frame):
        return replace(frame, gray=frame.gray + (frame.index == 563))

    copied = write_recording(stored, tmp_path / "same.zarr")
    original, same = (
        preparation.prepare(recording, tmp_path, OPTIONS)[0].detection.source
        for recording in (stored, copied)
    )
    assert repr(original) == repr(same)
    assert repr(original) != repr(replace(original, dark=True))
    assert prepare(brighter)[0].detection.source.content != original.content


def test_options_reach_the_run(stored, tmp_path):
    options = replace(
        OPTIONS, memory=9, in_air_mm=700.0, post_processing=False, frames=(3, 12)
    )
    ready, rows = preparation.prepare(stored, tmp_path, options)
    assert ready.management.invisible == 9
    assert not ready.post_processing
    assert ready.in_air.threshold_mm == 700.0
    assert ready.frames == range(3, 12)
    assert dict(rows)["kiln"].startswith(f"radius {ready.wall.radius_mm:.0f} mm")


def test_ignition_is_read_above_the_background(stored, tmp_path):
    ready = preparation.prepare(stored, tmp_path, OPTIONS)[0]
    fit = Fit((0.0, 0.0, 6500.0), 0.0, 0, (-0.1, 0.0), (2, 2, 2), LEVEL, 0.05, 0.3, 80)
    frame = np.arange(17, 97)
    places = dict(zip("xyz", fit(frame / 330.0).T, strict=True))
    track = pd.DataFrame({"frame": frame, "particle": 0, "radius_px": 3.0, **places})
    track["row"], track["col"] = 100.0, np.where(frame < 50, 60.0, 150.0)
    behind = background_gray(track, ready.detection.source, range(20))
    assert len(np.unique(behind)) == 2  # of both places
    track["gray"] = behind + 500.0 + np.sin(7 * frame)
    rising = track.assign(gray=track["gray"] + 4000.0 * (frame >= 50))
    for table, ignition in ((track, "none"), (rising, "seen")):
        assert chain.flights_from(ready, table, {0: fit})["ignition"].tolist() == [
            ignition
        ]


@pytest.fixture
def flown():
    """Tables of a run with made-up flights."""
    rows = [
        (1, 0.5, "landed", True, "seen", 0.21),
        (2, 0.7, "burnt out", True, "none", np.nan),
        (3, 0.9, "lost", False, "too few points", np.nan),
    ]
    names = ["particle", "dwell_s", "ending", "from_lance", "ignition", "ignition_s"]
    table = pd.DataFrame(rows, columns=names).reindex(
        columns=FLIGHTS.names, fill_value=0.0
    )
    velocities = pd.DataFrame(
        {
            "particle": [1, 1, 2],
            "slice_m": [1.0, 2.0, 1.0],
            "velocity_m_s": [10.0, 8.0, 12.0],
        }
    )
    found = DETECTIONS.empty().reindex(range(3)).fillna(5.0)
    tables = {"detections": found, "tracks": found.assign(frame=range(3), particle=0)}
    tables |= {
        "flights": table.assign(refused=""),
        "slices": velocities.assign(observed=True),
    }
    return tables


def test_the_summary_counts_accepted_flights_from_the_lance(flown):
    value = summary(flown)
    assert value["flights from the lance"] == "2 of 3 trajectories"
    assert value["ending: landed"] == value["ending: burnt out"] == "1"
    assert value["dwell time, median"].startswith("0.600 ")
    assert value["ignition: seen"] == value["ignition: none"] == "1"
    assert (
        value["velocity in the metre up to 2 m"]
        == "median 8.0 m/s, 50 % of the flights"
    )
    refused = flown["flights"].assign(refused=["turns back behind the lance", "", ""])
    value = summary(flown | {"flights": refused})
    assert value["refused: turns back behind the lance"] == "1"
    assert value["dwell time, median"].startswith("0.700 ")


def test_doubtful_flights_are_said(flown):
    flown |= {"tracks": pd.concat(5 * [flown["tracks"]])}
    assert not list(doubts(flown))
    wild = flown["flights"].assign(refused="faster than the air")
    assert next(doubts(flown | {"flights": wild})).startswith("2 of 2 ")
    elsewhere = flown["flights"].assign(from_lance=False, start_mm=9000.0)
    assert "9000 mm" in next(doubts(flown | {"flights": elsewhere}))


def test_settings_are_printed_before_the_film_is_searched(stored, tmp_path, capsys):
    prepared = preparation.prepare(stored, tmp_path, OPTIONS)[1]
    lines = capsys.readouterr().out.splitlines()
    assert [line.split("  ")[0] for line in lines] == [what for what, _ in prepared]
