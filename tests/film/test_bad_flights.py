"""Detections that make no flight: every outcome is a defined empty table."""

import re

import numpy as np
import pandas as pd
import pytest

from kilnflight import chain
from kilnflight.film.doubts import doubts
from kilnflight.film.preparation import prepare
from kilnflight.film.report import summary
from kilnflight.film.settings import Options
from kilnflight.recording.store import open_recording
from kilnflight.tables import DETECTIONS

LANCE = np.array([-64.9, 213.9, 5856.0])  # of the small twin, depth calibrated


def detections(count, start=LANCE, depth=lambda z: z):
    """Return one particle's detections, from ``start`` towards the camera.

    Another ``depth`` leaves places on their pixels' rays, as an error of the camera
    does.
    """
    frame = np.arange(count)
    time = (frame + 2) / 330.0
    scatter = np.random.default_rng(0).normal(0.0, 1.0, (20, 3))[:count] * (
        2.0,
        2.0,
        20.0,
    )
    way = np.stack(
        [400 * time, 900 * time - 2000 * time**2, -6000 * time + 2000 * time**2], 1
    )
    places = start + way + scatter
    x, y, z = (places * (depth(places[:, 2]) / places[:, 2])[:, None]).T
    table = pd.DataFrame(
        {"frame": frame, "row": 100.0 + 3 * frame, "col": 60.0 + 4 * frame}
    )
    table = table.assign(radius_px=3.0, gray=5000.0 + np.sin(7.0 * frame))
    return DETECTIONS.check(table.assign(x=x, y=y, z=z, points=5, case=1))


def without_depth(table, but=()):
    unknown = ~table["frame"].isin(but)
    gone = {axis: table[axis].mask(unknown) for axis in "xyz"}
    return table.assign(**gone, points=table["points"].mask(unknown, 0))


@pytest.fixture(scope="module")
def prepared(stored_flights, tmp_path_factory):
    recording = open_recording(stored_flights)
    return prepare(recording, tmp_path_factory.mktemp("run"), Options(threshold=200.0))


@pytest.fixture
def outcome(prepared, tmp_path, monkeypatch):
    """Return a function from detections to the tables, the summary and the doubts of a
    run.
    """

    def run_with(table):
        monkeypatch.setattr(chain.DetectionRun, "detections", lambda _: table)
        ready, _ = prepared
        object.__setattr__(ready.detection, "folder", tmp_path)
        tables = {"detections": table} | {
            step: ready.table(step)() for step in chain.CHAIN_STEPS
        }
        value, doubtful = summary(tables), " ".join(doubts(tables))
        assert not re.search(r"\b(?:nan|inf)\b", f"{value} {doubtful}", re.IGNORECASE)
        return tables, value, doubtful

    return run_with


@pytest.mark.parametrize(
    ("table", "tracks", "reasons"),
    [
        (detections(0), 0, []),
        (detections(2), 0, []),  # sec. 4.2.1: two are false
        (detections(3), 1, ["too few points"]),
        (without_depth(detections(20)), 1, ["no depth"]),
        (without_depth(detections(20), (5, 9)), 1, ["too few points"]),
    ],
)
def test_what_cannot_be_fitted_is_no_flight(outcome, table, tracks, reasons):
    tables, value, doubtful = outcome(table)
    assert value["tracks"].startswith(f"{tracks} with ")
    assert bool(doubtful) == (tracks == 0 or len(table) < 10)
    assert tables["trajectories"]["outcome"].tolist() == reasons
    assert tables["flights"].empty
    assert tables["slices"].empty
    assert "flights from the lance" not in value


@pytest.mark.parametrize("by", [3000.0, -3000.0])
def test_a_jump_of_three_metres_is_cut(outcome, by):
    """3 m in 3 ms along the ray, so that no pixel moves."""
    jump = np.where(np.arange(20) >= 10, by, 0.0)
    tables, _, _ = outcome(detections(20, depth=lambda z: z + jump))
    tracks = tables["tracks"].query("particle >= 0")
    assert tracks["particle"].nunique() == 2
    sides = (
        tracks.assign(late=tracks["frame"] >= 10).groupby("particle")["late"].nunique()
    )
    assert (sides == 1).all()
    assert (tables["slices"]["velocity_m_s"].abs() <= 32).all()


def test_lost_flights_have_no_dwell_time(outcome):
    tables, value, _ = outcome(detections(20))
    assert tables["flights"]["ending"].tolist() == ["lost"]
    assert value["flights from the lance"].startswith("1 of 1 ")
    assert value["ending: lost"] == "1"
    assert "dwell time, median" not in value
