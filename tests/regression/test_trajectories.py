"""The table of trajectories, the measures, and what cannot be regressed."""

import numpy as np
import pandas as pd
import pytest

from kilnflight.checks import InputError
from kilnflight.regression import (
    FITTED,
    NO_DEPTH,
    TOO_FEW,
    Fit,
    Regression,
    fits,
    measures,
    regress,
    regress_all,
)
from kilnflight.tables import TRAJECTORIES

EXIT, RATE = (120.0, 60.0, 6500.0), 330.0
SCATTER = (7.0, 7.0, 150.0)


@pytest.fixture
def tracks(flight):
    """Return five tracks: two good ones, one without depth, one short, one lost."""
    parts = [flight(seed=k, t0=0.1 * k, scatter=SCATTER) for k in range(5)]
    parts[2][list("xyz")] = np.nan
    parts[3].loc[3:, "z"] = np.nan
    names = (7, 0, 3, 5, -1)
    named = [part.assign(particle=name) for part, name in zip(parts, names, strict=True)]
    return pd.concat(named, ignore_index=True)


def test_every_track_has_its_row_and_says_what_became_of_it(tracks):
    table = regress_all(tracks, EXIT, RATE)
    assert table["particle"].tolist() == [0, 3, 5, 7]
    assert table["outcome"].tolist() == [FITTED, NO_DEPTH, TOO_FEW, FITTED]
    assert table["points"].tolist() == [60, 0, 3, 60]
    assert table.loc[1:2, "t0_s"].isna().all()
    assert table.loc[0, "coefficient_x_6"] == 0
    pd.testing.assert_frame_equal(TRAJECTORIES.check(table), table)


def test_the_fits_come_back_from_the_table_and_from_parquet(tracks, tmp_path):
    table = regress_all(tracks.sample(frac=1.0, random_state=1), EXIT, RATE)
    expected = {k: regress(tracks[tracks["particle"] == k], EXIT, RATE) for k in (0, 7)}
    assert fits(table) == expected
    table.to_parquet(tmp_path / "trajectories.parquet")
    assert fits(pd.read_parquet(tmp_path / "trajectories.parquet")) == expected


def test_nothing_gives_nothing(tracks):
    nothing = tracks.iloc[:0]
    table = regress_all(nothing, EXIT, RATE)
    assert len(table) == 0
    assert list(table.columns) == TRAJECTORIES.names
    assert fits(table) == {}
    assert len(regress_all(tracks[tracks["particle"] == -1], EXIT, RATE)) == 0


def test_the_measures_are_the_equations():
    places, fitted, k = np.array([1.0, 2.0, 4.0, 3.0]), np.array([1.5, 2.0, 3.0, 3.0]), 2
    rmse, mape, r2, adjusted = measures(places, fitted, k)
    assert rmse == pytest.approx(np.sqrt(1.25 / 1))
    assert mape == pytest.approx(100 / 4 * (0.5 + 0.25))
    assert r2 == pytest.approx(1 - 1.25 / 5)
    assert adjusted == pytest.approx(r2 - (1 - r2) * 2 / 1)


def test_measures_that_are_not_defined_are_nan():
    zeros = measures(np.zeros(5), np.ones(5), 2)
    assert np.isnan(zeros[1:]).all()  # no relative error, no scatter to explain
    values = measures(np.array([0.0, 2.0, 2.0, 4.0]), np.array([1.0, 1.0, 2.0, 4.0]), 2)
    assert values[1] == pytest.approx(100 / 3 * 0.5)


def test_an_axis_along_which_nothing_moves_has_no_r2(flight):
    track = flight(scatter=SCATTER).assign(x=150.0)
    for point in (EXIT, (150.0, *EXIT[1:])):
        fit = regress(track, point, RATE)
        assert np.isnan([fit.r2[0], fit.r2_adjusted[0]]).all()
        assert np.isfinite([*fit.rmse_mm, *fit.r2[1:]]).all()
    still = track.assign(x=EXIT[0], y=EXIT[1], z=EXIT[2])
    assert np.isfinite(regress(still, EXIT, RATE).t0)


@pytest.mark.parametrize("order", [2, 3, 7])
def test_a_fixed_order_is_that_of_every_axis(tracks, order):
    fixed = Regression(lowest=order, highest=order)
    fitted = [regress(tracks[tracks["particle"] == k], EXIT, RATE, fixed) for k in (0, 7)]
    assert {fit.orders for fit in fitted} == {(order,) * 3}
    assert np.median([fit.rmse_mm[2] for fit in fitted]) == pytest.approx(150, rel=0.3)


@pytest.mark.parametrize("order", [2, 3, 7])
def test_a_fixed_order_needs_two_points_more(flight, order):
    fixed = Regression(lowest=order, highest=order)
    assert fixed.fewest == order + 2
    assert regress(flight(points=order + 2, scatter=SCATTER), EXIT, RATE, fixed).orders[0] == order
    with pytest.raises(
        InputError, match=f"{order + 1} points, but order {order} needs {order + 2}"
    ):
        regress(flight(points=order + 1, scatter=SCATTER), EXIT, RATE, fixed)


@pytest.mark.parametrize("points", [4, 5, 6, 8])
def test_no_order_takes_the_last_degree_of_freedom(flight, points):
    fit = regress(flight(points=points, scatter=SCATTER), EXIT, RATE)
    assert max(fit.orders) <= points - 2
    assert np.isfinite([*fit.rmse_mm, *fit.r2_adjusted]).all()


def test_rows_without_depth_are_left_out(flight):
    track = flight(scatter=SCATTER)
    holes = track.copy()
    holes.loc[[0, 5, 59], ["x", "y", "z"]] = np.nan
    assert regress(holes, EXIT, RATE) == regress(track.drop([0, 5, 59]), EXIT, RATE)


def doubled(track):
    return pd.concat([track, track.iloc[[3]]], ignore_index=True)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.iloc[:3], "3 points, but order 2 needs 4"),
        (lambda t: t.iloc[:0], "no points"),
        (lambda t: t.assign(z=np.nan), "0 points"),
        (doubled, "particle 0 has two rows in frame"),
        (lambda t: t.assign(z=np.inf), "a place is infinite in row 0"),
        (lambda t: t.assign(z=1e200), "farther than"),
        (lambda t: t.assign(z="far"), "column z is not made of numbers"),
        (lambda t: t.assign(frame=t["frame"] + 0.5), "no whole number"),
        (lambda t: t.assign(particle=t["frame"]), "more than one particle"),
        (lambda t: t.drop(columns="x"), "column.s. x missing"),
        (lambda t: t.drop(columns="frame"), "column.s. frame missing"),
        (lambda t: t.to_numpy(), "no table"),
    ],
)
def test_a_track_that_cannot_be_regressed_is_refused(flight, change, message):
    with pytest.raises(InputError, match=message):
        regress(change(flight()), EXIT, RATE)


def test_what_else_cannot_be_is_refused(flight):
    track = flight()
    with pytest.raises(InputError, match="time_s missing"):
        regress(track, EXIT)
    with pytest.raises(InputError, match="column time_s"):
        regress(track.assign(time_s=np.nan), EXIT)
    with pytest.raises(InputError, match="particle 0 has two rows in time_s"):
        regress(track.assign(time_s=1.0), EXIT)
    with pytest.raises(InputError, match="frame_rate_hz"):
        regress(track, EXIT, 0.0)
    for point in ((1.0, 2.0), (1.0, 2.0, np.nan), "lance"):
        for call in (regress, regress_all):
            with pytest.raises(InputError, match="exit_point"):
                call(track, point, RATE)
    with pytest.raises(InputError, match="ends at order 6"):
        regress_all(track, EXIT, RATE, Regression(highest=7))
    with pytest.raises(InputError, match="Fit: time"):
        regress(track, EXIT, RATE)([np.nan])


@pytest.mark.parametrize(
    "wrong",
    [
        {"lowest": 0},
        {"lowest": 4, "highest": 3},
        {"highest": 10},
        {"gain": -0.1},
        {"draws": 0},
        {"longest_s": 0.0},
        {"seed": -1},
    ],
)
def test_parameters_that_are_none_are_refused(wrong):
    with pytest.raises(InputError, match=f"Regression: {[*wrong][-1]}"):
        Regression(**wrong)


def test_one_time_is_one_place(flight):
    fit = regress(flight(), EXIT, RATE)
    assert isinstance(fit, Fit)
    assert fit(0.3).shape == fit.velocity(0.3).shape == (1, 3)
    assert fit([]).shape == (0, 3)


@pytest.mark.parametrize("step", [1e-9, 1.0, 1e6])
@pytest.mark.parametrize("size", [1e-300, 1.0, 1e99])
def test_no_scale_of_time_or_space_breaks_it(step, size):
    places = size * np.random.default_rng(0).normal(size=(9, 3))
    fit = Regression()(1e3 * step + step * np.arange(9), places, np.array(EXIT))
    assert fit.t0_range_s[0] <= fit.t0 <= fit.t0_range_s[1] < fit.first_s
    assert np.isfinite(fit.rmse_mm).all()


def test_two_times_next_to_each_other_are_two():
    time = np.array([0.0, 1e-12, 1.0, 2.0, 3.0])
    places = np.random.default_rng(0).normal(size=(5, 3))
    assert np.isfinite(Regression()(time, places, np.array(EXIT)).rmse_mm).all()
