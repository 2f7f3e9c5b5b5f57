"""Films of one particle, or of particles that rest: tables and pictures from a run."""

import numpy as np
import pandas as pd
import pytest
from tests.definitions.films import film

import kilnflight
from kilnflight.film.pictures import pictures
from kilnflight.scores import score_tracks

ONE = {"cells": (1, 1), "pitch": 64, "drift": (0.0, 0.0)}
KINDS = {  # film, and whether its displacements are drawn
    "bead": (ONE | {"frames": 80, "diffusion": 0.3}, True),
    "flight": (ONE | {"frames": 30, "drift": (0.4, 1.0), "noise": 0.0}, True),
    "equal steps": (ONE | {"frames": 30, "drift": (1.0, 0.0), "noise": 0.0}, True),
    "rests": (ONE | {"frames": 30, "noise": 0.0}, False),
    "three rest": (ONE | {"cells": (1, 3), "frames": 30, "noise": 0.0}, False),
    "two frames": (ONE | {"frames": 2}, False),
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_run_of_one_particle_gives_tables_and_pictures(kind, tmp_path):
    given, drawn = KINDS[kind]
    pictures, truth = film(**given)
    tables = kilnflight.run(pictures, tmp_path / "out")
    tracks = tables["tracks"]
    assert score_tracks(truth, tracks, 2.0).jsc_theta == 1.0
    pd.testing.assert_frame_equal(
        pd.read_parquet(tmp_path / "out/tracks.parquet"), tracks
    )
    names = {path.stem for path in (tmp_path / "out").glob("*.png")}
    always = {"detections", "tracks", "lengths-and-speeds"}
    assert names - {"mean-square-displacement"} == always
    assert ("mean-square-displacement" in names) == drawn
    found = kilnflight.square_displacements(tracks)
    true = kilnflight.square_displacements(truth)
    if drawn:
        assert found["pairs"].tolist() == true["pairs"].tolist()
        np.testing.assert_allclose(found["square_px2"], true["square_px2"], atol=0.5)
        fit = kilnflight.fit_spreading(found)
        if kind == "bead":
            assert fit.diffusion == pytest.approx(0.3, abs=3 * fit.diffusion_error)
        else:
            assert fit.exponent == pytest.approx(2.0, abs=0.1)


def test_no_picture_prevents_a_table(tmp_path, monkeypatch):
    def fail(figure):
        raise ValueError("Too many bins")

    monkeypatch.setattr("kilnflight.film.pictures.png", fail)
    with pytest.raises(ValueError, match="bins"):
        kilnflight.run(film(**ONE)[0], tmp_path)
    written = {path.name for path in tmp_path.iterdir()} - {"parts"}
    tables = ("detections.parquet", "tracks.parquet", "tracks.csv", "summary.csv")
    assert written == set(tables)


def test_steps_that_differ_by_rounding_are_drawn(tmp_path):
    frame = np.arange(40)
    tracks = pd.DataFrame({"frame": frame, "particle": 0, "row": 5.0, "col": frame / 3})
    tracks = tracks.assign(radius_px=2.0, z=np.nan)
    tables = {"detections": tracks, "tracks": tracks}
    recording = kilnflight.open(np.zeros((40, 20, 20), np.uint8))
    drawn = dict(pictures(recording, tables, frame))
    assert len(drawn) == 4


@pytest.mark.parametrize("turn", ["wall", "stop"])
def test_a_lone_particle_that_turns_or_stops_is_one_track(turn):
    frame = np.arange(60)
    col = np.minimum(frame, 30) * 3.0
    if turn == "wall":
        col = 20.0 + np.where(frame < 30, 2 * frame, 118 - 2 * frame)
    rng = np.random.default_rng(0)
    row, col = np.array([frame * 0.5, col]) + rng.normal(0, 0.05, (2, 60))
    tracks = kilnflight.track(pd.DataFrame({"frame": frame, "row": row, "col": col}))
    assert len({*tracks["particle"]}) == 1
