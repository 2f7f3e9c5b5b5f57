"""Verdicts on flights, from results made by hand."""

import numpy as np
import pandas as pd
import pytest

from kilnflight.experiments import flight_claims, statements
from kilnflight.experiments.campaigns import Measurement, Results
from kilnflight.project import claims
from kilnflight.scores.flights import FlightValues
from kilnflight.twin.particles import FRACTIONS
from kilnflight.twin.scenes import PRESSURES_BAR

KEYS = [(name, bar) for name in FRACTIONS for bar in PRESSURES_BAR]
# seconds of dwell time, as the thesis has them at 4.5 bar
DWELL = {"wood chip": 0.30, "confetti": 0.42, "paper shred": 0.45, "PE granule": 0.48}
SPEED = {"wood chip": 13.5, "confetti": 7.4, "paper shred": 5.2, "PE granule": 9.0}
SCENE = np.random.default_rng(0)


def flights(name, bar, shorter=0.75, count=20):
    """Particles that all do the same; PE granules are quicker at 5 bar."""
    less = shorter if (name, bar) == ("PE granule", 5.0) else 1.0
    velocity = np.full((count, 5), SPEED[name])
    dwell = DWELL[name] * less + np.linspace(-0.005, 0.005, count)
    return FlightValues(dwell, velocity, np.full(count, np.nan), np.full(count, 3.0))


def every(**kinds):
    return {key: flights(*key, **kinds) for key in KEYS}


def results(measured, true=None, ending="landed", count=statements.LEAST_FLIGHTS, refused=""):
    rows = [(*key, k, True, refused, ending) for key in KEYS for k in range(count)]
    columns = ["fraction", "pressure_bar", "particle", "from_lance", "refused", "ending"]
    tables = Measurement(None, None, pd.DataFrame(rows, columns=columns), None)
    return Results([], tables, measured, measured if true is None else true)


def dwell(*args, **kinds):
    judged = flight_claims.dwell_verdicts(results(*args, **kinds), SCENE)
    return {each.id: each for each in judged}


def velocity(*args, **kinds):
    made = results(*args, **kinds)
    quantities = ["velocity", "remaining", "landed"]
    published = statements.beside_published(made.measured, made.true, quantities)
    judged = flight_claims.velocity_verdicts(made, published, SCENE)
    return {each.id: each for each in judged}


def test_dwell_times_as_published_are_reproduced():
    judged = dwell(every())
    assert list(judged) == ["dwell-1", "dwell-2", "dwell-3", "dwell-4"]
    assert judged["dwell-2"].verdict == judged["dwell-3"].verdict == claims.REPRODUCED
    assert "wood chip 4.5 < confetti 4.5" in judged["dwell-2"].reason


def test_what_fails_as_measured_only_is_the_chains_what_fails_on_the_truth_the_twins():
    slow = every() | {("wood chip", 5.0): flights("PE granule", 4.5)}
    for measured, true, cause in ((slow, every(), "chain"), (slow, slow, "twin")):
        verdict = dwell(measured, true)["dwell-2"]
        assert (verdict.verdict, verdict.because) == (claims.NOT_REPRODUCED, cause)


def test_a_median_out_of_bounds_is_open_where_its_interval_or_lost_flights_reach_them():
    """5.3.1: medians of 0.3 to 0.5 s. Complete flights alone are too short."""
    short = flights("wood chip", 4.5)._replace(dwell_s=np.linspace(0.24, 0.32, 20))
    near = dwell(every() | {("wood chip", 4.5): short})["dwell-1"]
    assert near.verdict == claims.NOT_REPRODUCED  # 0.26 to 0.30 s, and nothing was lost
    lost = short._replace(censored_s=np.full(12, 0.27))
    both = dwell(every() | {("wood chip", 4.5): lost}, every())["dwell-1"]
    assert (both.verdict, both.because) == (claims.NOT_DECIDABLE, "method")
    assert "with lost flights censored: " in both.reason
    wide = short._replace(dwell_s=np.linspace(0.24, 0.35, 20))
    assert dwell(every() | {("wood chip", 4.5): wide}, every())["dwell-1"].because == "criterion"


def test_much_shorter_is_open_where_half_and_twice_our_tenth_do_not_agree():
    for shorter, verdict, because in (
        (0.85, claims.NOT_DECIDABLE, "criterion"),
        (0.97, claims.NOT_REPRODUCED, "twin"),
        (1.05, claims.NOT_REPRODUCED, "twin"),
    ):
        judged = dwell(every(shorter=shorter))["dwell-3"]
        assert (judged.verdict, judged.because) == (verdict, because)


@pytest.mark.parametrize("few", [{"ending": "lost"}, {"count": 5}, {"refused": "leaves the kiln"}])
def test_without_complete_flights_nothing_about_dwell_is_decided(few):
    judged = dwell(every(), **few)
    assert {each.verdict for each in judged.values()} == {claims.NOT_DECIDABLE}
    assert {each.because for each in judged.values()} == {"chain"}


def test_lost_flights_have_velocities_and_refused_ones_decide_nothing():
    assert velocity(every(), ending="lost")["vel-1"].verdict == claims.REPRODUCED
    judged = velocity(every(), refused="leaves the kiln")
    assert {each.verdict for each in judged.values()} == {claims.NOT_DECIDABLE}


def test_measures_of_the_regression_to_which_the_pose_was_fitted_are_no_result():
    """As in print: z is far off in mm, nearest in per cent, and R2 is worst in z of shreds."""
    rows = [
        {"fraction": name, "pressure_bar": bar, "particle": k}
        for name, bar in KEYS
        for k in range(20)
    ]
    least = {"x": 6.0, "y": 5.0, "z": 2.0}
    columns = {f"mape_{axis}_percent": value for axis, value in least.items()}
    columns |= {f"r2_{axis}": value for axis, value in {"x": 0.98, "y": 0.99, "z": 0.9}.items()}
    trajectories = pd.DataFrame(rows).assign(**columns)
    made = results(every(), count=20)
    tables = made.tables._replace(trajectories=trajectories)
    table = pd.DataFrame(
        {"fraction": name, "axis": axis, "rmse_mm": rmse, "mape_percent": least[axis]}
        | {"r2": 0.5 if (name, axis) == ("paper shred", "z") else 0.9 if axis == "z" else 0.98}
        for name in FRACTIONS
        for axis, rmse in {"x": 6.0, "y": 7.0, "z": 150.0}.items()
    )
    orders = pd.DataFrame({"order": [6, 7], "axis": "x", "r2_adjusted": [0.99, 0.991]})
    judged = flight_claims.regression_verdicts(tables, table, orders, SCENE)
    by_id = {each.id: each for each in judged}
    assert {name: each.verdict for name, each in by_id.items()} == {
        "fit-1": claims.NOT_DECIDABLE,
        "fit-2": claims.NOT_DECIDABLE,
        "fit-3": claims.REPRODUCED,
        "fit-4": claims.REPRODUCED,
    }
    assert "agrees, but the pose was fitted to the printed MAPE of z" in by_id["fit-2"].reason
    off = table.assign(mape_percent=table["mape_percent"].where(table["axis"] != "z", 9.0))
    missed = flight_claims.regression_verdicts(tables, off, orders, SCENE)
    assert {each.id: each.verdict for each in missed}["fit-2"] == claims.NOT_REPRODUCED


def test_velocities_are_judged_beside_the_truth_and_what_was_fitted_is_no_result():
    judged = velocity(every())
    assert set(judged) == {f"vel-{k}" for k in range(1, 7)}
    assert judged["vel-1"].verdict == claims.REPRODUCED
    assert judged["vel-2"].verdict != claims.REPRODUCED
    assert "remaining particles with lost flights as ended: " in judged["vel-4"].reason
    swapped = {(a, b): flights({"wood chip": "confetti"}.get(a, a), b) for a, b in KEYS}
    swapped |= {("confetti", bar): flights("wood chip", bar) for bar in PRESSURES_BAR}
    assert velocity(swapped, every())["vel-1"].because == "chain"
    assert velocity(swapped)["vel-1"].because == "twin"


def test_a_ratio_of_velocities_is_open_where_its_interval_decides_otherwise():
    """5.3.1: 5 bar changes little. A bound of ours; 1.5 is out of it, unless it scatters."""
    for spread, verdict in ((0.05, claims.NOT_REPRODUCED), (8.0, claims.NOT_DECIDABLE)):
        speed = flights("wood chip", 4.5).velocity_m_s
        first = 1.5 * np.median(speed[:, 0]) + np.linspace(-spread, spread, len(speed))
        faster = speed.copy()
        faster[:, 0] = first
        fast = flights("wood chip", 4.5)._replace(velocity_m_s=faster)
        judged = velocity(every() | {("wood chip", 5.0): fast})["vel-6"]
        assert judged.verdict == verdict
        assert "95 % intervals of the ratios: " in judged.reason
    assert judged.because == "criterion"


def test_a_ratio_of_too_few_particles_is_open():
    few = flights("wood chip", 4.5)
    speed = few.velocity_m_s.copy()
    speed[5:, 0] = np.nan
    judged = velocity(every() | {("wood chip", 5.0): few._replace(velocity_m_s=speed)})["vel-6"]
    assert (judged.verdict, judged.because) == (claims.NOT_DECIDABLE, "criterion")
