"""Bad input all the way: every outcome is a sentence or a defined empty table.

A small recording with depth on disk; what is detected in it is made up. Then the whole command
runs: tracks, trajectories, flights, slices, summary and page are looked at.
"""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import kilnflight
from kilnflight import kiln, run
from kilnflight.__main__ import main
from kilnflight.checks import InputError
from kilnflight.project.parallel import Workers
from kilnflight.recording.store import open_recording, write_recording
from kilnflight.run.lance import place_in_picture
from kilnflight.tables import DETECTIONS, FLIGHTS, SLICES, TRAJECTORIES

LANCE = np.array([-64.9, 213.9, 5856.0])  # of the small twin, depth calibrated
RATE_HZ = 330.0
FILES = {"detections", "tracks", "trajectories", "flights", "slices"}


def detections(count, start=LANCE, depth=lambda z: z, first=0):
    """Return one particle's detections, from ``start`` towards the camera.

    Another ``depth`` leaves places on their pixels' rays, as an error of the camera does.
    """
    frame = np.arange(first, first + count)
    time = (frame - first + 2) / RATE_HZ
    scatter = np.random.default_rng(0).normal(0.0, 1.0, (20, 3))[:count] * (2.0, 2.0, 20.0)
    way = np.stack([400 * time, 900 * time - 2000 * time**2, -6000 * time + 2000 * time**2], 1)
    places = start + way + scatter
    x, y, z = (places * (depth(places[:, 2]) / places[:, 2])[:, None]).T
    table = pd.DataFrame({"frame": frame, "row": 100.0 + 3 * frame, "col": 60.0 + 4 * frame})
    table = table.assign(radius_px=3.0, gray=5000.0 + np.sin(7.0 * frame))
    table = table.assign(x=x, y=y, z=z, points=5, case=1)
    return DETECTIONS.check(table)


def without_depth(table, but=()):
    unknown = ~table["frame"].isin(but)
    gone = {axis: table[axis].mask(unknown) for axis in "xyz"}
    return table.assign(**gone, points=table["points"].mask(unknown, 0))


def jump(z, by=3000.0):
    return z + np.where(np.arange(len(z)) >= 10, by, 0.0)


@pytest.fixture
def outcome(stored_flights, tmp_path, monkeypatch, capsys):
    """Return a function from detections to the tables, the summary and the output of a run."""

    def run_with(table):
        def given(recording, frames, *_, **__):
            return table[table["frame"].isin(list(frames))].reset_index(drop=True)

        monkeypatch.setattr(kiln, "detect", given)
        target = tmp_path / "out"
        command = ["run", str(stored_flights), "--to", str(target), "--threshold", "200"]
        assert main(command) == 0
        printed = capsys.readouterr().out
        tables = {name: pd.read_parquet(target / f"{name}.parquet") for name in FILES}
        for shape in (DETECTIONS, TRAJECTORIES, FLIGHTS, SLICES):
            name = {"regressed trajectories": "trajectories", "space-sliced velocities": "slices"}
            shape.check(tables[name.get(shape.name, shape.name)])
        words = pd.read_csv(target / "summary.csv", dtype=str, keep_default_na=False)
        page = re.sub(r'src="data:[^"]*"', "", (target / "report.html").read_text())
        for text in (printed, page, *words["value"]):
            assert not re.search(r"\bnan\b|\binf\b", text, re.IGNORECASE)
        assert not list(target.rglob("*.part*"))
        return tables, words.set_index("what")["value"], " ".join(printed.split())

    return run_with


def test_nothing_detected(outcome):
    tables, value, printed = outcome(detections(0))
    assert all(table.empty for table in tables.values())
    assert "note: Nothing was detected" in printed
    assert value["flights from the lance"] == "0"


@pytest.mark.parametrize("count", [1, 2])
def test_tracks_of_one_or_two_detections_are_no_tracks(outcome, count):
    """Section 4.2.1: tracklets of up to two frames are false."""
    tables, value, printed = outcome(detections(count))
    assert (tables["tracks"]["particle"] == -1).all()
    assert tables["trajectories"].empty
    assert tables["flights"].empty
    assert f"note: No tracks: of {count} detections" in printed
    assert value["tracks"] == "0 with 0 detections"


def test_a_track_of_three_detections_is_too_short_for_a_trajectory(outcome):
    tables, value, printed = outcome(detections(3))
    assert value["tracks"] == "1 with 3 detections"
    assert tables["trajectories"]["outcome"].tolist() == ["too few points"]
    assert tables["flights"].empty
    assert "None of 1 tracks could be fitted (too few points 1)" in printed
    assert "4 or more detections with depth" in printed


@pytest.mark.parametrize(
    ("known", "reason"), [((), "no depth"), ((5,), "too few points"), ((5, 9), "too few points")]
)
def test_flights_without_depth_are_tracks_only(outcome, known, reason):
    tables, value, printed = outcome(without_depth(detections(20), known))
    assert value["tracks"] == "1 with 20 detections"
    assert tables["trajectories"]["outcome"].tolist() == [reason]
    assert tables["flights"].empty
    assert tables["slices"].empty
    assert f"could be fitted ({reason} 1)" in printed


def test_depths_that_are_all_equal_are_no_flight_from_the_lance(outcome):
    """Nothing leaves a lance that points at the camera without coming nearer."""
    tables, value, printed = outcome(detections(20, depth=lambda z: np.full(len(z), 6400.0)))
    assert len(tables["flights"]) == 1
    assert value["flights from the lance"] == "0"
    assert tables["slices"].empty
    assert "none starts at the lance" in printed or "are refused" in printed


@pytest.mark.parametrize("by", [3000.0, -3000.0])
def test_a_jump_of_three_metres_is_cut(outcome, by):
    """A step that no particle makes: 3 m in 3 ms, along the ray, so that no pixel moves."""
    tables, _, _ = outcome(detections(20, depth=lambda z: jump(z, by)))
    tracks = tables["tracks"].query("particle >= 0")
    assert tracks["particle"].nunique() == 2
    sides = tracks.assign(late=tracks["frame"] >= 10).groupby("particle")["late"].nunique()
    assert (sides == 1).all()
    counted = tables["flights"].query("from_lance and refused == ''")
    assert (tables["slices"]["velocity_m_s"].abs() <= 32).all()
    assert set(tables["slices"]["particle"]) <= set(counted["particle"])


def test_no_flight_from_the_lance(outcome):
    far = LANCE - (0.0, 0.0, 3500.0)
    tables, value, printed = outcome(detections(20, far))
    assert not tables["flights"]["from_lance"].any()
    assert tables["slices"].empty
    assert value["flights from the lance"] == "0"
    assert "dwell time, median" not in value.index
    assert "1 trajectories were fitted, but none starts at the lance" in printed


def test_all_flights_lost(outcome):
    tables, value, printed = outcome(detections(20))
    assert tables["flights"]["ending"].tolist() == ["lost"]
    assert value["flights from the lance"] == value["flights lost"] == "1"
    assert "All 1 flights from the lance were lost in the air" in printed
    assert "dwell time, median" not in value.index  # lost ones are never complete
    assert value["of complete flights"] == "0 of 1"


def test_the_steps_in_python_end_the_same_way(stored_flights, tmp_path, monkeypatch):
    """The functions behind the command: `kiln.make_tables` on three detections, and on none."""
    for count in (0, 3):
        monkeypatch.setattr(kiln, "detect", lambda *_, count=count, **__: detections(count))
        folder = tmp_path / str(count)
        prepared, _ = run.prepare(stored_flights, folder, run.Options(200.0))
        kiln.make_tables([prepared], Workers())
        assert FLIGHTS.check(prepared.table("flights")()).empty
        assert SLICES.check(prepared.table("slices")()).empty


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_few_detections_are_tracked_in_python_and_by_the_command(count, tmp_path, capsys):
    table = detections(count)
    tracks = kilnflight.track(table)
    assert tracks["particle"].nunique() == min(count, 1)
    assert (tracks["particle"] >= 0).all() == (count in (0, 3))
    raw = kilnflight.track(table, raw=True)
    assert (raw["particle"] >= 0).all()
    table.to_csv(tmp_path / "detections.csv", index=False)
    target = tmp_path / "tracks.csv"
    assert main(["track", str(tmp_path / "detections.csv"), str(target)]) == 0
    assert capsys.readouterr().out.startswith(f"{int(count == 3)} tracks with ")
    assert len(pd.read_csv(target)) == count


def test_a_frame_below_zero_is_refused_and_nothing_is_written(tmp_path, capsys):
    table = detections(5, first=-1)
    with pytest.raises(InputError, match="frame: "):
        kilnflight.track(table)
    table.to_csv(tmp_path / "detections.csv", index=False)
    assert main(["track", str(tmp_path / "detections.csv"), str(tmp_path / "tracks.csv")]) == 1
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert not (tmp_path / "tracks.csv").exists()


def test_images_without_particles_give_an_empty_table(tmp_path):
    recording = kilnflight.open(np.full((4, 48, 64), 1000, np.uint16))
    table = kilnflight.detect(recording)
    assert DETECTIONS.check(table).empty
    assert kilnflight.track(table).empty


def with_lance(stored_flights, folder, lance_mm):
    recording = open_recording(stored_flights)

    class Moved:
        attributes = replace(recording.attributes, lance_mm=lance_mm)
        frame = staticmethod(recording.frame)

        def __len__(self):
            return len(recording)

    write_recording(Moved(), folder, range(3))
    return folder


def test_a_lance_outside_the_picture_is_noted(stored_flights, tmp_path, capsys):
    folder = with_lance(stored_flights, tmp_path / "moved.zarr", (6000.0, 240.0, 6828.0))
    assert main(["run", str(folder), "--threshold", "200"]) == 0
    printed = capsys.readouterr().out
    assert re.search(
        r"note: The lance ends outside the picture, at row \d+ and column \d+ of", printed
    )
    assert "come into view later" in printed
    assert "The lance ends outside the picture" in (tmp_path / "moved-run/report.html").read_text()


@pytest.mark.parametrize(
    ("z", "message"),
    [(500.0, "the recording's depth calibration"), (0.0, "point 0 has depth 0")],
)
def test_a_lance_behind_the_camera_is_refused(stored_flights, tmp_path, capsys, z, message):
    """Eq. 2.4 holds around 3 to 5 m: it puts 500 mm behind the camera."""
    folder = with_lance(stored_flights, tmp_path / "moved.zarr", (0.0, 240.0, z))
    assert main(["run", str(folder), "--threshold", "200"]) == 1
    error = capsys.readouterr().err
    assert f"recording paper-shred-4.5-bar@small: lance: captured points: {message}" in error
    assert len(error.splitlines()) == 1
    assert not (tmp_path / "moved-run").exists()


def test_the_place_of_a_point_in_the_picture_is_that_of_the_clouds(stored_flights):
    recording = open_recording(stored_flights)
    row, col = place_in_picture(recording, [0, 1], tuple(LANCE.tolist()))
    assert 0 < row < recording.attributes.rows
    assert 0 < col < recording.attributes.columns
    assert place_in_picture(recording, [], tuple(LANCE.tolist())) is None
    cloud = recording.frame(0)
    pixel, place = cloud.pixels[500], run.calibrated_cloud(recording, 0)[500]
    at = place_in_picture(recording, [0], tuple(place.tolist()))
    np.testing.assert_allclose(at, pixel, atol=0.1)
