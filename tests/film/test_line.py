"""The command belt: from a table of particles to predictions, deviations and hits."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from kilnflight.__main__ import main
from kilnflight.belt.models import CV, IA, LateralCV, Predictor, Ratio
from kilnflight.belt.valves import ValveBar
from kilnflight.checks import InputError
from kilnflight.film.line import (
    Line,
    calibration_text,
    predict_line,
    read_calibration,
    run_belt,
)
from kilnflight.simulated.belt.sample import PARTICLES, sample_spots

SPOTS = sample_spots()
LINE = Line(until_mm=688.0, spread_mm=0.1)
FILES = {
    "arrivals.png",
    "calibration.toml",
    "hits.csv",
    "parts",
    "predictions.parquet",
    "summary.csv",
    "tracks.parquet",
}


@pytest.fixture(scope="module")
def found():
    return predict_line(SPOTS, LINE)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    SPOTS.to_csv("spots.csv", index=False)
    return tmp_path


def test_nearly_all_particles_are_predicted_and_hit(found):
    tables, predictor = found
    predictions = tables["predictions"]
    assert len(predictions) == pytest.approx(2 * PARTICLES, abs=4)
    assert isinstance(predictor.arrival, IA)
    assert (predictions["calibrates"] == 1).sum() == 40
    hits = tables["hits"].groupby("window_ms").mean()
    assert hits["hit_percent"][0.0] > 90
    assert hits["hit_percent"][0.0] > hits["hit_percent"][10.0]
    assert hits["air_ms"][0.0] < hits["air_ms"][10.0]


def test_hits_are_counted_by_class():
    """Definition: class 1 is blown out, class 0 hit by chance."""
    tables, _ = predict_line(SPOTS, replace(LINE, windows_ms=(50.0,)))
    predictions = tables["predictions"]
    blown = predictions[predictions["class"] == 1]
    bar = ValveBar(open_s=0.05)
    events = bar.events(blown.rename(columns={"y_mm": "y"}))
    seen = predictions[predictions["calibrates"] == 0]
    arrived = seen[["arrived_s", "arrived_y_mm"]].to_numpy().T
    hit = pd.Series(bar.hits(events, *arrived))
    share = 100 * hit.groupby(seen["class"].to_numpy()).mean()
    hits = tables["hits"].set_index(["class", "window_ms"]).loc[(1, 50.0)]
    assert hits["hit_percent"] == pytest.approx(share[1])
    assert hits["wrong_percent"] == pytest.approx(share[0])
    assert 0 < share[0] < 50


def test_all_are_blown_out_where_there_are_no_classes():
    tables, _ = predict_line(SPOTS.drop(columns="class"), LINE)
    hits = tables["hits"]
    assert hits["class"].tolist() == [-1] * 4
    assert hits["wrong_percent"].isna().all()
    assert hits["hit_percent"][0] > 90


@pytest.mark.parametrize("none", [np.nan, None, pd.NA, -1])
def test_particles_without_a_class_are_kept(none):
    some = SPOTS.astype({"class": object})
    some.loc[::9, "class"] = none
    tables, _ = predict_line(some, LINE)
    assert len(tables["predictions"]) == pytest.approx(2 * PARTICLES, abs=4)
    assert set(tables["predictions"]["class"]) == {0, 1}


def test_more_valves_blow_less_air_beside():
    """Windows by deviations: as many valves as the place is uncertain, and wide."""
    few, many = (
        predict_line(SPOTS, replace(LINE, valves=valves))[0]["hits"]
        for valves in (8, 64)
    )
    assert (few["hit_percent"][0], few["wrong_percent"][0]) > (90, 0)
    assert many["wrong_percent"][0] < few["wrong_percent"][0]


def test_arrivals_are_the_true_ones(found):
    """True paths cross the valves where the noise-free table does."""
    predictions = found[0]["predictions"].dropna()
    calm = SPOTS.groupby("particle")
    crossed = []
    for _, path in calm:
        after = path["x"].searchsorted(LINE.valves_mm)
        if 1 < after < len(path):
            near = path.iloc[after - 2 : after + 2]
            crossed.append(np.interp(LINE.valves_mm, near["x"], near["time_s"]))
    nearest = np.abs(np.subtract.outer(predictions["arrived_s"].to_numpy(), crossed))
    assert np.median(nearest.min(axis=1)) < 1e-4


def test_classes_come_through(found):
    share = found[0]["predictions"]["class"].mean()
    assert share == pytest.approx(0.5, abs=0.01)


def test_frames_and_pixels_are_the_same_as_times_and_millimetres(found):
    frames = SPOTS.assign(frame=(SPOTS["time_s"] * 200).round().astype(int))
    frames[["x", "y"]] /= 0.25
    tables, _ = predict_line(
        frames[["frame", "x", "y", "class"]],
        Line(until_mm=688.0, spread_mm=0.1, rate_hz=200.0, mm_per_px=0.25),
    )
    pd.testing.assert_series_equal(
        tables["predictions"]["y_mm"], found[0]["predictions"]["y_mm"], rtol=1e-6
    )


def test_time_stamps_may_jitter_and_frames_may_be_missing(found):
    rng = np.random.default_rng(0)
    stamps = SPOTS["time_s"].unique()
    moved = dict(
        zip(stamps, stamps + rng.uniform(-1e-3, 1e-3, len(stamps)), strict=True)
    )
    shaken = SPOTS.assign(time_s=SPOTS["time_s"].map(moved))
    gaps = SPOTS[~SPOTS["time_s"].isin(stamps[::17])]
    for spots in (shaken, gaps):
        tables, _ = predict_line(spots, LINE)
        assert len(tables["predictions"]) == len(found[0]["predictions"])


def test_a_calibration_is_saved_and_loaded(tmp_path):
    for models in ((IA(-120.5), Ratio(0.4)), (CV(), LateralCV())):
        predictor = Predictor(*models, 773.0, time_factor=0.6, y_factor=1.5)
        path = tmp_path / "calibration.toml"
        path.write_bytes(calibration_text(predictor))
        assert read_calibration(path) == predictor
    with pytest.raises(InputError, match="calibrated"):
        calibration_text(Predictor(IA()))


@pytest.mark.parametrize(
    "text", ["", "arrival = 3", 'arrival = "XY"', "[", "\0", 'arrival = "IA"\nx = 1']
)
def test_what_is_no_calibration_is_refused(tmp_path, text):
    path = tmp_path / "calibration.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=r"calibration\.toml"):
        read_calibration(path)


def test_the_command_writes_its_tables_and_takes_a_calibration(folder, capsys):
    main(["belt", "spots.csv", "--to", "a", "--until-mm", "688", "--spread-mm", "0.1"])
    assert {path.name for path in (folder / "a").iterdir()} == FILES
    again = ["belt", "spots.csv", "--to", "b", "--until-mm", "688", "--spread-mm"]
    main([*again, "0.1", "--calibration", "a/calibration.toml"])
    first, second = (
        pd.read_parquet(folder / name / "predictions.parquet") for name in "ab"
    )
    columns = ["particle", "time_s", "y_mm", "time_sd_s", "y_sd_mm", "class"]
    assert first.columns.tolist()[:6] == columns
    pd.testing.assert_frame_equal(first[columns], second[columns])
    assert "hit_percent" in capsys.readouterr().out


def test_a_calibration_of_another_place_is_refused(folder):
    (folder / "c.toml").write_bytes(calibration_text(Predictor(target_mm=700.0)))
    with pytest.raises(InputError, match="700"):
        run_belt("spots.csv", "to", LINE, "c.toml")
    assert not (folder / "to").exists()


def test_the_summary_counts_the_particles_that_are_judged(found, folder):
    tables = run_belt("spots.csv", "to", LINE)
    summary = tables["summary"].set_index("what")["value"]
    arrived = found[0]["predictions"]["arrived_s"].count()
    assert summary["of these seen at the valves"] == arrived


def test_the_same_run_again_writes_the_same_bytes(folder):
    def content():
        files = sorted(path for path in (folder / "to").rglob("*") if path.is_file())
        return {path: path.read_bytes() for path in files}

    run_belt("spots.csv", "to", LINE)
    before = content()
    run_belt("spots.csv", "to", LINE)
    assert content() == before


def test_files_of_others_are_kept(folder):
    (folder / "to").mkdir()
    (folder / "to/hits.csv").write_text("mine")
    with pytest.raises(InputError, match="hits"):
        run_belt("spots.csv", "to", LINE)
    assert (folder / "to/hits.csv").read_text() == "mine"


def test_a_camera_that_does_not_see_the_valves_predicts(folder):
    short = SPOTS[SPOTS["x"] < 700]
    with pytest.warns(UserWarning, match="not calibrated"):
        run_belt(short, "short", LINE)
    assert {path.name for path in (folder / "short").iterdir()} == FILES
    with pytest.warns(UserWarning, match="not calibrated"):
        tables, predictor = predict_line(short, LINE)
    assert isinstance(predictor.arrival, CV)
    assert tables["predictions"]["arrived_s"].isna().all()
    assert len(tables["predictions"]) > 390


WRONG = {
    "metres": SPOTS.assign(x=SPOTS["x"] / 1000, y=SPOTS["y"] / 1000),
    "swapped": SPOTS.assign(x=SPOTS["y"], y=SPOTS["x"]),
    "times in ms": SPOTS.assign(time_s=1000 * SPOTS["time_s"]),
    "no times": SPOTS.drop(columns="time_s"),
    "no x": SPOTS.drop(columns="x"),
    "text": SPOTS.assign(x="a"),
    "times of text": SPOTS.assign(time_s="a"),
    "a time that is missing": SPOTS.assign(
        time_s=SPOTS["time_s"].where(SPOTS.index != 5)
    ),
    "empty": SPOTS[:0],
    "one frame": SPOTS[SPOTS["time_s"] == SPOTS["time_s"].median()],
    "classes of text": SPOTS.assign(**{"class": "wheat"}),
    "half a class": SPOTS.assign(**{"class": SPOTS["class"] + (SPOTS.index == 7) / 2}),
}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("case", WRONG)
def test_a_table_that_does_not_fit_is_refused_by_name(folder, case, capsys):
    path = folder / "wrong.csv"
    WRONG[case].to_csv(path, index=False)
    for source in (WRONG[case], path):
        with pytest.raises(InputError, match=r"spots|wrong"):
            run_belt(source, "to", LINE)
    assert not (folder / "to").exists()
    with pytest.raises(SystemExit):
        main(["belt", "wrong.csv", "--to", "to"])
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_a_wrong_frame_interval_is_told():
    with pytest.warns(UserWarning, match="frame interval"):
        predict_line(SPOTS.assign(time_s=5 * SPOTS["time_s"]), LINE)


@pytest.mark.filterwarnings("ignore")
def test_particles_without_a_place_are_left_out_and_told():
    gaps = SPOTS.assign(x=SPOTS["x"].where(np.arange(len(SPOTS)) % 50 > 0))
    with pytest.warns(UserWarning, match="left out"):
        tables, _ = predict_line(gaps, LINE)
    assert len(tables["predictions"]) == pytest.approx(2 * PARTICLES, abs=6)


@pytest.mark.parametrize(
    "option",
    ["--until-mm=x", "--till=3", "--until-mm=300", "--width-mm=-1"],
)
def test_a_line_that_cannot_be_is_refused(folder, option, capsys):
    with pytest.raises(SystemExit):
        main(["belt", "spots.csv", "--to", "to", option])
    assert capsys.readouterr().err
    assert not (folder / "to").exists()
