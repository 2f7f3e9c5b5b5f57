"""`kilnflight run` on stored recordings: tables, notes, report, and what is refused."""

import re
import shutil
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from kilnflight import kiln, run
from kilnflight.__main__ import main
from kilnflight.checks import InputError
from kilnflight.recording.store import open_recording, write_recording
from kilnflight.regression import Fit
from kilnflight.run import preparation
from kilnflight.run.report import doubts, page, read_results, summary
from kilnflight.tables import FLIGHTS, SLICES, TRAJECTORIES

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
    """A function that prepares a changed recording: run, settings and notes."""

    def prepared(change=lambda frame: frame, options=None, **attributes):
        folder = tmp_path / "changed.zarr"
        shutil.rmtree(folder, ignore_errors=True)
        kept = write_recording(Changed(stored, change, **attributes), folder, range(6))
        return preparation.prepare(kept, tmp_path, options or run.Options(200.0))

    return prepared


def test_the_whole_way_and_its_report(stored_flights, tmp_path, capsys):
    command = ["run", str(stored_flights), "--to", str(tmp_path), "--threshold", "200"]
    assert main(command) == 0
    output = capsys.readouterr().out
    tracks = pd.read_parquet(tmp_path / "tracks.parquet")
    tracked = tracks[tracks["particle"] >= 0]
    assert (count := tracked["particle"].nunique()) >= 3
    assert re.search(rf"tracks +{count} with {len(tracked)} detections", output)
    for name, table in (("trajectories", TRAJECTORIES), ("flights", FLIGHTS), ("slices", SLICES)):
        assert list(pd.read_parquet(tmp_path / f"{name}.parquet")) == table.names
    written = (tmp_path / "report.html").read_text()
    assert "200 grey values" in written
    assert 'src="data:image/png;base64,' in written
    assert not re.findall(r"(?:src|href)=.?(?:https?:|//)", written)


def test_without_depth_there_are_tracks_in_2d(stored, tmp_path, capsys):
    def flat(frame):
        """Take the depth away and let one bright blob fly."""
        row, col = np.ogrid[: frame.gray.shape[0], : frame.gray.shape[1]]
        far = (row - 150) ** 2 + (col - 60 - 6 * (frame.index - 562)) ** 2
        gray = np.minimum(frame.gray + 20_000 * np.exp(-far / 18), 65_535).astype(np.uint16)
        return replace(frame, gray=gray, pixels=frame.pixels[:0], xyz=frame.xyz[:0])

    folder = tmp_path / "flat.zarr"
    write_recording(Changed(stored, flat, lance_mm=None, name="<b>&"), folder)
    assert main(["run", str(folder), "--threshold", "200"]) == 0  # beside the recording
    output = capsys.readouterr().out
    assert "note: The recording has no depth" in output
    assert re.search(r"tracks +[1-9]", output)
    assert pd.read_parquet(tmp_path / "flat-run" / "trajectories.parquet").empty
    written = (tmp_path / "flat-run" / "report.html").read_text()
    assert "<h1>&lt;b&gt;&amp;</h1>" in written
    assert "<b>&" not in written


@pytest.mark.parametrize("inside", [".", "a/../b/c"])
def test_a_run_leaves_the_recording_alone(inside, stored_flights, capsys):
    before = sorted(stored_flights.rglob("*"))
    assert main(["run", str(stored_flights), "--to", str(stored_flights / inside)]) == 1
    assert "--to" in capsys.readouterr().err
    assert sorted(stored_flights.rglob("*")) == before


def test_the_lance_must_be_known_and_is_better_seen(prepare):
    for lance in (None, (0.0, 240.0, 500.0)):  # Eq. 2.4 puts 500 mm behind the camera
        with pytest.raises(InputError, match=r"recording paper-shred.* lance"):
            prepare(lance_mm=lance)
    options = run.Options(200.0, (-77.0, 250.7, 6828.0))
    ready, settings, notes = prepare(options=options, lance_mm=None)
    np.testing.assert_allclose(ready.exit_point_mm, (-73.2, 238.2, 6486.7), atol=0.5)
    assert settings["exit point mm"].startswith("-73.2, 238.2, ")
    assert not notes
    assert "outside the picture" in prepare(lance_mm=(6000.0, 240.0, 6828.0))[2][0]


def test_a_threshold_from_the_noise(stored):
    assert 5 < preparation.noise_threshold(stored) < 1000
    noisy = np.abs(np.random.default_rng(0).normal(0, 100, (256, 256))).astype(np.float32)
    noise = preparation.block_noise(noisy)
    assert preparation.block_noise(3 * noisy) == pytest.approx(3 * noise, rel=1e-4)
    assert 2 < noise < 40  # of the difference of Gaussians, not of the pixels
    noisy[100:110, 100:110] += 20_000
    assert preparation.block_noise(noisy) == pytest.approx(noise, rel=0.1)


def test_no_wall_and_uneven_frames_are_notes(prepare):
    def sparse_and_late(frame):
        late = frame.time_s + (frame.index > 564)
        return replace(frame, time_s=late, pixels=frame.pixels[:3], xyz=frame.xyz[:3])

    ready, settings, notes = prepare(sparse_and_late, run.Options())
    assert [note[:25] for note in notes] == [
        "Frames are not evenly spa",
        "No threshold was given: 2",
        "The kiln's wall was not f",
    ]
    assert "after frame 2" in notes[0]
    assert ready.flights().empty
    assert "kiln's axis" not in settings


def test_another_content_is_another_source(stored, prepare, tmp_path):
    def brighter(frame):
        return replace(frame, gray=frame.gray + (frame.index == 563))

    copied = write_recording(stored, tmp_path / "same.zarr")
    original, same = (
        preparation.prepare(recording, tmp_path, run.Options(200.0))[0].detection.source
        for recording in (stored, copied)
    )
    assert repr(original) == repr(same)
    assert repr(original) != repr(replace(original, dark=True))
    assert prepare(brighter)[0].detection.source.content != original.content


def test_options_reach_the_rules(stored, tmp_path):
    options = run.Options(200.0, bright=1.0, above_background=True, air_m_s=5.0, in_air_mm=700.0)
    ready, settings, _ = preparation.prepare(stored, tmp_path, options)
    assert ready.rules.plausible.fastest_m_s == ready.cutting.fastest_m_s == 10.0
    assert (ready.rules.ignition.bright, ready.rules.ignition.above_background) == (1.0, True)
    assert ready.in_air.threshold_mm == 700.0
    assert settings["bright"] == "1.0"
    assert settings["kiln's radius"] == f"{ready.wall.radius_mm:.0f} mm"


def test_ignition_may_be_read_above_the_background(stored, tmp_path):
    options = run.Options(200.0, above_background=True)
    ready = preparation.prepare(stored, tmp_path, options)[0]
    fit = Fit((0.0, 0.0, 6500.0), 0.0, 0, (-0.1, 0.0), (2, 2, 2), LEVEL, 0.05, 0.3, 80)
    frame = np.arange(17, 97)
    places = dict(zip("xyz", fit(frame / 330.0).T, strict=True))
    track = pd.DataFrame({"frame": frame, "particle": 0, "radius_px": 3.0, **places})
    track["row"], track["col"] = 100.0, np.where(frame < 50, 60.0, 150.0)
    behind = kiln.background_gray(track, ready.detection.source, range(20))
    assert len(np.unique(behind)) == 2  # of both places
    track["gray"] = behind + 500.0 + np.sin(7 * frame)
    rising = track.assign(gray=track["gray"] + 4000.0 * (frame >= 50))
    for table, ignition in ((track, "none"), (rising, "seen")):
        assert kiln.flights_from(ready, table, {0: fit})["ignition"].tolist() == [ignition]


@pytest.fixture
def flown(stored, tmp_path):
    """Results with made-up flights."""
    prepared, settings, _ = preparation.prepare(stored, tmp_path, run.Options(200.0))
    results = read_results(prepared, settings, ["a <note>"])
    rows = [
        (1, 0.5, "landed", True, "seen", 0.21),
        (2, 0.7, "burnt out", True, "none", np.nan),
        (3, 0.9, "lost", False, "too few points", np.nan),
    ]
    names = ["particle", "dwell_s", "ending", "from_lance", "ignition", "ignition_s"]
    table = pd.DataFrame(rows, columns=names).reindex(columns=FLIGHTS.names, fill_value=0.0)
    table["refused"] = ""
    velocities = pd.DataFrame(
        {"particle": [1, 1, 2], "slice_m": [1.0, 2.0, 1.0], "velocity_m_s": [10.0, 8.0, 12.0]}
    )
    return results._replace(flights=table, slices=velocities.assign(observed=True))


def test_the_summary_counts_accepted_flights_from_the_lance(flown, stored):
    value = summary(flown).set_index("what")["value"]
    assert value["flights from the lance"] == "2"
    assert value["left out: not from the lance"] == "1"
    assert value["flights landed"] == value["flights burnt out"] == "1"
    assert value["dwell time, median"] == "0.600 s"  # two are too few for an interval
    assert value["ignition seen"] == value["ignition none"] == "1"
    assert value["velocity in the metre up to 2 m"] == "median 8.0 m/s, 50 % of the flights"
    written = page(flown, stored)
    assert written.count("<figure>") == 4
    assert "a &lt;note&gt;" in written
    assert written == page(flown, stored)
    refused = flown.flights.assign(refused=["turns back behind the lance", "", ""])
    value = summary(flown._replace(flights=refused)).set_index("what")["value"]
    assert value["refused: turns back behind the lance"] == "1"
    assert value["dwell time, median"] == "0.700 s"


def test_notes_say_what_is_missing_and_what_may_deceive(flown):
    (note,) = doubts(flown)
    assert note.startswith("Ignition was seen in 1 of 2 flights")
    assert not list(doubts(flown, above_background=True))
    dark = flown._replace(flights=flown.flights.assign(ignition="none"))
    assert not list(doubts(dark))
    wild = dark._replace(flights=dark.flights.assign(refused="faster than the air"))
    assert next(doubts(wild)).startswith("2 of 2 flights from the lance are refused")
    elsewhere = flown._replace(flights=flown.flights.assign(from_lance=False, start_mm=9000.0))
    assert "9000 mm from it" in next(doubts(elsewhere))
