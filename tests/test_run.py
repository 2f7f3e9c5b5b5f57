"""`kilnflight run` on stored recordings: what is made, noted and refused."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from kilnflight import kiln, run
from kilnflight.__main__ import _point, main
from kilnflight.checks import InputError
from kilnflight.flight import Rules
from kilnflight.recording.frames import Frame
from kilnflight.recording.store import open_recording, write_recording
from kilnflight.regression import Fit
from kilnflight.run import collect, settings, summary
from kilnflight.run.report import doubts
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


def flat(frame: Frame) -> Frame:
    """Take the depth away and let one bright blob fly."""
    row, col = np.ogrid[: frame.gray.shape[0], : frame.gray.shape[1]]
    far = (row - 150) ** 2 + (col - 60 - 6 * (frame.index - 562)) ** 2
    gray = np.minimum(frame.gray + 20_000 * np.exp(-far / 18), 65_535).astype(np.uint16)
    no_points = {"pixels": np.empty((0, 2), np.int32), "xyz": np.empty((0, 3), np.float32)}
    return replace(frame, gray=gray, **no_points)


@pytest.fixture
def stored(stored_flights):
    return open_recording(stored_flights)


def test_the_whole_way_and_its_report(stored_flights, tmp_path, capsys):
    command = ["run", str(stored_flights), "--to", str(tmp_path), "--threshold", "200"]
    assert main(command) == 0
    output = capsys.readouterr().out
    tracks = pd.read_parquet(tmp_path / "tracks.parquet")
    tracked = tracks[tracks["particle"] >= 0]
    count = tracked["particle"].nunique()
    assert count >= 3
    assert re.search(rf"tracks +{count} with {len(tracked)} detections", output)
    assert re.search(r"threshold of DoG +200 grey values \(given\)", output)
    assert re.search(r"jobs +1\n", output)
    assert "without the texture term" in output
    written = TRAJECTORIES.check(pd.read_parquet(tmp_path / "trajectories.parquet"))
    assert set(written["particle"]) <= set(tracks["particle"])
    assert re.search(rf"trajectories fitted +{len(written)}\n", output)
    FLIGHTS.check(pd.read_parquet(tmp_path / "flights.parquet"))
    SLICES.check(pd.read_parquet(tmp_path / "slices.parquet"))
    page = (tmp_path / "report.html").read_text()
    assert "200 grey values (given)" in page
    assert 'src="data:image/png;base64,' in page
    assert not re.findall(r"(?:src|href)=.?(?:https?:|//)", page)


def test_a_run_is_kept_beside_the_recording(stored, tmp_path, capsys, monkeypatch):
    folder = tmp_path / "mine.zarr"
    write_recording(stored, folder, range(3))
    assert main(["run", str(folder), "--threshold", "200"]) == 0
    assert f"tables and report: {tmp_path / 'mine-run' / 'report.html'}" in capsys.readouterr().out
    monkeypatch.chdir(folder)
    assert run.beside(run.Path(".")) == tmp_path / "mine-run"


def test_a_short_recording_is_work_for_several(stored, tmp_path):
    folder = tmp_path / "mine.zarr"
    write_recording(stored, folder, range(3))
    assert [run.chunk(n) for n in (1, 200, 201, 4000, 4001)] == [25, 25, 26, 500, 500]
    detection = run.prepare(folder, tmp_path, run.Options(200.0))[0].detection
    assert detection.chunks == [range(3)]
    assert len(replace(detection, stop=300, chunk=run.chunk(300)).chunks) == 8


@pytest.mark.parametrize("inside", [".", "out", "a/../b/c"])
def test_a_run_leaves_the_recording_alone(inside, stored_flights, capsys):
    before = sorted(stored_flights.rglob("*"))
    assert main(["run", str(stored_flights), "--to", str(stored_flights / inside)]) == 1
    assert "lies in the recording" in capsys.readouterr().err
    assert sorted(stored_flights.rglob("*")) == before


def test_without_depth_there_are_tracks_in_2d(stored, tmp_path, capsys):
    folder = tmp_path / "flat.zarr"
    write_recording(Changed(stored, flat, lance_mm=None, name="<b>&"), folder)
    assert main(["run", str(folder), "--to", str(tmp_path / "out"), "--threshold", "200"]) == 0
    output = capsys.readouterr().out
    assert "note: The recording has no depth: tracks are 2D." in output
    assert re.search(r"tracks +[1-9]", output)
    assert pd.read_parquet(tmp_path / "out" / "trajectories.parquet").empty
    page = (tmp_path / "out" / "report.html").read_text()
    assert "<h1>&lt;b&gt;&amp;</h1>" in page
    assert "<b>&" not in page


def test_the_lance_must_be_known(stored, tmp_path, capsys):
    folder = tmp_path / "mine.zarr"
    write_recording(Changed(stored, lance_mm=None), folder, range(2))
    command = ["run", str(folder), "--to", str(tmp_path / "out"), "--threshold", "200"]
    assert main(command) == 1
    assert "Give --exit-point x,y,z" in capsys.readouterr().err
    for bad in ("1,2", "a,b,c", "1,2,nan"):
        assert main([*command, "--exit-point", bad]) == 1
        assert f"--exit-point {bad}: write x,y,z" in capsys.readouterr().err
    options = run.Options(200.0, _point("-77,250.7,6828"))
    prepared, _ = run.prepare(folder, tmp_path, options)
    np.testing.assert_allclose(prepared.exit_point_mm, (-73.2, 238.2, 6486.7), atol=0.5)


def test_an_exit_point_may_begin_with_a_minus(stored, tmp_path, capsys):
    folder = tmp_path / "mine.zarr"
    write_recording(Changed(stored, lance_mm=None), folder, range(3))
    command = ["run", str(folder), "--to", str(tmp_path), "--threshold", "200"]
    assert main([*command, "--exit-point", "-77,250.7,6828"]) == 0


@pytest.mark.parametrize(
    "option", [["--threshold", "0"], ["--in-air", "-1"], ["--jobs", "0"], ["--bright", "0"]]
)
def test_numbers_that_make_no_sense(option, stored_flights, tmp_path, capsys):
    assert main(["run", str(stored_flights), "--to", str(tmp_path), *option]) == 1
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_a_threshold_from_the_noise(stored, tmp_path):
    threshold = run.noise_threshold(stored)
    assert 5 * run.LEAST_NOISE < threshold < 1000
    rng = np.random.default_rng(0)
    noisy = np.abs(rng.normal(0, 100, (256, 256))).astype(np.float32)
    noise = run.block_noise(noisy)
    assert run.block_noise(3 * noisy) == pytest.approx(3 * noise, rel=1e-4)
    assert 2 < noise < 40  # of the difference of Gaussians, not of the pixels
    noisy[100:110, 100:110] += 20_000
    assert run.block_noise(noisy) == pytest.approx(noise, rel=0.1)
    assert run.block_noise(np.zeros((40, 50), np.float32)) == 0


def test_no_wall_is_a_note_and_no_flights(stored, tmp_path):
    def sparse(frame):
        return replace(frame, pixels=frame.pixels[:3], xyz=frame.xyz[:3])

    folder = tmp_path / "sparse.zarr"
    write_recording(Changed(stored, sparse), folder, range(3))
    prepared, notes = run.prepare(folder, tmp_path, run.Options(200.0))
    assert "The kiln's wall was not found" in notes[0]
    assert prepared.table("flights")().empty
    assert prepared.table("slices")().empty


def test_uneven_frames_are_noted(stored, tmp_path):
    def late(frame):
        return replace(frame, time_s=frame.time_s + (frame.index > 564))

    folder = tmp_path / "uneven.zarr"
    write_recording(Changed(stored, late), folder, range(6))
    _, notes = run.prepare(folder, tmp_path, run.Options(200.0))
    assert "Frames are not evenly spaced: after frame 2" in notes[-1]


def test_another_content_is_another_source(stored_flights, stored, tmp_path):
    def brighter(frame):
        return replace(frame, gray=frame.gray + (frame.index == 563))

    same = write_recording(stored, tmp_path / "same.zarr")
    other = write_recording(Changed(stored, brighter), tmp_path / "other.zarr")
    original, copied, changed = (
        repr(kiln.stored_source(recording.path)) for recording in (stored, same, other)
    )
    assert original == copied
    assert original != changed


def test_the_settings_name_what_was_used(stored_flights, tmp_path):
    options = run.Options(200.0)
    prepared = run.prepare(stored_flights, tmp_path, options)[0]
    rows = dict(settings(prepared, options, "2"))
    assert rows["threshold of DoG"] == "200 grey values (given)"
    assert rows["lance's outlet, depth calibrated"].endswith(" mm (as recorded)")
    assert f"{prepared.exit_point_mm[2]:.1f} mm" in rows["lance's outlet, depth calibrated"]
    assert rows["kiln's axis"].startswith("through ")
    assert rows["kiln's radius"] == f"{prepared.wall.radius_mm:.0f} mm"
    assert rows["taken for in the air"] == "up to 800 mm from the axis"
    assert rows["taken for alight when first seen"] == "not asked"
    assert rows["jobs"] == "2"
    placed = dict(settings(prepared, run.Options(None, (1.0, 2.0, 3.0)), "2"))
    assert placed["lance's outlet, depth calibrated"].endswith(" mm (given)")
    assert placed["threshold of DoG"].endswith(" (not given, from the noise)")
    bare = dict(settings(replace(prepared, exit_point_mm=None, wall=None), run.Options(), "1"))
    assert bare["threshold of DoG"] == "200 grey values (not given, from the noise)"
    assert bare["lance's outlet"] == bare["kiln's wall"] == "not used"


def test_a_lance_elsewhere_is_noted(stored_flights, tmp_path):
    prepared = run.prepare(stored_flights, tmp_path, run.Options(200.0))[0]
    results = collect(replace(prepared, exit_point_mm=(0.0, 0.0, 30_000.0)), ("first",))
    assert results.notes[0] == "first"
    assert re.search(r"trajectories were fitted, but none starts at the lance", results.notes[1])
    assert re.search(r"lie \d{5} mm from it \(median\)[.;]", results.notes[1])


def test_what_is_bright_from_the_start_is_alight_above_a_level_that_the_user_sets(
    stored_flights, tmp_path
):
    plain = run.prepare(stored_flights, tmp_path, run.Options(200.0))[0]
    asked = run.prepare(stored_flights, tmp_path, run.Options(200.0, bright=1.0))[0]
    assert plain.rules == Rules()  # nothing changes unless it is asked for
    assert asked.rules.ignition.bright == 1.0
    assert dict(settings(asked, run.Options(200.0), "1"))[
        "taken for alight when first seen"
    ].startswith("from 1 ")
    fit = Fit((0.0, 0.0, 6500.0), 0.0, 0, (-0.1, 0.0), (2, 2, 2), LEVEL, 0.05, 0.3, 80)
    frame = np.arange(17, 97)
    places = dict(zip("xyz", fit(frame / 330.0).T, strict=True))
    track = pd.DataFrame({"frame": frame, "particle": 0, "row": 100.0, "col": 150.0, **places})
    track["radius_px"] = 3.0
    track["gray"] = 5000.0 + np.sin(7 * frame)
    for prepared, ignitions in ((plain, "none"), (asked, "before seen")):
        assert kiln.flights_from(prepared, track, {0: fit})["ignition"].tolist() == [ignitions]


def test_alight_when_first_seen_has_a_line_of_its_own(flown):
    first = flown.flights["particle"] == 2
    lit = flown.flights.assign(ignition=flown.flights["ignition"].mask(first, "before seen"))
    value = summary(flown._replace(flights=lit)).set_index("what")["value"]
    assert value["ignition seen"].startswith("50 [")
    assert value["ignition seen, or alight when first seen"].startswith("100 [")


@pytest.fixture
def flown(stored, stored_flights, tmp_path):
    """Results with made-up flights."""
    prepared, _ = run.prepare(stored_flights, tmp_path, run.Options(200.0))
    results = collect(prepared, ("a <note>",))
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


def test_the_summary_counts_flights_from_the_lance(flown, stored):
    value = summary(flown).set_index("what")["value"]
    assert value["flights from the lance"] == "2"
    assert value["left out: not from the lance"] == "1"
    assert value["flights landed"] == value["flights burnt out"] == "1"
    assert value["dwell time, median"] == "0.600 s"  # two are too few for an interval
    assert value["ignition seen"].startswith("50 [")
    assert value["too few points to judge ignition"] == "0 of 2"  # the third is not counted
    assert not [what for what in value.index if "alight" in what]
    assert value["velocity in the metre up to 2 m"] == (
        "median 8.0 m/s, 50 [9, 91] % of the flights"
    )
    page = run.page(flown, stored)
    assert page.count("<figure>") == 4
    assert "a &lt;note&gt;" in page
    assert page == run.page(flown, stored)


def test_the_summary_names_refused_flights_by_reason(flown, stored):
    assert not [what for what in summary(flown)["what"] if "refused:" in what]
    refused = ["turns back behind the lance", "", "leaves the kiln"]  # 3 is not from the lance
    slices = flown.slices[flown.slices["particle"] == 2]  # as the chain has it
    results = flown._replace(flights=flown.flights.assign(refused=refused), slices=slices)
    value = summary(results).set_index("what")["value"]
    assert value["refused: turns back behind the lance"] == "1 (particle 1)"
    assert "refused: leaves the kiln" not in value.index
    assert value["flights from the lance"] == "1"
    assert value["dwell time, median"] == "0.700 s"
    many = pd.concat([results.flights.head(1).assign(particle=k) for k in range(12)])
    none = slices.head(0)
    table = summary(flown._replace(flights=many, slices=none)).set_index("what")["value"]
    assert table["refused: turns back behind the lance"].endswith(" 8, 9, ...)")
    page = run.page(results, stored)
    assert "refused: turns back behind the lance" in page


def test_the_velocity_of_the_air_is_the_users(stored_flights, tmp_path):
    slow = run.Options(200.0, air_m_s=5.0)
    prepared = run.prepare(stored_flights, tmp_path, slow)[0]
    assert prepared.rules.plausible.fastest_m_s == prepared.cutting.fastest_m_s == 10.0
    assert dict(settings(prepared, slow, "1"))["refused as too fast"] == "above 10 m/s"
    with pytest.raises(InputError, match="air_m_s"):
        run.Options(air_m_s=0.0)


def test_the_summary_names_what_to_doubt(flown):
    table = flown.trajectories.head(3).assign(particle=[1, 2, 3], rmse_z_mm=[200.0, 1400.0, 9e9])
    slices = flown.slices.assign(observed=[True, False, True], velocity_m_s=[10.0, -99.0, 12.0])
    results = flown._replace(trajectories=table, slices=slices)
    value = summary(results).set_index("what")["value"]
    assert value["RMSE of their fits in x, y, z, median"].endswith(", 800 mm")
    assert value["largest RMSE in depth"] == "1400 mm (particle 2)"  # 3 is not from the lance
    assert value["fastest metre"] == "-99.0 m/s (particle 1, up to 2 m)"
    assert value["metres passed before the particle was first seen"] == "1 of 3"
    empty = results._replace(flights=results.flights.head(0), slices=slices.head(0))
    assert not [what for what in summary(empty)["what"] if "RMSE" in what or "fastest" in what]


def test_notes_say_what_is_missing_and_what_may_deceive(flown):
    (note,) = doubts(flown)
    assert note.startswith("Ignition was seen in 1 of 2 flights")
    assert not list(doubts(flown, above_background=True))
    dark = flown._replace(flights=flown.flights.assign(ignition="none"))
    assert not list(doubts(dark))
    wild = dark._replace(flights=dark.flights.assign(refused="faster than the air"))
    assert next(doubts(wild)).startswith("2 of 2 flights from the lance are refused")
    lost = flown._replace(tracks=flown.tracks.assign(particle=-1))
    assert re.match(r"No tracks: of \d+ detections \d+ are in the air", next(doubts(lost)))
    empty = lost._replace(tracks=lost.tracks.head(0), detections=lost.detections.head(0))
    assert next(doubts(empty)).startswith("Nothing was detected")
    elsewhere = flown._replace(flights=flown.flights.assign(from_lance=False, start_mm=9000.0))
    # a count of 0 is not mentioned
    assert "9000 mm from it (median)" in next(doubts(elsewhere))
    assert "Is the lance's" in next(doubts(elsewhere))
    early = flown.trajectories.head(2).assign(particle=[1, 2], t0_at_bound=-1)
    note = next(doubts(elsewhere._replace(trajectories=early)))
    assert "(median); of 2 no way back to it was found" in note


def test_a_picture_without_noise_is_noted(stored, tmp_path):
    def still(frame):
        return replace(frame, gray=np.full_like(frame.gray, 65_535))

    folder = tmp_path / "still.zarr"
    write_recording(Changed(stored, still), folder, range(3))
    _, notes = run.prepare(folder, tmp_path, run.Options())
    assert "the first frames have less (are they all of one grey value, saturated" in notes[0]


def test_a_file_is_no_folder_to_write_to(stored_flights, tmp_path, capsys):
    (tmp_path / "out").write_text("")
    command = ["run", str(stored_flights), "--to", str(tmp_path / "out"), "--threshold", "200"]
    assert main(command) == 1
    assert "is a file. Give a folder, such as" in capsys.readouterr().err


def test_ignition_may_be_read_above_the_background(stored_flights, tmp_path):
    options = run.Options(200.0, above_background=True)
    prepared, _ = run.prepare(stored_flights, tmp_path, options)
    ignitions = dict(settings(prepared, options, "1"))
    assert ignitions["ignition"] == "a step of the grey values above the background"
    fit = Fit((0.0, 0.0, 6500.0), 0.0, 0, (-0.1, 0.0), (2, 2, 2), LEVEL, 0.05, 0.3, 80)
    frame = np.arange(17, 97)
    places = dict(zip("xyz", fit(frame / 330.0).T, strict=True))
    track = pd.DataFrame({"frame": frame, "particle": 0, "radius_px": 3.0, **places})
    track["row"], track["col"] = 100.0, np.where(frame < 50, 60.0, 150.0)
    source = prepared.detection.source
    behind = kiln.background_gray(track, source, range(len(source.recording())))
    assert len(np.unique(behind)) == 2  # of both places
    track["gray"] = behind + 500.0 + np.sin(7 * frame)
    above = kiln.flights_from(prepared, track, {0: fit})["ignition"].tolist()
    rising = track.assign(gray=track["gray"] + 4000.0 * (frame >= 50))
    assert above == ["none"]
    assert kiln.flights_from(prepared, rising, {0: fit})["ignition"].tolist() == ["seen"]
